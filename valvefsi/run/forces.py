"""Forces of the fluid on bodies, in the history of a run.

The force on a body is what accelerates it less what holds it: with P the momentum of the fluid in it and F the sum of
its forces on the fluid (elastic ones cancel in it: springs, dampers, loads and the inertia of excess mass are left),

    force of the fluid = dP/dt - F,

the mean over the steps since the row before, without error from the step: State holds the time integral of F.
A control volume around the body checks it: what flows through its sides and what its fluid gains is the same force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.post.diagnostics.control_volume import ControlVolume

if TYPE_CHECKING:
    from valvefsi.fsi import Model, State
    from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True)
class ForceOutput:
    """A force in the history.

    Attributes:
        name: Name in the columns.
        bodies: Indices of the bodies whose forces are summed.
        box: Lower and upper corner of a box around them, whose balance of momentum gives the same force [cm]; None
            for no check.
    """

    name: str
    bodies: tuple[int, ...]
    box: tuple[tuple[float, ...], tuple[float, ...]] | None = None


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What the next row is compared with: everything at one time.

    Attributes:
        t: Time [s].
        momentum: Momentum of the bodies of each force, ``(num_forces, 3)`` [g cm/s].
        impulse: Impulse that they have given to the fluid, ``(num_forces, 3)`` [dyn s].
        inside: Momentum of the fluid in each control volume, ``(num_forces, 3)`` [g cm/s].
        inflow: Force and momentum that come in through its sides, ``(num_forces, 3)`` [dyn].
    """

    t: float
    momentum: Array
    impulse: Array
    inside: Array
    inflow: Array


class ForceMeter:
    """Gives the forces between the rows of a history.

    Args:
        model: The model.
        forces: What is asked for.

    Attributes:
        columns: Names of its columns [dyn; dyn/cm in two dimensions].
        last: Reading at the last row, None before the first.
    """

    def __init__(self, model: Model, forces: Sequence[ForceOutput]) -> None:
        self.model, self.forces = model, tuple(forces)
        self.last: Reading | None = None
        self._newest: Reading | None = None
        self.axes = "xyz"[: model.grid.dim]
        unit = "dyn" if model.grid.dim == 3 else "dyn_per_cm"
        names = [(f.name, part) for f in self.forces for part in ("", "_balance") if not part or f.box]
        self.columns = [f"force{part}_{axis}_{name}_{unit}" for name, part in names for axis in self.axes]
        self.volumes = [None if f.box is None else ControlVolume(model.grid, *f.box) for f in self.forces]

    def row(self, state: State) -> dict[str, float]:
        """Return the mean forces since the last row, not a number in the first one (collective)."""
        if not self.forces:
            return {}
        now, old = self._read(state), self.last
        self._newest = now
        nothing = np.full((len(self.forces), 3), np.nan)
        force = balance = nothing
        if old is not None and now.t > old.t:
            dt = now.t - old.t
            force = (now.momentum - old.momentum - (now.impulse - old.impulse)) / dt
            balance = 0.5 * (now.inflow + old.inflow) - (now.inside - old.inside) / dt
            balance = balance + (now.momentum - old.momentum) / dt
        dim, values = len(self.axes), []
        for k, output in enumerate(self.forces):
            values += [*force[k, :dim], *(balance[k, :dim] if output.box else ())]
        return dict(zip(self.columns, map(float, values), strict=True))

    def keep(self) -> None:
        """Count from the newest row on: it is in the history."""
        self.last = self._newest

    def meta(self) -> dict[str, object] | None:
        """Return what a checkpoint keeps."""
        last = self.last
        return None if last is None else {k: np.asarray(v).tolist() for k, v in vars(last).items()}

    def restore(self, meta: Mapping[str, Any] | None) -> None:
        """Go on from what `meta` was."""
        if meta is not None:
            arrays = {k: np.array(v).reshape(-1, 3) for k, v in meta.items() if k != "t"}
            self.last = Reading(t=meta["t"], **arrays)

    def _read(self, state: State) -> Reading:
        model = self.model
        rows = np.zeros((4, len(self.forces), 3))
        for k, (output, volume) in enumerate(zip(self.forces, self.volumes, strict=True)):
            for number in output.bodies:
                body, q = model.bodies[number], state.bodies[number]
                rows[0, k] += body.momentum(q, state.u, model.fluid.rho)
                rows[1, k] += state.given[number, :3]
            if volume is not None:
                rows[2, k] = volume.momentum(state.u, model.fluid.rho)
                rows[3, k] = volume.inflow(state.u, state.p, model.fluid.rho, model.fluid.mu)
        return Reading(t=state.t, momentum=rows[0], impulse=rows[1], inside=rows[2], inflow=rows[3])
