"""Reading the fluid series of a run: the files that `valvefsi.io.paraview` writes, put together from their pieces."""

from __future__ import annotations

import xml.etree.ElementTree as ET
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.io.series import read_times
from valvefsi.types import Array

TYPES = {"Float32": np.float32, "Float64": np.float64}
END = b"</VTKFile>"


@dataclass(frozen=True, kw_only=True)
class GridFields:
    """Fields in the cells of a grid.

    Attributes:
        t: Time [s].
        edges: Edges of the cells along each axis, three of ``(cells + 1,)``; one cell along z in two dimensions [cm].
        fields: Arrays by name, ``(nx, ny, nz)`` or ``(nx, ny, nz, components)``.
    """

    t: float
    edges: tuple[Array, Array, Array]
    fields: dict[str, Array]

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return 2 if len(self.edges[2]) == 2 else 3

    @property
    def centres(self) -> list[Array]:
        """Centres of the cells along each axis [cm]."""
        return [0.5 * (e[1:] + e[:-1]) for e in self.edges]


def times_of(series: Path) -> list[tuple[float, Path]]:
    """Return times and files of a series whose files are complete, in order; a run may still be writing it.

    Args:
        series: The list of times, ``NAME.pvd``.

    Raises:
        CaseError: The list is missing, cannot be read, or names no file that is complete.
    """
    series = Path(series)
    if not series.is_file():
        raise CaseError("no such series; was the run made with output.frames?", file=series)
    found = [entry for entry in list_times(series) if is_complete(entry[1])]
    if not found:
        raise CaseError("the series has no complete files yet", file=series)
    return found


def list_times(series: Path) -> list[tuple[float, Path]]:
    """Return times and files of a series in order, complete or not.

    Raises:
        CaseError: It cannot be read.
    """
    series = Path(series)
    return sorted((t, series.parent / name) for t, name in read_times(series))


def is_complete(path: Path) -> bool:
    """Return whether a file and all the pieces it names are there to their ends."""
    try:
        sources = [piece.get("Source", "") for piece in ET.parse(path).getroot().iter("Piece")]
        whole = not all(sources)  # a solid's file has all of it
        pieces = [path] if whole else [path.parent / name for name in sources]
        for piece in pieces:
            with piece.open("rb") as file:
                file.seek(-min(len(END) + 8, piece.stat().st_size), 2)
                if not file.read().rstrip().endswith(END):
                    return False
    except Exception:  # a damaged file fails anywhere
        return False
    return bool(pieces)


def nearest_time(series: Path, t: float | None) -> tuple[float, Path]:
    """Return time and file nearest to a time, the last if None."""
    found = times_of(series)
    return found[-1] if t is None else min(found, key=lambda entry: abs(entry[0] - t))


def read_grid(path: Path, t: float = 0.0) -> GridFields:
    """Read one time of a series.

    Args:
        path: A ``.pvti`` or ``.pvtr`` file.
        t: Its time [s].

    Raises:
        CaseError: The file or one of its pieces is missing, incomplete or of another kind.
    """
    path = Path(path)
    try:
        root = ET.parse(path).getroot()
        whole = next(child for child in root if child.tag in ("PImageData", "PRectilinearGrid"))
        extent = _extent(whole)
        cells = tuple(extent[2 * a + 1] - extent[2 * a] for a in range(3))
        edges = [np.zeros(n + 1) for n in cells]
        fields: dict[str, Array] = {}
        for piece in whole.iter("Piece"):
            _add_piece(path.parent / piece.attrib["Source"], cells, edges, fields)
        if whole.tag == "PImageData":
            origin, spacing = (
                np.array(whole.attrib[key].split(), dtype=float) for key in ("Origin", "Spacing")
            )
            edges = [o + h * np.arange(n + 1) for o, h, n in zip(origin, spacing, cells, strict=True)]
    except Exception as error:  # a damaged file fails anywhere
        raise CaseError(f"this file of a fluid series cannot be read: {error}", file=path) from None
    return GridFields(t=t, edges=(edges[0], edges[1], edges[2]), fields=fields)


def _extent(element: ET.Element) -> list[int]:
    return [int(v) for v in (element.get("WholeExtent") or element.attrib["Extent"]).split()]


def _add_piece(path: Path, cells: tuple[int, ...], edges: list[Array], fields: dict[str, Array]) -> None:
    """Put the data of one piece into the whole arrays."""
    raw = path.read_bytes()
    start = raw.index(b"<AppendedData")  # an underscore marks where the data in it begin
    mark = raw.index(b"_", raw.index(b">", start)) + 1
    root = ET.fromstring(raw[: mark - 1] + raw[raw.rindex(b"</AppendedData") :])
    data = memoryview(raw)[mark:]
    if root.get("compressor") != "vtkZLibDataCompressor":
        raise ValueError("it is not compressed by zlib, as an older release wrote it")
    piece = next(root.iter("Piece"))
    e = _extent(piece)
    where = tuple(slice(e[2 * a], e[2 * a + 1]) for a in range(3))
    size = tuple(s.stop - s.start for s in where)
    for item in piece.findall("CellData/*"):
        name, components = item.attrib["Name"], int(item.get("NumberOfComponents", "1"))
        values = _unpacked(data, int(item.attrib["offset"]), TYPES[item.attrib["type"]])
        shape = size[::-1] if components == 1 else (*size[::-1], components)
        turned = values.reshape(shape).transpose((2, 1, 0, 3)[: len(shape)])
        if name not in fields:
            fields[name] = np.zeros(cells if components == 1 else (*cells, components), values.dtype)
        fields[name][where] = turned
    places = piece.find("Coordinates")
    for axis, item in enumerate([] if places is None else places):
        values = _unpacked(data, int(item.attrib["offset"]), TYPES[item.attrib["type"]])
        edges[axis][e[2 * axis] : e[2 * axis + 1] + 1] = values


def _unpacked(data: memoryview, offset: int, kind: type) -> Array:
    """Undo VTK's packing: number of blocks, size of a block, size of the last, packed sizes, blocks."""
    count = int(np.frombuffer(data[offset : offset + 8], np.uint64)[0])
    sizes = np.frombuffer(data[offset + 24 : offset + 24 + 8 * count], np.uint64)
    place, parts = offset + 24 + 8 * count, []
    for size in sizes:
        parts.append(zlib.decompress(data[place : place + int(size)]))
        place += int(size)
    return np.frombuffer(b"".join(parts), kind)
