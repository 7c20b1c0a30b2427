"""Comparisons of beats as files: norms as JSON, tables and pictures, and the verdict of a validation."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from valvefsi.case.study_tables import Targets
from valvefsi.fitting.report import number, write_json
from valvefsi.io.folder import write_text
from valvefsi.post.valve_beat import QUANTITIES
from valvefsi.post.valve_comparison import Comparison, Pair
from valvefsi.types import Scalar

KINDS = ("l2_percent", "linf_percent", "nrmse_percent")
COLUMNS = (
    "A",
    "B",
    "quantity",
    "L2_percent",
    "Linf_percent",
    "NRMSE_percent",
    "shift_ms",
    "shifted_L2_percent",
    "shifted_Linf_percent",
    "shifted_NRMSE_percent",
    "repeats_A_percent",
    "repeats_B_percent",
)
"""Columns of the tables of norms, all of A less B over B."""
MUST_BEAT = ("p_lv", "q_ao")
"""Waveforms in which a valve in three dimensions must be nearer to the record than an orifice is."""


def write_comparison(pair: Pair, result: Comparison, folder: Path) -> Path:
    """Write ``comparison.json`` and ``comparison.png``; return the second."""
    from valvefsi.post.plots.valve_comparison import Overlay, valve_comparison

    write_json(folder / "comparison.json", result)
    shift, overlays = 1e-3 * result["shift_ms"], []
    for name in (name for name in pair.quantities if name in QUANTITIES):
        a, b = pair.values(name)
        rows = result["quantities"][name]
        said = [rows[which]["l2_percent"] for which in ("as_they_are", "shifted")]
        known = pair.b.deviation_at(name, pair.t) if name in pair.b.deviations else None
        text = "" if None in said else "L2 {:.2f} %, shifted {:.2f} %".format(*said)
        shifted = pair.values(name, shift)[0]
        overlays.append(Overlay(quantity=name, a=a, b=b, shifted=shifted, deviation=known, text=text))
    names = {"a": _called(result, "a"), "b": _called(result, "b")}
    names["shifted"] = f"difference with {names['a']} moved by {1e3 * shift:+.2f} ms"
    title = f"{names['a']} and {names['b']}"
    caption = f"one cycle of {pair.b.period:.4g} s; the lower panels show {names['a']} less {names['b']}"
    path = folder / "comparison.png"
    return valve_comparison(path, pair.t, overlays, names, title=title, caption=caption)


def _called(result: Comparison, side: str) -> str:
    """Return what a side is called; A and B where both have one name."""
    same = result["a"]["name"] == result["b"]["name"]
    return f"{result[side]['name']} ({side.upper()})" if same else str(result[side]["name"])


def norm_rows(results: Sequence[Comparison]) -> list[tuple[Scalar, ...]]:
    """Return the rows of the table of norms, under `COLUMNS`."""
    return [
        (
            result["a"]["name"],
            result["b"]["name"],
            name,
            *(row["as_they_are"][kind] for kind in KINDS),
            result["shift_ms"],
            *(row["shifted"][kind] for kind in KINDS),
            *(row["repeatability_l2_percent"][side] for side in "ab"),
        )
        for result in results
        for name, row in result["quantities"].items()
    ]


def write_tables(rows: Sequence[Sequence[Scalar]], folder: Path) -> None:
    """Write ``norms.csv`` and ``norms.md``, see `norm_rows`."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([["" if cell is None else cell for cell in row] for row in rows])
    write_text(folder / "norms.csv", text.getvalue())
    lines = [COLUMNS, ["---"] * len(COLUMNS)]
    lines += [[cell if isinstance(cell, str) else _short(cell) for cell in row] for row in rows]
    write_text(folder / "norms.md", "".join(f"| {' | '.join(line)} |\n" for line in lines))


def _short(cell: Scalar) -> str:
    return "" if cell is None else number(float(str(cell)))


def checks_of(results: Mapping[str, Comparison], targets: Targets) -> list[dict[str, Any]]:
    """Return what a study was asked for, what it found as it is and shifted, and whether that was reached.

    Args:
        results: Comparisons with the record by the name of the run, ``orifice`` among them.
        targets: Largest differences of a run from the record.
    """
    found = []
    for run in (name for name in results if name != "orifice"):
        quantities, yardstick = results[run]["quantities"], results["orifice"]["quantities"]
        for kind, asked in (("l2_percent", targets.l2), ("linf_percent", targets.linf)):
            found += [_check(run, name, kind, most, quantities, "target") for name, most in asked.items()]
        for name in MUST_BEAT:
            most = yardstick[name]["as_they_are"]["l2_percent"]
            found.append(_check(run, name, "l2_percent", most, quantities, "the orifice in its place"))
    return found


def _check(
    run: str, quantity: str, kind: str, most: float, quantities: Mapping[str, Any], against: str
) -> dict[str, Any]:
    row = quantities.get(quantity)
    value, shifted = (None, None) if row is None else (row["as_they_are"][kind], row["shifted"][kind])
    check: dict[str, Any] = {
        "run": run,
        "quantity": quantity,
        "norm": kind,
        "at_most": most,
        "against": against,
    }
    check |= {"found": value, "found_shifted": shifted}
    reached = {"reached": value, "reached_shifted": shifted}
    return check | {key: None if part is None else bool(part <= most) for key, part in reached.items()}


def advice(
    runs: Mapping[str, Mapping[str, Any]],
    results: Mapping[str, Comparison],
    checks: Sequence[Mapping[str, Any]],
    circuit_alone: float | None,
) -> list[str]:
    """Return what to do next.

    Args:
        runs: What came of each run: beats, whether it is periodic, by how much the last two differ.
        results: Comparisons with the record by the name of the run.
        checks: See `checks_of`.
        circuit_alone: L2 of P_Ao of the downstream circuit driven by the measured flow [%].
    """
    said = []
    for name, run in runs.items():
        if not run["periodic"]:
            most = max(
                run["last_two_apart_l2_percent"].items(), key=lambda pair: pair[1], default=("beats", 0.0)
            )
            said.append(
                f"{name}: not periodic after {run['beats']} beats (last two {most[1]:.3g} % apart in {most[0]}): raise "
                "max_beats and call again, it goes on from there"
            )
    for name, result in results.items():
        if result["shift_at_its_bound"]:
            said.append(
                f"{name}: the shift is at its bound: look for a reason in the pump or the start of the record"
            )
    missed = [check for check in checks if check["reached"] is False]
    for check in missed:
        kind = "L2" if check["norm"] == "l2_percent" else "Linf"
        shifted = "; shifted it is not" if check["reached_shifted"] else ""
        said.append(
            f"{check['run']}: {kind} of {check['quantity']} is {check['found']:.3g} %, more than "
            f"{check['at_most']:.3g} % ({check['against']}){shifted}"
        )
    if circuit_alone is not None and any(check["quantity"] == "p_ao" for check in missed):
        said.append(
            f"P_Ao: the circuit alone, driven by the measured flow, is {circuit_alone:.3g} % off in L2"
        )
    if set(runs) == {"orifice"}:
        said.append("there is no run in three dimensions yet: name grids")
    return said
