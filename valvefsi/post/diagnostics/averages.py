"""Running averages in time: mean velocity and pressure (S26) and turbulence kinetic energy (S27).

The mean and the sum of squares about it are updated sample by sample (West 1979), each with the length of
time it stands for, so that no history is kept and no digits are lost. Everything a restart needs is in
`Averages.fields` and `Averages.meta`.
"""

from __future__ import annotations

import numpy as np

from valvefsi.grid import MacGrid
from valvefsi.post.diagnostics.speeds import cell_velocity
from valvefsi.types import Array, Faces


class Averages:
    """Averages over the samples from a time on.

    Args:
        grid: The grid.
        start: Time from which on samples count [s].

    Attributes:
        time: Length of time averaged over [s].
        mean: Mean velocity in the owned cells, ``(n0, n1, n2, 3)`` [cm/s].
        pressure: Mean pressure there, ``(n0, n1, n2)`` [dyn/cm^2].
    """

    def __init__(self, grid: MacGrid, start: float = 0.0) -> None:
        self.grid, self.start = grid, start
        self.time = 0.0
        self.last: float | None = None
        self.mean = np.zeros((*grid.size, 3))
        self.pressure = np.zeros(grid.size)
        self._squares = np.zeros(grid.size)

    def add(self, t: float, u: Faces, p: Array) -> None:
        """Add the state at time t, which stands for the time since the one before; the first only sets the clock.

        Args:
            t: Time, not before the last one's [s].
            u: Velocity with filled ghosts [cm/s].
            p: Pressure [dyn/cm^2].
        """
        if t < self.start:
            return
        weight = 0.0 if self.last is None else t - self.last
        self.last = t
        if weight <= 0.0:
            return
        self.time += weight
        share = weight / self.time
        change = cell_velocity(self.grid, u) - self.mean
        self.mean += share * change
        self._squares += weight * (1.0 - share) * np.einsum("...i,...i->...", change, change)
        self.pressure += share * (p[self.grid.owned] - self.pressure)

    @property
    def kinetic_energy_of_turbulence(self) -> Array:
        """TKE, half the mean square of the fluctuation (S27), in the owned cells, ``(n0, n1, n2)`` [cm^2/s^2]."""
        return 0.5 * self._squares / self.time if self.time > 0.0 else np.zeros_like(self._squares)

    def fields(self) -> dict[str, Array]:
        """The arrays of a checkpoint by name, ``(n0, n1, n2)`` each; they share memory with this object's."""
        named = {f"mean_{axis}": self.mean[..., d] for d, axis in enumerate("xyz"[: self.grid.dim])}
        return named | {"mean_p": self.pressure, "mean_squares": self._squares}

    def meta(self) -> dict[str, float | None]:
        """The numbers of a checkpoint."""
        return {"time": self.time, "last": self.last, "start": self.start}

    def restore(self, fields: dict[str, Array], meta: dict[str, float | None]) -> None:
        """Go on from what `fields` and `meta` were."""
        for name, array in self.fields().items():
            array[...] = fields[name]
        self.time, self.last = float(meta["time"] or 0.0), meta["last"]
