"""Quadrature points that follow the elements of a solid, and the L2 projections between them and the nodes."""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import basix
import basix.ufl
from dolfinx import la

from valvefsi.errors import CaseError, StabilityError
from valvefsi.solid.elements import point_kernels
from valvefsi.solid.elements.mass import ConsistentMass, LumpedMass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array

FINEST = 24
"""Points along an edge of the finest rule."""


class ElementPoints:
    """Quadrature points of a solid, refined element by element, and the mass matrix of its nodes.

    Args:
        solid: The solid.
        mass: "consistent" or "lumped"; lumped is faster and keeps the total force, the torque only to second order.

    Raises:
        CaseError: The mass is neither.

    Note:
        Collective.
    """

    def __init__(self, solid: Structure, mass: str = "consistent") -> None:
        if mass not in ("consistent", "lumped"):
            raise CaseError('expected "consistent" or "lumped"', key="mass", value=mass)
        self.space, self.dim, self.comm = solid.space, solid.dim, solid.comm
        domain = solid.mesh.mesh
        cells = domain.topology.index_map(domain.topology.dim).size_local
        self.nodes = np.ascontiguousarray(self.space.dofmap.list[:cells])
        self.corners = domain.geometry.x[compat.geometry_nodes(domain)][..., : self.dim]
        self.cell = domain.basix_cell()
        self.degree = self.space.ufl_element().degree
        self.geometry = domain.ufl_domain().ufl_coordinate_element()
        self.smallest = 2 * self.degree  # points along an edge that integrate the mass matrix
        index_map = self.space.dofmap.index_map
        self.num_owned, self.num_local = index_map.size_local, index_map.size_local + index_map.num_ghosts
        self._vector = la.vector(index_map, 3)
        self._groups: dict[tuple[int, ...], _Group] = {}
        local = directions(self.cell.name)
        ends = np.sort(self.nodes[:, local], axis=-1)
        # Every edge of the mesh once, and those of each element along its directions, ``(num_cells, directions, k)``.
        self.edges, which = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
        self.edges_of = which.reshape(ends.shape[:-1]).astype(np.uint32)
        self._counts = np.zeros(self.edges_of.shape[:2], dtype=int)
        self.mass = (ConsistentMass if mass == "consistent" else LumpedMass)(self._mass_blocks(), self)

    def refined(self, chi: Array, gap: float) -> Rule:
        """Return the points at chi, no two neighbours further apart than ``gap`` [cm].

        Quadrilaterals and hexahedra have as many points along each of their directions as the longest edge of that
        direction asks for, so points that follow one another on a line through an element are at most a gap apart,
        and those at its ends at most half a gap from its faces. Simplices have one number of points for all edges.

        Args:
            chi: Positions of the owned nodes, ``(n, 3)`` [cm].
            gap: Largest gap [cm].

        Raises:
            StabilityError: An element is not finite, or larger than the finest rule can fill; on the ranks that
                have such an element.

        Note:
            Collective.
        """
        positions = self.local(chi)
        counts, squares = np.empty_like(self._counts), np.empty(len(self.edges))
        enough = np.square(gap / gaps(self.cell.name)[self.smallest - 1 :])
        point_kernels.square_lengths(squares, positions, self.edges)
        point_kernels.count_points(counts, squares, self.edges_of, enough)
        if counts.max(initial=0) == len(enough):
            raise StabilityError(
                f"an element {math.sqrt(squares.max()):.3g} cm long needs more than {FINEST} points along its edge for "
                f"gaps of {gap:.3g} cm; the solid is torn apart or its mesh is far too coarse"
            )
        counts += self.smallest
        if not np.array_equal(counts, self._counts) or not self._groups:
            keys, which = np.unique(counts, axis=0, return_inverse=True)
            self._groups = {
                key: self._group(key, np.flatnonzero(which.ravel() == k))
                for k, key in enumerate(map(tuple, keys.tolist()))
            }
            self._counts = counts
        return Rule(self, tuple(self._groups.values()), positions)

    def _group(self, n: tuple[int, ...], cells: NDArray[np.intp]) -> _Group:
        """Return the elements with n points along the edges; weights that are known are taken over."""
        known = self._groups.get(n)
        if known is None:
            X, _ = rule(self.cell.name, n)
            phi = self.space.element.basix_element.tabulate(0, X)[0, :, :, 0]
            return _Group(n, cells, self.nodes[cells], np.ascontiguousarray(phi), self._weights(n, cells))
        place = np.minimum(np.searchsorted(known.cells, cells), len(known.cells) - 1)
        new = known.cells[place] != cells
        weights = known.weights[place]
        weights[new] = self._weights(n, cells[new])
        return _Group(n, cells, self.nodes[cells], known.phi, weights)

    def _weights(self, n: tuple[int, ...], cells: NDArray[np.intp]) -> Array:
        """Return w_q |det dX/dxi| of some elements, ``(num_cells, num_points)`` [cm^dim]."""
        X, w = rule(self.cell.name, n)
        slopes = self.geometry.basix_element.tabulate(1, X)[1:, :, :, 0]
        J = np.einsum("dqk,ckx->cqxd", slopes, self.corners[cells])
        return np.abs(np.linalg.det(J)) * w

    def _mass_blocks(self) -> tuple[NDArray[np.int32], Array]:
        """Return the nodes of the elements and int phi_j phi_k dX of each, ``(num_cells, k, k)``."""
        group = self._group((self.smallest,) * self._counts.shape[1], np.arange(len(self.nodes)))
        return group.nodes, np.einsum("cq,qj,qk->cjk", group.weights, group.phi, group.phi, optimize=True)

    def local(self, values: Array) -> Array:
        """Return rows of owned and ghost nodes, ``(num_local, 3)``, from those of owned nodes (collective)."""
        array = self._vector.array
        array[: 3 * self.num_owned] = values.ravel()
        if self.comm.size > 1:
            self._vector.scatter_forward()
        return array.reshape(-1, 3).copy()

    def owned(self, values: Array) -> Array:
        """Add the rows of ghost nodes to those of their owners, ``(num_local, 3)`` to ``(n, 3)`` (collective)."""
        if self.comm.size == 1:
            return values
        array = self._vector.array
        array[:] = values.ravel()
        self._vector.scatter_reverse(la.InsertMode.add)
        return array[: 3 * self.num_owned].reshape(-1, 3).copy()


class _Group(NamedTuple):
    """Elements with one rule."""

    points: tuple[int, ...]
    """Number of points along each direction, the last one running fastest."""
    cells: NDArray[np.intp]
    """Local numbers in ascending order, ``(num_cells,)``."""
    nodes: NDArray[np.int32]
    """Local nodes, ``(num_cells, k)``."""
    phi: Array
    """Shape functions at the points, ``(num_points, k)``."""
    weights: Array
    """Quadrature weights of the reference position, ``(num_cells, num_points)`` [cm^dim]."""


class Rule:
    """The quadrature points of a solid at one position of its nodes; made by `ElementPoints.refined`.

    Attributes:
        x: Positions of the points, ``(num_points, 3)`` [cm].
    """

    def __init__(self, points: ElementPoints, groups: tuple[_Group, ...], positions: Array) -> None:
        self.points, self.groups = points, groups
        self.x = self._at_points(positions, weighted=False)

    def _at_points(self, values: Array, *, weighted: bool) -> Array:
        """Return sum_k phi_k values_k at the points, times w_q where weighted."""
        out, start = np.empty((sum(group.weights.size for group in self.groups), 3)), 0
        for group in self.groups:
            stop = start + group.weights.size
            part = out[start:stop].reshape(*group.weights.shape, 3)
            weights = group.weights if weighted else group.weights[:, :0]
            point_kernels.at_points(part, values, group.nodes, group.phi, weights)
            start = stop
        return out

    def lift(self, F: Array) -> Array:
        """Return the forces of the points that stand for nodal forces, w_q sum_k phi_k G_k with M G = F.

        Args:
            F: Force of the owned nodes, ``(n, 3)`` [dyn].

        Note:
            Collective.
        """
        return self._at_points(self.points.local(self.points.mass.solve(F)), weighted=True)

    def project(self, U: Array) -> Array:
        """Return the nodal velocity nearest to the one at the points, M U_k = sum_q w_q phi_k U_q.

        Args:
            U: Velocity of the points, ``(num_points, 3)`` [cm/s].

        Note:
            Collective.
        """
        sums, start = np.zeros((self.points.num_local, 3)), 0
        for group in self.groups:
            stop = start + group.weights.size
            part = U[start:stop].reshape(*group.weights.shape, 3)
            point_kernels.add_to_nodes(sums, part, group.nodes, group.phi, group.weights)
            start = stop
        return self.points.mass.solve(self.points.owned(sums))


@functools.cache
def directions(cell: str) -> NDArray[np.int64]:
    """Return the edges of a cell by direction, as pairs of vertices, ``(num_directions, k, 2)``.

    Quadrilaterals and hexahedra have those of their axes, all edges of a simplex count as one direction.
    """
    kind = getattr(basix.CellType, cell)
    edges, vertices = np.array(basix.topology(kind)[1]), basix.geometry(kind)
    if cell not in ("quadrilateral", "hexahedron"):
        return edges[None]
    along = np.abs(vertices[edges[:, 1]] - vertices[edges[:, 0]]).argmax(axis=1)
    return np.stack([edges[along == axis] for axis in range(vertices.shape[1])])


@functools.cache
def rule(cell: str, n: tuple[int, ...]) -> tuple[Array, Array]:
    """Return points ``(num_points, tdim)`` and weights of the Gauss rule with n points along the edges.

    The last direction runs fastest. Simplices, with one number, take Gauss-Jacobi rules.
    """
    if len(n) == 1:
        kind = getattr(basix.CellType, cell)
        return basix.make_quadrature(kind, 2 * n[0] - 1, rule=basix.QuadratureType.gauss_jacobi)
    lines = [np.polynomial.legendre.leggauss(k) for k in n]
    points = np.stack(np.meshgrid(*(0.5 + 0.5 * x for x, _ in lines), indexing="ij"), axis=-1)
    weights = functools.reduce(np.multiply.outer, (0.5 * w for _, w in lines))
    return points.reshape(-1, len(n)), weights.ravel()


@functools.cache
def gaps(cell: str) -> Array:
    """Return the largest distance of a point from its nearest neighbour, for 1 ... FINEST + 1 points along an edge.

    In edge lengths of the reference cell; the last one stands for what no rule reaches.
    """
    found = [1.0]
    for n in range(2, FINEST + 1):
        x, _ = np.polynomial.legendre.leggauss(n)
        found.append(0.5 * float(np.diff(x).max()))
    return np.array(found)
