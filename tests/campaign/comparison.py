"""Every file of two runs side by side, and whether a file is whole."""

from __future__ import annotations

import json
import tomllib
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from PIL import Image, ImageSequence

from valvefsi.io.grid_files import read_grid
from valvefsi.io.history import read_history
from valvefsi.io.series import read_times

OF_THE_CLOCK = {
    *("wall_s", "cell_steps_per_s", "phases", "seconds", "date", "peak_memory_gib", "step_ms"),
    *("steps_per_s", "environment", "steps", "calls"),
}
"""Entries of JSON files that tell how long it took, where, and how many steps were taken since a restart."""
GROWING = ("history.csv", "leaflets.csv")
"""Files that grow by a row; the last row of a process that was killed may be cut."""
NOTHING, OTHER = 0.0, float("inf")


def differences(ours: Path, theirs: Path, *, checkpoints: bool = True) -> dict[str, float]:
    """Return what differs between two folders: largest difference by file, infinite where it cannot be said.

    Args:
        ours: Folder of a run that was killed and resumed.
        theirs: That of the uninterrupted run.
        checkpoints: Whether both must have checkpoints of the same steps; if not, the last is compared.
    """
    mine, other = _files(ours), _files(theirs)
    if not checkpoints:
        last = max((name for name in other if name.endswith(".vfc")), default="")
        mine = {name for name in mine if not name.endswith(".vfc") or name == last}
        other = {name for name in other if not name.endswith(".vfc") or name == last}
    found = dict.fromkeys(mine ^ other, OTHER)
    for name in sorted(mine & other):
        gap = difference_of(ours / name, theirs / name)
        if gap > 0.0:
            found[name] = gap
    return found


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def difference_of(ours: Path, theirs: Path) -> float:
    """Return the largest difference of two files of one kind, as a part of the largest value in each array."""
    if ours.read_bytes() == theirs.read_bytes():
        return NOTHING
    try:
        a, b = contents(ours), contents(theirs)
    except Exception:  # a torn file may fail anywhere
        return OTHER
    return gap_of(a, b)


def gap_of(a: Any, b: Any) -> float:
    """Return the largest difference of two values, as JSON or arrays hold them."""
    if isinstance(a, dict) and isinstance(b, dict):
        if a.keys() != b.keys():
            return OTHER
        return max((gap_of(a[key], b[key]) for key in a if key not in OF_THE_CLOCK), default=NOTHING)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        if len(a) != len(b):
            return OTHER
        return max(map(gap_of, a, b), default=NOTHING)
    if isinstance(a, np.ndarray) or (_is_number(a) and _is_number(b)):
        x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        if x.shape != y.shape or (np.isfinite(x) != np.isfinite(y)).any():
            return OTHER
        x, y = x[np.isfinite(x)], y[np.isfinite(y)]
        return float(np.abs(x - y).max(initial=0.0) / max(np.abs(y).max(initial=0.0), 1e-12))
    return NOTHING if a == b else OTHER


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def contents(path: Path) -> Any:
    """Return what a file holds; raises where it is not whole."""
    match path.suffix:
        case ".csv":
            return _columns(path)
        case ".json":
            return json.loads(path.read_text(encoding="utf-8"))
        case ".toml":
            tomllib.loads(path.read_text(encoding="utf-8"))
            return path.read_text(encoding="utf-8")
        case ".pvd":
            ET.parse(path)
            return read_times(path)
        case ".pvti" | ".pvtr":
            grid = read_grid(path, 0.0)
            return [*grid.edges, grid.fields]
        case ".vti" | ".vtr":
            return _piece(path)
        case ".vtu":
            mesh = meshio.vtu.read(path)  # of a torn file meshio.read would end the process
            cells = [(block.type, block.data) for block in mesh.cells]
            return [mesh.points, cells, dict(mesh.point_data), dict(mesh.cell_data)]
        case ".vfc":
            return _checkpoint(path)
        case ".png" | ".gif":
            with Image.open(path) as image:
                return [np.asarray(frame.convert("RGB")) for frame in ImageSequence.Iterator(image)]
    return path.read_bytes()


def _columns(path: Path) -> Any:
    try:
        return {name: np.array(values) for name, values in read_history(path).items()}
    except ValueError:
        return path.read_text(encoding="utf-8")


def _piece(path: Path) -> bytes:
    """Return a piece of a grid as it is: in single precision what is not the same differs by more than round-off."""
    data = path.read_bytes()
    if not data.rstrip().endswith(b"</VTKFile>"):
        raise ValueError("cut off")
    return data


def _checkpoint(path: Path) -> list[Any]:
    """Return what is noted in a checkpoint, and its arrays, by the layout that its module documents."""
    data = path.read_bytes()
    length, checksum = np.frombuffer(data[8:24], dtype="<u8").tolist()
    header = data[24 : 24 + length]
    if zlib.crc32(header) != checksum:
        raise ValueError("damaged header")
    table = json.loads(header)
    arrays = {}
    for name, entry in table["arrays"].items():
        begin, size = 24 + length + entry["offset"], int(np.prod(entry["shape"]))
        arrays[name] = np.frombuffer(data, dtype=entry["dtype"], count=size, offset=begin)
    return [table["step"], table["meta"], arrays]


def torn(folder: Path) -> Iterator[str]:
    """Name the files of a folder that stand under their own name and are not whole."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.name.startswith(".") and path.name not in GROWING:
            try:
                contents(path)
            except Exception:  # a torn file may fail anywhere
                yield path.relative_to(folder).as_posix()
