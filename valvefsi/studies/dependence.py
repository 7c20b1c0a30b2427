"""What else than the spacing the numbers of a study of grids depend on, kind by kind; what was not varied is said.

What is said of a kind is the largest difference that one of its changes makes to a number that may have an order of
accuracy, relative to the base. A number that is nearly zero makes that large: the table of changes has every one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from valvefsi.case.models import Case
from valvefsi.case.schedule import beat_period
from valvefsi.studies.grid_study import AND, GridStudy
from valvefsi.studies.members import Values
from valvefsi.verification.answers import repeating_error, why_no_order


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of change.

    Attributes:
        meaning: What it shows.
        option: How it is asked for.
    """

    meaning: str
    option: str


STEP, RANKS, DOMAIN, KERNEL, OTHER = "time step", "ranks", "domain size", "kernel", "other"
KINDS: Mapping[str, Kind] = {
    STEP: Kind(
        meaning="the error of integration in time: the same grid with smaller steps, adaptive ones with a smaller "
        "Courant number",
        option="--steps 1,0.5",
    ),
    RANKS: Kind(
        meaning="sums in another order, which is round-off; more shows a fault, or a flow that magnifies round-off",
        option="--ranks 2",
    ),
    DOMAIN: Kind(
        meaning="how far the sides of the box are felt: a larger box at the same spacing",
        option="--also 'grid.lower=[...] & grid.upper=[...]'",
    ),
    KERNEL: Kind(
        meaning="the regularised delta function, over whose width bodies and fluid meet: an error of first order in h",
        option="--also solid.NAME.kernel=bspline4",
    ),
    OTHER: Kind(meaning="whatever else was asked for", option="--also KEY=VALUE"),
}
BOX = re.compile(r"grid\.(lower|upper|edges)(\..*)?")
CYCLES = re.compile(r"valve\.cycles\.(\d+)\.(.*)")


def kind_of(change: str) -> str:
    """Return the kind of a change of the base, a key of `KINDS`."""
    if change.startswith(STEP):
        return STEP
    keys = [part.partition("=")[0].strip() for part in change.split(AND)]
    if keys == ["ranks"]:
        return RANKS
    if any(BOX.fullmatch(key) for key in keys):
        return DOMAIN
    return KERNEL if all(key.endswith(".kernel") for key in keys) else OTHER


def dependence(changes: Sequence[Mapping[str, Any]], *, bodies: bool = True) -> list[Values]:
    """Return a row for each kind of change: what it means, what was changed, and what moves most.

    Args:
        changes: Rows of every number and waveform under every change, as ``verification.json`` has them.
        bodies: Whether there are bodies in the flow, which have kernels.
    """
    rows: list[Values] = []
    for name, kind in KINDS.items():
        own = [row for row in changes if kind_of(row["change"]) == name]
        if not own and (name == OTHER or (name == KERNEL and not bodies)):
            continue
        row: Values = {
            "of": name,
            "meaning": kind.meaning,
            "changes": list(dict.fromkeys(r["change"] for r in own)),
        }
        known = [r for r in own if r["difference_percent"] is not None and not why_no_order(r["quantity"])]
        for what, part in (
            ("number", [r for r in known if "norm" not in r]),
            ("waveform", [r for r in known if r.get("norm") == "L2"]),
        ):
            most = max(part, key=lambda r: abs(r["difference_percent"]), default=None)
            row[what] = None if most is None else most["quantity"]
            row[f"{what}_percent"] = None if most is None else most["difference_percent"]
        row["text"] = "varied" if own else f"NOT VARIED: {kind.option} does"
        rows.append(row)
    return rows


def iterations(case: Case, numbers: Mapping[str, float]) -> Values:
    """Return what iterations leave: of the solves of a step, and of beats that have not come to repeat.

    Args:
        case: The case of the base.
        numbers: The numbers of its summary by path.
    """
    solves = "the fluid's solves are direct: a step has no iterative error beyond round-off"
    if case.fluid.viscous == "coupled":
        from valvefsi.fluid.krylov import TOLERANCE

        solves = f"FGMRES ends at a residual of {TOLERANCE:g} of that of no change"
    cycles: dict[str, dict[int, float]] = {}
    for path, value in numbers.items():
        if match := CYCLES.fullmatch(path):
            cycles.setdefault(match[2], {})[int(match[1])] = value
    rows = []
    for name, found in cycles.items():
        values = [found[k] for k in sorted(found)]
        error = repeating_error(values)
        if error is not None:
            percent = 100.0 * error / abs(values[-1]) if values[-1] else None
            rows.append({"quantity": name, "values": values, "error": error, "error_percent": percent})
    return {"solves": solves, "beats": rows, "text": _beats(case, rows)}


def _beats(case: Case, rows: Sequence[Values]) -> str:
    if rows:
        return "error of the last beat, from how the beats before it came to repeat (Ferziger and Peric 1996)"
    if beat_period(case) is not None:
        return "NOT KNOWN how far the beat repeats: the base has fewer than two whole cycles"
    return "nothing repeats in this case"


def add_dependence(result: Values, study: GridStudy, numbers: Mapping[str, float]) -> None:
    """Add to a study's result what else its numbers depend on.

    Args:
        result: What `valvefsi.studies.grid_numbers.assess` found so far.
        study: The study.
        numbers: The numbers of the base's summary by path.
    """
    case = study.cases[study.base.name]
    bodies = bool(case.solid) or case.housing is not None
    result["dependence"] = dependence(result["changes"], bodies=bodies)
    result["iterations"] = iterations(case, numbers)
