"""Sides that are open on a part and wall elsewhere, in a direct solver of tensor-product operators.

Such a side changes the operator on its own entries only. What these add is a small dense system (a Schur
complement), assembled in the space of modes, where the response at the side to a source at the side is one number per
tangential mode. A solve still costs one transform and one back: the side's values are read off the modes, and the
modes are corrected before they are transformed back.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from mpi4py import MPI

from valvefsi.fluid import mixed_kernels
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.direct_solver import TensorSolver
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Mask


class SideModes:
    """Values on the open parts of one or two facing sides, between modes and points.

    Args:
        grid: The grid.
        solver: Solver with walls on the mixed sides.
        boundary: The sides.

    Attributes:
        axis: Axis normal to the sides.
        num: Number of points, all sides together.
    """

    def __init__(self, grid: MacGrid, solver: TensorSolver, boundary: Boundary) -> None:
        self.comm, self.solver, self.places = grid.comm, solver, boundary.mixed
        self.axis = self.places[0].axis
        self.tangents = tuple(a for a in range(3) if a != self.axis)
        self.masks = [place.mask for place in self.places]
        self.counts = [int(mask.sum()) for mask in self.masks]
        self.num = sum(self.counts)
        axis = solver.axes[self.axis]
        ends = [axis.size - 1 if place.upper else 0 for place in self.places]
        self.read = np.stack([axis.row(i, inverse=True) for i in ends])
        self.write = np.stack([axis.row(i) for i in ends])
        self.there = [solver.axes[a].dense() for a in self.tangents]
        self.back = [solver.axes[a].dense(inverse=True) for a in self.tangents]

    def split(self, values: Array) -> list[Array]:
        """Values at all points by side."""
        return np.split(values, np.cumsum(self.counts)[:-1])

    def values(self, x: Array) -> Array:
        """Values at the points of modes x, ``(num,)`` (collective)."""
        modes, (t1, t2) = self.solver.modes, self.tangents
        planes = np.zeros((len(self.places), len(self.there[0]), len(self.there[1])))
        read = np.tensordot(x, self.read[:, modes[self.axis]], (self.axis, 1))
        planes[:, modes[t1], modes[t2]] = np.moveaxis(read, -1, 0)
        self.comm.Allreduce(MPI.IN_PLACE, planes)
        return np.concatenate(
            [
                (self.back[0] @ plane @ self.back[1].T)[mask]
                for plane, mask in zip(planes, self.masks, strict=True)
            ]
        )

    def add(self, x: Array, sources: Array, a: float, b: float) -> None:
        """Add the response to sources at the points to modes x, in place."""
        modes, (t1, t2) = self.solver.modes, self.tangents
        planes = []
        for part, mask in zip(self.split(sources), self.masks, strict=True):
            plane = np.zeros(mask.shape)
            plane[mask] = part
            planes.append((self.there[0] @ plane @ self.there[1].T)[modes[t1], modes[t2]])
        weights = np.ascontiguousarray(self.write[:, modes[self.axis]])
        mixed_kernels.add_response(x, weights, np.array(planes), self.solver.eigenvalues, self.axis, (a, b))

    def responses(self, a: float, b: float) -> Array:
        """Values at the points of the solutions for unit sources at each of them, ``(num, num)``."""
        axes = self.solver.axes
        lam = [axis.eigenvalues for axis in axes]
        across = lam[self.tangents[0]][:, None] + lam[self.tangents[1]]
        rows = []
        for read, mask in zip(self.read, self.masks, strict=True):
            row = []
            for write, other in zip(self.write, self.masks, strict=True):
                g = np.zeros(across.shape)
                for r, w, value in zip(read, write, lam[self.axis], strict=True):
                    g += _quotient(r * w, a - b * (value + across))
                row.append(self._between(g, mask, other))
            rows.append(row)
        return np.block(rows)

    def _between(self, g: Array, mask: Mask, other: Mask) -> Array:
        """Apply ``back g there`` to the points of one side, at the points of another."""
        out = np.empty((int(mask.sum()), int(other.sum())))
        rows, columns = (np.flatnonzero(m.any(axis=1)) for m in (mask, other))
        starts, firsts = (np.concatenate([[0], np.cumsum(m.sum(axis=1))]) for m in (mask, other))
        for q in columns:
            kernel = (self.back[0][rows] * self.there[0][:, q]) @ g
            right = self.there[1][:, other[q]]
            for p, line in zip(rows, kernel, strict=True):
                block = (self.back[1][mask[p]] * line) @ right
                out[starts[p] : starts[p + 1], firsts[q] : firsts[q + 1]] = block
        return out


def _quotient(x: Array | float, d: Array) -> Array:
    """Return x / d, 0 where d is."""
    return np.divide(x, d, out=np.zeros(d.shape), where=d != 0.0)


class PressureCorrection:
    """Poisson solver with the value zero given on the open parts and a zero derivative on the rest of the sides.

    On an open part the second difference loses c q with c = 2/w^2 at the cells there, so that

        L x = r + E s,  s = c E^T x,    (E^T L^-1 E - 1/c) s = -E^T L^-1 r

    with L the operator for walls and E the cells at the open parts; bordered by the constant where L is singular.

    Args:
        grid: The grid.
        solver: Poisson solver with walls on the mixed sides.
        boundary: The sides.
    """

    def __init__(self, grid: MacGrid, solver: TensorSolver, boundary: Boundary) -> None:
        self.grid, self.solver = grid, solver
        self.modes = modes = SideModes(grid, solver, boundary)
        widths = [grid.cell_widths[modes.axis][-1 if place.upper else 0] for place in modes.places]
        c = np.repeat([2.0 / w**2 for w in widths], modes.counts)
        system = modes.responses(0.0, -1.0) - np.diag(1.0 / c)
        if solver.singular:
            t1, t2 = modes.tangents
            area = grid.cell_widths[t1][:, None] * grid.cell_widths[t2]
            volume = np.concatenate([area[mask] * w for mask, w in zip(modes.masks, widths, strict=True)])
            one = np.ones((modes.num, 1))
            system = np.block([[system, one], [volume[None, :], np.zeros((1, 1))]])
        self.factors = scipy.linalg.lu_factor(system)

    def solve(self, r: Array) -> Array:
        """Return x with (D0 + D1 + D2) x = r (collective).

        Args:
            r: Right-hand side on the owned cells, contiguous; is overwritten.
        """
        extra = []
        if self.solver.singular:
            x, y, z = (w[own] for w, own in zip(self.grid.widths, self.grid.owned, strict=True))
            along_z = (r.reshape(-1, len(z)) @ z).reshape(len(x), len(y))
            extra = [self.grid.comm.allreduce(float(x @ along_z @ y))]
        constant = np.zeros(1)

        def correct(x: Array) -> None:
            right = -np.concatenate([self.modes.values(x), extra])
            found = scipy.linalg.lu_solve(self.factors, right, check_finite=False)
            self.modes.add(x, found[: self.modes.num], 0.0, -1.0)
            constant[0] = found[-1] if extra else 0.0

        x = self.solver.solve(r, 0.0, -1.0, correct)
        if extra:
            x += constant[0]
        return x


class NormalVelocityCorrection:
    """Viscous solver of the velocity normal to mixed sides: the open faces on them are unknowns too.

    With u_b on the open faces and A the operator for faces inside, whose neighbours on the side are at rest,

        A u = r + b/(w g) E u_b,    (a + 2b/w^2 - b D_t) u_b = r_b + 2b/w^2 E^T u

    where E are the faces next to the side, w the width of the cells between and D_t the second differences
    along the side among open faces.

    Args:
        grid: The grid.
        solver: Solver with walls on the mixed sides.
        boundary: The sides.
    """

    def __init__(self, grid: MacGrid, solver: TensorSolver, boundary: Boundary) -> None:
        self.grid, self.solver = grid, solver
        self.modes = modes = SideModes(grid, solver, boundary)
        w = [grid.cell_widths[modes.axis][[-1, -2] if p.upper else [0, 1]] for p in modes.places]
        self.across = np.repeat([2.0 / first**2 for first, _ in w], modes.counts)
        self.inward = np.repeat([2.0 / (first * (first + second)) for first, second in w], modes.counts)
        self.along = self._along()
        self.known: tuple[float, float] | None = None
        self.factors = None

    def _along(self) -> Array:
        """Second differences along the sides among the open faces, ``(num, num)``."""
        D1, D2 = (self.solver.axes[a].second_difference() for a in self.modes.tangents)
        blocks = []
        for mask in self.modes.masks:
            i, j = np.nonzero(mask)
            same_i, same_j = i[:, None] == i, j[:, None] == j
            blocks.append(D1[np.ix_(i, i)] * same_j + D2[np.ix_(j, j)] * same_i)
        return scipy.linalg.block_diag(*blocks)

    def _factorise(self, a: float, b: float) -> None:
        if self.known != (a, b):
            n = self.modes.num
            system = np.diag(a + b * self.across) - b * self.along
            response = self.modes.responses(a, b)
            system -= (b * self.across)[:, None] * response * (b * self.inward)
            self.factors, self.known = scipy.linalg.lu_factor(system.reshape(n, n)), (a, b)

    def solve(self, r: Array, r_side: list[Array], a: float, b: float) -> tuple[Array, list[Array]]:
        """Return the velocity inside and on the open faces (collective).

        Args:
            r: Right-hand side on this rank's faces inside, contiguous; is overwritten.
            r_side: Right-hand side on the faces of each mixed side, whole planes, zero where another rank owns them.
            a: Multiple of the identity.
            b: Multiple of the second differences.

        Returns:
            Solution inside, and on the faces of each mixed side, whole planes, zero on walls.
        """
        self._factorise(a, b)
        for plane in r_side:
            self.grid.comm.Allreduce(MPI.IN_PLACE, plane)
        given = np.concatenate([plane[mask] for plane, mask in zip(r_side, self.modes.masks, strict=True)])
        found = np.zeros(self.modes.num)

        def correct(x: Array) -> None:
            right = given + b * self.across * self.modes.values(x)
            found[:] = scipy.linalg.lu_solve(self.factors, right, check_finite=False)
            self.modes.add(x, b * self.inward * found, a, b)

        x = self.solver.solve(r, a, b, correct)
        planes = []
        for part, mask in zip(self.modes.split(found), self.modes.masks, strict=True):
            plane = np.zeros(mask.shape)
            plane[mask] = part
            planes.append(plane)
        return x, planes
