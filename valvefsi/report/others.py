"""Pages of a fit, a benchmark, a sweep and a validation, from the files that these leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from valvefsi.io.folder import sha256
from valvefsi.report.blocks import Block, Cell, Chapter, Note, Section, Table, missing
from valvefsi.report.evidence import committed
from valvefsi.report.inputs import versions
from valvefsi.report.results import pictures
from valvefsi.report.runs import read_table
from valvefsi.report.words import pretty
from valvefsi.verification.collection import collect

MISFIT = {
    "r_squared": "1 - sum (curve - data)^2 / sum (data - mean)^2",
    "nrmse": "root mean square of curve - data over max - min of the data",
    "relative_l2": "|curve - data| / |data| in L2",
    "relative_linf": "max |curve - data| / max |data|",
    "half_sum_of_squares": "1/2 sum (curve - data)^2",
    "residual_std": "standard deviation of the residuals",
    "residual_correlation_samples": "samples over which residuals are alike, 1 for independent ones",
    "aicc": "Akaike's criterion, corrected for few data",
    "bic": "Bayes' information criterion",
    "n_points": "numbers that were fitted",
    "n_free": "parameters that were free",
    "seconds": "time of the fit [s]",
}
"""Numbers of a fit and what they mean."""
WAYS, KINDS = ("as_they_are", "shifted"), ("l2_percent", "linf_percent", "nrmse_percent")
FEW = 24
"""Columns of a sweep's table that are open."""


def flat(value: object, path: str = "") -> list[tuple[str, Cell]]:
    """Return the single values below a table by their paths; lists of numbers as text."""
    if isinstance(value, Mapping):
        return [row for key, item in value.items() for row in flat(item, f"{path}.{key}".lstrip("."))]
    if isinstance(value, list) and any(isinstance(item, Mapping) for item in value):
        return [row for key, item in enumerate(value) for row in flat(item, f"{path}.{key}".lstrip("."))]
    if isinstance(value, list):
        return [(path, ", ".join(f"{v:.5g}" if isinstance(v, float) else str(v) for v in value) or "none")]
    return [(path, value if isinstance(value, str | int | float | bool) or value is None else str(value))]


def a_fit(folder: Path) -> Chapter:
    """Return the part on a fit of a material or a circuit."""
    fit = read_table(folder / "fit.json")
    given: list[Block] = [Table(caption="The fit", headings=("what", "value"), rows=_identity(fit))]
    data = [(item["file"], item["sha256"]) for item in fit.get("data", ())]
    given.append(
        Table(caption="Data files", headings=("file", "SHA-256"), rows=data)
        if data
        else missing("The fit names no data files.")
    )
    given += versions(
        {"versions": fit.get("versions", {})} if fit.get("versions") else {}, "Versions are not recorded."
    )
    given += [Note(text=str(note), tone="warning") for note in fit.get("notes", ())]
    used = {"parameters", "notes", "data", "versions", "kind", "model", *MISFIT}
    rest = flat({key: value for key, value in fit.items() if key not in used})
    text = "Everything else in fit.json"
    sections = [
        Section(title="What was fitted", blocks=given),
        Section(title="Parameters and their uncertainty", blocks=_parameters(fit.get("parameters", {}))),
        Section(title="Misfit", blocks=[_misfit(fit)]),
        pictures(folder),
        Section(
            title="Evidence",
            blocks=[
                *committed(["fits"]),
                Table(caption=text, headings=("path", "value"), rows=rest, folded=text),
            ],
        ),
    ]
    return Chapter(
        title=f"Fit of {fit.get('model', folder.name)}", about=folder.resolve().name, sections=sections
    )


def _identity(fit: Mapping[str, Any]) -> list[tuple[str, Cell]]:
    return [(name, fit.get(name)) for name in ("kind", "model", "data_unit", "loss")]


def _parameters(parameters: Mapping[str, Mapping[str, Any]]) -> list[Block]:
    if not parameters:
        return [missing("fit.json holds no parameters.")]
    rows: list[tuple[Cell, ...]] = []
    for name, it in parameters.items():
        ends = it.get("ci95") or (None, None)
        boot = it.get("ci95_bootstrap") or ("-", "-")
        held = it.get("std") is None
        cells = ("held", "-", "-") if held else (it["std"], *ends)
        rows.append((name, it["value"], pretty(it["unit"]), *cells, *boot, it.get("verdict", "")))
    headings = (
        "parameter",
        "value",
        "unit",
        "std",
        "95 % from",
        "95 % to",
        "bootstrap from",
        "bootstrap to",
        "verdict",
    )
    methods = sorted({str(it["ci95_method"]) for it in parameters.values() if it.get("ci95_method")})
    caption = f"Parameters; 95 % intervals by {', '.join(methods) or 'no method that was recorded'}"
    return [Table(caption=caption, headings=headings, rows=rows)]


def _misfit(fit: Mapping[str, Any]) -> Block:
    rows = [(name, fit[name], meaning) for name, meaning in MISFIT.items() if name in fit]
    return Table(
        caption="How far the curve is from the data", headings=("number", "value", "definition"), rows=rows
    )


def a_benchmark(folder: Path) -> Chapter:
    """Return the part on a benchmark."""
    result = read_table(folder / "result.json")
    name = str(result.get("benchmark", folder.name))
    rows: list[tuple[Cell, ...]] = [
        (
            line.label(),
            line.computed,
            _or_dash(line.reference),
            _or_dash(line.difference_percent),
            pretty(line.unit),
            line.source,
        )
        for line in collect([folder], everything=True)
    ]
    headings = ("quantity", "computed", "reference", "difference [%]", "unit", "source")
    known = ("table", "environment", "parameters", "timing")
    rest = flat({key: value for key, value in result.items() if key not in known})
    text = "Everything in result.json"
    compared = Table(caption=f"Benchmark {name}", headings=headings, rows=rows)
    everything = Table(caption=text, headings=("path", "value"), rows=rest, folded=text)
    given = Table(
        caption="Parameters, CGS", headings=("parameter", "value"), rows=flat(result.get("parameters", {}))
    )
    took = Table(caption="Time and memory", headings=("what", "value"), rows=flat(result.get("timing", {})))
    made = versions(result.get("environment", {}), "Versions and machine are not recorded.")
    sections = [
        Section(title="Computed beside references", blocks=[compared]),
        Section(title="What was run", blocks=[given, took, *made]),
        pictures(folder),
        Section(title="Numbers", blocks=[everything]),
    ]
    return Chapter(title=f"Benchmark {name}", about=folder.resolve().name, sections=sections)


def _or_dash(value: Cell) -> Cell:
    return "-" if value is None else value


def a_sweep(folder: Path) -> Chapter:
    """Return the part on a sweep."""
    sweep = read_table(folder / "sweep.json")
    members: Sequence[Mapping[str, Any]] = sweep.get("members", ())
    columns = [str(it["column"]) for it in sweep.get("over", {}).values()]
    failed = [m for m in members if m["state"] == "failed"]
    said: list[Block] = [Note(text=f"{m['member']} failed: {m['message']}", tone="warning") for m in failed]
    rows: list[tuple[Cell, ...]] = [
        (m["member"], m["state"], *(m["row"].get(c) for c in columns), _or_dash(m.get("wall_s")))
        for m in members
    ]
    listed = Table(
        caption="Members", headings=("member", "state", *columns, "wall-clock time [s]"), rows=rows
    )
    about = [
        ("case", sweep.get("case")),
        ("version", sweep.get("version")),
        *flat({"over": sweep.get("over", {})}),
    ]
    files = [
        (name, sha256(folder / name)) for name in ("sweep.csv", "sweep.json") if (folder / name).is_file()
    ]
    sections = [
        Section(
            title="What was run",
            blocks=[
                Table(caption="The sweep", headings=("what", "value"), rows=about),
                *said,
                listed,
                Table(caption="Files that came out", headings=("file", "SHA-256"), rows=files),
            ],
        ),
        Section(title="Numbers of the members", blocks=_member_numbers(members)),
        pictures(folder),
    ]
    return Chapter(
        title=f"Sweep of {sweep.get('case', folder.name)}", about=folder.resolve().name, sections=sections
    )


def _member_numbers(members: Sequence[Mapping[str, Any]]) -> list[Block]:
    """Return the numbers that differ between members, one row each, those of the valve first."""
    names = list(dict.fromkeys(name for m in members for name in m["row"]))
    timing = ("timing.", "member", "state")
    kept = [n for n in names if not n.startswith(timing) and len({str(m["row"].get(n)) for m in members}) > 1]
    kept.sort(key=lambda name: (not name.startswith("valve."), not name.startswith("energy")))
    if not kept:
        return [missing("No number differs between the members.")]
    headings = ("number", *(str(m["member"]) for m in members))
    rows = [(name, *(m["row"].get(name) for m in members)) for name in kept]
    caption = f"Numbers that differ ({len(rows)})"
    return [Table(caption=caption, headings=headings, rows=rows, folded=caption if len(rows) > FEW else "")]


def a_validation(folder: Path) -> Chapter:
    """Return the part on a validation."""
    verdict, name = read_table(folder / "compare" / "verdict.json"), folder.resolve().name
    if not verdict:
        why = missing("The stage compare has not been made: there is no verdict.json yet.")
        return Chapter(
            title=f"Validation {name}", about="", sections=[Section(title="Verdict", blocks=[why])]
        )
    blocks: list[Block] = [_checks(verdict)]
    blocks += [Note(text=str(line), tone="warning") for line in verdict.get("next", ())]
    text, told = "What came of each stage", flat(verdict.get("stages", {}))
    stages = Table(caption=text, headings=("path", "value"), rows=told, folded=text)
    found = [block for one in sorted((folder / "compare").glob("*/")) for block in pictures(one).blocks]
    drawn = [block for block in found if block.kind == "picture"]
    sections = [
        Section(title="Verdict", blocks=blocks),
        Section(title="Norms", blocks=[_norms(verdict)]),
        Section(title="Stages", blocks=[stages]),
        Section(title="Pictures", blocks=drawn or [missing("There are no pictures.")]),
    ]
    return Chapter(title=f"Validation {verdict.get('title') or name}", about=name, sections=sections)


def _checks(verdict: Mapping[str, Any]) -> Table:
    """Return what a validation was asked for and what it found."""
    keys = ("run", "quantity", "norm", "at_most", "found", "found_shifted", "reached", "against")
    headings = ("run", "waveform", "norm", "at most [%]", "found [%]", "shifted [%]", "reached", "asked by")
    rows = [tuple(_or_dash(check.get(key)) for key in keys) for check in verdict.get("checks", ())]
    return Table(caption="What was asked and what was found", headings=headings, rows=rows)


def _norms(verdict: Mapping[str, Any]) -> Table:
    """Return the norms of a validation, against the record and between its grids."""
    pairs = (*verdict.get("against_record", ()), *verdict.get("between_grids", ()))
    rows = [
        (f"{it['a']['name']} - {it['b']['name']}, {name}", *(row[w][k] for w in WAYS for k in KINDS))
        for it in pairs
        for name, row in it["quantities"].items()
    ]
    kinds = [f"{text}{end}" for end in ("", " shifted") for text in ("L2 [%]", "Linf [%]", "NRMSE [%]")]
    caption = "Norms, against the record and between grids"
    return Table(caption=caption, headings=("pair, waveform", *kinds), rows=rows)
