"""What a plan warns of before a run is paid for: short boxes, coarse histories, materials whose stress jumps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.bodies.body import Entry
from valvefsi.case.expressions import TimeTable, read_table
from valvefsi.case.models import Case
from valvefsi.solid.materials.presets import ROUNDING

BEHIND_VALVE, BEHIND_DISK = 1.5, 3.0
"""Length of the box, in diameters, that a jet should have: behind a valve's posts, and from an open disk on."""
ROWS = 4
"""Rows of a history in the time that the fastest signal would take through its range at its steepest."""
STEEPEST = 0.98
"""Part of the time for which a signal is less steep than what counts: a jump at a record's start is none."""


def plan_warnings(case: Case) -> list[Entry]:
    """Return a line for each of them."""
    texts = [("fluid", text) for text in _short_jets(case)] + [
        ("history", text) for text in _coarse_history(case)
    ]
    return [Entry(quantity=f"warning, {what}", value="", note=text) for what, text in texts] + jumping_stress(
        case
    )


def jumping_stress(case: Case) -> list[Entry]:
    """Return a warning of a plan for every solid whose dispersed fibres begin to bear with a jump."""
    text = (
        "the stress of dispersed fibres jumps where they begin to bear, which can make the stable step several times "
        f"shorter: take width = {ROUNDING:g}"
    )
    return [
        Entry(quantity=f"warning, {solid.name}", value="", note=text)
        for solid in case.solid
        if solid.material is not None and _jumps(solid.material.parameters)
    ]


def _jumps(parameters: Mapping[str, Any]) -> bool:
    dispersed = any(family.get("kappa", 0.0) > 0.0 for family in parameters.get("families", ()))
    return dispersed and not parameters.get("width", 0.0) > 0.0


def _short_jets(case: Case) -> Iterator[str]:
    """Yield what is too short: behind each valve, else along a side that is open on a disk."""
    valves = [(s.name, s.mesh.valve) for s in case.solid if s.mesh.valve is not None]
    for name, valve in valves:
        shape = valve.geometry()
        behind = (case.grid.bounds[2][1] - valve.base - shape.height) / (2.0 * shape.radius)
        if behind < BEHIND_VALVE:
            yield (
                f"the jet of {name} has {behind:.2g} diameters of the box behind the posts; its end is felt below "
                f"{BEHIND_VALVE:g}: move the upper end of z"
            )
    if valves or case.housing is not None:
        return
    for axis, (lower, upper) in zip("xyz", case.grid.bounds, strict=False):
        for end in ("lower", "upper"):
            side = getattr(case.fluid.sides, f"{axis}_{end}")
            if side.type == "mixed" and side.radius and upper - lower < BEHIND_DISK * 2.0 * side.radius:
                length = (upper - lower) / (2.0 * side.radius)
                yield (
                    f"a jet from {axis}_{end} has {length:.2g} of its diameters to the other side; {BEHIND_DISK:g} "
                    "or more keep it from the end of the box"
                )


def _coarse_history(case: Case) -> Iterator[str]:
    """Yield the fastest signal of the case's tables where rows are too far apart for it."""
    between, found = case.dt * case.output.history_every, list(_signals(case))
    if not found:
        return
    time, name = min(found)
    if between > time / ROWS:
        rows = max(1, int(time / ROWS / case.dt))
        yield (
            f"a row every {1e3 * between:.3g} ms is too few for {name}, which changes within {1e3 * time:.3g} ms: "
            f"output.history_every = {rows}"
        )


def _signals(case: Case) -> Iterator[tuple[float, str]]:
    """Yield the time that each column of a case's tables takes through its range at its steepest [s]."""
    names = [(name, side.table) for name, side in case.fluid.sides if side.table]
    names += [(circuit.name, circuit.pump.file) for circuit in case.circuit if circuit.pump.file]
    for place, file in names:
        path = Path(file)
        path = path if path.is_absolute() or case.file is None else case.file.parent / path
        table = read_table(path)
        for column in table.columns:
            time = _fastest(table, column)
            if time < np.inf:
                yield time, f"{column} of {place}"


def _fastest(table: TimeTable, column: str) -> float:
    """Return the range of a column over its slope where it is steepest, infinite where it does not change [s]."""
    values, steps = table.columns[column], np.diff(table.t)
    slopes = np.abs(np.diff(values)) / steps
    order = np.argsort(slopes)
    steep = slopes[order][np.searchsorted(np.cumsum(steps[order]), STEEPEST * steps.sum())]
    return float(np.ptp(values) / steep) if steep > 0 else np.inf
