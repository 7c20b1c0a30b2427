"""Series of files for ParaView: the fluid in one compressed piece a rank, solids as unstructured grids.

A series is ``NAME.pvd``, the list of times, and the files it names in the folder ``NAME``. The list is
replaced in one go after the files of a time are complete, so that a run may be watched, or stopped, at any
moment.
"""

from __future__ import annotations

import math
import sys
import warnings
import xml.etree.ElementTree as ET
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.errors import CaseError, raise_together
from valvefsi.io.series import Frames, frame_number, read_times
from valvefsi.io.solid_body import Body, write_body
from valvefsi.runtime import threads
from valvefsi.types import Array, Indices

if TYPE_CHECKING:
    from mpi4py import MPI

BYTE_ORDER = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
FILE = {"version": "1.0", "byte_order": BYTE_ORDER, "header_type": "UInt64"}
PACKED = {**FILE, "compressor": "vtkZLibDataCompressor"}
LISTED = (".pvti", ".pvtr", ".vtu")
"""Endings of the files that a list of times names."""
SHOWN = 5
"""Numbers of frames that a line names."""
BLOCK = 1 << 20
"""Bytes that are compressed together."""
FIELDS = (("velocity", 3), ("pressure", 1))
MESHIO_CELLS = {
    5: "triangle",
    9: "quad",
    10: "tetra",
    12: "hexahedron",
    22: "triangle6",
    24: "tetra10",
    28: "quad9",
}
"""meshio's names of VTK's cell types."""
MESHIO_CELLS |= {69: "triangle6", 70: "quad9", 71: "tetra10", 72: "VTK_LAGRANGE_HEXAHEDRON"}


class FluidSeries:
    """Writes velocity and pressure in the cells of the grid, each rank its own piece.

    A uniform grid is image data (``.pvti``), a graded one a rectilinear grid (``.pvtr``).

    Args:
        directory: Folder of the series.
        name: Name of the series.
        comm: Communicator of the run.
        cells: Number of cells of the whole grid, ``(3,)``; a grid in two dimensions is one cell thick.
        start: This rank's first cell, ``(3,)``.
        size: This rank's number of cells, ``(3,)``.
        box: Lower corner of the grid and its spacing, ``((3,), (3,))``, or the edges of the cells along each axis,
            three of ``(cells + 1,)`` [cm].
        frames: Times of the frames by number, as the checkpoint that a run goes on from has them [s]; None for a new
            series. See `valvefsi.io.series.frames_on_disk` for None in it.

    Attributes:
        fields: Name and number of components of each field.

    Note:
        Collective.
    """

    fields: Sequence[tuple[str, int]] = FIELDS

    def __init__(
        self,
        directory: Path,
        name: str,
        comm: MPI.Comm,
        cells: Sequence[int],
        start: Sequence[int],
        size: Sequence[int],
        box: Sequence[Sequence[float]],
        frames: Frames | None = None,
    ) -> None:
        self.comm = comm
        self.whole = _extent((0, 0, 0), cells)
        self.extents = comm.allgather(_extent(start, size))
        self.shape = tuple(int(n) for n in size)
        self.edges = [np.asarray(edges, dtype=float) for edges in box] if len(box) == 3 else None
        self.kind, self.image = "RectilinearGrid", {}
        if self.edges is None:
            self.kind = "ImageData"
            self.image = {"Origin": _join(map(float, box[0])), "Spacing": _join(map(float, box[1]))}
        self.suffix = ".vti" if self.edges is None else ".vtr"
        self.index = _Index(directory, name, comm, frames)

    def write(self, t: float, *arrays: Array) -> None:
        """Write one time.

        Args:
            t: Time [s].
            arrays: The fields in the centres of this rank's cells, ``(nx, ny, nz)`` or ``(nx, ny, nz, components)``;
                velocity [cm/s] and pressure [dyn/cm^2] unless other fields were named.

        Raises:
            ValueError: The arrays do not have the shape of this rank's part.
            OSError: A file cannot be written.

        Note:
            Collective. Both are stored in single precision.
        """
        stem, error = self.index.stem(t), None
        try:
            expected = [self.shape if n == 1 else (*self.shape, n) for _, n in self.fields]
            if [a.shape for a in arrays] != expected:
                found = ", ".join(str(a.shape) for a in arrays)
                raise ValueError(f"expected arrays of {self.shape} cells, not {found}")
            if math.prod(self.shape):
                self._write_piece(_piece_path(stem, self.comm.rank, self.suffix), arrays)
        except (OSError, ValueError) as failure:
            error = failure
        raise_together(self.comm, error)
        self.index.add(t, stem.with_suffix(self.suffix.replace(".", ".p")), self._write_list)

    def _write_piece(self, path: Path, arrays: Sequence[Array]) -> None:
        extent = self.extents[self.comm.rank]
        root = ET.Element("VTKFile", {"type": self.kind, **PACKED})
        grid = ET.SubElement(root, self.kind, {"WholeExtent": _join(extent), **self.image})
        piece = ET.SubElement(grid, "Piece", {"Extent": _join(extent)})
        blocks, offset = [], 0

        def add(parent: ET.Element, attributes: Mapping[str, str], values: Array) -> None:
            nonlocal offset
            place = {"format": "appended", "offset": str(offset)}
            ET.SubElement(parent, "DataArray", {**attributes, **place})
            blocks.append(_packed(values))
            offset += len(blocks[-1])

        data = ET.SubElement(piece, "CellData", self._shown())
        for (name, components), array in zip(self.fields, arrays, strict=True):
            # VTK counts x fastest, the components of one cell are neighbours.
            turned = array.transpose(2, 1, 0, 3) if components > 1 else array.transpose(2, 1, 0)
            add(data, _array(name, components), np.ascontiguousarray(turned, dtype=np.float32))
        if self.edges is not None:
            places = ET.SubElement(piece, "Coordinates")
            for axis, edges in enumerate(self.edges):
                first, last = extent[2 * axis : 2 * axis + 2]
                add(places, _array("xyz"[axis], 1, "Float64"), np.ascontiguousarray(edges[first : last + 1]))
        ET.SubElement(root, "AppendedData", {"encoding": "raw"}).text = "_@"
        head, tail = ET.tostring(root, xml_declaration=True, encoding="utf-8").split(b"@")
        _replace(path, b"".join([head, *blocks, tail]))

    def _shown(self) -> dict[str, str]:
        """Which fields ParaView shows first."""
        found: dict[str, str] = {}
        for name, components in self.fields:
            found.setdefault("Vectors" if components > 1 else "Scalars", name)
        return found

    def _write_list(self, path: Path) -> None:
        kind = f"P{self.kind}"
        root = ET.Element("VTKFile", {"type": kind, **FILE})
        grid = ET.SubElement(root, kind, {"WholeExtent": _join(self.whole), "GhostLevel": "0", **self.image})
        data = ET.SubElement(grid, "PCellData", self._shown())
        for name, components in self.fields:
            ET.SubElement(data, "PDataArray", _array(name, components))
        if self.edges is not None:
            places = ET.SubElement(grid, "PCoordinates")
            for axis in "xyz":
                ET.SubElement(places, "PDataArray", _array(axis, 1, "Float64"))
        for rank, extent in enumerate(self.extents):
            if all(extent[k + 1] > extent[k] for k in (0, 2, 4)):
                source = _piece_path(path, rank, self.suffix).name
                ET.SubElement(grid, "Piece", {"Extent": _join(extent), "Source": source})
        _replace(path, _pretty(root))


class SolidSeries:
    """Writes a deformed mesh with its displacement and J, on rank 0.

    Args:
        directory: Folder of the series.
        name: Name of the series, the solid's.
        comm: Communicator of the run.
        frames: Times of the frames by number, as the checkpoint that a run goes on from has them [s]; None for a new
            series. See `valvefsi.io.series.frames_on_disk` for None in it.

    Note:
        Collective.
    """

    def __init__(self, directory: Path, name: str, comm: MPI.Comm, frames: Frames | None = None) -> None:
        self.index = _Index(directory, name, comm, frames)

    def write(
        self,
        t: float,
        points: Array | None,
        cells: Mapping[int, Indices] | None,
        J: Array | None,
        displacement: Array | None,
    ) -> None:
        """Write one time; ranks other than 0 may pass None.

        Args:
            t: Time [s].
            points: Positions of the nodes, ``(num_nodes, 3)`` [cm].
            cells: Nodes of the cells in VTK's order, ``(num_cells, k)``, by VTK cell type.
            J: Mean of det F in each cell, ``(num_cells,)``, in the order of ``cells``.
            displacement: Displacement of the nodes, ``(num_nodes, 3)`` [cm].

        Raises:
            OSError: A file cannot be written.

        Note:
            Collective.
        """

        def write(path: Path) -> None:
            import meshio

            assert cells is not None  # rank 0 has them
            assert J is not None
            named = {MESHIO_CELLS[kind]: nodes for kind, nodes in cells.items()}
            ends = np.cumsum([len(block) for block in named.values()])[:-1]
            mesh = meshio.Mesh(
                points, named, point_data={"displacement": displacement}, cell_data={"J": np.split(J, ends)}
            )
            temporary = path.with_name(f".{path.name}")
            mesh.write(temporary, file_format="vtu")
            temporary.replace(path)

        self.index.add(t, self.index.stem(t).with_suffix(".vtu"), write)


GatheredBody = tuple[Array, Mapping[int, Indices], Mapping[str, Array], Array]
"""Positions, nodes of the cells by VTK cell type, fields, reference positions."""


class BodySeries:
    """Writes a deformed mesh with any fields at its nodes, on rank 0.

    Args:
        directory: Folder of the series.
        name: Name of the series.
        comm: Communicator of the run.
        frames: Times of the frames by number, as the checkpoint that a run goes on from has them [s]; None for a new
            series. See `valvefsi.io.series.frames_on_disk` for None in it.

    Note:
        Collective.
    """

    def __init__(self, directory: Path, name: str, comm: MPI.Comm, frames: Frames | None = None) -> None:
        self.index = _Index(directory, name, comm, frames)

    def write(self, t: float, gathered: GatheredBody | None) -> None:
        """Write one time.

        Args:
            t: Time [s].
            gathered: On rank 0 positions, cells, fields and reference positions as `valvefsi.solid.stress` gathers
                them; None on other ranks.

        Note:
            Collective.
        """

        def write(path: Path) -> None:
            assert gathered is not None  # rank 0 has them
            points, cells, fields, reference = gathered
            write_body(path, Body(points=points, cells=cells, values=fields, reference=reference))

        self.index.add(t, self.index.stem(t).with_suffix(".vtu"), write)


class _Index:
    """The list of times of a series, kept in memory on rank 0 and in ``NAME.pvd``.

    The number of a file is that of its time in the checkpoint's frames, whatever the list has lost.
    """

    def __init__(self, directory: Path, name: str, comm: MPI.Comm, frames: Frames | None) -> None:
        self.comm, self.path = comm, Path(directory) / f"{name}.pvd"
        self.folder = self.path.with_suffix("")
        self.entries: list[tuple[float, str]] = []
        self.times: list[float | None] = list(frames or ())
        error = None
        try:
            if comm.rank == 0:
                self._start(resumed=frames is not None)
        except (OSError, CaseError) as failure:
            error = failure
        raise_together(comm, error)
        self.entries = comm.bcast(self.entries, root=0)

    def _start(self, *, resumed: bool) -> None:
        """List the frames up to the checkpoint whose files are there; remove the files of later ones."""
        self.folder.mkdir(parents=True, exist_ok=True)
        there: dict[int, Path] = {}
        for path in sorted(self.folder.iterdir()):
            number = frame_number(path.name.removeprefix("."), self.folder.name)
            if number is None or not path.is_file():
                continue
            if path.name.startswith(".") or number >= len(self.times):
                path.unlink()  # begun by a run that was killed, or of a later time
            elif path.suffix in LISTED:
                there[number] = path
        if resumed:
            self._restore(there)
        self._save()

    def _restore(self, there: Mapping[int, Path]) -> None:
        """Make the entries anew from the checkpoint's times and the files; say what the list had lost."""
        listed = read_times(self.path) if self.path.is_file() else []
        times = list(enumerate(self.times))
        for number, t in times:
            if t is not None and number in there:
                self.entries.append((t, f"{self.folder.name}/{there[number].name}"))
        lost = [number for number, t in times if t is not None and number not in there]
        unknown = [number for number, t in times if t is None and number in there]
        added = sum(entry not in listed for entry in self.entries)
        said = []
        if added:
            said.append(f"{added} of {len(self.entries)} entries are put in again from the checkpoint")
        if lost:
            said.append(f"the files of {_some(lost)} are gone")
        if unknown:
            said.append(f"the times of {_some(unknown)} are not known, their files stay")
        if said:
            warnings.warn(f"{self.path}: {', '.join(said)}", stacklevel=2)

    def stem(self, t: float) -> Path:
        """Return the path, without suffix, of the files of time t; a time that is there is written again."""
        number = self.times.index(t) if t in self.times else len(self.times)
        return self.folder / f"{self.folder.name}_{number:06d}"

    def add(self, t: float, path: Path, write: Callable[[Path], None]) -> None:
        """Write the file of time t by ``write(path)`` on rank 0 and enter it in the list (collective)."""
        entry, error = (t, f"{self.folder.name}/{path.name}"), None
        if entry not in self.entries:
            self.entries.append(entry)
        if t not in self.times:
            self.times.append(t)
        try:
            if self.comm.rank == 0:
                write(path)
                self._save()
        except Exception as failure:
            error = failure
        raise_together(self.comm, error)

    def _save(self) -> None:
        root = ET.Element("VTKFile", {"type": "Collection", "version": "1.0", "byte_order": BYTE_ORDER})
        collection = ET.SubElement(root, "Collection")
        for t, file in self.entries:
            ET.SubElement(collection, "DataSet", {"timestep": repr(float(t)), "part": "0", "file": file})
        _replace(self.path, _pretty(root))


def _some(numbers: Sequence[int]) -> str:
    """Return how many frames, and the numbers of the first ones."""
    first = ", ".join(map(str, numbers[:SHOWN])) + (", ..." if len(numbers) > SHOWN else "")
    return f"{len(numbers)} frame{'s' * (len(numbers) > 1)} ({first})"


def _extent(start: Sequence[int], size: Sequence[int]) -> tuple[int, ...]:
    """Return VTK's extent of a range of cells: its first and last point on each axis."""
    return tuple(int(v) for s, n in zip(start, size, strict=True) for v in (s, s + n))


def _piece_path(stem: Path, rank: int, suffix: str) -> Path:
    return stem.with_name(f"{stem.stem}_{rank:04d}{suffix}")


def _array(name: str, components: int, kind: str = "Float32") -> dict[str, str]:
    return {"type": kind, "Name": name, "NumberOfComponents": str(components)}


def _packed(values: Array) -> bytes:
    """Return an array as VTK's compressed blocks: their number, size, size of the last, packed sizes, data."""
    raw = memoryview(values).cast("B") if values.size else b""
    parts = [b""] * -(-len(raw) // BLOCK)

    def pack(first: int, last: int) -> None:
        for k in range(first, last):
            parts[k] = zlib.compress(raw[k * BLOCK : (k + 1) * BLOCK], 1)

    threads.divide(pack, 0, len(parts), least=1)
    header = np.array([len(parts), BLOCK, len(raw) % BLOCK, *map(len, parts)], dtype=np.uint64)
    return b"".join([header.tobytes(), *parts])


def _join(values: Iterable[float]) -> str:
    return " ".join(repr(value) for value in values)


def _pretty(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, xml_declaration=True, encoding="utf-8")


def _replace(path: Path, content: bytes) -> None:
    """Write a file under another name, then give it its own; one run holds the folder."""
    temporary = path.with_name(f".{path.name}")
    temporary.write_bytes(content)
    temporary.replace(path)
