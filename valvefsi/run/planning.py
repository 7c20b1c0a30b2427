"""What a run will take, before it is run: size, memory, limits of the step, time.

The limits are of the explicit coupling: with nodes moved by the fluid, a spring is a spring on the mass of fluid
that the kernel moves. For a stiffness k per area of a face,

    omega^2 = k c / (rho h),   c = max_r sum_j phi(r - j)^2,   dt < 2 / omega,

for a body tether omega^2 = k / rho, for the elastic waves omega = 2 sqrt(dim) c_p / l with
c_p^2 = (kappa + 4/3 mu_s + fibres) / rho and l the smallest edge, where a body of thickness t below h / c moves the
mass rho h / c of fluid instead of rho t; a damper eta decays stably while
dt < 2 rho / eta (body) or dt < 2 rho h / (eta c) (area). The penalty of the excess mass of a solid heavier than the
fluid takes a part of these limits, see `valvefsi.bodies.heavy`, and has none of its own. Implicit viscosity has no
limit, explicit viscosity that of `ExplicitViscosity`. These bounds are simple and on the safe side, for thin bodies by
far; `valvefsi.run.stable_step` measures the limit itself.
"""

from __future__ import annotations

import math
import resource
import time
from collections import defaultdict

import numpy as np

from valvefsi import fsi
from valvefsi.bodies.body import Entry
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.fsi import Model
from valvefsi.run.disk import disk_free, disk_needed
from valvefsi.run.schedule import AdaptiveSchedule, Schedule
from valvefsi.run.simulation import Simulation, timed
from valvefsi.run.stable_step import measured_limit

TRIAL_STEPS = 5


def plan(simulation: Simulation, t: float = 0.0) -> list[Entry]:
    """Return size, memory, limits of the step and expected time of a run.

    Args:
        simulation: The simulation, not run yet; a few trial steps are taken from its first state and thrown away.
        t: Time from which it is run [s].

    Note:
        Collective.
    """
    model, schedule = simulation.model, simulation.schedule
    steps = schedule.num_steps(t)
    held = [entry for body in model.bodies for entry in body.statics(schedule.dt)]
    return [
        *_size(model, schedule, steps),
        _disk(simulation, steps),
        *_limits(simulation),
        *held,
        *_cost(simulation, steps),
    ]


def _size(model: Model, schedule: Schedule | AdaptiveSchedule, steps: int) -> list[Entry]:
    grid = model.grid
    cells = " x ".join(str(n) for n in grid.cells[: grid.dim])
    note = "or more, where the time step is shorter" if isinstance(schedule, AdaptiveSchedule) else ""
    entries = [
        Entry(quantity="cells", value=math.prod(grid.cells), note=cells),
        Entry(quantity="spacing h", value=float(grid.spacing[0]), unit="cm"),
        Entry(quantity="steps", value=steps, note=note),
        Entry(quantity="ranks", value=grid.comm.size),
    ]
    for body in model.bodies:
        entries += body.size(grid)
    return [*entries, _memory(model)]


def _memory(model: Model) -> Entry:
    """Two states (u, N, p), the force, and at the peak a step's own arrays; what the bodies take."""
    grid = model.grid
    per_cell = 8 * (2 * (2 * grid.dim + 1) + grid.dim + grid.dim + 3)
    here = (math.prod(grid.shape) * per_cell + sum(body.memory() for body in model.bodies)) / 2**20
    loaded = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    total = grid.comm.allreduce(here + loaded)
    return Entry(
        quantity="memory, all ranks",
        value=total,
        unit="MiB",
        note=f"{grid.comm.allreduce(here):.0f} MiB of fields",
    )


def _disk(simulation: Simulation, steps: int) -> Entry:
    output = simulation.output
    needed = disk_needed(simulation.model, output, steps) / 1e9
    free = disk_free(output.directory) / 1e9
    note = f"{free:.3g} GB are free" if needed < free else f"ONLY {free:.3g} GB ARE FREE"
    return Entry(quantity="disk, at most", value=needed, unit="GB", note=note)


def step_limits(model: Model) -> dict[str, float]:
    """Largest stable steps by cause [s]. Collective."""
    h = float(min(model.grid.spacing[: model.grid.dim]))
    limits: dict[str, float] = {}
    for body in model.bodies:
        limits |= body.step_limits(h, model.fluid.rho)
    return limits


def _limits(simulation: Simulation) -> list[Entry]:
    model, schedule = simulation.model, simulation.schedule
    h = float(min(model.grid.spacing[: model.grid.dim]))
    limit = ExplicitViscosity.limit(model.grid, rho=model.fluid.rho, mu=model.fluid.mu)
    if isinstance(model.fluid, ExplicitViscosity):
        viscous = f"viscosity is explicit; {_share(schedule.dt / limit)}"
    else:
        viscous = "does not bind, viscosity is implicit"
    entries = [
        Entry(quantity="time step", value=schedule.dt, unit="s"),
        Entry(
            quantity="CFL limit: largest speed",
            value=schedule.cfl_max * h / schedule.dt,
            unit="cm/s",
            note=f"|u| dt / h <= {schedule.cfl_max:g}",
        ),
        Entry(
            quantity="viscous limit",
            value=limit,
            unit="s",
            note=viscous,
        ),
    ]
    rest = [measured_limit(model, schedule.dt, number) for number in range(len(model.bodies))]
    measured = any(map(math.isfinite, rest))
    for cause, limit in step_limits(model).items():
        note = f"a rough lower bound; {_share(schedule.dt / limit)}"
        note += "; the measured limit below counts" if schedule.dt > limit and measured else ""
        entries.append(Entry(quantity=f"step limit, {cause}", value=limit, unit="s", note=note))
    for body, limit in zip(model.bodies, rest, strict=True):
        if math.isfinite(limit):
            ratio = schedule.dt / limit
            note = _share(ratio) + (", unstable" if ratio > 1.0 else "")
            quantity = f"step limit, measured at rest, {body.name}"
            entries.append(Entry(quantity=quantity, value=limit, unit="s", note=note))
    return entries


def _share(ratio: float) -> str:
    """Say how long the step is beside a limit."""
    return f"the step is {100.0 * ratio:.3g} % of it" if ratio <= 1.0 else f"the step is {ratio:.3g} times it"


def _cost(simulation: Simulation, steps: int) -> list[Entry]:
    model, schedule = simulation.model, simulation.schedule
    state = simulation.initial or fsi.initial_state(model, schedule.dt)
    parts: dict[str, float] = defaultdict(float)
    times, fluid = [], []
    clocked = timed(model, parts)
    for _ in range(TRIAL_STEPS):
        model.grid.comm.barrier()
        parts.clear()
        started = time.perf_counter()
        state = fsi.step(clocked, state, schedule.dt)
        model.grid.comm.barrier()
        times.append(time.perf_counter() - started)
        fluid.append(parts["advection"] + parts["fluid solve"])
    each = model.grid.comm.bcast(float(np.median(times[1:])))
    share = model.grid.comm.bcast(float(np.median(fluid[1:]))) / each
    return [
        Entry(
            quantity="time of a step",
            value=each,
            unit="s",
            note=f"median of {TRIAL_STEPS - 1} trial steps",
        ),
        Entry(
            quantity="fluid's part of a step",
            value=100.0 * share,
            unit="%",
            note="the rest is the solids and their coupling",
        ),
        Entry(
            quantity="expected time",
            value=each * steps,
            unit="s",
            note="without output",
            wall=True,
        ),
    ]
