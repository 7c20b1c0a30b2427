"""What a run leaves behind: history, ParaView series, checkpoints, pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from mpi4py import MPI

from valvefsi.fsi import Model, State
from valvefsi.grid import Array, MacGrid
from valvefsi.io.history import History
from valvefsi.io.paraview import FluidSeries
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics import Section
from valvefsi.post.diagnostics.surfaces import surface_triangles
from valvefsi.run.energy import EnergyMeter
from valvefsi.run.forces import ForceMeter, ForceOutput
from valvefsi.run.recorded_stress import StressRecorder
from valvefsi.run.statistics import Line, Statistics
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from valvefsi.solid.structure import Structure

FREE_EDGES = "free_edges.csv"
"""Where the middles of a valve's free edges are over time."""


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
        middles: Reference positions of the middles of the free edges, which ``free_edges.csv`` follows, ``(3,)`` each
            [cm].
    """

    body: int
    radius: float
    middles: tuple[tuple[float, ...], ...] = ()


class FreeEdges:
    """How far the middles of a valve's free edges are from the axis, in ``free_edges.csv``, as often as the history.

    Each is the node of the free edge next to its middle, along its own direction from the axis in the reference
    configuration; negative beyond the axis.

    Args:
        model: The model.
        orifice: The valve.
        folder: Folder of the run.
        resume: State that the run goes on from, None for a new run.

    Note:
        Collective.
    """

    def __init__(self, model: Model, orifice: Orifice, folder: Path, resume: State | None) -> None:
        leaflets = model.bodies[orifice.body].solid
        self.body, self.table = orifice.body, None
        if leaflets is None or not orifice.middles:
            return
        self.leaflets: Structure = leaflets
        self.nodes = [leaflets.node_at(middle) for middle in orifice.middles]
        self.ways = [np.array([x, y, 0.0]) / np.hypot(x, y) for x, y, _ in orifice.middles]
        self.columns = [f"leaflet_{k + 1}_middle_cm" for k in range(len(self.nodes))]
        columns = ["step", "t_s", *self.columns]
        self.table = History(folder / FREE_EDGES, columns, model.grid.comm, resume.step if resume else None)

    def append(self, state: State) -> None:
        """Append a row. Collective."""
        if self.table is None:
            return
        chi = state.bodies[self.body]["chi"]
        at = [
            float(self.leaflets.position_of(node, chi) @ way)
            for node, way in zip(self.nodes, self.ways, strict=True)
        ]
        self.table.append({"step": state.step, "t_s": state.t} | dict(zip(self.columns, at, strict=True)))


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
        energy: Whether the history holds the balance of energy.
        observers: What adds columns of its own to the history.
        orifice: Valve whose open area the history holds.
        sections: Planes and disks by name whose flow and mean pressure the history holds.
        dissipation: Whether the history holds the viscous dissipation of the box.
        stress: Names of the stresses and strains written beside the frames, as a series ``NAME_stress``; see
            `valvefsi.solid.stress.QUANTITIES`.
        provenance: What is kept with every checkpoint.
        units: Units of the pictures, "lab" or "cgs".
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
    energy: bool = False
    observers: tuple[Observer, ...] = ()
    orifice: Orifice | None = None
    sections: Mapping[str, Section] = field(default_factory=dict)
    dissipation: bool = False
    stress: tuple[str, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)
    units: str = "lab"


def grid_part(array: Array, place: tuple[slice, ...]) -> Array:
    """Contiguous copy of a part of a local array."""
    return np.ascontiguousarray(array[place])


def _edges(grid: MacGrid) -> list[Array]:
    """Edges of all cells along each axis, three of ``(cells + 1,)`` [cm]."""
    return [
        start + np.concatenate([[0.0], np.cumsum(widths)])
        for start, widths in zip(grid.lower, grid.cell_widths, strict=True)
    ]


def box_of(grid: MacGrid) -> Sequence[Sequence[float]]:
    """Where the cells of a grid are, as ParaView series take it."""
    places = [grid.lower, grid.spacing] if all(grid.uniform) else _edges(grid)
    return [place.tolist() for place in places]


@dataclass(frozen=True, kw_only=True)
class Chosen:
    """The cells that the series of the fluid holds.

    Attributes:
        own: This rank's, in its owned cells.
        cells: Number of all along each axis.
        start: Number of this rank's first.
        size: Number of this rank's.
        box: Where they are, as `FluidSeries` takes it [cm].
    """

    own: tuple[slice, ...]
    cells: tuple[int, ...]
    start: tuple[int, ...]
    size: tuple[int, ...]
    box: Sequence[Sequence[float]]


def chosen_cells(grid: MacGrid, output: Output) -> Chosen:
    """Return this rank's cells that the series of the fluid holds.

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
    box = box_of(grid) if whole else [e.tolist() for e in shown]
    return Chosen(own=tuple(slices), cells=tuple(cells), start=tuple(start), size=tuple(size), box=box)


class Recorder:
    """Writes history and ParaView series of a run, new or continued.

    Args:
        model: The model.
        output: What to write.
        statistics: Averages of the run.
        meters: What it keeps from row to row of its history.
        frames: Times of the frames of the run so far [s]; those that it writes are added.
        resume: State that the run goes on from, None for a new run.

    Note:
        Collective.
    """

    def __init__(
        self,
        model: Model,
        output: Output,
        statistics: Statistics,
        meters: Sequence[ForceMeter | EnergyMeter],
        frames: list[float | None],
        resume: State | None = None,
    ) -> None:
        self.model, self.output, self.frames = model, output, frames
        self.statistics, self.meters = statistics, tuple(meters)
        grid, comm = model.grid, model.grid.comm
        self.probes = [(p, model.bodies[p.body].follow(p.at)) for p in output.probes]
        columns = ["step", "t_s", "courant", "kinetic_energy_erg"]
        for body in model.bodies:
            columns += body.columns()
        for probe, _ in self.probes:
            columns += [f"u_{axis}_{probe.name}_cm" for axis in "xyz"[: grid.dim]]
        for meter in self.meters:
            columns += meter.columns
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
        self.edges = FreeEdges(model, output.orifice, output.directory, resume) if output.orifice else None
        kept = frames if resume else None
        self.fluid_series = None
        if output.frames:
            folder = output.directory / "paraview"
            chosen = self.chosen = chosen_cells(grid, output)
            self.fluid_series = FluidSeries(
                folder, "fluid", comm, chosen.cells, chosen.start, chosen.size, chosen.box, kept
            )
            self.series = [body.series(folder, comm, kept) for body in model.bodies]
            self.stresses = StressRecorder(model, output, resume, frames)

    def reopen(self, state: State, *, finished: bool) -> None:
        """Begin a history that is lost with the state that a run goes on from, and end one with it. Collective."""
        if finished and (self.history.last is None or self.history.last < state.step):
            self.append(self.row(state), state)
        elif self.history.last is None:
            self.history.append(self.row(state))

    def append(self, row: dict[str, float], state: State) -> None:
        """Append a row to the history, and take averages, forces and energies on from it. Collective."""
        self.history.append(row)
        if self.edges is not None:
            self.edges.append(state)
        self.statistics.add(state)
        for meter in self.meters:
            meter.keep()

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
        for meter in self.meters:
            row |= meter.row(state)
        for observer in self.output.observers:
            row |= observer.row(state)
        return row | self._open_area(state) | self._read_off(state) | self._circuits(state)

    def _open_area(self, state: State) -> dict[str, float]:
        """Projected dynamic valve area of the orifice. Collective."""
        orifice = self.output.orifice
        if orifice is None:
            return {}
        leaflets = self.model.bodies[orifice.body].solid
        gathered = leaflets.cells_on_root(state.bodies[orifice.body]["chi"]) if leaflets else None
        area = None
        if gathered is not None:
            points, cells, _ = gathered
            triangles = np.concatenate([surface_triangles(kind, nodes) for kind, nodes in cells.items()])
            axis, centre = np.array([0.0, 0.0, 1.0]), np.zeros(3)
            view = diagnostics.projected_area(
                points, triangles, axis=axis, centre=centre, radius=orifice.radius, rows=128
            )
            area = view.open_area
        return {"pdva_cm2": self.model.grid.comm.bcast(area)}

    def _circuits(self, state: State) -> dict[str, float]:
        """Flow out of the box through each side with a circuit, and the pressure outside it. Collective."""
        circulation = self.model.circulation
        row: dict[str, float] = {}
        pressures = circulation.pressures(state.circuits, state.t)
        for side in circulation.sides:
            row[f"q_{side}_ml_s"] = self.model.fluid.boundary.outflow(state.u, side)
            row[f"p_{side}_mmHg"] = pressures[side] / MMHG
        return row

    def _read_off(self, state: State) -> dict[str, float]:
        """Dissipation, flows and pressures that were asked for. Collective."""
        grid = self.model.grid
        values: dict[str, float] = {}
        if self.output.dissipation:
            mu = self.model.fluid.mu
            values["dissipation_erg_per_s"] = diagnostics.dissipation(grid, state.u, mu)
        for name, section in self.output.sections.items():
            values[f"flow_{name}_cm3_per_s"] = diagnostics.flow(grid, state.u, section)
            values[f"pressure_{name}_dyn_per_cm2"] = diagnostics.mean_pressure(grid, state.p, section)
            if section.radius and grid.dim == 3 and self.model.fluid.mu > 0.0:
                rho, mu = self.model.fluid.rho, self.model.fluid.mu
                number = diagnostics.reynolds_number(
                    values[f"flow_{name}_cm3_per_s"], 2 * section.radius, rho, mu
                )
                values[f"reynolds_{name}"] = float(number)
        return values

    def frame(self, state: State) -> None:
        """Write one time of the ParaView series. Collective."""
        if self.fluid_series is None:
            return
        grid = self.model.grid
        velocity, p = diagnostics.cell_velocity(grid, state.u), state.p[grid.owned]
        self.fluid_series.write(state.t, velocity[self.chosen.own], grid_part(p, self.chosen.own))
        for series, q in zip(self.series, state.bodies, strict=True):
            series.write(state.t, q)
        self.stresses.write(state)
        if state.t not in self.frames:
            self.frames.append(state.t)
