"""A valve in a flow loop against a measured beat: the stages from records to the verdict.

`leaflet`, `downstream` and `upstream` make parameters of records, `case` puts them into a case, `run` runs it on each
grid and `orifice` with an orifice for the valve, `compare` says how far they are from the record and from one another.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from valvefsi.case import load_case
from valvefsi.case.study_tables import ValidationStudy
from valvefsi.case.values import values_by_path
from valvefsi.case.valve_runs import read_run
from valvefsi.fitting.report import write_json
from valvefsi.fitting.waveforms import read_waveforms
from valvefsi.post.valve_beat import Beat
from valvefsi.post.valve_comparison import DEFINITIONS, Comparison, compare_pair
from valvefsi.studies.beats import RunPart, launch, orifice_to_periodic, run_to_periodic
from valvefsi.studies.bench_start import NEEDED
from valvefsi.studies.comparison import (
    advice,
    checks_of,
    norm_rows,
    write_comparison,
    write_tables,
)
from valvefsi.studies.loop_stages import (
    case_of,
    make_case,
    make_downstream,
    make_leaflet,
    make_upstream,
    read_measured,
    upstream_values,
)
from valvefsi.studies.stages import Stage, Stages, read_record


@dataclass(frozen=True, kw_only=True)
class How:
    """How a study is carried out; nothing in it changes a number.

    Attributes:
        say: Called with a line on each stage.
        overwrite: Replace runs of another case.
        trust: Whether Python files of materials may be run.
        launcher: Runs a part of a run.
    """

    say: Callable[[str], None] = lambda line: None
    overwrite: bool = False
    trust: bool = False
    launcher: Callable[[RunPart], None] = launch


def validation_stages(study: ValidationStudy, folder: Path, how: How | None = None) -> Stages:
    """Return the stages of a validation; `Stages.make` makes them.

    Args:
        study: The study.
        folder: Folder of its results, one folder in it for each stage.
        how: How it is carried out.
    """
    how = how or How()
    _check_grids(study, how.trust)
    return Stages(folder, [*_loop(study, how), *_runs(study, how), _compare(study, how)], how.say)


def _loop(study: ValidationStudy, how: How) -> list[Stage]:
    """Return the stages from records to a case."""
    record = {"record": Path(study.record.file), **_values(study, "record")}
    values = {f"case.{key}": value for key, value in values_by_path(case_of(study, how.trust)[0]).items()}
    stages = [
        Stage(
            name="downstream",
            inputs=record | _values(study, "downstream"),
            make=lambda folder: make_downstream(study, folder),
            outputs=("circuit.toml", "fit.json"),
        ),
        Stage(
            name="upstream",
            inputs=record | upstream_values(study, how.trust) | {"smooth": study.upstream.smooth},
            make=lambda folder: make_upstream(study, folder, how.trust),
            outputs=("circuit.toml", "pump.csv", "fit.json"),
        ),
    ]
    if study.leaflet is not None:
        leaflet = Stage(
            name="leaflet",
            inputs={"tests": Path(study.leaflet.file), **_values(study, "leaflet")},
            make=lambda folder: make_leaflet(study, folder),
            outputs=("material.toml", "fit.json"),
        )
        stages.insert(0, leaflet)
    made = Stage(
        name="case",
        inputs=record | values | {"title": study.title, "solid": study.leaflet and study.leaflet.solid},
        make=lambda folder: make_case(study, folder, how.trust),
        outputs=("case.toml",),
        after=tuple(stage.name for stage in stages),
    )
    return [*stages, made]


def grids_of(study: ValidationStudy) -> dict[str, tuple[str, ...]]:
    """Return what each run changes in the case, by its name."""
    if study.grids is None:
        return {"run": ()}
    return {f"run-{10 * h:.4g}mm": (f"grid.h={h!r} cm",) for h in study.grids}


def _check_grids(study: ValidationStudy, trust: bool) -> None:
    """Refuse a spacing that the case cannot have, before any work."""
    for changes in grids_of(study).values():
        load_case(study.case, [*study.changes, *changes], trust=trust)


def _runs(study: ValidationStudy, how: How) -> list[Stage]:
    """Return the runs, one for each grid, and the loop with an orifice."""
    rule = {"max_beats": study.max_beats, "tolerance": study.tolerance}

    def run(changes: tuple[str, ...]) -> Callable[[Path], Mapping[str, Any]]:
        options: dict[str, Any] = {"fresh": how.overwrite, "trust": how.trust, "launcher": how.launcher}
        return lambda folder: run_to_periodic(study, folder, changes, **options)

    runs = [
        Stage(
            name=name,
            inputs=rule | {"changes": list(changes)},
            make=run(changes),
            outputs=("history.csv", "case.toml"),
            after=("case", "upstream"),
        )
        for name, changes in grids_of(study).items()
    ]
    orifice = Stage(
        name="orifice",
        inputs=rule
        | {"record": Path(study.record.file), **_values(study, "record"), **_values(study, "orifice")},
        make=lambda folder: orifice_to_periodic(study, folder, how.trust),
        outputs=("beat.csv",),
        after=("case", "upstream"),
    )
    return [*runs, orifice]


def _compare(study: ValidationStudy, how: How) -> Stage:
    return Stage(
        name="compare",
        inputs={
            "record": Path(study.record.file),
            "shift_max": study.shift_max,
            **_values(study, "record"),
            **_values(study, "targets"),
        },
        make=lambda folder: Verdict(study=study, folder=folder, trust=how.trust).make(),
        outputs=("verdict.json", "norms.csv", "norms.md"),
        after=("downstream", "case", *grids_of(study), "orifice"),
    )


def _values(study: ValidationStudy, table: str) -> dict[str, object]:
    """Return the values of a table of the study by their paths; files count by what they hold, not by their names."""
    values: dict[str, object] = getattr(study, table).model_dump(mode="json")
    return {f"{table}.{key}": value for key, value in values.items() if key != "file"}


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The comparisons of a study, in the folder of its stage.

    Attributes:
        study: The study.
        folder: Folder of the stage; those of the others are beside it.
        trust: Whether Python files of materials may be run.
    """

    study: ValidationStudy
    folder: Path
    trust: bool = False

    def make(self) -> dict[str, Any]:
        """Compare everything, and write ``verdict.json``, tables and pictures."""
        measured, names = read_measured(self.study), [*grids_of(self.study)]
        beats = {
            name: replace(read_run(self.folder.parent / name, trust=self.trust)[1], name=name)
            for name in names
        }
        beats["orifice"] = self._orifice(measured.beat.period)
        results = {
            name: self._against(name, beat, measured.beat, measured.start) for name, beat in beats.items()
        }
        between = [self._against(f"{a}-{b}", beats[a], beats[b], 0.0) for a, b in pairwise(names)]
        write_tables(norm_rows([*results.values(), *between]), self.folder)
        verdict = self._verdict(results, between)
        write_json(self.folder / "verdict.json", verdict)
        return {"checks": verdict["checks"], "next": verdict["next"]}

    def _verdict(self, results: Mapping[str, Comparison], between: Sequence[Comparison]) -> dict[str, Any]:
        fitted = ["leaflet"] if self.study.leaflet is not None else []
        names = [*fitted, "downstream", "upstream", "case", *results]
        records = {name: read_record(self.folder.parent / name) for name in names}
        told = {name: record["result"] for name, record in records.items() if record is not None}
        checks = checks_of(results, self.study.targets)
        runs = {name: told[name] for name in results if name in told}
        return {
            "title": self.study.title,
            "stages": told,
            "against_record": [_without(result) for result in results.values()],
            "between_grids": [_without(result) for result in between],
            "checks": checks,
            "next": advice(runs, results, checks, told.get("downstream", {}).get("l2_percent")),
            "definitions": DEFINITIONS,
        }

    def _orifice(self, period: float) -> Beat:
        """Return the beat of the loop with an orifice."""
        waves = read_waveforms(self.folder.parent / "orifice" / "beat.csv")
        values = {name: waves[name] for name in NEEDED}
        return Beat(name="orifice", t=waves.t, period=period, values=values)

    def _against(self, name: str, a: Beat, b: Beat, start: float) -> Comparison:
        pair, result = compare_pair(a, b, start=start, shift_max=self.study.shift_max)
        write_comparison(pair, result, self.folder / name)
        return result


def _without(result: Comparison) -> Comparison:
    """Return a comparison without the definitions that the verdict says once."""
    return {key: value for key, value in result.items() if key != "definitions"}
