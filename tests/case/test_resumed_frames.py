"""Lists of times that are damaged: made again from the checkpoint, so that no frame is lost or written over."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.campaign.comparison import differences
from tests.case.test_resuming import SELF, broken_off, case_with
from valvefsi.case.build import run_case
from valvefsi.io import checkpoint

pytestmark = pytest.mark.serial


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    run_case(case_with(), out=out, comm=SELF)
    return out


def lose_second_entry(path):
    lines = path.read_text().splitlines(keepends=True)
    first = next(k for k, line in enumerate(lines) if "DataSet " in line)
    path.write_text("".join(lines[: first + 1] + lines[first + 2 :]))


LIST_DAMAGE = {
    "missing": Path.unlink,
    "an entry lost": lose_second_entry,
    "another's": lambda path: path.write_bytes(path.with_name("block.pvd").read_bytes()),
}


@pytest.mark.parametrize("damage", LIST_DAMAGE)
def test_a_damaged_list_of_times_is_made_again_from_the_checkpoint(damage, tmp_path, whole):
    out = broken_off(tmp_path / "run", 30)
    LIST_DAMAGE[damage](out / "paraview" / "fluid.pvd")
    with pytest.warns(UserWarning, match=r"fluid\.pvd: \d of 3 entries are put in again from the checkpoint"):
        run_case(case_with(), out=out, resume=True, comm=SELF)
    assert differences(out, whole) == {}


def test_a_checkpoint_of_an_earlier_version_takes_the_frames_from_the_lists(tmp_path, whole, monkeypatch):
    def without_frames(folder, step, fields, rows, meta, *others, **options):
        return save(
            folder, step, fields, rows, {k: v for k, v in meta.items() if k != "frames"}, *others, **options
        )

    save = checkpoint.save
    monkeypatch.setattr(checkpoint, "save", without_frames)
    out = broken_off(tmp_path / "run", 30)
    monkeypatch.undo()
    lose_second_entry(out / "paraview" / "fluid.pvd")
    with pytest.warns(UserWarning, match=r"fluid\.pvd: 1 of 3 entries are put in again"):
        run_case(case_with(), out=out, resume=True, comm=SELF)
    assert differences(out, whole) == {}
