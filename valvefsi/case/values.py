"""The values of a case by their paths, as ``--set`` names them, and what differs between two cases."""

from __future__ import annotations

import re
import zlib
from collections.abc import Mapping
from pathlib import Path

from valvefsi.case.models import Case
from valvefsi.case.writing import to_dict
from valvefsi.types import Unchecked

FILES = ("file", "table")


def values_by_path(case: Case) -> dict[str, object]:
    """Return every value by its path, CGS, items of lists by name where they have one, files by what they hold."""
    return _flat(to_dict(case), "")


def written_values(tables: Mapping[str, object]) -> dict[str, object]:
    """Return every value of a case's tables as it was written, by the same paths."""
    return _flat(tables, "")


def case_differences(a: Case, b: Case) -> dict[str, tuple[object, object]]:
    """Return the values of two cases where they differ, by their paths; None where a case has no such key."""
    first, second = values_by_path(a), values_by_path(b)
    return {
        key: (first.get(key), second.get(key))
        for key in {**first, **second}
        if first.get(key) != second.get(key)
    }


def _flat(value: object, path: str) -> dict[str, object]:
    """Return values by their paths, items of lists by name where they have one."""
    if isinstance(value, Mapping):
        items = list(value.items())
    elif isinstance(value, list):
        named = [item.get("name") if isinstance(item, dict) else None for item in value]
        items = [(name or str(k), item) for k, (name, item) in enumerate(zip(named, value, strict=True))]
    else:
        return {path: _held_by(path, value)}
    flat: dict[str, object] = {}
    for key, item in items:
        flat |= _flat(item, f"{path}.{key}".lstrip("."))
    return flat


def _held_by(path: str, value: Unchecked) -> object:
    """Return a value, what a file holds instead of its name."""
    own = re.fullmatch(r"(.*\.py):(\w+)", value) if isinstance(value, str) else None
    file = own[1] if own else value if path.rpartition(".")[2] in FILES else None
    if not isinstance(file, str) or not Path(file).is_file():
        return value
    return f"contents {zlib.crc32(Path(file).read_bytes()):08x}" + (f":{own[2]}" if own else "")
