"""Pictures and summary of a run that has ended: a fault there loses nothing, and all ranks say so."""

from __future__ import annotations

import errno
import json
import os

import pytest

from tests.case.test_resuming import case_with
from valvefsi.case.build import run_case
from valvefsi.errors import SurroundingsError


@pytest.mark.parametrize("what", ["valvefsi.run.pictures._draw_flow", "valvefsi.case.build.report_valve"])
def test_a_disk_that_is_full_after_the_last_step_keeps_the_run_and_all_ranks_say_so(
    what, shared_tmp, comm, monkeypatch
):
    out = shared_tmp / "run"

    def full(*_):
        raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))

    with monkeypatch.context() as small:
        small.setattr(what, full)
        with pytest.raises(
            SurroundingsError, match=r"^File too large; the run itself has ended and is kept: --resume"
        ):
            run_case(case_with(), out=out, comm=comm)
    assert not (out / "summary.json").exists()
    steps = []
    run_case(case_with(), out=out, comm=comm, resume=True, progress=lambda step, *_: steps.append(step))
    assert steps == []
    comm.barrier()
    assert json.loads((out / "summary.json").read_text())["last"]["t_s"] == pytest.approx(0.08)
    assert (out / "flow.png").stat().st_size > 1000
