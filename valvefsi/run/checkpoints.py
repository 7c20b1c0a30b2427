"""The state of a run on the disk: what a checkpoint holds, and how it is read back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.errors import CaseError
from valvefsi.fsi import Model, State
from valvefsi.io import checkpoint
from valvefsi.io.series import frames_on_disk
from valvefsi.run.energy import EnergyMeter
from valvefsi.run.forces import ForceMeter
from valvefsi.run.health import Health
from valvefsi.run.recording import Output, grid_part
from valvefsi.run.stable_step import NO_MODE
from valvefsi.run.statistics import Statistics
from valvefsi.types import Array, Indices


@dataclass(frozen=True)
class Memory:
    """What a run keeps beside its state from row to row.

    Attributes:
        statistics: Running averages.
        forces: Forces between rows.
        energy: Balance of energy.
        health: What was warned of.
        recoveries: Returns to an earlier state, see `valvefsi.run.simulation.Outcome`.
        frames: Times of the frames by number [s], None where a time is not known.
    """

    statistics: Statistics
    forces: ForceMeter
    energy: EnergyMeter
    health: Health
    recoveries: list[dict[str, object]] = field(default_factory=list)
    frames: list[float | None] = field(default_factory=list)


def memory_of(model: Model, output: Output) -> Memory:
    """Return the memory of a run that begins."""
    statistics = Statistics(model.grid, start=output.averages_from, lines=output.lines)
    meters = ForceMeter(model, output.forces), EnergyMeter(model, output.energy)
    return Memory(statistics, *meters, Health(model))


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
        name: checkpoint.Rows(state.bodies[k][key], *model.bodies[k].rows(key))
        for name, (k, key) in tables_of(model, state).items()
    }
    for name, k in (modes_of(model) if state.modes else {}).items():
        rows[name] = checkpoint.Rows(state.modes[k], model.bodies[k].ids, model.bodies[k].num_points)
    meta: dict[str, Any] = {"t": state.t, "step": state.step, "dt": state.dt, "finished": finished}
    meta["dt_stable"] = state.dt_stable if math.isfinite(state.dt_stable) else None
    meta["measure_at"], meta["energies"] = state.measure_at, list(state.energies)
    meta["circuits"] = [float(value) for value in state.circuits]
    meta["given"] = state.given.tolist()
    meta["statistics"] = statistics.meta()
    meta["forces"], meta["energy"] = memory.forces.meta(), memory.energy.meta()
    meta["warnings"], meta["recoveries"] = memory.health.report(), memory.recoveries
    meta["frames"] = memory.frames
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
    rows, optional = _rows_of(model, tables)
    found = checkpoint.load_latest(output.directory / "checkpoints", request, rows, grid.comm, optional)
    if found is None:
        return None
    meta, fields, points = found
    statistics.restore({name: fields[name] for name in averages}, meta.get("statistics", {}))
    memory.forces.restore(meta.get("forces"))
    memory.energy.restore(meta.get("energy"))
    memory.health.restore(meta.get("warnings", ()))
    memory.recoveries[:] = meta.get("recoveries", ())
    memory.frames[:] = _frames_of(meta, output.directory / "paraview", grid.comm)
    arrays = {name: grid.zeros() for name in places}
    for name, place in places.items():
        arrays[name][place] = fields[name]
    grid.exchange((arrays["p"],), width=1)
    u = model.fluid.fill(tuple(arrays[f"u{d}"] for d in range(grid.dim)), meta["t"])
    N = tuple(arrays[f"N{d}"] for d in range(grid.dim))
    bodies = [
        {key: points[name] for name, (number, key) in tables.items() if number == k and name in points}
        for k in range(len(model.bodies))
    ]
    return State(
        u=u,
        p=arrays["p"],
        N=N,
        bodies=tuple(body.completed(q, u) for body, q in zip(model.bodies, bodies, strict=True)),
        circuits=np.array(meta["circuits"]),
        given=np.array(meta["given"]).reshape(-1, 4),
        **{key: meta[key] for key in ("t", "step", "dt")},
        **_measured(model, meta, points),
    )


def _frames_of(meta: dict[str, Any], folder: Path, comm: MPI.Comm) -> list[float | None]:
    """Return the times of the frames up to a checkpoint; one of an earlier version leaves them to the folder."""
    if "frames" in meta:
        return list(meta["frames"])
    return comm.bcast(frames_on_disk(folder, meta["t"]) if comm.rank == 0 else [])


def _rows_of(
    model: Model, tables: Mapping[str, tuple[int, str]]
) -> tuple[dict[str, Indices], dict[str, Indices]]:
    """Return the numbers of this rank's rows of the tables that a checkpoint must hold, and of those it may."""
    rows: dict[str, Indices] = {}
    optional = {name: model.bodies[k].ids for name, k in modes_of(model).items()}
    for name, (k, key) in tables.items():
        (optional if key in model.bodies[k].derived else rows)[name] = model.bodies[k].rows(key)[0]
    return rows, optional


def _measured(model: Model, meta: dict[str, Any], points: dict[str, Array]) -> dict[str, Any]:
    """Return what a state holds of the last measurement of the stable step; it is to be made anew where it is not."""
    names = {k: name for name, k in modes_of(model).items()}
    limit = math.inf if meta.get("dt_stable") is None else meta["dt_stable"]
    if "energies" not in meta or not points.keys() >= set(names.values()):
        return {"dt_stable": limit, "measure_at": 0}
    modes = tuple(points[names[k]] if k in names else NO_MODE for k in range(len(model.bodies)))
    energies = tuple(meta["energies"])
    return {"dt_stable": limit, "measure_at": meta["measure_at"], "modes": modes, "energies": energies}


def modes_of(model: Model) -> dict[str, int]:
    """Return the numbers of the bodies with a mode that limits the step, by its name in a checkpoint."""
    return {f"mode_{k}_{body.name}": k for k, body in enumerate(model.bodies) if body.solid is not None}


def tables_of(model: Model, state: State) -> dict[str, tuple[int, str]]:
    """Return number of the body and key of every table of the bodies' states, by its name in a checkpoint."""
    return {
        f"{key}_{k}_{body.name}": (k, key)
        for k, (body, q) in enumerate(zip(model.bodies, state.bodies, strict=True))
        for key in q
    }


def refuse_to_overwrite(directory: Path, comm: MPI.Comm, *, finished: bool) -> None:
    """Raise CaseError where a folder holds a run that a new one would remove.

    Args:
        directory: Folder of the run.
        comm: Communicator of the run.
        finished: Whether that holds for a finished one too.

    Note:
        Collective.
    """
    folder = directory / "checkpoints"
    meta = checkpoint.newest_meta(folder, comm)
    there = comm.bcast(bool(checkpoint.list_checkpoints(folder)) if comm.rank == 0 else None)
    if meta is not None and meta.get("finished"):
        if finished:
            message = "this folder holds a finished run; --overwrite replaces it, another --out keeps it"
            raise CaseError(message, file=directory)
    elif there:
        when = f"t = {meta['t']:.6g} s" if meta else "its newest checkpoint cannot be read"
        raise CaseError(
            f"this folder holds a run that is not finished ({when}); --resume goes on with it, --overwrite "
            "replaces it, another --out keeps it",
            file=directory,
        )
