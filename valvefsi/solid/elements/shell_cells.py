"""Forces, energies and tangents of solid-shell elements, one by one, compiled by DOLFINx from their energy."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix.ufl
import ufl
from dolfinx import fem
from dolfinx import mesh as meshes
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI

from valvefsi.solid.elements.packing import PackedFunctions
from valvefsi.solid.elements.shell_kernels import monomials
from valvefsi.solid.elements.shell_kinematics import (
    Metric,
    ShellKinematics,
    assumed_metric,
    base_vectors,
    volume_density,
)

if TYPE_CHECKING:
    from petsc4py import PETSc
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material, Volumetric
    from valvefsi.types import Array, Indices

MODES = 7
"""Monomials of an element's position but the constant one."""


class ShellCells:
    """The elements of a body as independent cells, each with the 7 x 3 monomials of its position as unknowns.

    The energy of a cell, integrated by 2 x 2 points along the layer and ``points`` through the thickness, is

        E = int W(C) dX + sum_columns U_1(J) dX + U_2(J of the cell) V

    with C of `ShellKinematics`. DOLFINx compiles it, its gradient and its tangent on a mesh of separate cells; the
    cells have the coordinates (xi, eta, zeta), so that nothing of the real mesh is in the forms but the monomials.

    Args:
        X: Corners of the elements, node i + 2 j + 4 l, the thickness along l, ``(num_cells, 8, 3)`` [cm].
        material: Energy W of an incompressible body.
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
        self.m, self.M = fem.Function(space, name="m"), fem.Function(space, name="M")
        self.X = np.ascontiguousarray(X[self.order]).reshape(-1, 3)
        self._own = np.arange(8 * len(X), dtype=np.int32).reshape(-1, 8)
        monomials(self.M.x.array.reshape(-1, MODES, 3), self.X, self._own)
        self.m.x.array[:] = self.M.x.array
        self.fibres = {name: self._constant(vectors) for name, vectors in fibres.items()}
        self.at = tuple(ufl.SpatialCoordinate(self.mesh))
        self.bulk_factor = fem.Constant(self.mesh, 1.0)
        self._material, self._columns, self._mean = material, columns, mean
        self._compile()

    def _constant(self, vectors: Array) -> fem.Function:
        field = fem.Function(fem.functionspace(self.mesh, ("DG", 0, (3,))))
        field.x.array[:] = np.asarray(vectors, dtype=np.float64)[self.order].ravel()
        return field

    @functools.cached_property
    def _parts(self) -> list[tuple[Callable[[Expr], Expr], ufl.Measure]]:
        """Energies per cell of the reference coordinates as functions of the monomials, each with its measure."""
        parts: list[tuple[Callable[[Expr], Expr], ufl.Measure]] = [
            (self._strain_energy, self.measure(self.points))
        ]
        if self._columns.kappa > 0:
            parts.append((self._column_energy, self.measure(1)))
        if self._mean.kappa > 0:
            parts.append((self._mean_energy, self.measure(1, 1)))
        return parts

    def measure(self, through: int, along: int = 2) -> ufl.Measure:
        """Return the measure with Gauss points along the layer and through the thickness."""
        points, weights = gauss(along, along, through)
        metadata = {"quadrature_rule": "custom", "quadrature_points": points, "quadrature_weights": weights}
        return ufl.Measure("dx", domain=self.mesh, metadata=metadata)

    def _strain_energy(self, m: Expr) -> Expr:
        return self.energy_of(assumed_metric(m, self.M, self.at)) * volume_density(self.M, self.at)

    def energy_of(self, metric: Metric) -> Expr:
        """Return W of a metric."""
        return self._material.energy(ShellKinematics(metric, base_vectors(self.M, self.at), self.fibres))

    def _column_energy(self, m: Expr) -> Expr:
        V = volume_density(self.M, self.at)
        return self._columns.energy(_Volume(volume_density(m, self.at) / V)) * V

    def _mean_energy(self, m: Expr) -> Expr:
        V = _volume(self.M)
        return self.bulk_factor * self._mean.energy(_Volume(_volume(m) / V)) * V / 8

    def pressure(self) -> Expr:
        """Return U_1' at J of the column through the point and U_2' at that of the cell [dyn/cm^2]."""
        xi, eta, _ = self.at
        middle = (xi, eta, 0.0)
        column = ufl.variable(volume_density(self.m, middle) / volume_density(self.M, middle))
        cell = ufl.variable(_volume(self.m) / _volume(self.M))
        pairs = (self._columns, column), (self._mean, cell)
        return sum(ufl.diff(U.energy(_Volume(J)), J) for U, J in pairs if U.kappa > 0) + 0.0 * xi

    def _compile(self) -> None:
        test, trial = ufl.TestFunction(self._space), ufl.TrialFunction(self._space)
        metric = assumed_metric(self.m, self.M, self.at)
        strain = ufl.variable(ufl.as_vector(list(metric)))
        W = self.energy_of(Metric(*(strain[i] for i in range(5))))
        S = ufl.diff(W, strain)
        rate = ufl.derivative(ufl.as_vector(list(metric)), self.m, test)
        work = ufl.inner(S, rate) * volume_density(self.M, self.at) * self.measure(self.points)
        for energy, dx in self._parts[1:]:
            work += ufl.derivative(energy(self.m), self.m, test) * dx
        self._work, self._trial = work, trial
        self._force_form = compat.compile_form(-work)
        self._constants = compat.pack_constants(self._force_form)
        self._coefficients = PackedFunctions(self._force_form, self.m)
        self._out = np.zeros(self.num_cells * MODES * 3)

    def forces(self) -> Array:
        """Return -dE/dm at the present monomials, ``(num_cells, 7, 3)``; the next call overwrites them."""
        self._out[:] = 0.0
        fem.assemble_vector(self._out, self._force_form, self._constants, self._coefficients())
        return self._out.reshape(-1, MODES, 3)

    def scale_bulk(self, factor: float) -> None:
        """Multiply the energy U_2 by a factor from now on."""
        self.bulk_factor.value = factor
        self._constants = compat.pack_constants(self._force_form)

    @functools.cached_property
    def _tangent(self) -> tuple[fem.Form, PETSc.Mat]:
        form = compat.compile_form(ufl.derivative(self._work, self.m, self._trial))
        return form, fem_petsc.create_matrix(form)

    def tangents(self) -> Array:
        """Return the second derivatives of E by the monomials, ``(num_cells, 21, 21)``."""
        form, matrix = self._tangent
        matrix.zeroEntries()
        fem_petsc.assemble_matrix(matrix, form)
        matrix.assemble()
        _, _, values = matrix.getValuesCSR()  # one block a cell, its columns in order
        return values.reshape(self.num_cells, MODES * 3, MODES * 3)

    @functools.cached_property
    def _energy_form(self) -> fem.Form:
        return compat.compile_form(sum(energy(self.m) * dx for energy, dx in self._parts))

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


class _Volume:
    """What a volumetric energy asks of the kinematics."""

    def __init__(self, J: Expr) -> None:
        self.J, self.log_J = J, ufl.ln(J)


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
