"""From folders of results to a page: what each holds, and what is said of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from valvefsi import __version__
from valvefsi.case.valve_runs import read_run
from valvefsi.errors import CaseError
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.report.blocks import Chapter, Page
from valvefsi.report.compared import Side, compared
from valvefsi.report.evidence import the_evidence
from valvefsi.report.geometry import the_geometry
from valvefsi.report.grids import a_verification
from valvefsi.report.inputs import the_case, what_was_run
from valvefsi.report.others import a_benchmark, a_fit, a_sweep, a_validation
from valvefsi.report.results import numbers, pictures, warnings_of, waveforms
from valvefsi.report.runs import Run, is_table, open_run
from valvefsi.report.samples import a_sample
from valvefsi.report.scenes import the_scene

LEFT: dict[str, Callable[[Path], Chapter]] = {
    "fit.json": a_fit,
    "sweep.json": a_sweep,
    **{
        f"{stage}/stage.json": a_validation
        for stage in ("compare", "downstream", "upstream", "leaflet", "case")
    },
    "result.json": a_benchmark,
}
STUDIED: dict[str, Callable[..., Chapter]] = {"verification.json": a_verification, "sample.json": a_sample}
"""The same of studies whose members are read, too."""
"""What a folder holds, by a file that only this leaves there; a run leaves case.toml."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How a page is made.

    Attributes:
        start: Time in the cycle of the second at which that of the first begins [s].
        shift_max: Largest common shift of the first [s].
        period: Length of a cycle, where a pump or a record says another or none [s].
        trust: Whether Python files of materials may be run.
    """

    start: float = 0.0
    shift_max: float = 7e-3
    period: float | None = None
    trust: bool = False


def report(paths: Sequence[Path], options: Options | None = None) -> Page:
    """Return the page on some folders; of two runs of a valve, or a run and a record, their comparison first.

    Args:
        paths: Folders of runs, fits, benchmarks, sweeps, validations, grids or samples; a record (CSV) beside a run.
        options: How it is made.

    Raises:
        CaseError: A folder holds nothing that is known, or a record stands alone.
    """
    options = options or Options()
    for path in paths:
        _check(path, paths)
    parts: list[Chapter] = []
    both = None
    if len(paths) == 2 and all(path.is_file() or _is_run(path) for path in paths):
        both = _sides(paths, options)
    if both is not None:
        parts.append(compared(*both, start=options.start, shift_max=options.shift_max))
    beside = both is not None and all(side.run is not None for side in both)
    parts += [part_of(path, trust=options.trust, scene=not beside) for path in paths if path.is_dir()]
    made = f"valvefsi {__version__}, report of {time.strftime('%Y-%m-%d %H:%M %Z').strip()}"
    return Page(title=parts[0].title, made=made, parts=parts)


def _check(path: Path, paths: Sequence[Path]) -> None:
    """Refuse what no page can be made of."""
    if not path.exists():
        raise CaseError("no such folder of results", file=path)
    if path.is_file():
        if len(paths) != 2 or not any(_is_run(other) for other in paths if other.is_dir()):
            raise CaseError("a record is compared with the folder of a run: name one beside it", file=path)
    elif not _is_run(path) and _maker(path) is None:
        known = ", ".join(("case.toml", *STUDIED, *LEFT))
        raise CaseError(f"there are no results here that are known: none of {known}", file=path)
    if path.is_dir() and not _is_run(path):
        for name in (*STUDIED, *LEFT, "compare/verdict.json"):
            if (path / name).is_file() and not is_table(path / name):
                raise CaseError("this cannot be read as JSON: no page is made of it", file=path / name)


def _is_run(path: Path) -> bool:
    return (path / "case.toml").is_file() and (path / "history.csv").is_file()


def _maker(path: Path) -> Callable[..., Chapter] | None:
    return next((make for name, make in (STUDIED | LEFT).items() if (path / name).is_file()), None)


def _sides(paths: Sequence[Path], options: Options) -> list[Side] | None:
    """Return the two beats to compare; None where both are runs of which one has no beat."""
    found = []
    for path in paths:
        if path.is_file():
            found.append(Side(beat=read_bench_beat(path, period=options.period)))
            continue
        try:
            _, beat = read_run(path, period=options.period, trust=options.trust)
        except CaseError:
            if any(other.is_file() for other in paths):
                raise
            return None
        found.append(Side(beat=beat, run=open_run(path, trust=options.trust)))
    return found


def part_of(path: Path, *, trust: bool = False, scene: bool = True) -> Chapter:
    """Return the part of a page on one folder.

    Args:
        path: The folder.
        trust: Whether Python files of materials may be run.
        scene: Whether a run's scene is in it; it stands elsewhere on the page if not.
    """
    make = None if _is_run(path) else _maker(path)
    if make is None:
        return a_run(open_run(path, trust=trust), scene=scene)
    return make(path, trust=trust) if make in STUDIED.values() else make(path)


def a_run(run: Run, *, scene: bool = True) -> Chapter:
    """Return the part on a run, with its scene or without."""
    window = None
    cycles = run.summary.get("valve", {}).get("cycles") or []
    whole = [cycle for cycle in cycles if "net_volume_ml" in cycle]
    if whole and run.t_end is not None:
        window = whole[-1]["start_s"], run.t_end
    sections = [
        what_was_run(run),
        *([the_scene(run, window)] if scene else []),
        waveforms(run),
        numbers(run),
        warnings_of(run),
        the_evidence(run),
        the_geometry(run),
        pictures(run.folder),
        the_case(run),
    ]
    return Chapter(title=run.title, about=f"Run in the folder {run.name}", sections=sections)
