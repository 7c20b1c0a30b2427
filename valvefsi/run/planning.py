"""What a run will take, before it is run: size, memory, limits of the step, time.

The limits are of the explicit coupling: with nodes moved by the fluid, a spring is a spring on the mass of fluid
that the kernel moves. For a stiffness k per area of a face,

    omega^2 = k c / (rho h),   c = max_r sum_j phi(r - j)^2,   dt < 2 / omega,

for a body tether omega^2 = k / rho, for the elastic waves omega = 2 sqrt(dim) c_p / l with
c_p^2 = (kappa + 4/3 mu_s + fibres) / rho and l the smallest edge, where a body of thickness t below h / c moves the
mass rho h / c of fluid instead of rho t; a damper eta decays stably while
dt < 2 rho / eta (body) or dt < 2 rho h / (eta c) (area). The tie of the excess mass of a solid heavier than the fluid
takes a part of these limits, see `valvefsi.bodies.excess_mass`, and has none of its own. Implicit viscosity has no
limit, explicit viscosity that of `ExplicitViscosity`. These bounds are simple and on the safe side, for thin bodies by
far; `valvefsi.run.stable_step` measures the limit itself.
"""

from __future__ import annotations

import math
import resource
import time
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from valvefsi import fsi
from valvefsi.coupling import kernels
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.fsi import Model
from valvefsi.run.health import LONGEST_GAP, remedy, widest_gap
from valvefsi.run.simulation import Simulation, timed
from valvefsi.run.stable_step import measured_limit

TRIAL_STEPS = 5


SOUND_BARE, SOUND_ELEMENTAL = 0.85, 1.0
"""Distance of nodes over h up to which nodal coupling without volumetric energy was sound (0.5 in all, 0.75 in some
of the kernel study), and from which elemental coupling is 5 % off or more."""
WIDE = ("ib4", "ib5", "ib6", "bspline6")
"""Kernels that were 3 to 6 % off on Cook's membrane with nodal coupling and elements of 0.5 to 1 h, stabilised."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One line of a plan.

    Attributes:
        quantity: What it is.
        value: Its value.
        unit: Unit of the value.
        note: What to make of it.
    """

    quantity: str
    value: float | int | str
    unit: str = ""
    note: str = ""


def plan(simulation: Simulation) -> list[Entry]:
    """Return size, memory, limits of the step and expected time of a run.

    Args:
        simulation: The simulation, not run yet; a few trial steps are taken from its first state and thrown away.

    Note:
        Collective.
    """
    model, schedule = simulation.model, simulation.schedule
    return [*_size(model, schedule.num_steps), *_limits(simulation), *_gives(model), *_cost(simulation)]


def _size(model: Model, steps: int) -> list[Entry]:
    grid = model.grid
    cells = " x ".join(str(n) for n in grid.cells[: grid.dim])
    entries = [
        Entry(quantity="cells", value=math.prod(grid.cells), note=cells),
        Entry(quantity="spacing h", value=float(grid.spacing[0]), unit="cm"),
        Entry(quantity="steps", value=steps),
        Entry(quantity="ranks", value=grid.comm.size),
    ]
    for solid, coupling in zip(model.solids, model.couplings, strict=True):
        ratio = solid.stiffness().smallest_edge / grid.spacing[0]
        longest = solid.longest_edge() / grid.spacing[0]
        entries.append(
            Entry(
                quantity=f"points of {solid.name}",
                value=solid.num_nodes,
                note=f"smallest edge / h = {ratio:.2f}, longest {longest:.2f}",
            )
        )
        gaps = widest_gap(solid, coupling, solid.X), solid.longest_gap(solid.X)
        entries += _advice(solid, coupling, *(float(gap / grid.spacing[0]) for gap in gaps))
    for surface in model.rigid:
        entries.append(Entry(quantity=f"points of {surface.name}", value=surface.num_nodes, note="rigid"))
    return [*entries, _memory(model)]


def _advice(solid: object, coupling: object, gap: float, nodes: float) -> list[Entry]:
    """Warn where a solid leaves the range in which the kernel study found errors of at most 3 % and no leak.

    Args:
        solid: The solid.
        coupling: Its coupling.
        gap: Largest distance of neighbouring points, over h.
        nodes: Largest distance of neighbouring nodes, over h.
    """
    found = []
    if gap > LONGEST_GAP:
        found.append(
            f"fluid leaks between points: neighbours are {gap:.2f} h apart, at most {LONGEST_GAP:g} is safe; "
            f"{remedy(coupling)}"
        )
    if not solid.kappa > 0.0:
        found.append("no volumetric energy (nu_stab, kappa): J goes far from 1 under large compression")
        if coupling.nodal and SOUND_BARE < nodes <= LONGEST_GAP:
            found.append(
                f"without volumetric energy nodes {nodes:.2f} h apart may leak where it stretches; 0.5 h was sound"
            )
    if not coupling.nodal and nodes > SOUND_ELEMENTAL:
        found.append(
            f"elemental coupling was 5 % and more off with nodes {SOUND_ELEMENTAL:g} h apart, here they are "
            f"{nodes:.2f} h; refine the mesh"
        )
    if coupling.nodal and solid.kappa > 0.0 and coupling.name in WIDE:
        found.append(f"{coupling.name} was 3 to 6 % off on Cook's membrane, bspline3 at most 1 %")
    return [Entry(quantity=f"warning, {solid.name}", value="", note=text) for text in found]


def _memory(model: Model) -> Entry:
    """Two states (u, N, p), the force, and at the peak a step's own arrays; 6 weights and indices per point."""
    grid = model.grid
    per_cell = 8 * (2 * (2 * grid.dim + 1) + grid.dim + grid.dim + 3)
    ghosted = math.prod(grid.shape)
    points = sum(
        len(s.X) * 8 * (2 * 6 * (c.kind[1] + 1) + 15)
        for s, c in zip(model.solids, model.couplings, strict=True)
    )
    here = (ghosted * per_cell + points) / 2**20
    loaded = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    total = grid.comm.allreduce(here + loaded)
    return Entry(
        quantity="memory, all ranks",
        value=total,
        unit="MiB",
        note=f"{grid.comm.allreduce(here):.0f} MiB of fields",
    )


def largest_square_sum(kernel: str) -> float:
    """Largest sum of squares of a kernel's weights over all shifts."""
    family, _, points = kernels.KERNELS[kernel]
    sums = []
    for s in np.linspace(0.0, 1.0, 101):
        w = np.zeros(points)
        kernels.weights_at(w, family, points, s)
        sums.append(float((w**2).sum()))
    return max(sums)


def step_limits(model: Model) -> dict[str, float]:
    """Largest stable steps by cause [s]. Collective."""
    grid, rho = model.grid, model.fluid.rho
    h = float(min(grid.spacing[: grid.dim]))
    limits: dict[str, float] = {}
    rooms = {body.solid: body.room for body in model.heavy}
    for number, (solid, coupling) in enumerate(zip(model.solids, model.couplings, strict=True)):
        room = rooms.get(number, 1.0)
        stiff, c = solid.stiffness(), largest_square_sum(coupling.name)
        fibres = getattr(solid.material, "fibre_modulus", 0.0)
        modulus = (stiff.kappa or 0.0) + 4.0 / 3.0 * stiff.shear_modulus + fibres
        mass = rho * max(1.0, h / (c * solid.thickness()))
        edge = stiff.smallest_edge
        limits[f"elastic, {solid.name}"] = edge * math.sqrt(room * mass / modulus / grid.dim)
        if solid.viscosity:
            limits[f"viscosity, {solid.name}"] = (
                room * mass * edge**2 / (4.0 * solid.viscosity.eta * grid.dim)
            )
        if solid.permeability > 0:
            limits[f"seepage, {solid.name}"] = edge**2 / (2.0 * solid.permeability * modulus * grid.dim)
        springs: dict[str, float] = {}
        for tether in solid.tethers:
            mass = rho if tether.on is None else rho * h / c
            for axis in "xyz"[: grid.dim]:
                if axis in tether.components:
                    springs[axis] = springs.get(axis, 0.0) + tether.stiffness / mass
        if springs:
            limits[f"tether, {solid.name}"] = 2.0 * math.sqrt(room / max(springs.values()))
        damping = solid.damping / rho + sum(
            t.damping / (rho if t.on is None else rho * h / c) for t in solid.tethers
        )
        if damping > 0.0:
            limits[f"damping, {solid.name}"] = 2.0 * room / damping
    return limits


def _limits(simulation: Simulation) -> list[Entry]:
    model, schedule = simulation.model, simulation.schedule
    h = float(min(model.grid.spacing[: model.grid.dim]))
    limit = ExplicitViscosity.limit(model.grid, rho=model.fluid.rho, mu=model.fluid.mu)
    if isinstance(model.fluid, ExplicitViscosity):
        viscous = f"viscosity is explicit, dt / limit = {schedule.dt / limit:.2f}"
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
    for cause, limit in step_limits(model).items():
        note = f"dt / limit = {schedule.dt / limit:.2f}, a bound on the safe side"
        entries.append(Entry(quantity=f"step limit, {cause}", value=limit, unit="s", note=note))
    for number, solid in enumerate(model.solids):
        limit = measured_limit(model, schedule.dt, number)
        ratio = schedule.dt / limit
        note = f"dt / limit = {ratio:.2f}" + (", unstable" if ratio > 1.0 else "")
        entries.append(
            Entry(quantity=f"step limit, measured at rest, {solid.name}", value=limit, unit="s", note=note)
        )
    return entries + _ties(model, schedule.dt)


def _ties(model: Model, dt: float) -> list[Entry]:
    """How stiffly the excess mass of each heavy solid is tied to it, and how far it lags. Collective."""
    return [
        Entry(
            quantity=f"tie of the excess mass of {model.solids[body.solid].name}",
            value=body.stiffness(dt),
            unit="dyn/cm",
            note=f"density {body.density:g} g/cm^3; lag = {body.lag_of_acceleration(dt):.3g} s^2 times acceleration",
        )
        for body in model.heavy
    ]


def _gives(model: Model) -> list[Entry]:
    """How far each tether gives under the mean of the loads it carries: mean traction / stiffness."""
    entries = []
    for solid in model.solids:
        total = np.zeros(3)
        for load in solid.load_report():
            total[: len(load.value)] += np.array(load.value) * load.measure
        for tether in solid.tether_report():
            force = max((abs(total["xyz".index(axis)]) for axis in tether.components), default=0.0)
            where = "body" if tether.on is None else ", ".join(tether.on)
            entries.append(
                Entry(
                    quantity=f"give of the tether on {where} ({''.join(tether.components)})",
                    value=force / (tether.measure * tether.value) if tether.value else math.inf,
                    unit="cm",
                    note="mean traction / stiffness",
                )
            )
    return entries


def _cost(simulation: Simulation) -> list[Entry]:
    model, schedule = simulation.model, simulation.schedule
    state = simulation.initial or fsi.initial_state(model, schedule.dt)
    times, fluid, parts = [], [], defaultdict(float)
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
            value=1e3 * each,
            unit="ms",
            note=f"median of {TRIAL_STEPS - 1} trial steps",
        ),
        Entry(
            quantity="fluid's part of a step",
            value=100.0 * share,
            unit="%",
            note="the rest is the solids and their coupling",
        ),
        Entry(quantity="expected time", value=each * schedule.num_steps, unit="s", note="without output"),
    ]
