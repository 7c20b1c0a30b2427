"""The balance of momentum of a box of fluid: an independent look at the force on a body in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from valvefsi.grid import MacGrid
from valvefsi.post.diagnostics.gradients import velocity_gradient
from valvefsi.post.diagnostics.speeds import cell_velocity
from valvefsi.types import Array, Faces


class ControlVolume:
    """A box of whole cells.

    Args:
        grid: The grid.
        lower: Lower corner, ``(2,)`` or ``(3,)`` [cm]; the nearest faces of cells are taken.
        upper: Upper corner [cm].

    Attributes:
        bounds: First and last cell along each axis, ``(3, 2)``.

    Raises:
        ValueError: The box is empty, or within a cell of the sides of the grid.
    """

    def __init__(self, grid: MacGrid, lower: Sequence[float], upper: Sequence[float]) -> None:
        self.grid = grid
        bounds = [(0, n) for n in grid.cells]
        for axis in range(grid.dim):
            edges = grid.lower[axis] + np.concatenate([[0.0], np.cumsum(grid.cell_widths[axis])])
            low, high = (int(np.argmin(np.abs(edges - x))) for x in (lower[axis], upper[axis]))
            if not 1 <= low < high <= grid.cells[axis] - 1:
                raise ValueError(
                    f"expected a box of at least one cell, one cell away from the sides, got {lower} to {upper} cm"
                )
            bounds[axis] = (low, high)
        self.bounds = np.array(bounds)

    def momentum(self, u: Faces, rho: float) -> Array:
        """Return the momentum of the fluid in it, ``(3,)`` [g cm/s] (collective).

        Args:
            u: Velocity on the faces, ghosts filled [cm/s].
            rho: Density of the fluid [g/cm^3].
        """
        velocity = cell_velocity(self.grid, u)
        weights = [self._inside(axis) * self._widths(axis) for axis in range(3)]
        return self._summed(rho * np.einsum("ijkd,i,j,k->d", velocity, *weights))

    def inflow(self, u: Faces, p: Array, rho: float, mu: float) -> Array:
        """Return the force on its fluid through its sides, with momentum that comes in, ``(3,)`` [dyn] (collective).

            sum over the sides of int [-p n + mu (grad u + grad u^T) n - rho u (u . n)] dA

        Args:
            u: Velocity on the faces, ghosts filled [cm/s].
            p: Pressure in the cells, a local array [dyn/cm^2].
            rho: Density of the fluid [g/cm^3].
            mu: Its viscosity [dyn s/cm^2].
        """
        grid = self.grid
        velocity, gradient = cell_velocity(grid, u), velocity_gradient(grid, u)
        pressure, total = p[grid.owned], np.zeros(3)
        for axis in range(grid.dim):
            stress = mu * (gradient[..., :, axis] + gradient[..., axis, :])
            stress[..., : velocity.shape[-1]] -= rho * velocity * velocity[..., axis, None]
            stress[..., axis] -= pressure
            weights = [self._inside(a) * self._widths(a) for a in range(3)]
            weights[axis] = self._on_sides(axis)
            total += np.einsum("ijkd,i,j,k->d", stress, *weights)
        return self._summed(total)

    def _own(self, axis: int, values: Array) -> Array:
        start = self.grid.start[axis]
        return values[start : start + self.grid.size[axis]]

    def _widths(self, axis: int) -> Array:
        return self._own(axis, np.asarray(self.grid.cell_widths[axis]))

    def _inside(self, axis: int) -> Array:
        number = np.arange(self.grid.cells[axis])
        low, high = self.bounds[axis]
        return self._own(axis, ((number >= low) & (number < high)).astype(float))

    def _on_sides(self, axis: int) -> Array:
        """Weights of this rank's cells along an axis: linear interpolation to the upper side, less to the lower one."""
        width, weights = self.grid.cell_widths[axis], np.zeros(self.grid.cells[axis])
        for face, sign in zip(self.bounds[axis], (-1.0, 1.0), strict=True):
            below, above = width[face - 1], width[face]
            weights[face - 1] += sign * above / (below + above)
            weights[face] += sign * below / (below + above)
        return self._own(axis, weights)

    def _summed(self, values: Array) -> Array:
        whole = np.zeros(3)
        whole[: len(values)] = values
        return self.grid.comm.allreduce(whole)
