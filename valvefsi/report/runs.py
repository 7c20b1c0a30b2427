"""What the folder of a run holds; what is missing or cannot be read is said."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case import Case, load_case
from valvefsi.case.origins import read_provenance
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history
from valvefsi.types import Array


@dataclass(frozen=True, kw_only=True)
class Run:
    """The folder of a run.

    Attributes:
        folder: The folder.
        case: Its case, None where that cannot be read.
        why: Why the case cannot be read.
        history: Columns of its history by name, ``(n,)`` each; empty without one.
        summary: Its ``summary.json``, empty without one.
        provenance: Its ``provenance.json``, empty without one.
        remarks: What was said on the way of reading.
    """

    folder: Path
    case: Case | None
    why: str
    history: Mapping[str, Array]
    summary: Mapping[str, Any]
    provenance: Mapping[str, Any]
    remarks: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.resolve().name

    @property
    def title(self) -> str:
        """Title of its case, the name of the folder where that has none."""
        return (self.case.title if self.case is not None else "") or self.name

    @property
    def t_end(self) -> float | None:
        """Last time of the history [s], None without one."""
        t = self.history.get("t_s", np.zeros(0))
        return float(t[-1]) if len(t) else None


def open_run(folder: Path, *, trust: bool = False) -> Run:
    """Read the folder of a run.

    Args:
        folder: The folder.
        trust: Whether Python files of materials may be run.
    """
    folder, case, why = Path(folder), None, ""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            case = load_case(folder / "case.toml", trust=trust)
        except CaseError as error:
            why = str(error)
        history: dict[str, Array] = {}
        if (folder / "history.csv").is_file():
            history = {
                name: np.array(column) for name, column in read_history(folder / "history.csv").items()
            }
    return Run(
        folder=folder,
        case=case,
        why=why,
        history=history,
        summary=read_table(folder / "summary.json"),
        provenance=read_provenance(folder),
        remarks=(*(str(item.message) for item in said), *_no_numbers(history)),
    )


def _no_numbers(history: Mapping[str, Array]) -> list[str]:
    """Say which columns of a history hold what is no number, in how many rows and from when on."""
    found = []
    for name, column in history.items():
        bad = np.flatnonzero(~np.isfinite(column))
        if len(bad):
            when = f", the first at t = {history['t_s'][bad[0]]:.6g} s" if name != "t_s" else ""
            found.append(f"NO NUMBER in {len(bad)} of {len(column)} rows of {name}{when}")
    return found


def is_table(path: Path) -> bool:
    """Whether a file can be read as a table of JSON."""
    try:
        return isinstance(json.loads(path.read_text(encoding="utf-8")), dict)
    except (OSError, ValueError):
        return False


def read_table(path: Path) -> dict[str, Any]:
    """Return what a JSON file holds, empty where there is none or it is damaged."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
