"""Records of a flow loop: pressures, flows and a valve's area over time, read from columns that carry their units.

A heading is a quantity and a unit: ``t_s``, ``p_ao_mmHg``, ``q_ao_ml_s``, ``Q_Ao [L/min]``, ``P_LV (kPa)``. The first
letter says the kind: t(ime), p(ressure), q (flow), v(olume); the one area is ``pdva_cm2``. Inside everything is CGS.
Every complaint names file, row and column; a row is counted as an editor counts lines. Columns of other things are
passed over, and so are those of a standard deviation (``p_lv_sd``, ``sd_p_lv_mmHg``), which `bench_beat` reads.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.record_table import Table, is_statistic, read_table
from valvefsi.io.folder import sha256, write_text
from valvefsi.types import Array, Indices
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
    "a": {"cm2": 1.0, "mm2": 1e-2, "m2": 1e4},
}
KINDS = {"t": "time", "p": "pressure", "q": "flow", "v": "volume", "a": "area"}
EXAMPLES = {"t": "t_s", "p": "{}_mmHg", "q": "{}_ml_s", "v": "{}_ml", "a": "{}_cm2"}
AREA = "pdva"
"""Projected dynamic valve area, the one quantity whose first letter does not say its kind."""
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
        notes: What was done to the record.
    """

    t: Array
    values: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    headings: Mapping[str, str] = field(default_factory=dict)
    rows: Indices | None = None
    file: Path | None = None
    notes: tuple[str, ...] = ()

    def __getitem__(self, quantity: str) -> Array:
        return self.values[quantity]

    @property
    def origin(self) -> dict[str, str]:
        """Name and hash of the file; nothing for a record made in memory."""
        return {"data": self.file.name, "sha256": sha256(self.file)} if self.file else {}

    @property
    def span(self) -> float:
        """Time between the first and the last sample [s]."""
        return float(self.t[-1] - self.t[0])

    def heading(self, quantity: str) -> str:
        """Return the heading of a quantity in its file."""
        return self.headings.get(quantity, quantity)

    def unit_scale(self, quantity: str) -> float:
        """Return the size in CGS of the unit that a quantity has in its file."""
        return UNITS[kind_of(quantity)][self.units[quantity]] if quantity in self.units else 1.0

    def require(self, quantities: Iterable[str], what: str) -> None:
        """Say in one line what is missing.

        Raises:
            CaseError: One of ``quantities`` is not in the record.
        """
        need = list(quantities)
        missing = [quantity for quantity in need if quantity not in self.values]
        if missing:
            names = " and ".join(
                f"{q} ({KINDS[kind_of(q)]}, a column such as {EXAMPLES[kind_of(q)].format(q)})"
                for q in missing
            )
            there = ", ".join(self.heading(q) for q in self.values) or "none"
            raise CaseError(
                f"{what} needs {' and '.join(need)}; missing is {names}; columns read besides the time: {there}",
                file=self.file,
            )

    def with_values(self, changed: Mapping[str, Array], note: str = "") -> Waveforms:
        """Return the record with some quantities replaced, each ``(n,)``, CGS."""
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

    def picked(self, samples: Indices) -> Waveforms:
        """Return the record at some of its samples, by number, ``(k,)``."""
        values = {name: array[samples] for name, array in self.values.items()}
        return replace(
            self, t=self.t[samples], values=values, rows=None if self.rows is None else self.rows[samples]
        )


def kind_of(quantity: str) -> str:
    """Return the kind of a quantity, a key of ``KINDS``."""
    return "a" if quantity == AREA else quantity[:1]


def parse_heading(heading: str) -> tuple[str, str] | None:
    """Return quantity and unit of a heading; None where it is no time, pressure, flow, volume or area with a unit."""
    flat = re.sub("[^a-z0-9]+", "_", heading.strip().lower()).strip("_")
    flat = re.sub("^time(?=_|$)", "t", flat)
    kind = kind_of(flat.partition("_")[0])
    if is_statistic(heading) or not re.match(f"(t|[pqv]_[a-z0-9]+|{AREA})(_|$)", flat):
        return None
    for short in sorted(FLAT[kind], key=len, reverse=True):
        name = flat.removesuffix(f"_{short}")
        if name != flat and (name in ("t", AREA) if kind in "ta" else len(name) > 2 and name[1] == "_"):
            return name, FLAT[kind][short]
    return None


def read_waveforms(
    path: str | Path, *, columns: Mapping[str, str] | None = None, gaps: bool = False, decimal: str = "."
) -> Waveforms:
    """Read a record: a heading line, then one line a sample; lines that begin with # are skipped.

    Args:
        path: A CSV file, its cells parted by commas, semicolons or tabs.
        columns: ``quantity: heading`` or ``quantity: heading:unit`` for columns whose headings do not say it.
        gaps: Accept gaps in time; the record is linear across them.
        decimal: The decimal mark, a point or a comma.

    Returns:
        The record in CGS.

    Raises:
        CaseError: The file, a heading or a cell cannot be used; says which, in file, row and column.
    """
    table = read_table(Path(path), decimal)
    read = _assign(table, dict(columns or {}))
    missing = [] if "t" in read else ["no column of times, such as t_s"]
    if not read.keys() - {"t"}:
        missing.append("no pressure or flow with a unit in its heading, such as p_ao_mmHg")
    if missing:
        message = f"{'; '.join(missing)}; columns: {', '.join(table.header)}"
        raise CaseError(message, file=table.path)
    if len(table.rows) < FEWEST:
        raise CaseError(f"{len(table.rows)} samples, expected {FEWEST} or more", file=table.path)
    arrays = {name: _numbers(table, name, *place) for name, place in read.items()}
    t = arrays.pop("t")
    _check_times(t, table, read["t"][0], gaps)
    return Waveforms(
        t=t,
        values=arrays,
        units={name: unit for name, (_, unit) in read.items()},
        headings={name: heading for name, (heading, _) in read.items()},
        rows=table.lines,
        file=table.path,
        notes=table.unused(heading for heading, _ in read.values()),
    )


def write_waveforms(waves: Waveforms, path: Path, header: Iterable[str] = ()) -> Path:
    """Write a record that `read_waveforms` reads, in the units of the file it came from (CGS where it has none)."""
    fallback = {"p": "mmHg", "q": "ml_s", "v": "ml", "a": "cm2"}
    units = {q: waves.units.get(q, fallback[kind_of(q)]) for q in waves.values}
    names = ["t_s", *(f"{q}_{units[q]}" for q in waves.values)]
    table = [waves.t, *(array / UNITS[kind_of(q)][units[q]] for q, array in waves.values.items())]
    lines = [*(f"# {line}" for line in header), ",".join(names)]
    lines += [",".join(f"{value:.10g}" for value in row) for row in zip(*table, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, "\n".join(lines) + "\n")
    return path


def _numbers(table: Table, name: str, heading: str, unit: str) -> Array:
    """Return a column in CGS; refuse what no flow loop has."""
    scale = UNITS[kind_of(name)][unit]
    values = table.numbers(heading) * scale
    beyond = np.flatnonzero(np.abs(values) > PLAUSIBLE[kind_of(name)])
    if len(beyond):
        most = f"{PLAUSIBLE[kind_of(name)] / scale:.3g} {unit}"
        message = f"no flow loop has this {KINDS[kind_of(name)]}, at most {most} is plausible"
        raise table.fault(message, heading, table.lines[beyond[0]], float(values[beyond[0]] / scale))
    return values


def _assign(table: Table, columns: dict[str, str]) -> dict[str, tuple[str, str]]:
    """Return heading and unit of each quantity."""
    read: dict[str, tuple[str, str]] = {}
    _check_pointed(table, columns.values())
    pointed = {name: _pointed(table, name, text) for name, text in columns.items()}
    headings = {heading for heading, _ in pointed.values()}
    for heading in table.header:
        if heading in headings:
            continue
        parsed = parse_heading(heading)
        if parsed is None:
            _complain_about_unit(table, heading)
            continue
        name, unit = parsed
        if name in read or name in pointed:
            other = (read.get(name) or pointed[name])[0]
            raise table.fault(f"is there twice, as {other} and {heading}", name)
        read[name] = (heading, unit)
    return {**read, **pointed}


def _parted(table: Table, text: str) -> tuple[str, str]:
    """Return heading and unit of ``heading:unit``."""
    heading, _, unit = (text, "", "") if text in table.header or ":" not in text else text.rpartition(":")
    return heading, unit


def _check_pointed(table: Table, texts: Iterable[str]) -> None:
    """Refuse headings that are not there, all at once, each with the nearest that is."""
    missing = [
        heading for heading, _ in (_parted(table, text) for text in texts) if heading not in table.header
    ]
    if missing:
        near = [difflib.get_close_matches(heading, table.header, n=1) for heading in missing]
        hint = f", did you mean {' and '.join(found[0] for found in near if found)}?" if any(near) else ""
        raise CaseError(f"no such column{hint}", file=table.path, key=f"column {', '.join(missing)}")


def _pointed(table: Table, name: str, text: str) -> tuple[str, str]:
    """Return heading and unit of a quantity that the user pointed out."""
    if not re.fullmatch(f"t|[pqv]_[a-z0-9]+|{AREA}", name):
        raise CaseError("expected a quantity such as t, p_ao or q_lv", key="columns", value=name)
    heading, unit = _parted(table, text)
    if not unit:
        parsed = parse_heading(heading)
        if parsed is None or kind_of(parsed[0]) != kind_of(name):
            message = f"its heading has no unit of {KINDS[kind_of(name)]}: give {name}={heading}:UNIT"
            raise CaseError(message, file=table.path, key=f"column {heading}")
        return heading, parsed[1]
    flat = re.sub("[^a-z0-9]+", "_", unit.lower())
    if flat not in FLAT[kind_of(name)]:
        raise CaseError(_unknown(unit, kind_of(name)), file=table.path, key=f"column {heading}")
    return heading, FLAT[kind_of(name)][flat]


def _complain_about_unit(table: Table, heading: str) -> None:
    """Refuse a heading that is plainly a pressure or a flow, but has no unit that is known."""
    match = re.match(r"\s*([tpq])(?:ime)?(?:_([a-z0-9]+))?(?:[_ \[(]+([^\])]*))?[\])]?\s*$", heading, re.I)
    if match is None or is_statistic(heading) or (match[1].lower() != "t" and match[2] is None):
        return
    unit = match[3] if match[1].lower() != "t" else (match[3] or match[2])
    raise table.fault(_unknown(unit or "", match[1].lower()), heading)


def _unknown(unit: str, kind: str) -> str:
    start = f"unknown unit {unit!r}" if unit else "no unit in the heading"
    return f"{start}, expected one of {KINDS[kind]}: {', '.join(UNITS[kind])}"


def _check_times(t: Array, table: Table, heading: str, gaps: bool) -> None:
    """Refuse times that do not increase, and gaps."""
    step = np.diff(t)
    if not step.min() > 0:
        at = int(np.argmax(step <= 0)) + 1
        message = f"time does not increase: {t[at]:.7g} s after {t[at - 1]:.7g} s"
        raise table.fault(message, heading, table.lines[at])
    usual = float(np.median(step))
    if not gaps and step.max() > GAP * usual:
        at = int(np.argmax(step))
        message = (
            f"gap of {step[at]:.4g} s after {t[at]:.7g} s (median interval {usual:.4g} s); "
            "accept it with --gaps, the record is then linear across it"
        )
        raise table.fault(message, heading, table.lines[at + 1])
