"""Forces, energies and tangents of solid-shell elements, one by one, compiled by DOLFINx from their energy."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix.ufl
import ufl
from dolfinx import fem
from dolfinx import mesh as meshes
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from valvefsi.solid.elements.shell_forces import AssembledForces, Energies, PointForces
from valvefsi.solid.elements.shell_kernels import monomials
from valvefsi.solid.elements.shell_kinematics import (
    KnownRatio,
    Metric,
    ShellKinematics,
    StressFreeKinematics,
    assumed_metric,
    assumed_shear,
    assumed_thickness,
    base_vectors,
    volume_density,
)

if TYPE_CHECKING:
    from petsc4py import PETSc
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material, Volumetric
    from valvefsi.types import Array, Indices

    Place = tuple[Expr | float, Expr | float, Expr | float]

MODES = 7
"""Monomials of an element's position but the constant one."""


class Part(NamedTuple):
    """A part of an energy: strains q(m), energy of them per cell of the reference coordinates, measure."""

    strains: Callable[[Expr], Expr]
    energy: Callable[[Expr], Expr]
    dx: ufl.Measure

    def stress(self, q: Expr) -> Expr:
        """Return the derivative of the energy by the strains."""
        strains = ufl.variable(q)
        return ufl.diff(self.energy(strains), strains)

    def rate(self, m: fem.Function, test: Expr) -> Expr:
        """Return the derivative of the strains by the monomials along ``test``."""
        return ufl.derivative(self.strains(m), m, test)


class ShellCells:
    """The elements of a body as independent cells, each with the 7 x 3 monomials of its position as unknowns.

    The energy of a cell, integrated by 2 x 2 points along the layer and ``points`` through the thickness, is

        E = int W(C) dX + sum_columns U_1(J) dX + U_2(J of the cell) V

    with C of `ShellKinematics`; of a compressible material C of `StressFreeKinematics` and, in place of U_1 and U_2,
    (lam + 2 mu)/2 e^2, e the strain along the normal beside the one that leaves no stress there.
    DOLFINx compiles it and its tangent on a mesh of separate cells, `shell_forces` its gradient; the cells have the
    coordinates (xi, eta, zeta), so that nothing of the real mesh is in the forms but the monomials.

    Args:
        X: Corners of the elements, node i + 2 j + 4 l, the thickness along l, ``(num_cells, 8, 3)`` [cm].
        material: Energy W of an incompressible body, or one with ``thinning``, see `Material`.
        columns: Volumetric energy U_1 of each column of points through the thickness.
        mean: Volumetric energy U_2 of the whole cell.
        points: Gauss points through the thickness.
        fibres: Unit vectors of each cell by name, ``(num_cells, 3)`` each.
    """

    def __init__(
        self,
        X: Array,
        material: Material,
        *,
        columns: Volumetric,
        mean: Volumetric,
        points: int,
        fibres: Mapping[str, Array],
    ) -> None:
        self.num_cells, self.points = len(X), points
        self.mesh, self.order = _separate_cells(len(X))
        space = fem.functionspace(self.mesh, ("DG", 0, (MODES, 3)))
        self._space = space
        self.m, self.M, self.last = (fem.Function(space, name=name) for name in ("m", "M", "last"))
        self.X = np.ascontiguousarray(X[self.order]).reshape(-1, 3)
        self._own = np.arange(8 * len(X), dtype=np.int32).reshape(-1, 8)
        monomials(self.M.x.array.reshape(-1, MODES, 3), self.X, self._own)
        self.m.x.array[:] = self.last.x.array[:] = self.M.x.array
        self.fibres = {name: self._constant(vectors) for name, vectors in fibres.items()}
        self.at = tuple(ufl.SpatialCoordinate(self.mesh))
        self.bulk_factor = fem.Constant(self.mesh, 1.0)
        self._material, self._columns, self._mean = material, columns, mean
        self._thinning = getattr(material, "thinning", None)
        self._normal_modulus = getattr(material, "normal_modulus", 0.0)

    def _constant(self, vectors: Array) -> fem.Function:
        field = fem.Function(fem.functionspace(self.mesh, ("DG", 0, (3,))))
        field.x.array[:] = np.asarray(vectors, dtype=np.float64)[self.order].ravel()
        return field

    @functools.cached_property
    def _parts(self) -> list[Part]:
        """What the energy of a cell is the sum of."""
        parts = [Part(self._layer_strains, self._strain_energy, self.measure(self.points))]
        if self._thinning is not None:
            parts.append(Part(self._normal_strains, self._normal_energy, self.measure(1)))
        if self._columns.kappa > 0:
            parts.append(Part(self._column_strains, self._column_energy, self.measure(1)))
        if self._mean.kappa > 0:
            parts.append(Part(self._mean_strains, self._mean_energy, self.measure(1, 1)))
        return parts

    def measure(self, through: int, along: int = 2) -> ufl.Measure:
        """Return the measure with Gauss points along the layer and through the thickness."""
        points, weights = gauss(along, along, through)
        metadata = {"quadrature_rule": "custom", "quadrature_points": points, "quadrature_weights": weights}
        return ufl.Measure("dx", domain=self.mesh, metadata=metadata)

    @property
    def _density(self) -> Expr:
        """Volume per volume of the reference coordinates, of right- and left-handed cells."""
        return abs(volume_density(self.M, self.at))

    def _layer_strains(self, m: Expr) -> Expr:
        return ufl.as_vector(list(assumed_metric(m, self.M, self.at)))

    def _strain_energy(self, strains: Expr) -> Expr:
        return self.energy_of(_metric(strains)) * self._density

    def kinematics_of(self, metric: Metric, at: Place | None = None) -> ShellKinematics:
        """Return what an energy may depend on, of a metric, at a place in the cell (default: the integration's)."""
        frame = base_vectors(self.M, at or self.at)
        if self._thinning is None:
            return ShellKinematics(metric, frame, self.fibres)
        return StressFreeKinematics(metric, frame, self.fibres, self._thinning)

    def energy_of(self, metric: Metric) -> Expr:
        """Return W of a metric."""
        return self._material.energy(self.kinematics_of(metric))

    def _column_strains(self, m: Expr) -> Expr:
        return ufl.as_vector([volume_density(m, self.at) / volume_density(self.M, self.at)])

    def _column_energy(self, strains: Expr) -> Expr:
        return self._columns.energy(KnownRatio(strains[0])) * self._density

    def _normal_strains(self, m: Expr) -> Expr:
        return ufl.as_vector([self._growth(m, self.at), *assumed_metric(m, self.M, self.at)])

    def _normal_energy(self, strains: Expr) -> Expr:
        excess = self._excess(strains[0], _metric(strains, 1), self.at)
        return self._normal_modulus / 2 * excess**2 * self._density

    def _growth(self, m: Expr, at: Place) -> Expr:
        """Return how c_33 of the nodes has changed."""
        return assumed_thickness(m, at) - assumed_thickness(self.M, at)

    def _excess(self, growth: Expr, metric: Metric, at: Place) -> Expr:
        """Return the strain along the normal beside the one that leaves no stress there."""
        kinematics = self.kinematics_of(metric, at)
        assert isinstance(kinematics, StressFreeKinematics)
        normal = kinematics.dual[2]
        return (growth - kinematics.growth) / 2 * ufl.inner(normal, normal)

    def _mean_strains(self, m: Expr) -> Expr:
        return ufl.as_vector([_volume(m) / _volume(self.M)])

    def _mean_energy(self, strains: Expr) -> Expr:
        return self.bulk_factor * self._mean.energy(KnownRatio(strains[0])) * abs(_volume(self.M)) / 8

    def stress(self) -> tuple[Expr, Expr]:
        """Return the derivative of the energy by the metric, ``(5,)``, and by c_33, that of the middle [dyn/cm^2]."""
        here = ufl.variable(self._layer_strains(self.m))
        c = ufl.diff(self.energy_of(_metric(here)), here)
        if self._thinning is None:
            return c, 0.0 * c[0]
        middle = (self.at[0], self.at[1], 0.0)
        strains = [self._growth(self.m, middle), *assumed_metric(self.m, self.M, middle)]
        there = ufl.variable(ufl.as_vector(strains))
        excess = self._excess(there[0], _metric(there, 1), middle)
        more = ufl.diff(self._normal_modulus / 2 * excess**2, there)
        return c + ufl.as_vector([more[i] for i in range(1, 6)]), more[0]

    def pressure(self) -> Expr:
        """Return U_1' at J of the column through the point and U_2' at that of the cell [dyn/cm^2]."""
        xi, eta, _ = self.at
        middle = (xi, eta, 0.0)
        column = ufl.variable(volume_density(self.m, middle) / volume_density(self.M, middle))
        cell = ufl.variable(_volume(self.m) / _volume(self.M))
        pairs = (self._columns, column), (self._mean, cell)
        return sum(ufl.diff(U.energy(KnownRatio(J)), J) for U, J in pairs if U.kappa > 0) + 0.0 * xi

    def forces(self) -> Array:
        """Return -dE/dm at the present monomials, ``(num_cells, 7, 3)``; the next call overwrites them."""
        return self._forces()

    @functools.cached_property
    def _forces(self) -> Callable[[], Array]:
        """What works the forces out: written out for incompressible materials, any energy's by DOLFINx."""
        return self.assembled() if self._thinning is not None else self._written_out()

    def assembled(self) -> AssembledForces:
        """Return the forces by DOLFINx from the energy's form."""
        test = ufl.TestFunction(self._space)
        work = sum(
            ufl.inner(part.stress(part.strains(self.m)), part.rate(self.m, test)) * part.dx
            for part in self._parts
        )
        return AssembledForces(-work, self.m)

    def _written_out(self) -> PointForces:
        """Return the forces by the loop over points."""
        columns, mean = ((U.energy if U.kappa > 0 else None) for U in (self._columns, self._mean))
        energies = Energies(self._material.energy, columns, mean, self.bulk_factor)
        points, weights = gauss(2, 2, self.points)
        middle, _ = gauss(2, 2, 1)
        V = volume_density(self.M, self.at)
        at_rest = assumed_metric(self.M, self.M, self.at)
        short = (
            metric - shear for metric, shear in zip(at_rest[3:], assumed_shear(self.M, self.at), strict=True)
        )
        dual = ShellKinematics(at_rest, base_vectors(self.M, self.at)).dual
        rest = [*(vector[d] for vector in dual for d in range(3)), V, *short]
        return PointForces(
            energies,
            self.m,
            self.fibres,
            rest=self._tabulated(rest, points),
            volumes=self._tabulated([V], middle)[..., 0],
            rule=(points[: self.points, 2].copy(), weights),
        )

    def _tabulated(self, values: list[Expr], points: Array) -> Array:
        """Return expressions at points of all cells, ``(num_cells, num_points, num_values)``."""
        compiled = compat.compile_expression(ufl.as_vector(values), points, MPI.COMM_SELF)
        table = compat.evaluate(compiled, self.mesh, np.arange(self.num_cells))
        return table.reshape(self.num_cells, len(points), len(values))

    def scale_bulk(self, factor: float) -> None:
        """Multiply the energy U_2 by a factor from now on."""
        self.bulk_factor.value = factor

    @functools.cached_property
    def _tangent(self) -> tuple[fem.Form, PETSc.Mat]:
        test, trial, m, last = (
            ufl.TestFunction(self._space),
            ufl.TrialFunction(self._space),
            self.m,
            self.last,
        )
        K = None
        for part in self._parts:
            q = part.strains(last)
            linear = q + ufl.derivative(q, last, m - last)
            rate = part.rate(m, test)
            material = ufl.inner(ufl.derivative(part.stress(part.strains(m)), m, trial), rate)
            geometric = ufl.inner(part.stress(linear), ufl.derivative(rate, m, trial))
            K = (material + geometric) * part.dx + (0 if K is None else K)
        form = compat.compile_form(K)
        return form, fem_petsc.create_matrix(form)

    def start(self) -> None:
        """Take the present monomials for those that the next tangents are linearised about."""
        self.last.x.array[:] = self.m.x.array

    def tangents(self) -> Array:
        """Return the second derivatives of E by the monomials, ``(num_cells, 21, 21)``.

        With q(m) the strains, E' = E_q q' and E'' = q' E_qq q' + E_q q''. The stress E_q before q'' is that of the
        strains that the last linear step promised, q + q' dm, not those that the nodes have now: an element that turns
        in a linear step is lengthened by it, and the stress of that, which the next step takes away, would spoil it.
        It is Newton's method with the stress of each point as an unknown of its own, and the same solution
        (Magisano, Leonetti and Garcea 2017, Int. J. Numer. Meth. Engng 109).
        """
        form, matrix = self._tangent
        matrix.zeroEntries()
        fem_petsc.assemble_matrix(matrix, form)
        matrix.assemble()
        _, _, values = matrix.getValuesCSR()  # one block a cell, its columns in order
        self.start()
        return values.reshape(self.num_cells, MODES * 3, MODES * 3)

    @functools.cached_property
    def _energy_form(self) -> fem.Form:
        return compat.compile_form(sum(part.energy(part.strains(self.m)) * part.dx for part in self._parts))

    def energy(self) -> float:
        """Return the energy of all cells [erg]."""
        return float(fem.assemble_scalar(self._energy_form))

    @functools.cached_property
    def _ratio(self) -> fem.Expression:
        points, _ = gauss(2, 2, 1)
        J = volume_density(self.m, self.at) / volume_density(self.M, self.at)
        return compat.compile_expression(J, points, MPI.COMM_SELF)

    def column_ratios(self) -> Array:
        """Return J of the columns, ``(num_cells, 4)``."""
        return compat.evaluate(self._ratio, self.mesh, np.arange(self.num_cells))

    @functools.cached_property
    def _volume_form(self) -> fem.Form:
        return compat.compile_form(volume_density(self.m, self.at) * self.measure(2))

    def volume(self) -> float:
        """Return the volume of all cells [cm^3]."""
        return float(fem.assemble_scalar(self._volume_form))

    def in_order(self, values: Array) -> Array:
        """Return rows of the separate cells in the order that they were made in."""
        out = np.empty_like(values)
        out[self.order] = values
        return out


def _metric(strains: Expr, first: int = 0) -> Metric:
    """Return five of the strains as a metric."""
    return Metric(*(strains[first + i] for i in range(5)))


def _volume(m: Expr) -> Expr:
    """Return the volume of a cell by the midpoints of its 2 x 2 columns."""
    g = 1 / math.sqrt(3)
    return 2 * sum(volume_density(m, (i * g, j * g, 0.0)) for i in (-1, 1) for j in (-1, 1))


def gauss(*counts: int) -> tuple[Array, Array]:
    """Return points ``(n, 3)`` and weights of the Gauss rule of the cube from -1 to 1, the last axis fastest."""
    lines = [np.polynomial.legendre.leggauss(k) for k in counts]
    points = np.stack(np.meshgrid(*(x for x, _ in lines), indexing="ij"), axis=-1).reshape(-1, len(counts))
    weights = functools.reduce(np.multiply.outer, (w for _, w in lines)).ravel()
    return points, weights


def _separate_cells(count: int) -> tuple[meshes.Mesh, Indices]:
    """Return a mesh of unconnected reference tetrahedra, and the number that each of them was made with.

    Their coordinates are those of the reference cell, whatever points of it an integral asks for.
    """
    corners = np.vstack([np.zeros(3), np.eye(3)])
    element = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    cells = np.arange(4 * count, dtype=np.int64).reshape(-1, 4)
    mesh = meshes.create_mesh(MPI.COMM_SELF, cells=cells, x=np.tile(corners, (count, 1)), e=element)
    return mesh, np.asarray(mesh.topology.original_cell_index)
