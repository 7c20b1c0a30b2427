"""A study of grids as files: ``verification.json``, tables, and a picture."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from valvefsi import __version__
from valvefsi.io.folder import write_text
from valvefsi.post.columns import units_of_run
from valvefsi.studies.grid_study import GridStudy
from valvefsi.studies.members import Outcome, Values
from valvefsi.studies.sweep_picture import FIRST, headlines

MOST, MOST_WAVES = 8, 6
"""Numbers and waveforms that are drawn."""
DULL = ("energy_",)
"""Waveforms that are not drawn."""


def write_verification(case: Path, study: GridStudy, result: Values, folder: Path) -> None:
    """Write ``verification.json``, ``verification.csv``, ``changes.csv`` and ``verification.md``.

    Args:
        case: The case file.
        study: The study.
        result: What `valvefsi.studies.grid_numbers.assess` found.
        folder: Where to.
    """
    about = {"case": str(case), "version": __version__}
    write_text(folder / "verification.json", json.dumps(about | result, indent=2) + "\n")
    names = [grid["member"] for grid in result["grids"]]
    _write_csv(folder / "verification.csv", [*_number_rows(names, result), *_wave_rows(names, result)])
    if result["changes"]:
        _write_csv(folder / "changes.csv", result["changes"])
    write_text(folder / "verification.md", _page(case, names, result))


def _number_rows(names: Sequence[str], result: Values) -> list[dict[str, Any]]:
    return [
        {"quantity": row["quantity"], "norm": ""}
        | dict(zip(names, row["values"], strict=True))
        | {key: row[key] for key in ("kind", "order", "extrapolated", "index", "uncertainty")}
        for row in result["quantities"]
    ]


def _wave_rows(names: Sequence[str], result: Values) -> list[dict[str, Any]]:
    """Return the rows of waveforms; under each grid but the finest stands its difference from the next."""
    return [
        {"quantity": row["quantity"], "norm": row["norm"]}
        | dict(zip(names, [*row["differences"], None], strict=True))
        | {"kind": row["kind"], "order": row["order"], "extrapolated": None}
        | {key: row[key] for key in ("index", "uncertainty")}
        for row in result["waveforms"]
    ]


def _write_csv(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    text, names = io.StringIO(), list(dict.fromkeys(name for row in rows for name in row))
    table = csv.DictWriter(text, names, restval="", lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_text(path, text.getvalue())


def _page(case: Path, names: Sequence[str], result: Values) -> str:
    """Return the tables in Markdown, with what must be said before them."""
    lines = [f"# Refinement of {case.name}", "", *(f"- {note}" for note in result["notes"])]
    lines += [f"- FAILED: {name}: {why}; it is in no number here" for name, why in result["failed"].items()]
    head = ["quantity", *names, "order", "Richardson", "GCI [%]", "uncertainty", "verdict"]
    lines += ["", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in result["quantities"]:
        cells = [row["quantity"], *map(_short, row["values"]), *_judged(row, row["extrapolated"])]
        lines.append("| " + " | ".join([*cells, row["text"]]) + " |")
    for row in result["waveforms"]:
        gaps = [*(f"{100 * gap:.3g} %" for gap in row["differences"]), "0"]
        bound = "-" if row["uncertainty"] is None else f"{100 * row['uncertainty']:.3g} %"
        judged = [*_judged(row, None)[:-1], bound]
        cells = [f"{row['quantity']}, {row['norm']} of the difference", *gaps, *judged]
        lines.append("| " + " | ".join([*cells, row["text"]]) + " |")
    return "\n".join([*lines, *_time_step_lines(result), *_dependence_lines(result)]) + "\n"


def _dependence_lines(result: Values) -> list[str]:
    """Return what else than the spacing the numbers depend on, and what iterations leave."""
    if not result["dependence"]:
        return []
    head = ["depends on", "which is", "largest change of a number", "of a waveform (L2)", "said"]
    lines = ["", f"What else than the spacing moves {result['base']}:", "", "| " + " | ".join(head) + " |"]
    lines.append("|---" * len(head) + "|")
    for row in result["dependence"]:
        said = [_moved(row, "number"), _moved(row, "waveform"), ", ".join(row["changes"]) or row["text"]]
        lines.append("| " + " | ".join([row["of"], row["meaning"], *said]) + " |")
    found = result["iterations"]
    lines += ["", f"Iterations: {found['solves']}; {found['text']}."]
    if found["beats"]:
        lines += ["", "| quantity | error of the last beat | of its value [%] |", "|---|---|---|"]
    for row in found["beats"]:
        cells = [row["quantity"], _short(row["error"]), _short(row["error_percent"])]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _moved(row: Mapping[str, Any], what: str) -> str:
    percent = row[f"{what}_percent"]
    return "-" if percent is None else f"{row[what]}, {percent:+.3g} %"


def _time_step_lines(result: Values) -> list[str]:
    """Return the table of the time steps, nothing where there is one."""
    rows = result["time_steps"]
    if not rows:
        return []
    head = [
        "quantity",
        *(f"dt x {factor:g}" for factor in rows[0]["factors"]),
        "order",
        "uncertainty",
        "verdict",
    ]
    lines = [
        "",
        f"Time steps of {result['base']}:",
        "",
        "| " + " | ".join(head) + " |",
        "|---" * len(head) + "|",
    ]
    for row in rows:
        numbers = (*row["values"], row["order"], row["uncertainty"])
        lines.append("| " + " | ".join([row["quantity"], *map(_short, numbers), row["text"]]) + " |")
    return lines


def _judged(row: Mapping[str, Any], limit: float | None) -> list[str]:
    index = None if row["index"] is None else 100.0 * row["index"]
    return [_short(row["order"]), _short(limit), _short(index), _short(row["uncertainty"])]


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _is_shown(row: Values) -> bool:
    """Whether a waveform's norm is one to draw: it changes from grid to grid, has an order and is worth a look."""
    changes = row["norm"] == "L2" and min(row["differences"]) > 0.0
    return changes and row["kind"] != "no order" and not row["quantity"].startswith(DULL)


def draw_verification(
    title: str, result: Values, outcomes: Sequence[Outcome], path: Path, study: GridStudy
) -> Path | None:
    """Draw the first numbers and waveforms of a study of grids.

    Args:
        title: Heading.
        result: What `valvefsi.studies.grid_numbers.assess` found.
        outcomes: How the members ended.
        path: The picture.
        study: The study.

    Returns:
        The path, None where fewer than two grids are done.
    """
    from valvefsi.post.plots.refinement import RefinedNumber, RefinementPicture, refinement_picture

    if len(result["grids"]) < 2:
        return None
    rows = {row["quantity"]: row for row in result["quantities"]}
    finest = next(o for o in outcomes if o.member.name == result["grids"][-1]["member"])
    summary = finest.summary
    first = [name for name in _paths(summary) if name in rows]
    changing = [name for name in first if rows[name]["kind"] not in ("unchanged", "no order")][:MOST]
    numbers = [
        RefinedNumber(
            name=name.rpartition(".")[2],
            values=rows[name]["values"],
            extrapolated=rows[name]["extrapolated"],
            uncertainty=rows[name]["uncertainty"],
            text=_said(rows[name]),
        )
        for name in changing
    ]
    shown = [row for row in result["waveforms"] if _is_shown(row)]
    shown.sort(key=lambda row: not row["quantity"].startswith(FIRST))
    waves = {row["quantity"]: (row["differences"], row["order"]) for row in shown[:MOST_WAVES]}
    spacings = ", ".join(f"{10 * grid['h_cm']:.4g}" for grid in result["grids"])
    caption = f"h = {spacings} mm"
    caption += "; bars: uncertainty of the finest value; diamonds: Richardson's value"
    picture = RefinementPicture(
        h=[grid["h_cm"] for grid in result["grids"]],
        numbers=numbers,
        waves=waves,
        expected=study.expected,
        title=title or "grids",
        caption=caption,
        units=units_of_run(finest.folder),
    )
    return refinement_picture(path, picture)


def _paths(summary: Mapping[str, Any]) -> list[str]:
    """Return the paths of the numbers of a summary that are worth a picture."""
    cycles = summary.get("valve", {}).get("cycles", [])
    whole = [k for k, cycle in enumerate(cycles) if set(headlines(summary)) <= set(cycle)]
    place = f"valve.cycles.{whole[-1]}" if whole and headlines(summary) else "last"
    return [f"{place}.{name}" for name in headlines(summary)]


def _said(row: Mapping[str, Any]) -> str:
    if row["index"] is None:
        return str(row["kind"]).upper() if row["kind"] == "diverging" else str(row["kind"])
    return f"{row['kind']}, order {row['order']:.2f}, GCI {100 * row['index']:.2g} %"
