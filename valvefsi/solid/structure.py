"""A solid as the coupled step sees it: nodes, reference positions, and the force at a given position."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
from dolfinx import fem
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.solid.elements.elasticity import Elasticity
from valvefsi.solid.elements.gaps import Gaps
from valvefsi.solid.elements.lumping import lumped_weights, surface_area
from valvefsi.solid.elements.numbering import number_nodes
from valvefsi.solid.elements.shell_elasticity import ShellElasticity, split
from valvefsi.solid.elements.viscosity import Viscosity
from valvefsi.solid.materials import Volumetric, kappa_stab, stabilisation
from valvefsi.solid.materials.fibres import check_fibres
from valvefsi.solid.moving_tether import MovingTether

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from valvefsi.solid.loads import DeadLoad, Ramp, Tether
    from valvefsi.solid.materials import Material
    from valvefsi.types import Array, Mesh


ELEMENTS = ("lagrange", "solid_shell")
"""Elements by the name a case file uses."""


@dataclass(frozen=True, kw_only=True)
class Discretisation:
    """How a solid is discretised.

    Args:
        degree: Degree of the Lagrange elements, 1 or 2.
        quadrature_degree: Degree of the quadrature of the elastic forces; None takes 2 degree + 1.
        volumetric: Volumetric energy of the stabilisation, see `Volumetric`.
        kappa: Numerical bulk modulus instead of the one that nu_stab gives, 0 for off [dyn/cm^2].
        volumetric_degree: Degree of the quadrature of what kappa adds to the bulk modulus of nu_stab, which keeps
            that of the forces and with it single points from inverting; None for that of the forces everywhere.
        element: "lagrange", or "solid_shell" for thin bodies of hexahedra, incompressible or of `SaintVenantKirchhoff`,
            see `valvefsi.solid.elements.shell_kinematics`: they bend without locking, one or two through the thickness.
        faces: Tags of the facets on both sides of a body of solid-shell elements; None to look for its thickness where
            rows of elements are shortest.
    """

    element: str = "lagrange"
    degree: int = 1
    quadrature_degree: int | None = None
    volumetric: str = "log"
    kappa: float | None = None
    volumetric_degree: int | None = None
    faces: tuple[tuple[str, ...], tuple[str, ...]] | None = None

    def __post_init__(self) -> None:
        if self.degree not in (1, 2):
            raise CaseError("expected 1 or 2", key="degree", value=self.degree)
        self._check_element()
        if not 1 <= self.force_degree <= 30:
            raise CaseError("expected 1 to 30", key="quadrature_degree", value=self.quadrature_degree)
        if not 1 <= (self.volumetric_degree or 1) <= self.force_degree:
            message = f"expected 1 to quadrature_degree = {self.force_degree}"
            raise CaseError(message, key="volumetric_degree", value=self.volumetric_degree)
        if self.volumetric_degree is not None and self.kappa is None:
            message = "it is the quadrature of what kappa adds to the bulk modulus of nu_stab; give kappa"
            raise CaseError(message, key="volumetric_degree", value=self.volumetric_degree)

    @property
    def force_degree(self) -> int:
        """Degree of the quadrature of the elastic forces."""
        return 2 * self.degree + 1 if self.quadrature_degree is None else self.quadrature_degree

    def _check_element(self) -> None:
        """Refuse an unknown element, and what solid-shell elements have no use for."""
        if self.element not in ELEMENTS:
            raise CaseError(f"expected one of {', '.join(ELEMENTS)}", key="element", value=self.element)
        if self.element == "solid_shell":
            for key, usual in {"degree": 1, "quadrature_degree": None, "volumetric_degree": None}.items():
                if getattr(self, key) != usual:
                    message = (
                        "solid-shell elements are of degree 1 with a quadrature of their own; leave it out"
                    )
                    raise CaseError(message, key=key, value=getattr(self, key))


@dataclass(frozen=True, kw_only=True)
class Damping:
    """What takes energy from a body.

    Args:
        body: Body damping eta, force density -eta U, not negative [dyn s/cm^4].
        viscosity: Viscosity eta_s of the solid on top of the fluid's, not negative [dyn s/cm^2].

    Raises:
        CaseError: One is negative or not finite.
    """

    body: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        keys = {"damping": self.body, "viscosity": self.viscosity}
        for key, value in keys.items():
            if not 0 <= value < np.inf:
                raise CaseError("expected a number that is not negative", key=key, value=value)


class Stiffness(NamedTuple):
    """What limits an explicit step of a solid."""

    shear_modulus: float
    """mu_s [dyn/cm^2]."""
    kappa: float
    """Numerical bulk modulus, 0 for off [dyn/cm^2]."""
    smallest_edge: float
    """Smallest distance of two vertices of a cell [cm]."""
    tether: float
    """Largest tether stiffness kappa w_k of a node [dyn/cm]."""
    damping: float
    """Largest damping eta w_k of a node [dyn s/cm]."""


class SupportReport(NamedTuple):
    """A tether or a load and the size of what it acts on."""

    on: tuple[str, ...] | None
    """Names of the tags, None for the whole body."""
    value: float | tuple[float, ...]
    """Stiffness of a tether [dyn/cm^3 or dyn/cm^4]; traction of a load [dyn/cm^2]."""
    measure: float
    """Area of the facets, or volume of the cells; in two dimensions per cm depth."""
    components: tuple[str, ...]
    """The axes it acts along."""


class Structure:
    """A hyperelastic body with its loads and supports.

    All arrays are of this rank's owned nodes, ``(n, 3)``; in two dimensions the third column is 0.5 for
    positions and 0 for forces, and forces are per cm depth.

    Args:
        mesh: A ``SolidMesh``: ``mesh``, ``cell_tags``, ``facet_tags``, ``tag(name)``, ``fibres``.
        material: Isochoric energy.
        name: Name in files and messages.
        nu_stab: Numerical Poisson ratio of the stabilisation (S22); None for off.
        discretisation: Degree, quadrature.
        damping: What takes energy from it; a number is the body damping eta [dyn s/cm^4].
        tethers: Springs that hold it.
        loads: Dead loads.

    Note:
        Collective.
    """

    def __init__(
        self,
        mesh: Mesh,
        material: Material,
        *,
        name: str = "solid",
        nu_stab: float | None = 0.4,
        discretisation: Discretisation = Discretisation(),
        damping: float | Damping = 0.0,
        tethers: Sequence[Tether] = (),
        loads: Sequence[DeadLoad] = (),
    ) -> None:
        given = damping if isinstance(damping, Damping) else Damping(body=damping)
        self.name, self.mesh, self.material = name, mesh, material
        self.discretisation = discretisation
        self.damping, self.nu_stab = given.body, nu_stab
        self.tethers, self.loads = tuple(tethers), tuple(loads)
        self.comm, self.dim = mesh.mesh.comm, mesh.mesh.geometry.dim
        self.volumetric = stabilisation(material, nu_stab, discretisation.volumetric, discretisation.kappa)
        self.kappa = self.volumetric.kappa
        check_fibres(mesh, material)
        self.space = fem.functionspace(mesh.mesh, ("Lagrange", discretisation.degree, (self.dim,)))
        self._gaps: Gaps | None = None
        self._place_nodes()
        self._assemble_supports()
        degree = discretisation.force_degree
        self.elasticity = self._elements(degree)
        self.viscosity = Viscosity(self.space, given.viscosity, degree) if given.viscosity > 0 else None

    def _elements(self, degree: int) -> Elasticity | ShellElasticity:
        """Return what computes the elastic forces."""
        given = self.discretisation
        if given.element == "solid_shell":
            parts = split(self.material, self.nu_stab, given.kappa, given.volumetric)
            return ShellElasticity(self.mesh, self.space, self.material, *parts, faces=given.faces)
        return Elasticity(self.space, self.material, self._volumetric_parts(), degree, self.mesh.fibres)

    def _volumetric_parts(self) -> list[tuple[Volumetric, int]]:
        """Return the volumetric energies and the degrees of their quadratures."""
        given = self.discretisation
        if given.volumetric_degree is None:
            return [(self.volumetric, given.force_degree)]
        full = min(kappa_stab(self.material.shear_modulus, self.nu_stab), self.kappa)
        parts = (full, given.force_degree), (self.kappa - full, given.volumetric_degree)
        return [(Volumetric(kappa=kappa, form=given.volumetric), degree) for kappa, degree in parts]

    def _place_nodes(self) -> None:
        """Set reference positions and global numbers of the owned nodes."""
        index_map = self.space.dofmap.index_map
        n = index_map.size_local
        self.num_nodes: int = index_map.size_global
        self.X: Array = self.space.tabulate_dof_coordinates()[:n].copy()
        if self.dim == 2:
            self.X[:, 2] = 0.5
        self.ids: NDArray[np.int64] = number_nodes(self.X, self.comm)
        self._order = np.argsort(self.ids)

    def _assemble_supports(self) -> None:
        """Assemble weights, dead loads, springs and dampers of the nodes, once."""
        n = len(self.X)
        self.weights: Array
        self.weights, self.reference_volume = lumped_weights(self.space, self.mesh, None)
        self._spring, self._damper = np.zeros((n, 3)), np.zeros((n, 3))
        self._damper[:, : self.dim] = self.damping * self.weights[:, None]
        self._tether_reports: list[SupportReport] = []
        self._moving: list[tuple[MovingTether, NDArray[np.intp], Array]] = []
        for tether in self.tethers:
            spread, measure = self._spread(tether)
            spring = tether.stiffness * spread
            self._spring += spring
            if isinstance(tether, MovingTether):
                held = np.flatnonzero(spring.any(axis=1))
                self._moving.append((tether, held, spring[held]))
            self._damper += tether.damping * spread
            axes = tether.components if self.dim == 3 else tuple(c for c in tether.components if c != "z")
            self._tether_reports.append(SupportReport(tether.on, tether.stiffness, measure, axes))
        self._dead: list[tuple[Ramp, Array]] = []
        self._load_reports: list[SupportReport] = []
        for load in self.loads:
            self._add_load(load)

    def _spread(self, tether: Tether) -> tuple[Array, float]:
        """Return what of a tether's area or volume each node has along each axis, ``(n, 3)``, and the whole."""
        weights, measure = lumped_weights(self.space, self.mesh, tether.on)
        return weights[:, None] * (np.array(tether.mask) * (np.arange(3) < self.dim)), measure

    def tethers_on(self, tags: Collection[str]) -> tuple[Array, Array]:
        """Return springs and dampers of the tethers on facets with these tags and no others.

        Args:
            tags: Names of tags.

        Returns:
            kappa w [dyn/cm] and eta w [dyn s/cm] of this rank's nodes along each axis, ``(n, 3)`` each; 0 for none.

        Note:
            Collective.
        """
        spring, damper = np.zeros_like(self.X), np.zeros_like(self.X)
        for tether in self.tethers:
            if tether.on is not None and set(tether.on) <= set(tags):
                spread, _ = self._spread(tether)
                spring += tether.stiffness * spread
                damper += tether.damping * spread
        return spring, damper

    def _add_load(self, load: DeadLoad) -> None:
        """Assemble a dead load, integral of phi_k t dA."""
        if any(self.mesh.tag(tag)[0] == self.dim for tag in load.on):
            raise CaseError("a load needs facets, this tag names cells", key="on", value=list(load.on))
        weights, measure = lumped_weights(self.space, self.mesh, load.on, positive=False)
        traction = np.zeros(3)
        traction[: len(load.traction)] = load.traction
        if self.dim == 2 and traction[2] != 0:
            raise CaseError("no z component in two dimensions", key="traction", value=list(load.traction))
        self._dead.append((load.ramp, weights[:, None] * traction))
        axes, components = ("x", "y", "z")[: self.dim], tuple(traction[: self.dim].tolist())
        self._load_reports.append(SupportReport(load.on, components, measure, axes))

    def force(self, chi: Array, U: Array, t: float) -> Array:
        """Return the force on the nodes.

            F_k = -int (P + P_v) : grad(phi_k) dX + ramp(t) int phi_k t dA
                  + kappa w_k (X_k + d_k(t) - chi_k) - eta w_k U_k

        with d_k the displacement of the anchors of moving tethers, else 0, and P_v the stress of `Viscosity`.

        Args:
            chi: Positions, ``(n, 3)`` [cm].
            U: Velocities, ``(n, 3)`` [cm/s].
            t: Time [s].

        Returns:
            Forces, ``(n, 3)`` [dyn]; a new array.

        Note:
            Collective. NaN where a cell is inverted.
        """
        F = self._spring * (self.X - chi)
        F -= self._damper * U
        for ramp, dead in self._dead:
            F += ramp(t) * dead
        for tether, held, spring in self._moving:
            F[held] += spring * tether.motion(self.X[held], tether.ramp(t))
        F[:, : self.dim] += self.elasticity.force(chi)
        if self.viscosity:
            F[:, : self.dim] += self.viscosity.force(chi, U)
        return F

    def jacobian(self, chi: Array) -> Array:
        """Return J at all quadrature points of this rank, one-dimensional (collective)."""
        return self.elasticity.jacobian(chi).ravel()

    def volume(self, chi: Array) -> float:
        """Return the current volume [cm^3; cm^2 in two dimensions] (collective)."""
        return self.elasticity.volume(chi)

    def energy(self, chi: Array) -> float:
        """Return the elastic energy [erg] (collective)."""
        return self.elasticity.energy(chi)

    def tether_energy(self, chi: Array) -> float:
        """Return the energy of tethers whose anchors stay, at positions chi ``(n, 3)`` [erg] (collective)."""
        here = 0.5 * float(np.sum(self._spring * (self.X - chi) ** 2))
        return self.comm.allreduce(here)

    def node_at(self, X0: Sequence[float]) -> int:
        """Return the number of the node nearest to the reference position ``X0 (dim,)`` (collective)."""
        distance = np.linalg.norm(self.X[:, : self.dim] - np.asarray(X0, dtype=float)[: self.dim], axis=1)
        nearest = self.comm.allreduce(distance.min(initial=np.inf), op=MPI.MIN)
        tied = self.ids[distance <= nearest + 1e-9 * (1 + nearest)]
        return self.comm.allreduce(int(tied.min(initial=self.num_nodes)), op=MPI.MIN)

    def position_of(self, node_id: int, chi: Array) -> Array:
        """Return the position ``(3,)`` [cm] of a node, on all ranks (collective)."""
        position = np.zeros(3)
        mine = np.flatnonzero(self.ids == node_id)
        if len(mine):
            position[:] = chi[mine[0]]
        return self.comm.allreduce(position)

    def cells_on_root(self, chi: Array) -> tuple[Array, dict[int, NDArray[np.int64]], Array] | None:
        """Gather the deformed mesh for pictures.

        Returns:
            On rank 0 the positions ``(num_nodes, 3)`` by node number, node numbers ``(num_cells, k)`` by VTK cell
            type with the nodes in VTK's order, and the mean J of each cell; None on other ranks.
            The order of the cells does not depend on the number of ranks.

        Note:
            Collective.
        """
        J = self.elasticity.jacobian(chi).mean(axis=1)
        ids = self._ids_with_ghosts()
        kind, nodes = compat.vtk_cells(self.space)
        gathered = self.comm.gather((self.ids, np.asarray(chi), kind, ids[nodes], J), root=0)
        if gathered is None:
            return None
        points = np.zeros((self.num_nodes, 3))
        for rank_ids, rank_chi, *_ in gathered:
            points[rank_ids] = rank_chi
        cells = np.concatenate([part[3] for part in gathered])
        order = np.lexsort(np.sort(cells, axis=1).T)
        J = np.concatenate([part[4] for part in gathered])
        return points, {max(part[2] for part in gathered): cells[order]}, J[order]

    def _ids_with_ghosts(self) -> NDArray[np.int64]:
        """Return the numbers of owned and ghost nodes (collective)."""
        numbers = fem.Function(self.space)
        owned = len(self.ids) * self.dim
        numbers.x.array[:owned] = np.repeat(self.ids, self.dim)
        numbers.x.scatter_forward()
        return np.rint(numbers.x.array[:: self.dim]).astype(np.int64)

    def stiffness(self) -> Stiffness:
        """Return what limits an explicit step (collective)."""
        corners = self.mesh.mesh.geometry.x[compat.geometry_nodes(self.mesh.mesh)]
        a, b = np.triu_indices(corners.shape[1], k=1)
        edge = np.linalg.norm(corners[:, a] - corners[:, b], axis=2).min(initial=np.inf)
        edge = self.comm.allreduce(float(edge), op=MPI.MIN)
        tether = self.comm.allreduce(float(self._spring.max(initial=0.0)), op=MPI.MAX)
        damping = self.comm.allreduce(float(self._damper.max(initial=0.0)), op=MPI.MAX)
        return Stiffness(self.material.shear_modulus, self.kappa, edge, tether, damping)

    def longest_edge(self) -> float:
        """Return the length of the longest edge of a cell [cm] (collective)."""
        domain = self.mesh.mesh
        corners = domain.geometry.x[compat.geometry_nodes(domain)]
        a, b = np.array(compat.edges(domain)).T
        edge = np.linalg.norm(corners[:, a] - corners[:, b], axis=2).max(initial=0.0)
        return self.comm.allreduce(float(edge), op=MPI.MAX)

    def longest_gap(self, chi: Array) -> float:
        """Return the largest distance at chi of nodes that follow one another on an edge [cm] (collective)."""
        if self._gaps is None:
            self._gaps = Gaps(self.space)
        return self._gaps.longest(chi)

    def thickness(self) -> float:
        """Return the thickness of a plate of this volume and surface, 2 V / A [cm] (collective)."""
        return 2.0 * self.reference_volume / surface_area(self.space)

    def tether_report(self) -> list[SupportReport]:
        """Return each tether with the area or volume it holds; give = mean traction / stiffness."""
        return list(self._tether_reports)

    def load_report(self) -> list[SupportReport]:
        """Return each dead load with the area that carries it."""
        return list(self._load_reports)
