"""Histories: every digit, and no gap or double after a restart."""

import contextlib

import pytest
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.io.history import History, HistoryReader, read_history

COLUMNS = ("step", "t_s", "u_y_cm")


def rows(first, last):
    return [{"step": k, "t_s": 0.1 * k, "u_y_cm": -1 / (k + 3)} for k in range(first, last)]


def test_numbers_are_read_back_to_the_last_digit(comm, shared_tmp):
    history = History(shared_tmp / "a" / "history.csv", COLUMNS, comm)
    for row in rows(0, 20):
        history.append(row)
    comm.barrier()
    found = read_history(history.path)
    for name in COLUMNS:
        assert found[name] == [row[name] for row in rows(0, 20)]


def test_a_resumed_history_equals_an_uninterrupted_one(comm, shared_tmp):
    path = shared_tmp / "history.csv"
    first = History(path, COLUMNS, comm)
    for row in rows(0, 17):
        first.append(row)
    if comm.rank == 0:
        with path.open("a") as file:
            file.write("17,1.7")  # killed while writing
    second = History(path, COLUMNS, comm, resume_step=10)
    for row in rows(11, 25):
        second.append(row)
    comm.barrier()
    assert read_history(path)["step"] == list(range(25))
    assert read_history(path)["u_y_cm"] == [row["u_y_cm"] for row in rows(0, 25)]


def test_a_row_cut_off_inside_its_last_number_is_dropped(comm, shared_tmp):
    path = shared_tmp / "history.csv"
    if comm.rank == 0:
        path.write_text("step,t_s,u_y_cm\n1,0.1,0.5\n2,0.2,0.3")
    comm.barrier()
    History(path, COLUMNS, comm, resume_step=5)
    comm.barrier()
    assert read_history(path)["step"] == [1]


def test_a_new_run_replaces_the_history(comm, shared_tmp):
    path = shared_tmp / "history.csv"
    History(path, COLUMNS, comm).append(rows(0, 1)[0])
    History(path, COLUMNS, comm)
    comm.barrier()
    assert read_history(path)["step"] == []


def test_other_columns_are_refused_on_all_ranks(comm, shared_tmp):
    path = shared_tmp / "history.csv"
    History(path, COLUMNS, comm)
    with pytest.raises(CaseError, match="its columns are step, t_s, u_y_cm"):
        History(path, ("step", "t_s"), comm, resume_step=1)
    with pytest.raises(ValueError, match="differ in u_y_cm"):
        History(path, COLUMNS, comm).append({"step": 1, "t_s": 0.1})


def test_damaged_rows_are_passed_over_with_one_line(comm, shared_tmp):
    path = shared_tmp / "history.csv"
    bad = ["x,0.2,0.3", "2,0.2", "2,0.2,0.3,4", "\0\0\0", "1,0.1,0.5", "2,zz,1", "99999"]
    if comm.rank == 0:
        path.write_text("\n".join(["step,t_s,u_y_cm", "1,0.1,0.5", *bad, "3,0.3,0.7", ""]))
    comm.barrier()
    with contextlib.ExitStack() as stack:
        if comm.rank == 0:
            stack.enter_context(pytest.warns(UserWarning, match=r"history\.csv: 7 damaged rows passed over"))
        History(path, COLUMNS, comm, resume_step=5)
    comm.barrier()
    assert read_history(path) == {"step": [1, 3], "t_s": [0.1, 0.3], "u_y_cm": [0.5, 0.7]}


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="knows of no ranks")
@pytest.mark.parametrize(
    "data", [b"", b"\xff\xfe\0" * 1000, b"step,t_s,u_y_cm\n"], ids=["empty", "noise", "heading"]
)
def test_a_history_without_a_whole_row_is_said_to_be_lost(data, tmp_path):
    path = tmp_path / "history.csv"
    path.write_bytes(data)
    said = r"history\.csv holds no whole row: its rows up to step 5 are lost, it begins anew there"
    with pytest.warns(UserWarning, match=said) as heard:
        History(path, COLUMNS, MPI.COMM_SELF, resume_step=5)
    assert len(heard) == 1
    assert path.read_text() == "step,t_s,u_y_cm\n"


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="knows of no ranks")
def test_a_history_that_an_editor_has_marked_as_text_is_gone_on_with(tmp_path):
    path = tmp_path / "history.csv"
    path.write_bytes(b"\xef\xbb\xbfstep,t_s,u_y_cm\r\n1,0.1,0.5\r\n")
    History(path, COLUMNS, MPI.COMM_SELF, resume_step=5)
    assert read_history(path) == {"step": [1], "t_s": [0.1], "u_y_cm": [0.5]}


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="knows of no ranks")
def test_a_history_that_grows_is_read_on_by_whole_rows_only(tmp_path):
    path = tmp_path / "history.csv"
    reader = HistoryReader(path)
    assert not reader.read()
    assert reader.columns == {}
    for text, new, steps in (
        ("step,t", False, None),
        ("_s\n", True, []),
        ("0,0.0\n1,0.", True, [0]),
        ("", False, [0]),
        ("125", False, [0]),
        ("\n2,oh\n3,0.3,4\n4,0.5\n", True, [0, 1, 4]),
    ):
        with path.open("a") as file:
            file.write(text)
        assert reader.read() == new
        assert (list(reader.columns["step"]) if reader.columns else None) == steps
    assert list(reader.columns["t_s"]) == [0.0, 0.125, 0.5]


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="knows of no ranks")
def test_a_history_that_was_replaced_is_read_from_its_start(tmp_path):
    path = tmp_path / "history.csv"
    path.write_text("step,t_s\n0,0\n1,1\n2,2\n")
    reader = HistoryReader(path)
    reader.read()
    for text in ("step,q\n0,5\n1,6\n2,7\n3,8\n", "step,q\n0,9\n"):
        (tmp_path / "new").write_text(text)
        (tmp_path / "new").replace(path)
        assert reader.read()
        assert [float(row.split(",")[1]) for row in text.split()[1:]] == list(reader.columns["q"])
    path.unlink()
    assert reader.read()
    assert reader.columns == {}
