"""The equations of static equilibrium: potential, follower loads, prescribed values, solved by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat  # noqa: F401  (before dolfinx)

# isort: split
import basix.ufl
import ufl
from dolfinx import fem
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.solid.loads import DeadLoad, PointLoad, Pressure, Tether
from valvefsi.solid.materials.fibres import check_fibres
from valvefsi.solid.newton import Newton
from valvefsi.solid.statics.contact import Contact
from valvefsi.solid.statics.fieldsplit import BlockNewton
from valvefsi.solid.statics.formulations import deformation
from valvefsi.solid.statics.supports import Fixed, Prescribed, Symmetry, facet_tags, plane_normal

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.formulations import Formulation
    from valvefsi.types import Array, Mesh


@dataclass(frozen=True, kw_only=True)
class Body:
    """A body in static equilibrium: what it is made of, what holds it and what loads it.

    Args:
        mesh: A ``SolidMesh``; two dimensions are plane strain.
        material: Isochoric energy W.
        supports: Prescribed displacements, planes of symmetry, planes that may be touched.
        loads: Dead loads, follower pressures and forces on nodes; their ramps in time are ignored.
        tethers: Springs to the reference position; their damping is ignored.
        quadrature_degree: Degree of the quadrature of all forms.
    """

    mesh: Mesh
    material: Material
    supports: Sequence[Fixed | Symmetry | Contact]
    loads: Sequence[DeadLoad | Pressure | PointLoad]
    tethers: Sequence[Tether]
    quadrature_degree: int

    def __post_init__(self) -> None:
        for load in self.loads:
            if not isinstance(load, DeadLoad | Pressure | PointLoad):
                raise CaseError("expected DeadLoad, Pressure or PointLoad", key="loads", value=load)
        check_fibres(self.mesh, self.material)

    @property
    def size(self) -> float:
        """Largest extent of the body [cm] (collective)."""
        x, comm = self.mesh.mesh.geometry.x, self.mesh.mesh.comm
        upper = comm.allreduce(x.max(initial=-np.inf), op=MPI.MAX)
        return float(upper - comm.allreduce(x.min(initial=np.inf), op=MPI.MIN))

    @property
    def dX(self) -> ufl.Measure:
        """Measure of the reference volume; DOLFINx 0.9 wants the same cell tags in all integrals of a form."""
        names = [name for tether in self.tethers for name in tether.on or ()]
        tagged = any(self.mesh.tag(name)[0] == self.mesh.mesh.topology.dim for name in names)
        metadata = {"quadrature_degree": self.quadrature_degree}
        data = self.mesh.cell_tags if tagged else None
        return ufl.Measure("dx", domain=self.mesh.mesh, subdomain_data=data, metadata=metadata)

    def fixed(self) -> list[Fixed]:
        """Return what is prescribed, planes of symmetry at right angles to an axis included (collective)."""
        found = [support for support in self.supports if isinstance(support, Fixed)]
        for support, normal in self._planes():
            axis = _axis_of(normal)
            if axis is not None:
                found.append(Fixed(on=tuple(support.on), components=("xyz"[axis],)))
        return found

    def potential(self, u: Expr, factor: fem.Constant) -> ufl.Form:
        """Return the potential of springs, contact and dead loads (collective)."""
        form = fem.Constant(self.mesh.mesh, 0.0) * self.dX
        for load in self.loads:
            if isinstance(load, DeadLoad):
                traction = fem.Constant(self.mesh.mesh, np.array(load.traction[: self.mesh.dim]))
                form -= factor * ufl.inner(traction, u) * self._ds(load.on)
        for tether in self.tethers:
            mask = ufl.as_vector(tether.mask[: self.mesh.dim])
            held = sum(mask[i] * u[i] ** 2 for i in range(self.mesh.dim))
            form += tether.stiffness / 2 * held * self._measure(tether.on)
        for plane in self.supports:
            if isinstance(plane, Contact):
                form += plane.stiffness / 2 * plane.depth(self.mesh, u) ** 2 * self._ds(plane.on)
        for support, normal in self._planes():
            if _axis_of(normal) is None:
                stiffness = support.stiffness or 1e5 * self.material.shear_modulus / self.size
                across = ufl.inner(u, ufl.as_vector(normal[: self.mesh.dim].tolist()))
                form += stiffness / 2 * across**2 * self._ds(support.on)
        return form

    def point_forces(self, space: fem.FunctionSpace) -> Array | None:
        """Return the forces on nodes at load factor 1 by owned degrees of freedom; None without any (collective).

        Args:
            space: Of the displacement, or a mixed one whose first part that is.

        Raises:
            CaseError: There is no node where a force acts.
        """
        points = [load for load in self.loads if isinstance(load, PointLoad)]
        if not points:
            return None
        mixed = space.num_sub_spaces > 0 and space.dofmap.index_map_bs == 1
        V, parent = space.sub(0).collapse() if mixed else (space, None)
        owned = V.dofmap.index_map.size_local
        X, dim = V.tabulate_dof_coordinates()[:owned, : self.mesh.dim], self.mesh.dim
        forces = np.zeros(space.dofmap.index_map.size_local * space.dofmap.index_map_bs)
        for load in points:
            for point in load.at:
                node = np.flatnonzero(np.linalg.norm(X - point[:dim], axis=1) < 1e-8 * self.size)
                if self.mesh.mesh.comm.allreduce(len(node)) != 1:
                    raise CaseError("there must be one node where a force acts", key="at", value=list(point))
                dofs = dim * node[:, None] + np.arange(dim)
                rows = dofs if parent is None else np.ravel(parent)[dofs]
                forces[rows] += np.array(load.force[:dim]) / len(load.at)
        return forces

    def follower(self, u: Expr, v: Expr, factor: fem.Constant) -> ufl.Form | None:
        """Return the virtual work of follower pressures, int p J F^-T N . v dA; None without any."""
        F, N = deformation(self.mesh, u), ufl.FacetNormal(self.mesh.mesh)
        form = None
        for load in self.loads:
            if isinstance(load, Pressure):
                value = fem.Constant(self.mesh.mesh, float(load.value))
                work = factor * value * ufl.inner(cofactor(F) * N, v) * self._ds(load.on)
                form = work if form is None else form + work
        return form

    def _planes(self) -> list[tuple[Symmetry, np.ndarray]]:
        """Return the planes of symmetry with their normals (collective)."""
        return [(s, plane_normal(self.mesh, s.on)) for s in self.supports if isinstance(s, Symmetry)]

    def _ds(self, names: Sequence[str]) -> ufl.Measure:
        """Return the measure of tagged facets."""
        metadata = {"quadrature_degree": self.quadrature_degree}
        ds = ufl.Measure("ds", domain=self.mesh.mesh, subdomain_data=self.mesh.facet_tags, metadata=metadata)
        return ds(tuple(facet_tags(self.mesh, names)))

    def _measure(self, names: Sequence[str] | None) -> ufl.Measure:
        """Return the measure of tagged facets or cells, or of the whole body."""
        if names is None:
            return self.dX
        dims = {self.mesh.tag(name)[0] for name in names}
        if dims != {self.mesh.mesh.topology.dim}:
            return self._ds(names)
        return self.dX(tuple(self.mesh.tag(name)[1] for name in names))


class Problem(Protocol):
    """A discrete problem that follows the load factor."""

    def set_factor(self, s: float) -> None:
        """Set the load factor of loads and prescribed displacements."""

    def set_tolerances(self, relative: float, absolute: float, max_iterations: int) -> None:
        """Set the tolerances of Newton's method."""

    def solve(self) -> tuple[bool, int]:
        """Solve from the present state; return whether it converged and the iterations."""

    def fields(self) -> tuple[fem.Function, fem.Function | None]:
        """Return displacement and pressure."""


class DirectProblem:
    """One matrix for all unknowns, factorised by MUMPS (collective)."""

    def __init__(self, body: Body, formulation: Formulation) -> None:
        domain, dim = body.mesh.mesh, body.mesh.dim
        elements = [basix.ufl.element("Lagrange", domain.basix_cell(), formulation.degrees[0], shape=(dim,))]
        elements += [basix.ufl.element("Lagrange", domain.basix_cell(), k) for k in formulation.degrees[1:]]
        self.mixed = len(elements) > 1
        space = fem.functionspace(domain, basix.ufl.mixed_element(elements) if self.mixed else elements[0])
        self.state, test = fem.Function(space), ufl.TestFunction(space)
        u, p = ufl.split(self.state) if self.mixed else (self.state, None)
        v = ufl.split(test)[0] if self.mixed else test
        self.factor = fem.Constant(domain, 0.0)
        potential = formulation.potential(body.mesh, body.material, u, p) * body.dX
        residual = ufl.derivative(potential + body.potential(u, self.factor), self.state, test)
        follower = body.follower(u, v, self.factor)
        if follower is not None:
            residual += follower
        self.prescribed = Prescribed(body.mesh, space.sub(0) if self.mixed else space, body.fixed())
        self.newton = Newton(self.state, residual, self.prescribed.conditions, body.point_forces(space))
        self.set_tolerances, self.solve = self.newton.set_tolerances, self.newton.solve

    def set_factor(self, s: float) -> None:
        """Set the load factor of loads and prescribed displacements."""
        self.factor.value = s
        self.newton.factor = s
        self.prescribed.set_factor(s)

    def fields(self) -> tuple[fem.Function, fem.Function | None]:
        """Return displacement and pressure."""
        if not self.mixed:
            return self.state, None
        return self.state.sub(0).collapse(), self.state.sub(1).collapse()


class SplitProblem:
    """Displacement and pressure in blocks, solved by FGMRES with a Schur complement (collective)."""

    def __init__(self, body: Body, formulation: Formulation) -> None:
        if len(formulation.degrees) != 2:
            raise CaseError("needs a formulation with a pressure", key="solver", value="fieldsplit")
        if any(isinstance(load, PointLoad) for load in body.loads):
            raise CaseError("forces on nodes need the direct solver", key="solver", value="fieldsplit")
        if not body.material.shear_modulus > 0:
            message = (
                "this material has no stiffness at F = I to scale the pressure with; use the direct solver"
            )
            raise CaseError(message, key="solver", value="fieldsplit")
        domain, dim = body.mesh.mesh, body.mesh.dim
        V = fem.functionspace(domain, ("Lagrange", formulation.degrees[0], (dim,)))
        Q = fem.functionspace(domain, ("Lagrange", formulation.degrees[1]))
        self.u, self.p = fem.Function(V), fem.Function(Q)
        v, q = ufl.TestFunction(V), ufl.TestFunction(Q)
        self.factor = fem.Constant(domain, 0.0)
        potential = formulation.potential(body.mesh, body.material, self.u, self.p) * body.dX
        F_u = ufl.derivative(potential + body.potential(self.u, self.factor), self.u, v)
        follower = body.follower(self.u, v, self.factor)
        if follower is not None:
            F_u += follower
        F_p = ufl.derivative(potential, self.p, q)
        self.prescribed = Prescribed(body.mesh, V, body.fixed())
        scale = fem.Constant(domain, -1.0 / body.material.shear_modulus)
        schur = scale * ufl.TrialFunction(Q) * q * body.dX + ufl.derivative(F_p, self.p)
        self.newton = BlockNewton((self.u, self.p), (F_u, F_p), self.prescribed.conditions, schur)
        self.set_tolerances, self.solve = self.newton.set_tolerances, self.newton.solve

    def set_factor(self, s: float) -> None:
        """Set the load factor of loads and prescribed displacements."""
        self.factor.value = s
        self.prescribed.set_factor(s)

    def fields(self) -> tuple[fem.Function, fem.Function | None]:
        """Return displacement and pressure."""
        return self.u, self.p


SOLVERS: dict[str, type] = {"direct": DirectProblem, "fieldsplit": SplitProblem}
"""Problems by the name of their linear solver."""


def cofactor(F: Expr) -> Expr:
    """Return J F^-T, polynomial in F."""
    if F.ufl_shape[0] == 2:
        return ufl.as_tensor([[F[1, 1], -F[1, 0]], [-F[0, 1], F[0, 0]]])
    columns = [ufl.as_vector([F[i, j] for i in range(3)]) for j in range(3)]
    crossed = [ufl.cross(columns[(j + 1) % 3], columns[(j + 2) % 3]) for j in range(3)]
    return ufl.as_tensor([[crossed[j][i] for j in range(3)] for i in range(3)])


def _axis_of(normal: np.ndarray) -> int | None:
    """Return the axis that a unit normal lies along, None for an oblique one."""
    axis = int(np.argmax(np.abs(normal)))
    return axis if abs(normal[axis]) > 1 - 1e-10 else None
