"""Records of a flow loop: pressures and flows over time, read from columns that carry their units.

A heading is a quantity and a unit: ``t_s``, ``p_ao_mmHg``, ``q_ao_ml_s``, ``Q_Ao [L/min]``, ``P_LV (kPa)``. The first
letter says the kind: t(ime), p(ressure), q (flow), v(olume). Inside everything is CGS. Every complaint names file,
row and column; a row is counted as an editor counts lines.
"""

from __future__ import annotations

import csv
import difflib
import hashlib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from valvefsi.errors import CaseError
from valvefsi.fitting.record_table import STATISTIC
from valvefsi.units import KILOPASCAL, LITRE_PER_MINUTE, MILLILITRE, MMHG, PASCAL, PLAUSIBLE

UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0},
    "p": {
        "mmHg": MMHG,
        "torr": MMHG,
        "Pa": PASCAL,
        "kPa": KILOPASCAL,
        "mbar": 100 * PASCAL,
        "bar": 1e5 * PASCAL,
        "cmH2O": 98.0665 * PASCAL,
        "dyn_cm2": 1.0,
    },
    "q": {
        "ml_s": MILLILITRE,
        "ml_min": MILLILITRE / 60,
        "cm3_s": 1.0,
        "l_s": 1e3,
        "L_min": LITRE_PER_MINUTE,
        "lpm": LITRE_PER_MINUTE,
        "m3_s": 1e6,
    },
    "v": {"ml": MILLILITRE, "cm3": 1.0, "l": 1e3, "m3": 1e6},
}
KINDS = {"t": "time", "p": "pressure", "q": "flow", "v": "volume"}
EXAMPLES = {"t": "t_s", "p": "{}_mmHg", "q": "{}_ml_s", "v": "{}_ml"}
GAP = 10.0
"""An interval longer than this many times the median one is a gap."""
FEWEST = 4
"""Samples below which a record says nothing."""
FLAT = {
    kind: {re.sub("[^a-z0-9]+", "_", unit.lower()): unit for unit in units} for kind, units in UNITS.items()
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Waveforms:
    """A record of a flow loop.

    Attributes:
        t: Increasing times, ``(n,)`` [s].
        values: Samples by quantity (``p_ao``, ``q_lv``), each ``(n,)``, CGS.
        units: Unit of each quantity in the file.
        headings: Heading of each quantity in the file.
        rows: Line of each sample in the file, ``(n,)``.
        file: The file; None for a record made in memory.
        sha256: Hash of the file.
        notes: What was done to the record.
    """

    t: NDArray
    values: Mapping[str, NDArray]
    units: Mapping[str, str] = field(default_factory=dict)
    headings: Mapping[str, str] = field(default_factory=dict)
    rows: NDArray | None = None
    file: Path | None = None
    sha256: str = ""
    notes: tuple[str, ...] = ()

    def __getitem__(self, quantity: str) -> NDArray:
        return self.values[quantity]

    @property
    def span(self) -> float:
        """Time between the first and the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def heading(self, quantity: str) -> str:
        """Return the heading of a quantity in its file."""
        return self.headings.get(quantity, quantity)

    def unit_scale(self, quantity: str) -> float:
        """Return the size in CGS of the unit that a quantity has in its file."""
        return UNITS[quantity[0]][self.units[quantity]] if quantity in self.units else 1.0

    def require(self, quantities: Iterable[str], what: str) -> None:
        """Say in one line what is missing.

        Raises:
            CaseError: One of ``quantities`` is not in the record.
        """
        wanted = list(quantities)
        missing = [quantity for quantity in wanted if quantity not in self.values]
        if missing:
            named = " and ".join(
                f"{q} ({KINDS[q[0]]}, a column such as {EXAMPLES[q[0]].format(q)})" for q in missing
            )
            there = ", ".join(self.heading(q) for q in self.values) or "none"
            raise CaseError(
                f"{what} needs {' and '.join(wanted)}; missing is {named}; columns read besides the time: {there}",
                file=self.file,
            )

    def with_values(self, changed: Mapping[str, NDArray], note: str = "") -> Waveforms:
        """Return the record with some quantities replaced."""
        notes = (*self.notes, note) if note else self.notes
        return replace(self, values={**self.values, **changed}, notes=notes)

    def flipped(self, quantities: Iterable[str]) -> Waveforms:
        """Return the record with the positive direction of some flows turned round.

        Raises:
            CaseError: One of them is not a flow of the record.
        """
        names = list(quantities)
        for name in names:
            if name not in self.values or name[0] != "q":
                flows = ", ".join(q for q in self.values if q[0] == "q") or "none"
                raise CaseError(f"expected a flow of the record, it has {flows}", key="flip", value=name)
        if not names:
            return self
        return self.with_values(
            {q: -self[q] for q in names}, f"positive direction turned round: {', '.join(names)}"
        )

    def picked(self, samples: NDArray) -> Waveforms:
        """Return the record at some of its samples, by number or by a mask."""
        values = {name: array[samples] for name, array in self.values.items()}
        return replace(
            self, t=self.t[samples], values=values, rows=None if self.rows is None else self.rows[samples]
        )


def parse_heading(heading: str) -> tuple[str, str] | None:
    """Return quantity and unit of a heading; None where it is neither a time, pressure, flow nor volume with a unit."""
    flat = re.sub("[^a-z0-9]+", "_", heading.strip().lower()).strip("_")
    flat = re.sub("^time(?=_|$)", "t", flat)
    kind = flat[:1]
    if not re.match("(t|p_[a-z0-9]+|q_[a-z0-9]+|v_[a-z0-9]+)(_|$)", flat):
        return None
    for short in sorted(FLAT[kind], key=len, reverse=True):
        name = flat.removesuffix(f"_{short}")
        if name != flat and (name == "t" if kind == "t" else len(name) > 2 and name[1] == "_"):
            return name, FLAT[kind][short]
    return None


def read_waveforms(
    path: str | Path, *, columns: Mapping[str, str] | None = None, gaps: bool = False
) -> Waveforms:
    """Read a record: a heading line, then one line a sample; lines that begin with # are skipped.

    Args:
        path: A CSV file, its cells parted by commas, semicolons or tabs.
        columns: ``quantity: heading`` or ``quantity: heading:unit`` for columns whose headings do not say it.
        gaps: Accept gaps in time; the record is linear across them.

    Returns:
        The record in CGS.

    Raises:
        CaseError: The file, a heading or a cell cannot be used; says which, in file, row and column.
    """
    path = Path(path)
    text, digest = _text(path)
    lines = [
        (n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip() and not line.startswith("#")
    ]
    if not lines:
        raise CaseError("the file is empty", file=path)
    cells = _cells(lines, path)
    (first, headings), body = cells[0], cells[1:]
    found = _assign(path, first, headings, dict(columns or {}))
    if "t" not in found:
        raise CaseError(f"no column of times, such as t_s; columns: {', '.join(headings)}", file=path)
    if len(found) < 2:
        message = f"no pressure or flow with a unit in its heading, such as p_ao_mmHg; columns: {', '.join(headings)}"
        raise CaseError(message, file=path)
    if len(body) < FEWEST:
        raise CaseError(f"{len(body)} samples, expected {FEWEST} or more", file=path)
    arrays = {
        name: np.array([_number(path, row, headings, cells, at) for row, cells in body])
        * UNITS[name[0]][unit]
        for name, (at, unit) in found.items()
    }
    rows = np.array([row for row, _ in body])
    for name, array in arrays.items():
        _check_size(path, rows, headings[found[name][0]], name, array)
    t = arrays.pop("t")
    _check_times(t, path, rows, headings[found["t"][0]], gaps)
    return Waveforms(
        t=t,
        values=arrays,
        units={name: unit for name, (_, unit) in found.items()},
        headings={name: headings[at] for name, (at, _) in found.items()},
        rows=rows,
        file=path,
        sha256=digest,
        notes=_passed_over(headings),
    )


def write_waveforms(waves: Waveforms, path: Path, header: Iterable[str] = ()) -> Path:
    """Write a record that `read_waveforms` reads, in the units of the file it came from (CGS where it has none)."""
    fallback = {"p": "mmHg", "q": "ml_s", "v": "ml"}
    units = {q: waves.units.get(q, fallback[q[0]]) for q in waves.values}
    names = ["t_s", *(f"{q}_{units[q]}" for q in waves.values)]
    table = [waves.t, *(array / UNITS[q[0]][units[q]] for q, array in waves.values.items())]
    lines = [*(f"# {line}" for line in header), ",".join(names)]
    lines += [",".join(f"{value:.10g}" for value in row) for row in zip(*table, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _text(path: Path) -> tuple[str, str]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CaseError(f"cannot be read ({error.strerror})", file=path) from None
    try:
        return data.decode("utf-8-sig"), hashlib.sha256(data).hexdigest()
    except UnicodeDecodeError:
        raise CaseError("is not a text file in UTF-8", file=path) from None


def _cells(lines: list[tuple[int, str]], path: Path) -> list[tuple[int, list[str]]]:
    """Split lines into cells; all must have as many as the heading line."""
    parting = max(",;\t", key=lambda mark: lines[0][1].count(mark))
    try:
        split = csv.reader([line for _, line in lines], delimiter=parting, strict=True)
        cells = [
            (row, [cell.strip() for cell in found]) for (row, _), found in zip(lines, split, strict=True)
        ]
    except (csv.Error, ValueError):
        raise CaseError("is not a table: a quoted cell does not end on its line", file=path) from None
    for row, found in cells[1:]:
        if len(found) != len(cells[0][1]):
            message = f"expected {len(cells[0][1])} cells as in the heading line, found {len(found)}"
            raise CaseError(message, file=path, key=f"row {row}")
    return cells


def _assign(path: Path, row: int, headings: list[str], columns: dict[str, str]) -> dict[str, tuple[int, str]]:
    """Return the column number and the unit of each quantity."""
    found: dict[str, tuple[int, str]] = {}
    mapped = {name: _mapped(path, headings, name, given) for name, given in columns.items()}
    taken = {at for at, _ in mapped.values()}
    for at, heading in enumerate(headings):
        if STATISTIC.search(heading) and at not in taken:
            continue
        known = None if at in taken else parse_heading(heading)
        if known is None:
            if at not in taken:
                _complain_about_unit(path, row, heading)
            continue
        name, unit = known
        if name in found or name in mapped:
            other = headings[(found.get(name) or mapped[name])[0]]
            raise CaseError(
                f"is there twice, as {other} and {heading}", file=path, key=f"row {row}, column {name}"
            )
        found[name] = (at, unit)
    return {**found, **mapped}


def _passed_over(headings: list[str]) -> tuple[str, ...]:
    """Note the columns that hold statistics of others."""
    passed = [heading for heading in headings if STATISTIC.search(heading)]
    return (f"columns passed over: {', '.join(passed)}",) if passed else ()


def _mapped(path: Path, headings: list[str], name: str, given: str) -> tuple[int, str]:
    """Return column number and unit of a quantity that the user pointed out."""
    if not re.fullmatch("t|[pqv]_[a-z0-9]+", name):
        raise CaseError("expected a quantity such as t, p_ao or q_lv", key="columns", value=name)
    heading, unit = given, None
    if given not in headings and ":" in given:
        heading, unit = given.rsplit(":", 1)
    if headings.count(heading) != 1:
        near = difflib.get_close_matches(heading, headings, n=1)
        hint = f", did you mean {near[0]}?" if near and near[0] != heading else ""
        many = "is there twice" if heading in headings else f"no such column{hint}"
        raise CaseError(many, file=path, key=f"column {heading}")
    if unit is None:
        known = parse_heading(heading)
        if known is None or known[0][0] != name[0]:
            message = f"its heading has no unit of {KINDS[name[0]]}: give {name}={heading}:UNIT"
            raise CaseError(message, file=path, key=f"column {heading}")
        return headings.index(heading), known[1]
    flat = re.sub("[^a-z0-9]+", "_", unit.lower())
    if flat not in FLAT[name[0]]:
        raise CaseError(_unknown(unit, name[0]), file=path, key=f"column {heading}")
    return headings.index(heading), FLAT[name[0]][flat]


def _complain_about_unit(path: Path, row: int, heading: str) -> None:
    """Refuse a heading that is plainly a pressure or a flow, but has no unit that is known."""
    match = re.match(r"\s*([tpq])(?:ime)?(?:_([a-z0-9]+))?(?:[_ \[(]+([^\])]*))?[\])]?\s*$", heading, re.I)
    if match is None or (match[1].lower() != "t" and match[2] is None):
        return
    unit = match[3] if match[1].lower() != "t" else (match[3] or match[2])
    said = _unknown(unit, match[1].lower()) if unit else _unknown("", match[1].lower())
    raise CaseError(said, file=path, key=f"row {row}, column {heading}")


def _unknown(unit: str, kind: str) -> str:
    known = ", ".join(UNITS[kind])
    start = f"unknown unit {unit!r}" if unit else "no unit in the heading"
    return f"{start}, expected one of {KINDS[kind]}: {known}"


def _number(path: Path, row: int, headings: list[str], cells: list[str], at: int) -> float:
    try:
        value = float(cells[at])
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > 1e100:
        found = cells[at] or "nothing"
        raise CaseError(
            f"expected a number, found {found[:40]}", file=path, key=f"row {row}, column {headings[at]}"
        )
    return value


def _check_size(path: Path, rows: NDArray, heading: str, name: str, array: NDArray) -> None:
    """Refuse values that nothing in a flow loop reaches."""
    over = np.flatnonzero(np.abs(array) > PLAUSIBLE[name[0]])
    if len(over):
        message = (
            f"no flow loop has this {KINDS[name[0]]}, at most {PLAUSIBLE[name[0]]:g} in CGS is plausible"
        )
        raise CaseError(
            message, file=path, key=f"row {rows[over[0]]}, column {heading}", value=array[over[0]]
        )


def _check_times(t: NDArray, path: Path, rows: NDArray, heading: str, gaps: bool) -> None:
    """Refuse times that do not increase, and gaps."""
    step = np.diff(t)
    if not step.min() > 0:
        at = int(np.argmax(step <= 0)) + 1
        message = f"time does not increase: {t[at]:.7g} s after {t[at - 1]:.7g} s"
        raise CaseError(message, file=path, key=f"row {rows[at]}, column {heading}")
    usual = float(np.median(step))
    if not gaps and step.max() > GAP * usual:
        at = int(np.argmax(step))
        message = (
            f"gap of {step[at]:.4g} s after {t[at]:.7g} s (median interval {usual:.4g} s); "
            "accept it with --gaps, the record is then linear across it"
        )
        raise CaseError(message, file=path, key=f"row {rows[at + 1]}, column {heading}")
