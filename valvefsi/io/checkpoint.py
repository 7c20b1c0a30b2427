"""Checkpoints: one file a state, written by all ranks together, readable on any number of ranks.

Layout of ``step_00001234.vfc``: magic, length of the header, CRC-32 of the header (8 bytes each), the header
(JSON), then the arrays in C order, one after another. The header holds a checksum of each array,

    c = sum_i A(w_i xor g (i + 1)) mod 2^64,    w_i the i-th 64-bit word, g odd, A the last mixing of XXH64,

which every rank adds its part to, so that it does not depend on how the array is distributed. Each word in its place
is mixed to all bits before it is added: whatever is wrong changes c, but for one chance in 2^64.
"""

from __future__ import annotations

import json
import math
import os
import re
import warnings
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from mpi4py import MPI
from numpy.typing import NDArray

from valvefsi.errors import CaseError, raise_together, system_error

MAGIC = b"VFSISTA3"
OLD = (b"VFSISTA1", b"VFSISTA2")
"""Of earlier formats, with other states and checksums."""
PREFIX = 24
CHUNK = 1 << 21
MASK = (1 << 64) - 1
GOLDEN = np.uint64(0x9E3779B97F4A7C15)
AVALANCHE = (
    (np.uint64(33), np.uint64(0xC2B2AE3D27D4EB4F)),
    (np.uint64(29), np.uint64(0x165667B19E3779F9)),
)
TYPES = ("<f8", "<i8", "<u8")
NAME = re.compile(r"step_(\d+)\.vfc")


@dataclass(frozen=True)
class Block:
    """This rank's part of a distributed array.

    Attributes:
        data: The part, of 8-byte numbers.
        start: Index of its first entry in the whole array.
        shape: Shape of the whole array.
    """

    data: NDArray[Any]
    start: tuple[int, ...]
    shape: tuple[int, ...]


@dataclass(frozen=True)
class Rows:
    """This rank's rows of a table.

    Attributes:
        data: The rows, ``(n, k)``, of 8-byte numbers.
        ids: Their numbers in the whole table, ``(n,)``, each owned by one rank.
        count: Number of rows of the whole table.
    """

    data: NDArray[Any]
    ids: NDArray[Any]
    count: int


def _mixed(words: NDArray[np.uint64], places: NDArray[np.uint64]) -> int:
    """Return the sum of the mixed words; ``places`` (index + 1) is overwritten."""
    x = places
    with np.errstate(over="ignore"):
        x *= GOLDEN
        x ^= words
        for shift, factor in AVALANCHE:
            x ^= x >> shift
            x *= factor
        x ^= x >> np.uint64(32)
        return int(x.sum())


Request = Mapping[str, tuple[tuple[int, ...], tuple[int, ...]]]
Arrays = dict[str, NDArray[Any]]


def save(
    directory: Path,
    step: int,
    fields: Mapping[str, Block],
    rows: Mapping[str, Rows],
    meta: Mapping[str, Any],
    comm: MPI.Comm,
    keep: int = 2,
) -> Path:
    """Write a checkpoint, then remove all but the last ``keep`` of them.

    Args:
        directory: Folder of the checkpoints, made if need be.
        step: Number of steps taken, names the file.
        fields: Distributed arrays by name.
        rows: Tables by name.
        meta: Anything JSON can hold; rank 0's is written.
        comm: Communicator of the run.
        keep: How many files to keep.

    Returns:
        Path of the file.

    Raises:
        CaseError: The parts do not add up to the whole array.
        OSError: The file cannot be written; the checkpoints that exist stay as they are.

    Note:
        Collective. The file appears under its name only when it is complete and on the disk. Files of later
        steps belong to a run that this one replaces and are removed.
    """
    parts = {**{n: _block_part(b) for n, b in fields.items()}, **{n: _rows_part(r) for n, r in rows.items()}}
    header, offsets = _header(step, parts, meta, comm)
    path = Path(directory) / f"step_{step:08d}.vfc"
    temporary = path.with_name(f".{path.name}.part")
    error = None
    try:
        if comm.rank == 0:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.unlink(missing_ok=True)
    except OSError as failure:
        error = failure
    raise_together(comm, error)
    _write(temporary, header, parts, offsets, comm)
    try:
        if comm.rank == 0:
            temporary.replace(path)
            folder = os.open(path.parent, os.O_RDONLY)
            os.fsync(folder)  # the new name must be on the disk too before an older file goes
            os.close(folder)
            _remove_old(path, keep)
    except OSError as failure:
        error = failure
    raise_together(comm, error)
    return path


def load_latest(
    directory: Path,
    request: Request,
    rows_request: Mapping[str, NDArray[Any]],
    comm: MPI.Comm,
    optional: Mapping[str, NDArray[Any]] | None = None,
) -> tuple[dict[str, Any], Arrays, Arrays] | None:
    """Read the newest checkpoint that is whole.

    Args:
        directory: Folder of the checkpoints.
        request: Start and size of this rank's part of each distributed array.
        rows_request: Numbers of the rows this rank wants of each table.
        comm: Communicator of the run, of any size.
        optional: The same for tables that a file need not hold.

    Returns:
        What ``save`` was given as meta, with "step", and this rank's parts of the arrays and rows of the
        tables; None where the folder holds no checkpoint.

    Raises:
        CaseError: No file in the folder is whole, or the arrays are not those asked for.

    Note:
        Collective. Warns (on rank 0) about each damaged file that it passes over.
    """
    paths = comm.bcast(list_checkpoints(directory)[::-1] if comm.rank == 0 else None, root=0)
    for number, path in enumerate(paths):
        header, reason = _inspect(path, comm)
        if reason is None:
            there = {k: ids for k, ids in (optional or {}).items() if k in header["arrays"]}
            return _read(path, header, request, {**rows_request, **there}, comm)
        if comm.rank == 0:
            left = paths[number + 1 :]
            then = f"using {left[0].name} instead" if left else "there is none before it"
            warnings.warn(f"checkpoint {path} is damaged ({reason}), {then}", stacklevel=2)
    if paths:
        raise CaseError("no checkpoint in this folder can be used, all are damaged", file=directory)
    return None


def list_checkpoints(directory: Path) -> list[Path]:
    """Return the checkpoints in a folder, oldest step first."""
    paths = Path(directory).glob("step_*.vfc")
    found = [(NAME.fullmatch(path.name), path) for path in paths if path.is_file()]
    return [path for _, path in sorted((int(match[1]), path) for match, path in found if match)]


def newest_meta(directory: Path, comm: MPI.Comm) -> dict[str, Any] | None:
    """Return what the newest file with a readable header was given as meta, None where there is none (collective)."""
    meta = None
    if comm.rank == 0:
        headers = (_read_header(path)[0] for path in reversed(list_checkpoints(directory)))
        meta = next((header["meta"] for header in headers if header), None)
    return comm.bcast(meta, root=0)


@dataclass(frozen=True)
class _Part:
    """This rank's part of one array: its words in the order of the file, and where they go."""

    words: NDArray[np.uint64]
    index: tuple[NDArray[Any], ...]
    shape: tuple[int, ...]
    dtype: str
    problem: str | None = None

    def checksum(self) -> int:
        """Return what this part adds to the checksum of the array."""
        strides = [math.prod(self.shape[axis + 1 :]) for axis in range(len(self.shape))]
        inner = np.ones(self.words.shape[1:], dtype=np.uint64)
        for axis in range(1, len(self.shape)):
            line = (self.index[axis] * strides[axis]).astype(np.uint64)
            inner += line.reshape([-1 if a == axis else 1 for a in range(1, len(self.shape))])
        first = (self.index[0] * strides[0]).astype(np.uint64).reshape([-1] + [1] * inner.ndim)
        slab = max(1, CHUNK // max(1, inner.size))
        parts = (slice(k, k + slab) for k in range(0, len(first), slab))
        return sum(_mixed(self.words[part], inner + first[part]) for part in parts) & MASK

    def file_type(self) -> MPI.Datatype:
        """Return where the words go in the file, counted from the start of the array."""
        word, size = MPI.UINT64_T, self.words.shape
        if self.words.size == 0:
            return word.Dup()
        contiguous = all(int(line[-1] - line[0]) == len(line) - 1 for line in self.index)
        if contiguous:
            start = [int(line[0]) for line in self.index]
            return word.Create_subarray(self.shape, size, start, order=MPI.ORDER_C)
        width = math.prod(self.shape[1:])
        return word.Create_hindexed_block(width, [int(i) * width * 8 for i in self.index[0]])


def _block_part(block: Block) -> _Part:
    data = np.ascontiguousarray(block.data)
    problem = None
    if data.dtype.itemsize != 8 or data.ndim != len(block.shape) or len(block.start) != len(block.shape):
        problem = f"expected {len(block.shape)} axes of 8-byte numbers, not {data.dtype} {data.shape}"
    elif any(s < 0 or s + n > m for s, n, m in zip(block.start, data.shape, block.shape, strict=True)):
        problem = f"a part {data.shape} at {tuple(block.start)} does not fit into {tuple(block.shape)}"
    index = tuple(np.arange(s, s + n) for s, n in zip(block.start, data.shape, strict=False))
    words = data.view(np.uint64) if data.dtype.itemsize == 8 else data
    return _Part(words, index, tuple(int(n) for n in block.shape), data.dtype.str, problem)


def _rows_part(rows: Rows) -> _Part:
    ids = np.asarray(rows.ids, dtype=np.int64)
    order = np.argsort(ids, kind="stable")  # a file view must not go backwards
    data, ids = np.ascontiguousarray(np.asarray(rows.data)[order]), ids[order]
    problem = None
    if data.ndim != 2 or data.dtype.itemsize != 8:
        problem = f"expected rows of 8-byte numbers, not {data.dtype} {data.shape}"
    elif len(ids) and (ids[0] < 0 or ids[-1] >= rows.count or (np.diff(ids) == 0).any()):
        problem = f"row numbers outside 0 ... {rows.count - 1} or twice the same"
    shape = (int(rows.count), data.shape[-1])
    words = data.view(np.uint64) if data.dtype.itemsize == 8 else data
    return _Part(words, (ids, np.arange(shape[1])), shape, data.dtype.str, problem)


def _header(
    step: int, parts: Mapping[str, _Part], meta: Mapping[str, Any], comm: MPI.Comm
) -> tuple[bytes, dict[str, int]]:
    """Return the first bytes of the file and the offset of each array in it (collective)."""
    problem = next(((n, p.problem) for n, p in parts.items() if p.problem), None)
    raise_together(comm, CaseError(problem[1], key=problem[0]) if problem else None)
    local = [(part.words.size, part.checksum()) for part in parts.values()]
    totals = [tuple(map(sum, zip(*ranks, strict=True))) for ranks in zip(*comm.allgather(local), strict=True)]
    table, offset = {}, 0
    for (name, part), (size, checksum) in zip(parts.items(), totals, strict=True):
        if size != math.prod(part.shape):
            raise CaseError(f"the ranks hold {size} of {math.prod(part.shape)} entries", key=name)
        entry: dict[str, Any] = {
            "shape": part.shape,
            "dtype": part.dtype,
            "offset": offset,
            "checksum": f"{checksum & MASK:016x}",
        }
        table[name], offset = entry, offset + 8 * size
    body = {"step": step, "bytes": offset, "arrays": table, "meta": dict(meta)}
    text = json.dumps(comm.bcast(body, root=0), default=_plain).encode()
    text += b" " * (-len(text) % 8)
    prefix = MAGIC + np.array([len(text), zlib.crc32(text)], dtype="<u8").tobytes()
    start = PREFIX + len(text)
    return prefix + text, {name: start + entry["offset"] for name, entry in table.items()}


def _plain(value: np.generic | np.ndarray | Path) -> Any:
    """Return what JSON can hold for a NumPy number or array, or a path."""
    return value.tolist() if isinstance(value, np.generic | np.ndarray) else str(value)


def _write(
    path: Path, header: bytes, parts: Mapping[str, _Part], offsets: Mapping[str, int], comm: MPI.Comm
) -> None:
    """Write the file on all ranks together and force it to the disk."""
    error: OSError | None = None
    try:
        file = MPI.File.Open(cast(MPI.Intracomm, comm), str(path), MPI.MODE_CREATE | MPI.MODE_WRONLY)
    except MPI.Exception as failure:
        raise_together(comm, system_error(path.parent, failure))
    raise_together(comm, None)

    def attempt(call: Callable[..., None], *arguments: Any) -> None:
        nonlocal error
        try:
            call(*arguments)
        except MPI.Exception as failure:
            error = error or system_error(path.parent, failure)

    # A rank that cannot write goes on with the others to the end: they would wait for it for ever.
    if comm.rank == 0:
        attempt(file.Write_at, 0, header)
    for name, part in parts.items():
        kind = part.file_type().Commit()
        attempt(file.Set_view, offsets[name], MPI.UINT64_T, kind)
        attempt(file.Write_all, [part.words, part.words.size, MPI.UINT64_T])
        kind.Free()
    attempt(file.Sync)
    attempt(file.Close)
    if comm.allreduce(error is not None, op=MPI.LOR) and comm.rank == 0:
        path.unlink(missing_ok=True)
    raise_together(comm, error)


def _remove_old(path: Path, keep: int) -> None:
    paths = list_checkpoints(path.parent)
    here = paths.index(path)
    for old in (*paths[: max(here + 1 - max(keep, 1), 0)], *paths[here + 1 :]):
        old.unlink(missing_ok=True)
    for torn in path.parent.glob(".step_*.vfc.part"):
        torn.unlink(missing_ok=True)


def _inspect(path: Path, comm: MPI.Comm) -> tuple[dict[str, Any], str | None]:
    """Return the header of a file and what is wrong with the file, on all ranks alike (collective)."""
    header, reason = comm.bcast(_read_header(path) if comm.rank == 0 else None, root=0)
    if reason is not None:
        return header, reason
    sums, problem = [], None
    try:
        for entry in header["arrays"].values():
            sums.append(
                _sum_of_share(path, header["data"] + entry["offset"], math.prod(entry["shape"]), comm)
            )
    except (OSError, ValueError) as failure:
        problem = str(failure)
    shares = comm.allgather((sums, problem))
    problem = next((text for _, text in shares if text), None)
    if problem is not None:
        return header, problem
    for number, (name, entry) in enumerate(header["arrays"].items()):
        if f"{sum(share[number] for share, _ in shares) & MASK:016x}" != entry["checksum"]:
            return header, f"wrong checksum of {name}"
    return header, None


def _read_header(path: Path) -> tuple[dict[str, Any], str | None]:
    try:
        with path.open("rb") as file:
            prefix = file.read(PREFIX)
            if prefix[:8] in OLD:
                reason = (
                    "a checkpoint of an earlier version, which this one does not read: start the run anew"
                )
                return {}, reason
            if len(prefix) < PREFIX or prefix[:8] != MAGIC:
                return {}, "not a checkpoint"
            length, crc = (int(value) for value in np.frombuffer(prefix[8:], dtype="<u8"))
            if length > path.stat().st_size:
                return {}, "cut off in the header"
            text = file.read(length)
        if len(text) < length or zlib.crc32(text) != crc:
            return {}, "wrong checksum of the header"
        header = json.loads(text)
        size, expected = path.stat().st_size, PREFIX + length + header["bytes"]
        if any(entry["dtype"] not in TYPES for entry in header["arrays"].values()):
            return {}, "an array of no numbers"
    except OSError as failure:
        return {}, str(failure.strerror)
    except (ValueError, KeyError, TypeError, AttributeError):  # a header that this package did not write
        return {}, "not a checkpoint"
    header["data"] = PREFIX + length
    return header, None if size == expected else f"{size} bytes instead of {expected}"


def _sum_of_share(path: Path, start: int, size: int, comm: MPI.Comm) -> int:
    """Return this rank's share of the checksum of an array's ``size`` words; the ranks share them evenly."""
    first, last = size * comm.rank // comm.size, size * (comm.rank + 1) // comm.size
    total = 0
    for begin in range(first, last, CHUNK):
        count = min(CHUNK, last - begin)
        words = np.fromfile(path, dtype=np.uint64, count=count, offset=start + 8 * begin)
        if len(words) < count:
            raise ValueError("the file ends too early")
        total += _mixed(words, np.arange(begin + 1, begin + count + 1, dtype=np.uint64))
    return total & MASK


def _read(
    path: Path,
    header: dict[str, Any],
    request: Request,
    rows_request: Mapping[str, NDArray[Any]],
    comm: MPI.Comm,
) -> tuple[dict[str, Any], Arrays, Arrays]:
    """Read this rank's parts of a file that is known to be whole (collective)."""
    error, fields, rows = None, {}, {}
    try:
        for name, (start, size) in request.items():
            slices = tuple(slice(s, s + n) for s, n in zip(start, size, strict=True))
            array = _array(path, header, name)
            if len(slices) != array.ndim or any(s.stop > n for s, n in zip(slices, array.shape, strict=True)):
                message = f"it has the shape {array.shape}, another grid was asked for"
                raise CaseError(message, file=path, key=name)
            fields[name] = np.array(array[slices])
        for name, ids in rows_request.items():
            array = _array(path, header, name)
            if len(ids) and max(ids) >= len(array):
                raise CaseError(f"it has {len(array)} rows, another mesh was asked for", file=path, key=name)
            rows[name] = np.array(array[np.asarray(ids, dtype=np.int64)])
    except (CaseError, OSError) as failure:
        error = failure
    raise_together(comm, error)
    for name in (*request, *rows_request):
        asked = math.prod(request[name][1]) if name in request else len(rows_request[name])
        whole = math.prod(header["arrays"][name]["shape"][: None if name in request else 1])
        asked = comm.allreduce(asked)
        if asked < whole:
            raise CaseError(f"it has {whole} entries, the run asked for {asked}", file=path, key=name)
    return {**header["meta"], "step": header["step"]}, fields, rows


def _array(path: Path, header: dict[str, Any], name: str) -> NDArray[Any]:
    """Map an array of the file into memory, without reading it."""
    if name not in header["arrays"]:
        raise CaseError(f"not in the file, it holds {', '.join(header['arrays'])}", file=path, key=name)
    entry = header["arrays"][name]
    shape = tuple(entry["shape"])
    if math.prod(shape) == 0:
        return np.zeros(shape, dtype=entry["dtype"])
    start = header["data"] + entry["offset"]
    return np.memmap(path, dtype=entry["dtype"], mode="r", offset=start, shape=shape)
