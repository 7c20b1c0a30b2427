"""Checkpoints: exact round trips between decompositions, damage recognised."""

import os
import subprocess
import sys
import warnings
import zlib
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.errors import CaseError, reason_of, system_error
from valvefsi.io.checkpoint import MAGIC, Block, Rows, _inspect, list_checkpoints, load_latest, save

SHAPE = (12, 7, 3)
COUNT = 41


def whole_field(seed=1):
    return np.random.default_rng(seed).standard_normal(SHAPE)


def whole_table(seed=2):
    return np.random.default_rng(seed).standard_normal((COUNT, 3))


def part(comm, axis, flip=False):
    """Start and size of this rank's share of SHAPE, cut along an axis."""
    rank = comm.size - 1 - comm.rank if flip else comm.rank
    first, last = (SHAPE[axis] * (rank + k) // comm.size for k in (0, 1))
    start, size = [0, 0, 0], list(SHAPE)
    start[axis], size[axis] = first, last - first
    return tuple(start), tuple(size)


def cut(array, start, size):
    return array[tuple(slice(s, s + n) for s, n in zip(start, size, strict=True))]


def write(comm, directory, step, seed=1, **options):
    start, size = part(comm, 0)
    ids = np.random.default_rng(5).permutation(COUNT)[comm.rank :: comm.size]
    fields = {"u0": Block(np.asfortranarray(cut(whole_field(seed), start, size)), start, SHAPE)}
    rows = {"chi": Rows(whole_table(seed + 1)[ids], ids, COUNT)}
    return save(directory, step, fields, rows, {"t": 0.1 * step, "note": "a"}, comm, **options)


def read(comm, directory, axis=1):
    ids = np.arange(COUNT)[comm.rank :: comm.size][::-1]
    return load_latest(directory, {"u0": part(comm, axis, flip=True)}, {"chi": ids}, comm)


def read_quietly(comm, directory):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return read(comm, directory), [str(item.message) for item in caught]


def damage(comm, path, change):
    comm.barrier()
    if comm.rank == 0:
        content = bytearray(path.read_bytes())
        path.write_bytes(change(content))
    comm.barrier()


def flip_bit(content, position=-1000, bit=3):
    content[position] ^= 1 << bit
    return content


def assert_is(comm, found, step, seed=1):
    meta, fields, rows = found
    assert meta == {"t": 0.1 * step, "note": "a", "step": step}
    np.testing.assert_array_equal(fields["u0"], cut(whole_field(seed), *part(comm, 1, flip=True)))
    np.testing.assert_array_equal(rows["chi"], whole_table(seed + 1)[comm.rank :: comm.size][::-1])


def test_what_is_written_in_one_layout_is_read_in_another(comm, shared_tmp):
    path = write(comm, shared_tmp / "new", 1234)
    assert path.name == "step_00001234.vfc"
    assert_is(comm, read(comm, shared_tmp / "new"), 1234)


def test_a_file_written_by_all_ranks_is_read_by_one_and_the_other_way_round(comm, shared_tmp):
    from mpi4py import MPI

    write(comm, shared_tmp / "all", 1)
    if comm.rank == 0:
        assert_is(MPI.COMM_SELF, read(MPI.COMM_SELF, shared_tmp / "all"), 1)
        write(MPI.COMM_SELF, shared_tmp / "one", 1)
    comm.barrier()
    assert_is(comm, read(comm, shared_tmp / "one"), 1)


def test_the_bytes_of_a_file_do_not_depend_on_the_number_of_ranks(comm, shared_tmp):
    from mpi4py import MPI

    path = write(comm, shared_tmp / "all", 1)
    if comm.rank == 0:
        assert write(MPI.COMM_SELF, shared_tmp / "one", 1).read_bytes() == path.read_bytes()
        # On one rank the comparison must not be empty: the file holds the arrays as they are.
        assert path.read_bytes().endswith(whole_field().tobytes() + whole_table(2).tobytes())


def test_an_empty_folder_holds_no_checkpoint(comm, shared_tmp):
    assert read(comm, shared_tmp) is None
    assert read(comm, shared_tmp / "missing") is None


@pytest.mark.parametrize("position", [3, 10, 18, 60, -1000, -1])
def test_one_wrong_bit_is_recognised_and_the_file_before_is_used(comm, shared_tmp, position):
    write(comm, shared_tmp, 10, seed=3)
    damage(comm, write(comm, shared_tmp, 20), lambda content: flip_bit(content, position))
    found, messages = read_quietly(comm, shared_tmp)
    assert_is(comm, found, 10, seed=3)
    assert len(messages) == (comm.rank == 0)
    if comm.rank == 0:
        assert "step_00000020.vfc is damaged" in messages[0]
        assert "using step_00000010.vfc" in messages[0]


@pytest.mark.parametrize("length", [0, 20, 300, -8, -1])
def test_a_file_that_is_cut_off_is_recognised(comm, shared_tmp, length):
    write(comm, shared_tmp, 10, seed=3)
    damage(comm, write(comm, shared_tmp, 20), lambda content: content[:length])
    found, _ = read_quietly(comm, shared_tmp)
    assert_is(comm, found, 10, seed=3)


def test_a_file_with_something_added_is_recognised(comm, shared_tmp):
    write(comm, shared_tmp, 10, seed=3)
    damage(comm, write(comm, shared_tmp, 20), lambda content: content + b"more")
    found, _ = read_quietly(comm, shared_tmp)
    assert_is(comm, found, 10, seed=3)


def test_a_run_does_not_start_anew_where_all_checkpoints_are_damaged(comm, shared_tmp):
    damage(comm, write(comm, shared_tmp, 10), flip_bit)
    with pytest.raises(CaseError, match="all are damaged"):
        read_quietly(comm, shared_tmp)


def test_the_last_files_are_kept_and_those_of_an_abandoned_run_go(comm, shared_tmp):
    for step in (10, 20, 30):
        write(comm, shared_tmp, step)
    assert [path.stem for path in list_checkpoints(shared_tmp)] == ["step_00000020", "step_00000030"]
    comm.barrier()
    write(comm, shared_tmp, 25)
    assert [path.stem for path in list_checkpoints(shared_tmp)] == ["step_00000020", "step_00000025"]
    comm.barrier()
    write(comm, shared_tmp, 30, keep=1)
    assert [path.name for path in sorted(shared_tmp.iterdir())] == ["step_00000030.vfc"]


def test_parts_that_do_not_add_up_are_refused_on_all_ranks(comm, shared_tmp):
    start, size = part(comm, 0)
    short = (size[0] - (comm.rank == 0), *size[1:])
    with pytest.raises(CaseError, match="entries"):
        save(shared_tmp, 1, {"u0": Block(np.zeros(short), start, SHAPE)}, {}, {}, comm)
    outside = {"u0": Block(np.zeros(size), (start[0] + (comm.rank == 0) * 12, 0, 0), SHAPE)}
    with pytest.raises(CaseError, match="does not fit"):
        save(shared_tmp, 1, outside, {}, {}, comm)
    ids = np.zeros(2 if comm.rank == 0 else 0, dtype=int)
    with pytest.raises(CaseError, match="twice the same"):
        save(shared_tmp, 1, {}, {"chi": Rows(np.zeros((len(ids), 3)), ids, 2)}, {}, comm)


def test_another_grid_or_mesh_or_name_is_refused_on_all_ranks(comm, shared_tmp):
    write(comm, shared_tmp, 1)
    start, size = part(comm, 1)
    for request, ids, message in (
        ({"u0": (start, (*size[:2], 2))}, [], "the run asked for"),
        ({"u0": (start, (*size[:2], 4))}, [], "another grid"),
        ({}, np.arange(COUNT + 1), "another mesh"),
    ):
        with pytest.raises(CaseError, match=message):
            load_latest(shared_tmp, request, {"chi": ids} if len(ids) else {}, comm)
    with pytest.raises(CaseError, match="it holds u0, chi"):
        load_latest(shared_tmp, {"u9": (start, size)}, {}, comm)


def test_arrays_without_entries_and_whole_numbers_survive(comm, shared_tmp):
    empty = {"none": Rows(np.zeros((0, 3)), np.zeros(0), 0)}
    numbers = np.arange(5) - 2 if comm.rank == 0 else np.zeros(0, dtype=np.int64)
    save(shared_tmp, 1, {"n": Block(numbers, (0 if comm.rank == 0 else 5,), (5,))}, empty, {}, comm)
    own = ((0,), (5,)) if comm.rank == 0 else ((0,), (0,))
    _, fields, rows = load_latest(shared_tmp, {"n": own}, {"none": np.zeros(0)}, comm)
    assert fields["n"].tolist() == ([-2, -1, 0, 1, 2] if comm.rank == 0 else [])
    assert rows["none"].shape == (0, 3)


@pytest.mark.serial
def test_pairs_of_wrong_bits_and_exchanged_words_are_recognised(tmp_path):
    """Sums with odd weights miss a pair of sign bits in one half of all pairs of places."""
    path = write(MPI.COMM_SELF, tmp_path, 10)
    whole, rng = path.read_bytes(), np.random.default_rng(7)
    words = SHAPE[0] * SHAPE[1] * SHAPE[2]  # of u0, the first array
    start = len(whole) - 8 * (words + 3 * COUNT)

    def spoilt(kind):
        content = bytearray(whole)
        a, b = (start + 8 * int(k) for k in rng.choice(words, 2, replace=False))
        if kind == "signs":
            content[a + 7] ^= 0x80
            content[b + 7] ^= 0x80
        elif kind == "exchanged":
            content[a : a + 8], content[b : b + 8] = content[b : b + 8], content[a : a + 8]
        else:
            content[a : a + 8] = bytes(8)
            content[b : b + 8] = bytes(8)
        return bytes(content)

    for kind in ("signs", "exchanged", "zeros"):
        for _ in range(200):
            path.write_bytes(spoilt(kind))
            _, reason = _inspect(path, MPI.COMM_SELF)
            assert reason == "wrong checksum of u0", kind
    path.write_bytes(whole)
    assert _inspect(path, MPI.COMM_SELF)[1] is None


def test_strange_files_among_checkpoints_are_passed_over(comm, shared_tmp):
    path = write(comm, shared_tmp, 10, seed=3)
    if comm.rank == 0:
        (shared_tmp / "step_abc.vfc").write_text("mine")
        (shared_tmp / "step_00000020.vfc.bak").write_text("mine")
        (shared_tmp / "step_00000030.vfc").mkdir()
        (shared_tmp / "step_00000005.vfc").write_text("no checkpoint")
    comm.barrier()
    assert list_checkpoints(shared_tmp)[-1] == path
    assert_is(comm, read(comm, shared_tmp), 10, seed=3)


def test_a_header_that_another_program_wrote_is_no_traceback(comm, shared_tmp):
    write(comm, shared_tmp, 10, seed=3)
    for text in (
        b"[]",
        b"{}",
        b'{"bytes": 0, "arrays": {"u0": {"dtype": "O"}}}',
        b'{"bytes": "x", "arrays": {}}',
        b"{",
    ):
        prefix = MAGIC + np.array([len(text), zlib.crc32(text)], dtype="<u8").tobytes()
        if comm.rank == 0:
            (shared_tmp / "step_00000020.vfc").write_bytes(prefix + text)
        comm.barrier()
        found, messages = read_quietly(comm, shared_tmp)
        assert_is(comm, found, 10, seed=3)
        assert len(messages) == (comm.rank == 0)
        comm.barrier()


class Stack(MPI.Exception):
    """What MPI says of a file that it cannot write, with the functions that it was in."""

    def __init__(self, kind, text):
        super().__init__(kind)
        self.text = text

    def __str__(self):
        return f"Other I/O error , error stack:\ninternal_File_write_all_c(8034): {self.text}"


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        (MPI.ERR_IO, "Other I/O error No space left on device", "No space left on device"),
        (MPI.ERR_IO, "Other I/O error File too large", "File too large"),
        (MPI.ERR_NO_SPACE, "failed", "No space left on device"),
        (MPI.ERR_NO_SUCH_FILE, "Invalid file name", "No such file or directory"),
        (MPI.ERR_IO, "failed", "Input/output error"),
    ],
)
def test_what_mpi_cannot_write_is_said_as_the_system_says_it(kind, text, said):
    error = system_error(Path("run/checkpoints"), Stack(kind, text))
    assert reason_of(error) == f"run/checkpoints: {said}"


ONE_RANK_CANNOT = """
import os, sys, types
from pathlib import Path
import numpy as np
from mpi4py import MPI
from valvefsi.errors import reason_of
from valvefsi.io import checkpoint
comm, call, rank = MPI.COMM_WORLD, sys.argv[2], int(sys.argv[3])

class Full:
    def __init__(self, file):
        self.file, self.number = file, 0
    def __getattr__(self, name):
        def run(*arguments):
            getattr(self.file, name)(*arguments)
            self.number += name == call
            if name == call and comm.rank == rank and self.number == 1:
                raise MPI.Exception(MPI.ERR_NO_SPACE)
        return run

checkpoint.MPI = types.SimpleNamespace(**{name: getattr(MPI, name) for name in dir(MPI)})
opened = lambda *arguments: Full(MPI.File.Open(*arguments))
checkpoint.MPI.File = types.SimpleNamespace(Open=opened)
fields = {n: checkpoint.Block(np.ones((2, 3)), (2 * comm.rank, 0), (4, 3)) for n in "abc"}
try:
    checkpoint.save(Path(sys.argv[1]), 3, fields, {}, {}, comm)
except OSError as error:
    os.write(1, f"{comm.rank} {reason_of(error)}\\n".encode())  # at once: ranks share the line
"""


@pytest.mark.serial
@pytest.mark.parametrize(("call", "rank"), [("Write_at", 0), ("Write_all", 1), ("Sync", 1)])
def test_where_one_rank_cannot_write_all_say_so(call, rank, tmp_path):
    """The others do not wait for it for ever, and no file stands there."""
    command = ["mpirun", "-n", "2", sys.executable, "-c", ONE_RANK_CANNOT, str(tmp_path), call, str(rank)]
    clean = {
        k: v for k, v in os.environ.items() if not k.startswith(("PMI", "OMPI_", "PMIX", "HYDRA", "MPI"))
    }
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=clean)
    said = f"{tmp_path}: No space left on device"
    assert sorted(done.stdout.split("\n")) == ["", f"0 {said}", f"1 {said}"], done.stderr
    assert not list(tmp_path.iterdir())
