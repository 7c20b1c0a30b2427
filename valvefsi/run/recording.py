"""What a run leaves behind: history, ParaView series, checkpoints, pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.excess_mass import Twin
from valvefsi.errors import CaseError
from valvefsi.fsi import Model, State
from valvefsi.grid import Array, MacGrid
from valvefsi.io import checkpoint
from valvefsi.io.history import History
from valvefsi.io.paraview import FluidSeries, SolidSeries
from valvefsi.io.solid_body import Body, write_body
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics import Section
from valvefsi.post.diagnostics.surfaces import surface_triangles
from valvefsi.run.recorded_stress import StressRecorder
from valvefsi.run.statistics import Line, Statistics
from valvefsi.units import MMHG


@dataclass(frozen=True, kw_only=True)
class Probe:
    """A node whose displacement the history follows.

    Attributes:
        name: Name in the columns.
        solid: Index of the solid.
        at: Reference position; the nearest node is followed, ``(2,)`` or ``(3,)`` [cm].
    """

    name: str
    solid: int
    at: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Orifice:
    """A valve whose open area, seen along z, the history follows.

    Attributes:
        solid: Index of the leaflets.
        radius: Of the orifice about the z axis [cm].
    """

    solid: int
    radius: float


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
    orifice: Orifice | None = None
    sections: Mapping[str, Section] = field(default_factory=dict)
    dissipation: bool = False
    stress: tuple[str, ...] = ()
    provenance: Mapping[str, object] = field(default_factory=dict)


def save_state(
    model: Model, state: State, output: Output, statistics: Statistics, *, finished: bool = False
) -> Path:
    """Write a checkpoint of a state, with a note whether the run is finished with it. Collective."""
    grid = model.grid
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
        f"chi_{k}_{solid.name}": checkpoint.Rows(chi, solid.ids, solid.num_nodes)
        for k, (solid, chi) in enumerate(zip(model.solids, state.chi, strict=True))
    }
    rows |= {
        f"carried_{k}_{surface.name}": checkpoint.Rows(d, surface.ids, surface.num_nodes)
        for k, (surface, d) in enumerate(zip(model.rigid, state.carried, strict=True))
    }
    for name, solid, twin in zip(_twin_tables(model), _heavy(model), state.twins, strict=True):
        rows[name] = checkpoint.Rows(np.hstack(twin), solid.ids, solid.num_nodes)
    meta = {"t": state.t, "step": state.step, "dt": state.dt, "finished": finished}
    meta["dt_stable"] = state.dt_stable if math.isfinite(state.dt_stable) else None
    meta["circuits"] = [float(value) for value in state.circuits]
    meta["statistics"] = statistics.meta()
    meta["provenance"] = dict(output.provenance)
    folder = output.directory / "checkpoints"
    return checkpoint.save(folder, state.step, fields, rows, meta, grid.comm, keep=output.keep_checkpoints)


def load_state(model: Model, output: Output, statistics: Statistics) -> State | None:
    """Read the newest whole checkpoint, None where there is none; the averages go on from it. Collective."""
    grid = model.grid
    places = {"p": grid.owned}
    for d in range(grid.dim):
        places |= {f"u{d}": grid.owned_faces(d), f"N{d}": grid.owned_faces(d)}
    request = {name: (grid.start, tuple(s.stop - s.start for s in place)) for name, place in places.items()}
    averages = statistics.fields()
    request |= {name: (grid.start, array.shape) for name, array in averages.items()}
    names = [f"chi_{k}_{solid.name}" for k, solid in enumerate(model.solids)]
    rows = {name: solid.ids for name, solid in zip(names, model.solids, strict=True)}
    held = {f"carried_{k}_{surface.name}": surface.ids for k, surface in enumerate(model.rigid)}
    twins = {name: s.ids for name, s in zip(_twin_tables(model), _heavy(model), strict=True)}
    rows |= held | twins
    found = checkpoint.load_latest(output.directory / "checkpoints", request, rows, grid.comm)
    if found is None:
        return None
    meta, fields, points = found
    statistics.restore({name: fields[name] for name in averages}, meta.get("statistics", {}))
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
        chi=tuple(points[name] for name in names),
        circuits=np.array(meta["circuits"]),
        carried=tuple(points[name] for name in held),
        twins=tuple(Twin(*np.hsplit(points[name], 2)) for name in twins),
    )


def _heavy(model: Model) -> list[object]:
    return [model.solids[body.solid] for body in model.heavy]


def _twin_tables(model: Model) -> list[str]:
    """Names of the tables of twins in a checkpoint: position and velocity in a row."""
    return [f"twin_{body.solid}_{model.solids[body.solid].name}" for body in model.heavy]


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
        resume: State that the run goes on from, None for a new run.

    Note:
        Collective.
    """

    def __init__(self, model: Model, output: Output, resume: State | None = None) -> None:
        self.model, self.output = model, output
        grid, comm = model.grid, model.grid.comm
        self.probes = [(p, model.solids[p.solid], model.solids[p.solid].node_at(p.at)) for p in output.probes]
        self.start = [solid.position_of(node, solid.X) for _, solid, node in self.probes]
        columns = ["step", "t_s", "courant", "kinetic_energy_erg"]
        self.measure = "area" if grid.dim == 2 else "volume"
        for solid in model.solids:
            columns += [
                f"{solid.name}_{self.measure}_change_percent",
                f"{solid.name}_J_min",
                f"{solid.name}_J_max",
            ]
        for solid in _heavy(model):
            columns += [f"{solid.name}_excess_kinetic_energy_erg", f"{solid.name}_twin_lag_cm"]
        for probe, _, _ in self.probes:
            columns += [f"u_{axis}_{probe.name}_cm" for axis in "xyz"[: grid.dim]]
        if output.orifice is not None:
            columns.append("pdva_cm2")
        if output.dissipation:
            columns.append("dissipation_erg_per_s")
        for name in output.sections:
            columns += [f"flow_{name}_cm3_per_s", f"pressure_{name}_dyn_per_cm2"]
            if output.sections[name].radius and grid.dim == 3 and model.fluid.mu > 0.0:
                columns.append(f"reynolds_{name}")
        for side in model.circulation.sides if model.circulation else ():
            columns += [f"q_{side}_ml_s", f"p_{side}_mmHg"]
        self.history = History(
            output.directory / "history.csv", columns, comm, resume.step if resume else None
        )
        time = resume.t if resume else None
        self.fluid_series = self.solid_series = None
        if output.frames:
            folder = output.directory / "paraview"
            self.chosen, place = chosen_cells(grid, output)
            self.fluid_series = FluidSeries(folder, "fluid", comm, *place, resume_time=time)
            self.solid_series = [SolidSeries(folder, s.name, comm, resume_time=time) for s in model.solids]
            self._write_rigid(folder)
            self.stresses = StressRecorder(model, output, resume)

    def _write_rigid(self, folder: Path) -> None:
        """Write each rigid surface with faces once, for pictures. Collective."""
        if self.model.grid.comm.rank == 0:
            for surface in self.model.rigid:
                if surface.faces is not None and len(surface.faces):
                    body = Body(points=surface.points, cells={9: surface.faces})
                    write_body(folder / f"{surface.name}.vtu", body)
        self.model.grid.comm.barrier()

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
        for solid, chi in zip(self.model.solids, state.chi, strict=True):
            J = solid.jacobian(chi)
            extremes = np.array([-J.min(initial=np.inf), J.max(initial=-np.inf)])
            comm.Allreduce(MPI.IN_PLACE, extremes, op=MPI.MAX)
            change = solid.volume(chi) / solid.reference_volume - 1.0
            row |= {
                f"{solid.name}_{self.measure}_change_percent": 100.0 * change,
                f"{solid.name}_J_min": -extremes[0],
                f"{solid.name}_J_max": extremes[1],
            }
        for body, solid, twin in zip(self.model.heavy, _heavy(self.model), state.twins, strict=True):
            row |= {
                f"{solid.name}_excess_kinetic_energy_erg": body.kinetic_energy(twin),
                f"{solid.name}_twin_lag_cm": body.lag(twin, state.chi[body.solid]),
            }
        for (probe, solid, node), start in zip(self.probes, self.start, strict=True):
            chi = state.chi[probe.solid]
            shift = solid.position_of(node, chi) - start
            row |= {f"u_{axis}_{probe.name}_cm": shift[a] for a, axis in enumerate("xyz"[: grid.dim])}
        return row | self._open_area(state) | self._read_off(state) | self._circuits(state)

    def _open_area(self, state: State) -> dict[str, float]:
        """Projected dynamic valve area of the orifice. Collective."""
        orifice = self.output.orifice
        if orifice is None:
            return {}
        found = self.model.solids[orifice.solid].cells_on_root(state.chi[orifice.solid])
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
        if circulation is not None:
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
        for series, solid, chi in zip(self.solid_series, self.model.solids, state.chi, strict=True):
            now, first = solid.cells_on_root(chi), solid.cells_on_root(solid.X)
            if now is None:
                series.write(state.t, None, None, None, None)
            else:
                points, cells, J = now
                series.write(state.t, points, cells, J, points - first[0])
        self.stresses.write(state)
