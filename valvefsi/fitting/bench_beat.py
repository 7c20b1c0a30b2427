"""The mean beat of a record of a pulse duplicator, with the standard deviations that the record has."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.record_table import Table, read_table
from valvefsi.fitting.waveform_repair import find_period
from valvefsi.fitting.waveforms import UNITS, Waveforms, kind_of, parse_heading, read_waveforms
from valvefsi.post.valve_beat import QUANTITIES, Beat, mean_beat
from valvefsi.post.valve_record import LARGEST_GAP
from valvefsi.types import Array

DEVIATION = re.compile(r"(^|[^a-z0-9])(?:sd|std|stdev|stddev)(?=[^a-z0-9]|$)", re.I)
NOTE = re.compile(r"\bperiod(?:\s+of|\s+is|\s*[:=])?\s*(\d+\.?\d*)\s*(?:/\s*(\d+\.?\d*))?\s*(ms|s)\b", re.I)
SEVERAL = 1.9
"""Cycles from which on they are looked for in the record itself."""


def read_bench_beat(path: Path, *, period: float | None = None, decimal: str = ".") -> Beat:
    """Return the mean beat of a record.

    Columns are times, any of ``p_lv``, ``p_ao``, ``q_ao`` and ``pdva``, with units in their headings, and standard
    deviations such as ``sd_p_lv``, in the unit of their quantity where they have none. The cycle begins with the
    record. A record of three cycles or more without standard deviations has those over its cycles.

    Args:
        path: A CSV file.
        period: Length of a cycle [s]; unless given, what a remark of the file says (``# period: 0.857 s``), or what
            repeats in the record, or else its length.
        decimal: The decimal mark, a point or a comma.

    Raises:
        CaseError: It cannot be read, has none of the columns, or is shorter than a cycle.
    """
    waves = read_waveforms(path, decimal=decimal)
    names = [name for name in QUANTITIES if name in waves.values]
    if not names:
        message = "missing columns: expected any of p_lv_mmHg, p_ao_mmHg, q_ao_ml_s and pdva_cm2"
        raise CaseError(message, file=path)
    length, where = _period(Path(path), waves, names, period)
    if not 0.0 < length < np.inf:
        raise CaseError(f"expected a positive time ({where})", file=path, key="period", value=length)
    t, means, cycles = mean_beat(waves.t, {name: waves[name] for name in names}, length)
    gap = float(np.diff(np.append(t, length)).max()) if cycles else length
    if cycles == 0 or gap > LARGEST_GAP * length:
        message = (
            f"no whole cycle of {length:.6g} s ({where}), or too few samples: it lasts {waves.span:.6g} s"
        )
        raise CaseError(message, file=path)
    own = _deviations(read_table(Path(path), decimal), waves, names) if cycles == 1 else {}
    return Beat(
        name=Path(path).stem,
        t=t,
        period=length,
        values=means["values"],
        deviations={name: y[: len(t)] for name, y in own.items()} or means["deviations"],
        measured=True,
        start=float(waves.t[0]),
        cycles=cycles,
        notes=(f"period of {length:.6g} s {where}",),
    )


def _period(path: Path, waves: Waveforms, names: list[str], period: float | None) -> tuple[float, str]:
    """Return the length of a cycle [s], and where it is from."""
    if period is not None:
        return period, "as given"
    remarks = (
        line for line in path.read_text(encoding="utf-8-sig").splitlines() if line.lstrip().startswith("#")
    )
    if match := next(filter(None, map(NOTE.search, remarks)), None):
        value = float(match[1]) / (float(match[2] or 1.0) or np.inf)
        return value * UNITS["t"][match[3].lower()], "from the record's remark"
    repeated = find_period(waves.t, waves[names[0]])
    if repeated is not None and waves.span >= SEVERAL * repeated:
        return repeated, f"found in its {names[0]}"
    return waves.span + float(np.median(np.diff(waves.t))), "the length of the record"


def _deviations(table: Table, waves: Waveforms, names: list[str]) -> dict[str, Array]:
    """Return the standard deviations that a table has, by quantity, CGS."""
    notes = {}
    for heading in table.header:
        rest, count = DEVIATION.subn(r"\1", heading)
        if not count:
            continue
        flat = re.sub("[^a-z0-9]+", "_", rest.lower()).strip("_")
        name, unit = parse_heading(flat) or (flat, None)
        if name in names:
            scale = UNITS[kind_of(name)][unit] if unit else waves.unit_scale(name)
            notes[name] = np.abs(table.numbers(heading)) * scale
    return notes
