"""The list of times of a ParaView series, ``NAME.pvd``: what of it is whole is read, wherever it was cut."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from valvefsi.errors import CaseError

ITEM = re.compile(r"<DataSet\s([^<>]*)/>")
ATTRIBUTE = re.compile(r'(\w+)\s*=\s*"([^"<>]*)"')

Frames = Sequence[float | None]
"""Times of the frames of a run by number [s], None where a time is not known."""


def frame_number(file: str, series: str) -> int | None:
    """Return the number of the frame that a file of a series is of, None for other files."""
    name = re.match(rf"{re.escape(series)}_(\d{{6,9}})[._]", file)
    return int(name[1]) if name else None


def frames_on_disk(folder: Path, t: float) -> list[float | None]:
    """Return the times of the frames up to a time, from all series in a folder, for a checkpoint that has none.

    Args:
        folder: The folder of the series.
        t: The time [s].

    Returns:
        Times by number [s]; None where no list knows it, or lists do not agree on it. A frame whose time is not known
        counts as of an earlier time unless one before it is of a later time.
    """
    times: dict[int, set[float]] = {}
    there: set[int] = set()
    for path in sorted(Path(folder).glob("*")):
        if path.suffix == ".pvd" and path.is_file():
            for when, file in read_times(path):
                number = frame_number(PurePosixPath(file).name, path.stem)
                if number is not None:
                    times.setdefault(number, set()).add(when)
        elif path.is_dir():
            numbers = (frame_number(file.name, path.name) for file in path.iterdir())
            there.update(number for number in numbers if number is not None)
    later = min((number for number, found in times.items() if min(found) > t), default=math.inf)
    count = 1 + max((number for number in there if number < later), default=-1)
    found = [times.get(number, set()) for number in range(count)]
    return [min(entry) if len(entry) == 1 and max(entry) <= t else None for entry in found]


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
