"""Reading the files of studies: TOML tables whose paths are relative to the file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from valvefsi.case.includes import read_toml
from valvefsi.case.overrides import apply_overrides
from valvefsi.case.reading import nearest_file, one_line
from valvefsi.case.table import Table
from valvefsi.errors import CaseError

T = TypeVar("T", bound=Table)


def read_study(path: Path, overrides: Sequence[str], kind: type[T], files: Sequence[tuple[str, str]]) -> T:
    """Read a study; the paths of its files become absolute.

    Args:
        path: The TOML file.
        overrides: Texts ``a.b=value`` that replace or add values.
        kind: Its tables.
        files: Table, "" for the root, and key of each path; every table of a list of that name has one.

    Raises:
        CaseError: One line with file, key, value and the nearest valid choice.
    """
    if not path.exists():
        raise CaseError(f"no such study{nearest_file(path, '.toml', 0.5)}", file=path)
    raw = read_toml(path)
    changed = apply_overrides(raw, overrides)
    for place, key in files:
        found = raw if not place else raw.get(place)
        several = found if isinstance(found, list) else [found]
        for number, table in enumerate(several):
            if isinstance(table, dict) and isinstance(table.get(key), str):
                item = str(table.get("name", number)) if isinstance(found, list) else ""
                where = ".".join(part for part in (place, item, key) if part)
                _make_absolute(table, key, path, where, "--set" if where in changed else path)
    try:
        return kind.model_validate(raw)
    except ValidationError as error:
        raise one_line(error, raw, path, changed) from None


def _make_absolute(table: dict[str, Any], key: str, path: Path, where: str, said_in: Path | str) -> None:
    found = path.parent / table[key]
    if not found.is_file():
        message = f"no such file{nearest_file(found, found.suffix)}"
        raise CaseError(message, file=said_in, key=where, value=table[key])
    table[key] = str(found.resolve())
