"""Sweeps: a case run for values of some of its keys, all combinations of them; a row of numbers for each."""

from __future__ import annotations

import csv
import io
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zlib import crc32

from valvefsi import __version__
from valvefsi.case.overrides import split_override
from valvefsi.case.quantities import NUMBER, Quantity
from valvefsi.errors import CaseError
from valvefsi.io.folder import write_text
from valvefsi.studies.members import Member, Outcome, Values
from valvefsi.types import Unchecked

LONGEST = 40
"""Characters of a value in the name of a folder."""
OPEN, CLOSE, QUOTES = "[{(", "]})", "\"'"


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A key that a sweep varies.

    Attributes:
        key: The key, as ``--set`` names it.
        values: Its values, as ``--set`` takes them.
        short: The end of the key that tells it from the others.
        unit: Unit of the numbers, "" for pure numbers and for what is no number.
        numbers: The values as numbers in that unit, empty where they are none.
    """

    key: str
    values: tuple[str, ...]
    short: str
    unit: str = ""
    numbers: tuple[float, ...] = ()

    @property
    def column(self) -> str:
        """Name of its column, with the unit."""
        unit = self.unit.replace("**", "").replace("^", "").replace("/", "_per_").replace("*", "_")
        return f"{self.short}_{re.sub(r'[ ()]', '', unit)}" if unit else self.short

    @property
    def label(self) -> str:
        """What stands at an axis."""
        return f"{self.short.replace('_', ' ')} [{self.unit}]" if self.unit else self.short.replace("_", " ")

    def shown(self, k: int) -> float | str:
        """Return a value for a table, the number where it is one."""
        return self.numbers[k] if self.numbers else self.values[k]


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """The members of a sweep, and which values each has.

    Attributes:
        parameters: What is varied.
        points: Number of the value of each parameter, one tuple for each member.
        members: The members.
    """

    parameters: tuple[Parameter, ...]
    points: tuple[tuple[int, ...], ...]
    members: tuple[Member, ...]

    def values(self, number: int) -> Values:
        """Return the values of a member by column."""
        return {
            parameter.column: parameter.shown(k)
            for parameter, k in zip(self.parameters, self.points[number], strict=True)
        }


def make_sweep(over: Sequence[str], overrides: Sequence[str] = ()) -> Sweep:
    """Return the sweep over all combinations of values.

    Args:
        over: Texts ``key=value,value,...``; commas inside of brackets and quotes do not part values.
        overrides: Texts ``key=value`` that all members take.

    Raises:
        CaseError: A text is none of these, a key stands twice, or a value does.
    """
    read = [_split(text) for text in over]
    keys = [key for key, _ in read]
    for number, key in enumerate(keys):
        if key in keys[:number]:
            raise CaseError("this key stands twice; give all of its values at once", file="--over", key=key)
        if key in [split_override(text)[0] for text in overrides]:
            raise CaseError("this key is in --set, too", file="--over", key=key)
    parameters = [_parameter(key, values, _short(key, keys)) for key, values in read]
    points = list(itertools.product(*(range(len(parameter.values)) for parameter in parameters)))
    raw = [[p.values[k] for p, k in zip(parameters, point, strict=True)] for point in points]
    names = [
        ",".join(_word(p.short, value) for p, value in zip(parameters, values, strict=True)) for values in raw
    ]
    members = [
        Member(
            name if names.count(name) == 1 else f"{name}-{crc32(repr(values).encode()):08x}",
            (*overrides, *(f"{p.key}={value}" for p, value in zip(parameters, values, strict=True))),
        )
        for name, values in zip(names, raw, strict=True)
    ]
    return Sweep(parameters=tuple(parameters), points=tuple(points), members=tuple(members))


def _split(text: str) -> tuple[str, tuple[str, ...]]:
    """Return the key and the values of ``key=value,value``."""
    key, sign, rest = (part.strip() for part in text.partition("="))
    values = tuple(value.strip() for value in _parts(rest))
    if not sign or not all(part.strip() for part in key.split(".")) or not all(values):
        message = "expected key=value,value,..., such as solid.leaflets.mesh.valve.diameter=21mm,25mm"
        raise CaseError(message, file="--over", key=text)
    alike = ["".join(value.split()).strip(QUOTES) for value in values]
    twice = next((value for k, value in enumerate(values) if alike[k] in alike[:k]), None)
    if twice is not None:
        raise CaseError("this value stands twice", file="--over", key=key, value=twice)
    return key, values


def _parts(text: str) -> list[str]:
    """Split a text at its commas, but for those in brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in QUOTES:
            quote = letter
        else:
            depth += (letter in OPEN) - (letter in CLOSE)
            if letter == "," and depth == 0:
                parts.append("")
                continue
        parts[-1] += letter
    return parts


def _short(key: str, keys: Sequence[str]) -> str:
    """Return the shortest end of a key that no other ends with and that begins with a name."""
    parts = key.split(".")
    for length in range(1, len(parts)):
        end = parts[-length:]
        if not end[0].isdigit() and all(other == key or other.split(".")[-length:] != end for other in keys):
            return ".".join(end)
    return key


def _word(short: str, value: str) -> str:
    """Return what names a value in the name of a folder."""
    plain = re.sub(r"[^\w.+%^-]", "_", "".join(value.split()).strip(QUOTES).replace("/", "_per_"))
    if len(plain) > LONGEST:
        plain = f"{plain[:LONGEST]}-{crc32(value.encode()):08x}"
    return f"{short}={plain}"


def _parameter(key: str, values: tuple[str, ...], short: str) -> Parameter:
    """Return a key with its values as numbers of one unit, where they are."""
    read = [split_override(f"{key}={value}")[1] for value in values]
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in read):
        return Parameter(key=key, values=values, short=short, numbers=tuple(map(float, map(str, read))))
    match = NUMBER.fullmatch(read[0]) if isinstance(read[0], str) else None
    if match is None or not match[2] or not all(isinstance(value, str) for value in read):
        return Parameter(key=key, values=values, short=short)
    try:
        numbers = tuple(Quantity(match[2]).parse(value) for value in read)
    except ValueError:
        return Parameter(key=key, values=values, short=short)
    return Parameter(key=key, values=values, short=short, unit=match[2], numbers=numbers)


def scalars(summary: Unchecked, path: str = "") -> Values:
    """Return the single values of a summary by their paths; items of lists by number."""
    if isinstance(summary, dict):
        items = list(summary.items())
    elif isinstance(summary, list):
        items = [(str(k), item) for k, item in enumerate(summary) if isinstance(item, dict)]
    else:
        return {path: summary}
    found: Values = {}
    for key, item in items:
        found |= scalars(item, f"{path}.{key}".lstrip("."))
    return found


def sweep_rows(sweep: Sweep, outcomes: Sequence[Outcome]) -> list[Values]:
    """Return the table of a sweep: a row for each member, all of the same columns.

    Columns are the member, how it ended, its values, and of the summaries every number, and what else differs
    between members. None stands for what a member does not have.
    """
    found = [scalars(outcome.summary) for outcome in outcomes]
    names = list(dict.fromkeys(name for values in found for name in values))
    kept = [name for name in names if _tells([values.get(name) for values in found])]
    return [
        {"member": outcome.member.name, "state": outcome.state}
        | sweep.values(number)
        | {name: values.get(name) for name in kept}
        for number, (outcome, values) in enumerate(zip(outcomes, found, strict=True))
    ]


def _tells(values: Sequence[object]) -> bool:
    """Whether values are numbers, or differ."""
    number = any(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    return number or any(value != values[0] for value in values)


def write_tables(case: Path, sweep: Sweep, outcomes: Sequence[Outcome], folder: Path) -> None:
    """Write ``sweep.csv`` and ``sweep.json``.

    Args:
        case: The case file.
        sweep: The sweep.
        outcomes: How its members ended.
        folder: Where to.
    """
    rows, text = sweep_rows(sweep, outcomes), io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_text(folder / "sweep.csv", text.getvalue())
    members = [
        {
            "member": outcome.member.name,
            "overrides": list(outcome.member.overrides),
            "state": outcome.state,
            "message": outcome.message,
            "log": str(outcome.log),
            "wall_s": outcome.wall_s,
            "row": row,
        }
        for outcome, row in zip(outcomes, rows, strict=True)
    ]
    over = {p.key: {"values": list(p.values), "column": p.column} for p in sweep.parameters}
    result = {"case": str(case), "version": __version__, "over": over, "members": members}
    write_text(folder / "sweep.json", json.dumps(result, indent=2) + "\n")
