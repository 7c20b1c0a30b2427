"""The list of times of a ParaView series, ``NAME.pvd``: what of it is whole is read, wherever it was cut."""

from __future__ import annotations

import math
import re
from pathlib import Path, PurePosixPath

from valvefsi.errors import CaseError

ITEM = re.compile(r"<DataSet\s([^<>]*)/>")
ATTRIBUTE = re.compile(r'(\w+)\s*=\s*"([^"<>]*)"')


def read_times(series: Path) -> list[tuple[float, str]]:
    """Return time and file of each whole entry of a series, files relative to its folder.

    Args:
        series: The list, ``NAME.pvd``.

    Raises:
        CaseError: It cannot be read.
    """
    try:
        text = Path(series).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise CaseError(f"cannot read this series: {error.strerror}", file=series) from None
    entries = []
    for item in ITEM.finditer(text):
        named = dict(ATTRIBUTE.findall(item[1]))
        try:
            t, file = float(named["timestep"]), PurePosixPath(named["file"])
        except (KeyError, ValueError):
            continue
        if math.isfinite(t) and not file.is_absolute() and ".." not in file.parts:
            entries.append((t, str(file)))
    return entries
