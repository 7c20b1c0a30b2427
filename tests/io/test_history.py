"""Histories: every digit, and no gap or double after a restart."""

import contextlib

import pytest

from valvefsi.errors import CaseError
from valvefsi.io.history import History, read_history

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
