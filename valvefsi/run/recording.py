"""What a run leaves behind: history, ParaView series, checkpoints, pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.errors import CaseError
from valvefsi.fsi import Model, State
from valvefsi.grid import Array, MacGrid
from valvefsi.io import checkpoint
from valvefsi.io.history import History
from valvefsi.io.paraview import FluidSeries
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics import Section
from valvefsi.post.diagnostics.surfaces import surface_triangles
from valvefsi.run.forces import ForceMeter, ForceOutput
from valvefsi.run.recorded_stress import StressRecorder
from valvefsi.run.statistics import Line, Statistics
from valvefsi.units import MMHG


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A node whose displacement the history follows.

    Attributes:
        name: Name in the columns.
        body: Index of the body.
        at: Reference position; the nearest node is followed, ``(2,)`` or ``(3,)`` [cm].
    """

    name: str
    body: int
    at: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Orifice:
    """A valve whose open area, seen along z, the history follows.

    Attributes:
        body: Index of the leaflets.
        radius: Of the orifice about the z axis [cm].
    """

    body: int
    radius: float


class Observer(Protocol):
    """Adds columns of its own to the history, and may keep what it sees."""

    @property
    def columns(self) -> Sequence[str]:
        """Names of its columns."""
        ...

    def row(self, state: State) -> dict[str, float]:
        """Return a value for each column (collective)."""
        ...


@dataclass(frozen=True, kw_only=True)
class Output:
    """What is written, where and how often.

    Attributes:
        directory: Folder of the run.
        history_every: Steps between rows of the history, and between the checks that need all elements.
        frames: Number of ParaView frames over the whole run, 0 for none.
        checkpoint_every: Steps between checkpoints, 0 for one at the end only.
        checkpoint_wall_s: Wall-clock time between checkpoints, 0 for none by the clock [s].
        keep_checkpoints: Number of checkpoints to keep.
        probes: Nodes to follow.
        averages_from: Time from which on the flow is averaged, None for no averages [s].
        lines: Lines by name along which profiles are written at the end.
        every: Every how many cells along each axis the ParaView series of the fluid holds one.
        part: Lower and upper corner of the part of the box that it holds, None for all of it [cm].
        forces: Bodies whose force the history holds.
        observers: What adds columns of its own to the history.
        orifice: Valve whose open area the history holds.
        sections: Planes and disks by name whose flow and mean pressure the history holds.
        dissipation: Whether the history holds the viscous dissipation of the box.
        stress: Names of the stresses and strains written beside the frames, as a series ``NAME_stress``; see
            `valvefsi.solid.stress.QUANTITIES`.
        provenance: What is kept with every checkpoint.
    """

    directory: Path
    history_every: int = 100
    frames: int = 0
    checkpoint_every: int = 0
    checkpoint_wall_s: float = 0.0
    keep_checkpoints: int = 2
    probes: tuple[Probe, ...] = ()
    averages_from: float | None = None
    lines: Mapping[str, Line] = field(default_factory=dict)
    every: int = 1
    part: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    forces: tuple[ForceOutput, ...] = ()
    observers: tuple[Observer, ...] = ()
    orifice: Orifice | None = None
    sections: Mapping[str, Section] = field(default_factory=dict)
    dissipation: bool = False
    stress: tuple[str, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Memory:
    """What a run keeps beside its state from row to row.

    Attributes:
        statistics: Running averages.
        forces: Forces between rows.
    """

    statistics: Statistics
    forces: ForceMeter


def memory_of(model: Model, output: Output) -> Memory:
    """Return the memory of a run that begins."""
    statistics = Statistics(model.grid, start=output.averages_from, lines=output.lines)
    return Memory(statistics, ForceMeter(model, output.forces))


def save_state(model: Model, state: State, output: Output, memory: Memory, *, finished: bool = False) -> Path:
    """Write a checkpoint of a state, with a note whether the run is finished with it. Collective."""
    grid, statistics = model.grid, memory.statistics
    fields = {"p": checkpoint.Block(grid_part(state.p, grid.owned), grid.start, grid.cells)}
    for d in range(grid.dim):
        owned = grid.owned_faces(d)
        for name, faces in (("u", state.u), ("N", state.N)):
            fields[f"{name}{d}"] = checkpoint.Block(
                grid_part(faces[d], owned), grid.start, grid.face_shape(d)
            )
    for name, array in statistics.fields().items():
        fields[name] = checkpoint.Block(grid_part(array, (slice(None),) * 3), grid.start, grid.cells)
    rows = {
        name: checkpoint.Rows(state.bodies[k][key], model.bodies[k].ids, model.bodies[k].num_points)
        for name, (k, key) in tables_of(model, state).items()
    }
    meta = {"t": state.t, "step": state.step, "dt": state.dt, "finished": finished}
    meta["dt_stable"] = state.dt_stable if math.isfinite(state.dt_stable) else None
    meta["circuits"] = [float(value) for value in state.circuits]
    meta["impulse"] = state.impulse.tolist()
    meta["statistics"], meta["forces"] = statistics.meta(), memory.forces.meta()
    meta["provenance"] = dict(output.provenance)
    folder = output.directory / "checkpoints"
    return checkpoint.save(folder, state.step, fields, rows, meta, grid.comm, keep=output.keep_checkpoints)


def load_state(model: Model, output: Output, memory: Memory) -> State | None:
    """Read the newest whole checkpoint, None where there is none; the memory goes on from it. Collective."""
    grid, statistics = model.grid, memory.statistics
    places = {"p": grid.owned}
    for d in range(grid.dim):
        places |= {f"u{d}": grid.owned_faces(d), f"N{d}": grid.owned_faces(d)}
    request = {name: (grid.start, tuple(s.stop - s.start for s in place)) for name, place in places.items()}
    averages = statistics.fields()
    request |= {name: (grid.start, array.shape) for name, array in averages.items()}
    tables = tables_of(model, fsi.initial_state(model, 1.0))
    rows = {name: model.bodies[k].ids for name, (k, _) in tables.items()}
    found = checkpoint.load_latest(output.directory / "checkpoints", request, rows, grid.comm)
    if found is None:
        return None
    meta, fields, points = found
    statistics.restore({name: fields[name] for name in averages}, meta.get("statistics", {}))
    memory.forces.restore(meta.get("forces"))
    arrays = {name: grid.zeros() for name in places}
    for name, place in places.items():
        arrays[name][place] = fields[name]
    u = tuple(arrays[f"u{d}"] for d in range(grid.dim))
    grid.exchange((arrays["p"],), width=1)
    return State(
        t=meta["t"],
        step=meta["step"],
        dt=meta["dt"],
        dt_stable=math.inf if meta.get("dt_stable") is None else meta["dt_stable"],
        u=model.fluid.fill(u, meta["t"]),
        p=arrays["p"],
        N=tuple(arrays[f"N{d}"] for d in range(grid.dim)),
        bodies=tuple(
            {key: points[name] for name, (number, key) in tables.items() if number == k}
            for k in range(len(model.bodies))
        ),
        circuits=np.array(meta["circuits"]),
        impulse=np.array(meta["impulse"]).reshape(-1, 3),
    )


def tables_of(model: Model, state: State) -> dict[str, tuple[int, str]]:
    """Return number of the body and key of every table of the bodies' states, by its name in a checkpoint."""
    return {
        f"{key}_{k}_{body.name}": (k, key)
        for k, (body, q) in enumerate(zip(model.bodies, state.bodies, strict=True))
        for key in q
    }


def refuse_to_overwrite(model: Model, output: Output) -> None:
    """Raise CaseError where the folder holds a run that was not finished: a new one would remove it. Collective."""
    folder = output.directory / "checkpoints"
    meta = checkpoint.newest_meta(folder, model.grid.comm)
    if meta is not None and not meta.get("finished"):
        raise CaseError(
            f"this folder holds a run that is not finished (t = {meta['t']:.6g} s); --resume goes on with it, "
            "another --out or removing the folder starts anew",
            file=output.directory,
        )


def grid_part(array: Array, place: tuple[slice, ...]) -> Array:
    """Contiguous copy of a part of a local array."""
    return np.ascontiguousarray(array[place])


def _edges(grid: MacGrid) -> list[Array]:
    """Edges of all cells along each axis, three of ``(cells + 1,)`` [cm]."""
    return [
        start + np.concatenate([[0.0], np.cumsum(widths)])
        for start, widths in zip(grid.lower, grid.cell_widths, strict=True)
    ]


def box_of(grid: MacGrid) -> object:
    """Where the cells of a grid are, as ParaView series take it."""
    return (grid.lower, grid.spacing) if all(grid.uniform) else _edges(grid)


def chosen_cells(grid: MacGrid, output: Output) -> tuple[tuple[slice, ...], tuple]:
    """Return this rank's cells that the series of the fluid holds, and number, first, size and places of them.

    Of every ``every`` cells along an axis the middle one is taken, and shown as large as they are together.
    """
    every, edges = output.every, _edges(grid)
    slices, cells, start, size, shown = [], [], [], [], []
    for axis, e in enumerate(edges):
        step = every if axis < grid.dim else 1
        low, high = 0, len(e) - 1
        if output.part is not None and axis < grid.dim:
            low = max(0, int(np.searchsorted(e, output.part[0][axis] + 1e-9, side="right")) - 1)
            high = min(high, int(np.searchsorted(e, output.part[1][axis] - 1e-9)))
        picked = np.arange(low + step // 2, high, step)
        own = grid.start[axis], grid.start[axis] + grid.size[axis]
        first, last = np.searchsorted(picked, own)
        local = int(picked[first]) - own[0] if last > first else 0
        slices.append(slice(local, local + step * int(last - first), step))
        cells.append(len(picked))
        start.append(int(first))
        size.append(int(last - first))
        shown.append(e[np.minimum(np.append(picked - step // 2, picked[-1] - step // 2 + step), len(e) - 1)])
    whole = every == 1 and output.part is None
    place = (tuple(cells), tuple(start), tuple(size), box_of(grid) if whole else shown)
    return tuple(slices), place


class Recorder:
    """Writes history and ParaView series of a run, new or continued.

    Args:
        model: The model.
        output: What to write.
        memory: What the run keeps beside its state.
        resume: State that the run goes on from, None for a new run.

    Note:
        Collective.
    """

    def __init__(self, model: Model, output: Output, memory: Memory, resume: State | None = None) -> None:
        self.model, self.output, self.memory = model, output, memory
        grid, comm = model.grid, model.grid.comm
        self.probes = [(p, model.bodies[p.body].follow(p.at)) for p in output.probes]
        columns = ["step", "t_s", "courant", "kinetic_energy_erg"]
        for body in model.bodies:
            columns += body.columns()
        for probe, _ in self.probes:
            columns += [f"u_{axis}_{probe.name}_cm" for axis in "xyz"[: grid.dim]]
        columns += memory.forces.columns
        columns += [name for observer in output.observers for name in observer.columns]
        if output.orifice is not None:
            columns.append("pdva_cm2")
        if output.dissipation:
            columns.append("dissipation_erg_per_s")
        for name in output.sections:
            columns += [f"flow_{name}_cm3_per_s", f"pressure_{name}_dyn_per_cm2"]
            if output.sections[name].radius and grid.dim == 3 and model.fluid.mu > 0.0:
                columns.append(f"reynolds_{name}")
        for side in model.circulation.sides:
            columns += [f"q_{side}_ml_s", f"p_{side}_mmHg"]
        self.history = History(
            output.directory / "history.csv", columns, comm, resume.step if resume else None
        )
        time = resume.t if resume else None
        self.fluid_series = None
        if output.frames:
            folder = output.directory / "paraview"
            self.chosen, place = chosen_cells(grid, output)
            self.fluid_series = FluidSeries(folder, "fluid", comm, *place, resume_time=time)
            self.series = [body.series(folder, comm, time) for body in model.bodies]
            self.stresses = StressRecorder(model, output, resume)

    def append(self, row: dict[str, float], state: State) -> None:
        """Append a row to the history, and take averages and forces on from it. Collective."""
        self.history.append(row)
        self.memory.statistics.add(state)
        self.memory.forces.keep()

    def row(self, state: State) -> dict[str, float]:
        """Return one row of the history: Courant number, energy, volume change, J, displacements. Collective."""
        grid, comm = self.model.grid, self.model.grid.comm
        rate = comm.allreduce(diagnostics.local_courant_rate(grid, state.u), op=MPI.MAX)
        row = {
            "step": state.step,
            "t_s": state.t,
            "courant": rate * state.dt,
            "kinetic_energy_erg": diagnostics.kinetic_energy(grid, state.u, self.model.fluid.rho),
        }
        for body, q in zip(self.model.bodies, state.bodies, strict=True):
            row |= body.row(q)
        for probe, displacement in self.probes:
            shift = displacement(state.bodies[probe.body])
            row |= {f"u_{axis}_{probe.name}_cm": shift[a] for a, axis in enumerate("xyz"[: grid.dim])}
        row |= self.memory.forces.row(state)
        for observer in self.output.observers:
            row |= observer.row(state)
        return row | self._open_area(state) | self._read_off(state) | self._circuits(state)

    def _open_area(self, state: State) -> dict[str, float]:
        """Projected dynamic valve area of the orifice. Collective."""
        orifice = self.output.orifice
        if orifice is None:
            return {}
        leaflets = self.model.bodies[orifice.body].solid
        found = leaflets.cells_on_root(state.bodies[orifice.body]["chi"])
        area = None
        if found is not None:
            points, cells, _ = found
            triangles = np.concatenate([surface_triangles(kind, nodes) for kind, nodes in cells.items()])
            view = {"axis": np.array([0.0, 0.0, 1.0]), "centre": np.zeros(3), "radius": orifice.radius}
            area = diagnostics.projected_area(points, triangles, rows=128, **view).open_area
        return {"pdva_cm2": self.model.grid.comm.bcast(area)}

    def _circuits(self, state: State) -> dict[str, float]:
        """Flow out of the box through each side with a circuit, and the pressure outside it. Collective."""
        circulation, row = self.model.circulation, {}
        pressures = circulation.pressures(state.circuits, state.t)
        for side in circulation.sides:
            row[f"q_{side}_ml_s"] = self.model.fluid.boundary.outflow(state.u, side)
            row[f"p_{side}_mmHg"] = pressures[side] / MMHG
        return row

    def _read_off(self, state: State) -> dict[str, float]:
        """Dissipation, flows and pressures that were asked for. Collective."""
        grid, found = self.model.grid, {}
        if self.output.dissipation:
            mu = self.model.fluid.mu
            found["dissipation_erg_per_s"] = diagnostics.dissipation(grid, state.u, mu)
        for name, section in self.output.sections.items():
            found[f"flow_{name}_cm3_per_s"] = diagnostics.flow(grid, state.u, section)
            found[f"pressure_{name}_dyn_per_cm2"] = diagnostics.mean_pressure(grid, state.p, section)
            if section.radius and grid.dim == 3 and self.model.fluid.mu > 0.0:
                rho, mu = self.model.fluid.rho, self.model.fluid.mu
                number = diagnostics.reynolds_number(
                    found[f"flow_{name}_cm3_per_s"], 2 * section.radius, rho, mu
                )
                found[f"reynolds_{name}"] = float(number)
        return found

    def frame(self, state: State) -> None:
        """Write one time of the ParaView series. Collective."""
        if self.fluid_series is None:
            return
        grid = self.model.grid
        velocity, p = diagnostics.cell_velocity(grid, state.u), state.p[grid.owned]
        self.fluid_series.write(state.t, velocity[self.chosen], grid_part(p, self.chosen))
        for series, q in zip(self.series, state.bodies, strict=True):
            series.write(state.t, q)
        self.stresses.write(state)
