"""Whether a checkpoint is of the case that is to go on from it: what differs, and what of that may."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from mpi4py import MPI

from valvefsi.case.models import Case, Mesh
from valvefsi.case.origins import entries_of
from valvefsi.case.quantities import Quantity
from valvefsi.case.values import values_by_path
from valvefsi.errors import CaseError
from valvefsi.io import checkpoint
from valvefsi.io.folder import held
from valvefsi.run.checkpoints import refuse_to_overwrite
from valvefsi.run.schedule import check_end

FREE = re.compile(
    r"title|time\.(t_end|max_recoveries)|output\.(frames|units|history_every|checkpoint_every|checkpoint_wall"
    r"|keep_checkpoints)|circuit\.\w+\.(provenance\..*|target_pressure|pump\.cycles_from)"
    r"|solid\.\w+\.material\.preset|target\..*"
)
"""What is no part of a state and of the way on from it."""
DIGITS = (6, 12, 17)
"""Digits that a quantity is shown with: as few as tell the old from the new value."""
NO_SHAPE = ("fibre_angles",)
"""What is no part of the shape of leaflets."""
FIXED = re.compile(
    r"grid\..*|housing\..*|output\..*|fluid\.density|fluid\.sides\.\w+\.(type|circuit)|circuit\.\w+\.(name|model)"
    r"|solid\.\w+\.(name|degree|mesh\..*|coupling|kernel|point_gap|density|probe\..*)"
)
"""What gives the numbers in a checkpoint, or in the files beside it, their meaning."""


@contextlib.contextmanager
def run_folder(
    case: Case,
    out: Path,
    comm: MPI.Comm,
    *,
    resume: bool,
    overwrite: bool = False,
    allow_change: bool = False,
) -> Iterator[tuple[dict[str, object], ...]]:
    """Hold the folder of a run, after a look at what it holds.

    Args:
        case: The case that is to be run in it.
        out: The folder.
        comm: Communicator of the run.
        resume: Whether to go on with the run in it.
        overwrite: Whether a run in it may be replaced.
        allow_change: Whether the way on may differ from the way there.

    Yields:
        Changes of the case since the run began: key, old and new value, time [s].

    Raises:
        CaseError: Another run holds it, or it holds a run that must not be replaced or gone on with like this; or
            there is no run in the folder that a new one is to begin from.

    Note:
        Collective.
    """
    if resume and overwrite:
        raise CaseError("go on with the run or replace it, not both", key="--overwrite", value="--resume")
    if not resume and case.file is not None and case.file.resolve() == (Path(out) / "case.toml").resolve():
        message = "a run writes case.toml into its folder, over this case: give another --out, or the case another name"
        raise CaseError(message, file=case.file)
    if not resume:
        check_start(case)
    with held(out, comm):
        if resume:
            meta = checkpoint.newest_meta(Path(out) / "checkpoints", comm)
            if meta:
                check_end(meta["t"], meta["dt"], case.time.t_end, case.file)
            yield _changes(meta, case, allow_change) if meta else ()
            return
        if not overwrite:
            refuse_to_overwrite(Path(out), comm, finished=True)
        yield ()


def check_start(case: Case) -> None:
    """Refuse a folder to begin from that holds no run. A run that goes on needs it no more.

    Raises:
        CaseError: It holds none, or is not there.
    """
    if case.start is None or not case.start.run or (Path(case.start.run) / "case.toml").is_file():
        return
    there = Path(case.start.run).is_dir()
    message = "this folder holds no case.toml of a run" if there else "no such folder of a run"
    raise CaseError(message, file=case.file, key="start.run", value=case.start.run)


def start_time(case: Case) -> float:
    """Return the time of the newest state of the run that a case begins from, 0 where it begins from rest [s].

    Raises:
        CaseError: It lies after the end of the case.
    """
    if case.start is None or not case.start.run:
        return 0.0
    meta = checkpoint.newest_meta(Path(case.start.run) / "checkpoints", MPI.COMM_SELF)
    if not meta:
        return 0.0
    check_end(meta["t"], meta["dt"], case.time.t_end, case.file)
    return float(meta["t"])


def check_shapes(there: Case, here: Case) -> None:
    """Refuse a run to begin from whose solids have another unloaded shape: displacements are those of places in it.

    Sizes of elements and layers may differ. Of meshes from files the shape is not known.

    Raises:
        CaseError: A shape differs: says solid and key, and both values.
    """
    for a, b in zip(there.solid, here.solid, strict=False):
        old, new = _shape(a.mesh), _shape(b.mesh)
        key = next((key for key in new if old and old.get(key) != new[key]), None)
        if key is not None:
            raise CaseError(
                "the run to begin from has another unloaded shape, which its displacements belong to; this was "
                f"{old.get(key)} there",
                file=here.file,
                key=f"solid.{b.name}.mesh.{key}",
                value=new[key],
            )


def _shape(mesh: Mesh) -> dict[str, object]:
    """Return what says the unloaded shape of a mesh, by key, lengths in cm without their round-off."""
    if mesh.valve is None:
        return {"lower": _rounded(mesh.lower), "size": _rounded(mesh.size)} if mesh.shape else {}
    own = {key: value for key, value in asdict(mesh.valve.geometry()).items() if key not in NO_SHAPE}
    shape = {"diameter": 2.0 * own.pop("radius"), "base": mesh.valve.base, **own}
    return {f"valve.{key}": _rounded(value) for key, value in shape.items()}


def _rounded(value: object) -> object:
    if isinstance(value, tuple):
        return tuple(map(_rounded, value))
    return float(f"{value:.9g}") if isinstance(value, float) else value


def clear(out: Path, comm: MPI.Comm) -> None:
    """Remove what an earlier run would be taken for: its checkpoints, history and summary. Collective."""
    if comm.rank == 0:
        for path in (
            *checkpoint.list_checkpoints(out / "checkpoints"),
            out / "history.csv",
            out / "summary.json",
        ):
            path.unlink(missing_ok=True)
    comm.barrier()


def provenance_of(case: Case, changes: tuple[dict[str, object], ...] = ()) -> dict[str, object]:
    """Return what a checkpoint records of its case: every value by its path, files by what they hold."""
    return {"case": values_by_path(case), "changes": list(changes)}


def _changes(meta: Mapping[str, Any], case: Case, allow: bool) -> tuple[dict[str, object], ...]:
    recorded = meta.get("provenance", {})
    old, new = recorded.get("case", {}), values_by_path(case)
    found = {key: (old.get(key), new.get(key)) for key in {**old, **new} if old.get(key) != new.get(key)}
    held_back = [key for key in found if not FREE.fullmatch(key)]
    fixed = [key for key in held_back if FIXED.fullmatch(key)]
    held_back = [] if allow else held_back
    if fixed or held_back:
        keys = fixed or held_back
        pairs = [" was {}, it is {}".format(*shown_pair(case, key, *found[key])) for key in keys]
        others = "".join(f"; {key}{pair}" for key, pair in zip(keys[1:], pairs[1:], strict=True))
        then = "start a new run" if fixed else "--allow-change goes on with it"
        message = f"the checkpoint is of a run where this{pairs[0]}{others}; {then}"
        raise CaseError(message, file=case.file, key=keys[0])
    made = [{"t_s": meta["t"], "key": key, "old": a, "new": b} for key, (a, b) in found.items()]
    return (*recorded.get("changes", ()), *made)


def shown_pair(case: Case, key: str, old: object, new: object) -> tuple[str, str]:
    """Return two values of a key as the case writes it: quantities with their unit, to the digits that part them."""
    unit = next((e.unit for e in entries_of(case, None) if f"{key}.".startswith(f"{e.path}.") and e.unit), "")
    like, pair = case.written.get(key), ("", "")
    for digits in DIGITS:
        pair = _shown(old, unit, like, digits), _shown(new, unit, like, digits)
        if pair[0] != pair[1]:
            break
    return pair


def _shown(value: object, unit: str, like: object, digits: int) -> str:
    """Return a value as a case writes it."""
    if value is None:
        return "not there"
    if unit and isinstance(value, int | float) and not isinstance(value, bool):
        return Quantity(unit).text_in(value, like, digits)
    return json.dumps(value)
