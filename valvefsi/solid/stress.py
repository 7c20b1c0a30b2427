"""Stress and strain of a deformed body, at quadrature points or projected to the nodes of its mesh.

Tensors are three-dimensional; in two dimensions the body is in plane strain and carries a normal stress out of its
plane, which von Mises' stress needs.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix
import dolfinx
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from petsc4py import PETSc

from valvefsi.errors import CaseError
from valvefsi.solid.elements.numbering import number_nodes
from valvefsi.solid.materials import Volumetric
from valvefsi.solid.materials.kinematics import Kinematics

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from types import TracebackType

    from numpy.typing import NDArray
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material
    from valvefsi.solid.materials.parameters import Direction
    from valvefsi.solid.statics import StaticSolution
    from valvefsi.types import Array

QUANTITIES = (
    "pk1",
    "pk2",
    "cauchy",
    "principal_stresses",
    "von_mises",
    "principal_stretches",
    "fibre_stretch",
    "J",
)
"""What can be asked for."""

LABELS = {
    "pk1": "first Piola-Kirchhoff stress [dyn/cm^2]",
    "pk2": "second Piola-Kirchhoff stress [dyn/cm^2]",
    "cauchy": "Cauchy stress [dyn/cm^2]",
    "principal_stresses": "principal stresses [dyn/cm^2]",
    "von_mises": "von Mises stress [dyn/cm^2]",
    "principal_stretches": "principal stretches [-]",
    "fibre_stretch": "fibre stretch [-]",
    "J": "J [-]",
}
"""Names in files and pictures."""
OF_CAUCHY = ("principal_stresses", "von_mises")
"""What follows from the Cauchy stress."""


class Stress:
    """Stress and strain of a body, evaluated at its present deformation at every call.

        P = dW/dF + dU/dF - p J F^-T,  S = F^-1 P,  sigma = P F^T / J,
        von Mises sqrt(3/2 dev sigma : dev sigma), principal values of sigma,
        stretches: roots of the eigenvalues of F^T F, |F f|

    Args:
        motion: The displacement, or the position if ``of_position``.
        material: Isochoric energy W.
        of_position: Whether ``motion`` is the position chi rather than u.
        pressure: Pressure p of an incompressible body, positive in compression; None for none.
        kappa: Numerical bulk modulus of U(J); 0 leaves it out [dyn/cm^2].
        fibres: Fibre fields by name, as the material's directions name them.
        fibre: The direction whose stretch is "fibre_stretch": a field's name, an angle [deg] or a vector.
        quadrature_degree: Degree of the quadrature whose points are meant.

    Note:
        Collective.
    """

    def __init__(
        self,
        motion: fem.Function,
        material: Material,
        *,
        of_position: bool = False,
        pressure: fem.Function | None = None,
        kappa: float = 0.0,
        fibres: Mapping[str, Expr] | None = None,
        fibre: Direction | None = None,
        quadrature_degree: int = 4,
    ) -> None:
        self.motion, self.of_position = motion, of_position
        self.mesh = motion.function_space.mesh
        self.dim, self.has_fibre = self.mesh.geometry.dim, fibre is not None
        self.degree = quadrature_degree
        self.points, self.weights = basix.make_quadrature(self.mesh.basix_cell(), quadrature_degree)
        F = ufl.variable(self._gradient())
        kinematics = _Embedded(F, fibres, self.dim)
        W = material.energy(kinematics)
        if kappa > 0:
            W = W + Volumetric(kappa=kappa).energy(kinematics)
        if pressure is not None:
            W = W - pressure * (kinematics.J - 1)
        P = ufl.diff(W, F)
        parts = [F[i, j] for i in range(3) for j in range(3)] + [P[i, j] for i in range(3) for j in range(3)]
        parts.append(abs(ufl.JacobianDeterminant(self.mesh)))
        if fibre is not None:
            parts += [kinematics.vector(fibre)[i] for i in range(3)]
        self._expression = compat.compile_expression(ufl.as_vector(parts), self.points, self.mesh.comm)

    def _gradient(self) -> Expr:
        """Return the three-dimensional F."""
        H = ufl.grad(self.motion)
        if not self.of_position:
            H = ufl.Identity(self.dim) + H
        if self.dim == 3:
            return ufl.as_tensor([[H[i, j] for j in range(3)] for i in range(3)])
        return ufl.as_tensor([[H[0, 0], H[0, 1], 0.0], [H[1, 0], H[1, 1], 0.0], [0.0, 0.0, 1.0]])

    def _evaluate(self) -> tuple[Array, Array, Array, Array | None]:
        """Return F, P, the cell's |det dX/dxi| and the fibres at the points of owned cells."""
        num_cells = self.mesh.topology.index_map(self.mesh.topology.dim).size_local
        values = compat.evaluate(self._expression, self.mesh, np.arange(num_cells, dtype=np.int32))
        values = values.reshape(num_cells, len(self.points), -1)
        F, P = (values[..., 9 * k : 9 * k + 9].reshape(*values.shape[:2], 3, 3) for k in range(2))
        return F, P, values[..., 18], values[..., 19:22] if self.has_fibre else None

    def at_points(self, *names: str) -> dict[str, Array]:
        """Return quantities at the quadrature points of this rank's cells.

        Args:
            names: Names of `QUANTITIES`.

        Returns:
            By name ``(num_cells, num_points)`` scalars, ``(..., 3)`` principal values from the largest to the
            smallest, or ``(..., 3, 3)`` tensors.

        Raises:
            CaseError: A name is unknown, or there is no fibre for "fibre_stretch".
        """
        for name in names:
            if name not in QUANTITIES:
                raise CaseError(f"expected one of {', '.join(QUANTITIES)}", key="quantity", value=name)
        F, P, _, fibre = self._evaluate()
        if fibre is None and "fibre_stretch" in names:
            raise CaseError("this body has no fibres", key="quantity", value="fibre_stretch")
        return {name: _quantity(name, F, P, fibre) for name in names}

    @functools.cached_property
    def measure(self) -> Array:
        """The reference cells' |det dX/dxi| at the quadrature points of this rank, ``(num_cells, num_points)``."""
        return self._evaluate()[2].copy()

    def point_volumes(self) -> Array:
        """Return the reference volume that each quadrature point stands for, ``(num_cells, num_points)``."""
        return self.measure * self.weights

    @staticmethod
    def projected(*names: str) -> set[str]:
        """Return the quantities at the points that those at the nodes follow from."""
        return {"cauchy" if name in OF_CAUCHY else name for name in names}

    def at_nodes(self, *names: str, values: Mapping[str, Array] | None = None) -> dict[str, fem.Function]:
        """Return quantities as functions of first degree, by L2 projection.

        Von Mises' stress is that of the projected Cauchy stress, and so never negative; principal stresses are, too.

        Args:
            names: Names of `QUANTITIES`.
            values: What they follow from at the points now, see `projected`; evaluated here if left out.

        Note:
            Collective.
        """
        needed = sorted(self.projected(*names))
        values = self.at_points(*needed) if values is None else values
        with _Projection(self._nodal) as projection:
            nodes = {name: projection.project(values[name], self.measure, name) for name in needed}
        if "von_mises" in names:
            nodes["von_mises"] = equivalent = fem.Function(self._nodal.space(1), name="von_mises")
            equivalent.x.array[:] = _von_mises(nodes["cauchy"].x.array.reshape(-1, 3, 3))
        if "principal_stresses" in names:
            nodes["principal_stresses"] = fem.Function(self._nodal.space(3), name="principal_stresses")
            principal = nodes["principal_stresses"]
            principal.x.array[:] = _principal(nodes["cauchy"].x.array.reshape(-1, 3, 3)).ravel()
        return {name: nodes[name] for name in names}

    @functools.cached_property
    def _nodal(self) -> _Nodal:
        return _Nodal(self.mesh, self.points, self.weights, self.degree)

    @functools.cached_property
    def _motion_space(self) -> fem.FunctionSpace:
        degree = self.motion.function_space.ufl_element().degree
        return fem.functionspace(self.mesh, ("Lagrange", degree, (self.dim,)))

    def gather(
        self, *names: str, values: Mapping[str, Array] | None = None
    ) -> tuple[Array, dict[int, NDArray[np.int64]], dict[str, Array], Array] | None:
        """Gather the deformed mesh and projected quantities for pictures and files.

        Args:
            names: Names of `QUANTITIES`; none for all there are.
            values: As of `at_nodes`.

        Returns:
            On rank 0 the positions of the nodes ``(n, 3)``, ``{VTK cell type: nodes (num_cells, k)}``, the
            quantities of the nodes by their `LABELS`, flat, and the reference positions; None elsewhere.

        Note:
            Collective.
        """
        names = names or tuple(q for q in QUANTITIES if q != "fibre_stretch" or self.has_fibre)
        functions = self.at_nodes(*names, values=values)
        space, degree = self._motion_space, self.motion.function_space.ufl_element().degree
        motion = fem.Function(space)
        motion.interpolate(self.motion)
        ids, X, position = _rows(motion)
        if not self.of_position:
            position += X[:, : self.dim]
        position = np.pad(position, ((0, 0), (0, 3 - self.dim)))
        fields = {LABELS[name]: _rows(_at_degree(f, degree)) for name, f in functions.items()}
        kind, cells = compat.vtk_cells(space)
        part = (ids, position, X, fields, kind, _with_ghosts(space, ids)[cells])
        parts = self.mesh.comm.gather(part, root=0)
        return None if parts is None else _assembled(parts)


class _Embedded(Kinematics):
    """Three-dimensional kinematics of a body whose directions may have two components (plane strain)."""

    def __init__(self, F: Expr, fibres: Mapping[str, Expr] | None, dim: int) -> None:
        super().__init__(F, fibres)
        plane = ufl.as_tensor([[F[i, j] for j in range(dim)] for i in range(dim)])
        self._plane = Kinematics(plane, fibres)

    def vector(self, direction: Direction) -> Expr:
        """Return the unit vector of a direction, ``(3,)``."""
        flat = self._plane.vector(direction)
        return ufl.as_vector([flat[i] if i < self._plane.dim else 0.0 for i in range(3)])


def stress_of_solution(solution: StaticSolution, material: Material, **options: Any) -> Stress:
    """Return the stress of an incompressible static solution; options as of `Stress` (collective)."""
    return Stress(solution.displacement, material, pressure=solution.pressure, **options)


def _quantity(name: str, F: Array, P: Array, fibre: Array | None) -> Array:
    """Return one quantity from F and P ``(..., 3, 3)``."""
    if name == "pk1":
        return P
    if name == "pk2":
        return np.linalg.solve(F, P)
    J = np.linalg.det(F)
    if name == "J":
        return J
    if name == "fibre_stretch":
        assert fibre is not None  # or this quantity is not offered
        return np.linalg.norm(np.einsum("...ij,...j->...i", F, fibre), axis=-1)
    if name == "principal_stretches":
        return np.linalg.svd(F, compute_uv=False)
    sigma = P @ np.swapaxes(F, -1, -2) / J[..., None, None]
    if name == "cauchy":
        return sigma
    return _von_mises(sigma) if name == "von_mises" else _principal(sigma)


def _principal(sigma: Array) -> Array:
    """Return the principal values of stresses ``(..., 3, 3)``, the largest first, ``(..., 3)``."""
    return np.linalg.eigvalsh(0.5 * (sigma + np.swapaxes(sigma, -1, -2)))[..., ::-1]


def _von_mises(sigma: Array) -> Array:
    """Return von Mises' equivalent of stresses ``(..., 3, 3)``."""
    deviator = sigma - np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=(-2, -1)))


class _Nodal:
    """Functions of first degree, and what their projection takes from the mesh alone."""

    def __init__(self, mesh: dolfinx.mesh.Mesh, points: Array, weights: Array, degree: int) -> None:
        self.mesh, self.spaces = mesh, {1: fem.functionspace(mesh, ("Lagrange", 1))}
        u, v = ufl.TrialFunction(self.spaces[1]), ufl.TestFunction(self.spaces[1])
        self.form = compat.compile_form(u * v * ufl.dx(domain=mesh, degree=degree))
        self.shapes = self.spaces[1].element.basix_element.tabulate(0, points)[0, :, :, 0] * weights[:, None]

    def space(self, width: int) -> fem.FunctionSpace:
        """Return the space of functions of so many components."""
        if width not in self.spaces:
            self.spaces[width] = fem.functionspace(self.mesh, ("Lagrange", 1, (width,)))
        return self.spaces[width]


class _Projection:
    """L2 projection of values at quadrature points to functions of first degree.

    A context, which frees what PETSc holds: on several ranks petsc4py leaves it to the end of the program, and with it
    the communicator of the mesh.
    """

    def __init__(self, nodal: _Nodal) -> None:
        self.nodal, space = nodal, nodal.space(1)
        self._A = fem_petsc.assemble_matrix(nodal.form)
        self._A.assemble()
        self._solver = PETSc.KSP().create(nodal.mesh.comm)
        self._solver.setOperators(self._A)
        self._solver.setType("cg")
        self._solver.getPC().setType("jacobi")
        self._solver.setTolerances(rtol=1e-12, max_it=1000)
        self._b, self._x = compat.create_vector(space), compat.create_vector(space)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: BaseException | type[BaseException] | TracebackType | None) -> None:
        for thing in (self._solver, self._A, self._b, self._x):
            thing.destroy()

    def project(self, values: Array, measure: Array, name: str) -> fem.Function:
        """Project ``(num_cells, num_points, ...)``; tensors become flat vectors."""
        flat = values.reshape(*values.shape[:2], -1)
        width = flat.shape[2]
        result, dofmap = fem.Function(self.nodal.space(width), name=name), self.nodal.space(1).dofmap
        loads = np.einsum("qk,cqw->ckw", self.nodal.shapes, measure[..., None] * flat)
        index_map, cells = dofmap.index_map, dofmap.list[: len(flat)]
        vector = la.vector(index_map, 1)
        for w in range(width):
            vector.array[:] = 0.0
            np.add.at(vector.array, cells, loads[:, :, w])
            vector.scatter_reverse(la.InsertMode.add)
            self._b.array[:] = vector.array[: index_map.size_local]
            self._solver.solve(self._b, self._x)
            result.x.array[w::width][: index_map.size_local] = self._x.array_r
        result.x.scatter_forward()
        return result


def _at_degree(function: fem.Function, degree: int) -> fem.Function:
    """Return a function of first degree as one of another degree."""
    if degree == 1:
        return function
    mesh, width = function.function_space.mesh, function.function_space.dofmap.index_map_bs
    finer = fem.Function(fem.functionspace(mesh, ("Lagrange", degree, (width,) if width > 1 else ())))
    finer.interpolate(function)
    return finer


def _rows(function: fem.Function) -> tuple[NDArray[np.int64], Array, Array]:
    """Return global numbers, reference positions and values of the owned nodes (collective)."""
    space = function.function_space
    n, width = space.dofmap.index_map.size_local, space.dofmap.index_map_bs
    X = space.tabulate_dof_coordinates()[:n]
    return number_nodes(X, space.mesh.comm), X, function.x.array[: n * width].reshape(n, width).copy()


def _with_ghosts(space: fem.FunctionSpace, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the numbers of owned and ghost nodes (collective)."""
    numbers, width = fem.Function(space), space.dofmap.index_map_bs
    numbers.x.array[: len(ids) * width] = np.repeat(ids, width)
    numbers.x.scatter_forward()
    return np.rint(numbers.x.array[::width]).astype(np.int64)


def _assembled(
    parts: Sequence[tuple[Any, ...]],
) -> tuple[Array, dict[int, NDArray[np.int64]], dict[str, Array], Array]:
    """Put the parts of all ranks together, by node number."""
    count = sum(len(part[0]) for part in parts)
    points, reference = np.zeros((count, 3)), np.zeros((count, 3))
    fields = {name: np.zeros((count, rows[2].shape[1])) for name, rows in parts[0][3].items()}
    for ids, position, X, values, _, _ in parts:
        points[ids], reference[ids] = position, X
        for name, (own, _, rows) in values.items():
            fields[name][own] = rows
    cells = np.concatenate([part[5] for part in parts])
    order = np.lexsort(np.sort(cells, axis=1).T)
    flat = {name: values[:, 0] if values.shape[1] == 1 else values for name, values in fields.items()}
    return points, {max(part[4] for part in parts): cells[order]}, flat, reference
