"""Beat after beat until two are alike: of a run in three dimensions, and of the loop with an orifice."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from valvefsi.case import load_case
from valvefsi.case.circulation import build_circulation
from valvefsi.case.resuming import FREE
from valvefsi.case.study_tables import OrificeTable, ValidationStudy
from valvefsi.case.values import case_differences
from valvefsi.case.valve_report import ENDS, valve_test
from valvefsi.case.valve_runs import read_beats
from valvefsi.circulation.loop import FlowLoop
from valvefsi.circulation.orifice import Orifice, OrificeLoop, orifice_of
from valvefsi.errors import CaseError, Stopped, SurroundingsError, ValvefsiError
from valvefsi.fitting.waveforms import Waveforms, write_waveforms
from valvefsi.io.checkpoint import list_checkpoints
from valvefsi.post.valve_beat import Beat
from valvefsi.post.valve_comparison import Pair
from valvefsi.runtime.surroundings import on_ranks
from valvefsi.studies.bench_start import NEEDED
from valvefsi.studies.loop_stages import Measured, read_measured
from valvefsi.units import MMHG

YIELDING = {"OMPI_MCA_mpi_yield_when_idle": "1"}
"""Ranks of Open MPI that wait give their core to those that work; other MPIs do not look at it."""
STEPS = 2000
"""Steps of a beat of the loop with an orifice."""
UNITS = {"p_lv": "mmHg", "p_ao": "mmHg", "q_ao": "ml_s"}


@dataclass(frozen=True, kw_only=True)
class RunPart:
    """What one call of ``valvefsi run`` is to do.

    Attributes:
        case: The case file.
        out: Folder of the run.
        changes: Values that are set.
        ranks: MPI ranks.
        trust: Whether Python files of materials may be run.
        fresh: Begin, over what the folder holds, else go on from its last checkpoint.
    """

    case: Path
    out: Path
    changes: tuple[str, ...]
    ranks: int = 1
    trust: bool = False
    fresh: bool = False

    def command(self) -> list[str]:
        """Return the command.

        Raises:
            SurroundingsError: It needs mpirun, and there is none beside the interpreter or on the path.
        """
        words = [sys.executable, "-m", "valvefsi", "run", str(self.case), "--out", str(self.out)]
        words += ["--overwrite" if self.fresh else "--resume", *(["--trust"] if self.trust else [])]
        words += [word for change in self.changes for word in ("--set", change)]
        return on_ranks(words, self.ranks)


def launch(part: RunPart) -> None:
    """Run a part as a process of its own, which a signal that ends this one asks to write a checkpoint and end.

    Raises:
        ValvefsiError: It failed, in the class of its exit code; it has said why.
    """
    process = subprocess.Popen(part.command(), env=os.environ | YIELDING)
    with _passing_on(process, signal.SIGTERM):
        code = process.wait()
    if code == 0:
        return
    message = f"the run in {part.out} ended with {code}, see above"
    if code == 2:
        raise CaseError(message)
    message += "; the same command goes on from its last checkpoint"
    stopped = {128 + signal.SIGTERM: signal.SIGTERM, -signal.SIGTERM: signal.SIGTERM, 130: signal.SIGINT}
    if code in stopped:
        raise Stopped(message, stopped[code])
    raise (SurroundingsError if code == 4 else ValvefsiError)(message)


@contextlib.contextmanager
def _passing_on(process: subprocess.Popen[bytes], number: signal.Signals) -> Iterator[None]:
    """Pass a signal on to a process as long as this lasts; what it does then is its answer."""
    before = signal.signal(number, lambda *_: process.send_signal(number))
    try:
        yield
    except KeyboardInterrupt:  # the terminal has sent it to both
        process.wait()
        raise
    finally:
        signal.signal(number, before)


def run_to_periodic(
    study: ValidationStudy,
    folder: Path,
    changes: Sequence[str],
    *,
    fresh: bool,
    trust: bool,
    launcher: Callable[[RunPart], None] = launch,
) -> dict[str, Any]:
    """Run a case beat by beat until the last two are alike, going on with what the folder holds.

    Args:
        study: The study; the case is that of its stage ``case``, beside the folder.
        folder: Folder of the run.
        changes: Values of the case that are set.
        fresh: Replace a run that the folder holds.
        trust: Whether Python files of materials may be run.
        launcher: Runs a part.

    Raises:
        CaseError: The folder holds the run of another case.
        ValvefsiError: The run failed.
    """
    path = folder.parent / "case" / "case.toml"
    period = next(c.pump.period for c in load_case(path, trust=trust).circuit if c.pump.period)
    if not fresh:
        _refuse_another(path, folder, changes, trust)
    beats = [] if fresh else _beats_so_far(folder, trust)
    fresh = fresh or not list_checkpoints(folder / "checkpoints")
    apart = _last_two(beats)
    while not _alike(apart, study.tolerance) and len(beats) < study.max_beats:
        if fresh and beats:
            message = (
                f"{len(beats)} beats are here, and no checkpoint to go on from; --overwrite begins again"
            )
            raise CaseError(message, file=folder)
        more = (*changes, f"time.t_end={(len(beats) + 1) * period!r} s")
        launcher(RunPart(case=path, out=folder, changes=more, ranks=study.ranks, trust=trust, fresh=fresh))
        done, beats, fresh = len(beats), read_beats(folder, trust=trust)[1], False
        if len(beats) <= done:
            raise ValvefsiError(f"the run in {folder} has ended without another whole beat")
        apart = _last_two(beats)
    return _outcome(len(beats), apart, study)


def _outcome(beats: int, apart: dict[str, float], study: ValidationStudy) -> dict[str, Any]:
    return {
        "beats": beats,
        "last_two_apart_l2_percent": apart,
        "periodic": _alike(apart, study.tolerance),
        "tolerance_percent": 100.0 * study.tolerance,
    }


def _refuse_another(path: Path, folder: Path, changes: Sequence[str], trust: bool) -> None:
    """Refuse a folder that holds the run of a case with other values."""
    if not (folder / "case.toml").exists():
        return
    there, wanted = load_case(folder / "case.toml", trust=trust), load_case(path, changes, trust=trust)
    for key, (old, new) in case_differences(there, wanted).items():
        if not FREE.fullmatch(key):
            message = f"the run here was of {old!r}, the study now asks for {new!r}; --overwrite replaces it"
            raise CaseError(message, file=folder, key=key)


def _beats_so_far(folder: Path, trust: bool) -> list[Beat]:
    """Return the whole beats of a run that was begun, none where there is less than one."""
    try:
        return read_beats(folder, trust=trust)[1]
    except CaseError:  # what is wrong with more than a short history is said once there is a beat
        return []


def _last_two(beats: Sequence[Beat]) -> dict[str, float]:
    """Return how far the last beat is from the one before it, in L2 over the last [%]; nothing where there is one."""
    if len(beats) < 2:
        return {}
    pair = Pair(a=beats[-2], b=beats[-1])
    return {name: float(pair.norms(name)["l2_percent"] or 0.0) for name in NEEDED}


def _alike(apart: dict[str, float], tolerance: float) -> bool:
    return bool(apart) and max(apart.values()) <= 100.0 * tolerance


def orifice_to_periodic(study: ValidationStudy, folder: Path, trust: bool) -> dict[str, Any]:
    """Run the loop of the case with an orifice for the valve until its last two beats are alike; ``beat.csv``."""
    path = folder.parent / "case" / "case.toml"
    case, measured = load_case(path, trust=trust), read_measured(study)
    valve, how = orifice_from(measured, study.orifice, case.fluid.density, Path(study.record.file))
    circulation = build_circulation(case)
    at = {c.side: c for c in circulation.connections} if isinstance(circulation, FlowLoop) else {}
    loop = OrificeLoop(valve, at[ENDS[0]], at[ENDS[1]])
    state, dt, beats = loop.begin(), measured.beat.period / STEPS, list[Beat]()
    apart = dict[str, float]()
    while not _alike(apart, study.tolerance) and len(beats) < study.max_beats:
        found, state = loop.run(state, STEPS, dt)
        values = {name: found[name][:-1] for name in NEEDED}
        beats.append(
            Beat(name="orifice", t=found["t"][:-1] - found["t"][0], period=STEPS * dt, values=values)
        )
        apart = _last_two(beats)
    last = replace(beats[-1], test=valve_test(case))
    waves = Waveforms(t=last.t, values=last.values, units=UNITS)
    write_waveforms(
        waves, folder / "beat.csv", [f"period: {last.period!r} s", f"{how}: last of {len(beats)} beats"]
    )
    about = {
        "effective_orifice_area_cm2": valve.area,
        "inertance_mmHg_s2_per_ml": valve.inertance / MMHG,
        "from": how,
    }
    return {**about, **_outcome(len(beats), apart, study)}


def orifice_from(measured: Measured, table: OrificeTable, rho: float, file: Path) -> tuple[Orifice, str]:
    """Return the orifice that a record's forward flow shows, and in words how.

    Args:
        measured: The measured beat.
        table: What is given instead.
        rho: Density of the fluid [g/cm^3].
        file: The record, for messages.

    Raises:
        CaseError: The record shows no forward flow, or no orifice.
    """
    numbers, why = measured.beat.numbers(rho)
    if numbers is None or numbers.effective_orifice_area is None or numbers.forward_end is None:
        reason = why or "; ".join(sorted(set(numbers.reasons.values()))) if numbers is not None else why
        raise CaseError(f"no orifice can be read off it: {reason}", file=file, key="orifice")
    grid = measured.beat.grid
    since = numbers.start + (numbers.forward_start or 0.0)
    t = since + grid[grid <= numbers.forward_end - (numbers.forward_start or 0.0)]
    p_lv, p_ao, q = (measured.beat.at(name, t) for name in NEEDED)
    area = None if table.fit_area else table.area or numbers.effective_orifice_area
    inertance, loss = orifice_of(t, p_lv - p_ao, q, None if area is None else rho / (2.0 * area**2))
    inertance = table.inertance or inertance
    if inertance <= 0.0 or loss <= 0.0:
        found = f"inertance {inertance:.4g} g/cm^4, loss {loss:.4g} g/cm^7"
        message = (
            f"its forward flow is not that of an orifice ({found}): give orifice.area and orifice.inertance"
        )
        raise CaseError(message, file=file, key="orifice")
    how = (
        "area and inertance fitted"
        if table.fit_area
        else "area given"
        if table.area
        else "area by the 51.6 formula"
    )
    how += "" if table.fit_area else ", inertance given" if table.inertance else ", inertance fitted"
    return Orifice(area=math.sqrt(rho / (2.0 * loss)), inertance=inertance, rho=rho), f"orifice, {how}"
