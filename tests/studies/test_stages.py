"""Stages: made when their inputs change, skipped when not, alone where that is asked for."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from valvefsi.errors import CaseError
from valvefsi.studies.stages import Stage, Stages


class Chain:
    """Two numbers are added up, and the sum is squared beside a third one: stages that count their calls."""

    def __init__(self, folder):
        self.folder, self.calls, self.lines = folder, [], []
        self.values, self.broken = {"a": 1.0, "b": 2.0}, ""
        self.file = folder / "third.txt"
        self.file.write_text("3")

    def stages(self):
        return Stages(
            self.folder / "out",
            [
                Stage(name="sum-plain", inputs=self.values, make=self.sum, outputs=("sum.txt",)),
                Stage(
                    name="square",
                    inputs={"third": self.file},
                    make=self.square,
                    outputs=("square.txt",),
                    after=("sum-plain",),
                ),
            ],
            self.lines.append,
        )

    def sum(self, folder):
        self.calls.append("sum")
        (folder / "sum.txt").write_text(str(round(sum(self.values.values()))))
        return {"sum": sum(self.values.values())}

    def square(self, folder):
        self.calls.append("square")
        if self.broken:
            raise CaseError(self.broken)
        number = int((folder.parent / "sum-plain" / "sum.txt").read_text()) ** 2 + int(self.file.read_text())
        (folder / "square.txt").write_text(str(number))
        return {"square": number}

    def made(self, **options):
        """The calls that making all of it takes."""
        self.calls.clear()
        self.lines.clear()
        self.stages().make(**options)
        return list(self.calls)


@pytest.fixture
def chain(tmp_path):
    return Chain(tmp_path)


def test_everything_is_made_once_and_then_unchanged(chain):
    assert chain.made() == ["sum", "square"]
    assert chain.stages().record("square")["result"] == {"square": 12}
    assert chain.made() == []
    assert chain.lines == ["sum-plain: unchanged", "square: unchanged"]
    assert chain.made(again=True) == ["sum", "square"]


def test_a_value_that_changes_makes_what_depends_on_it(chain):
    chain.made()
    chain.values["a"] = 5.0
    assert chain.made() == ["sum", "square"]
    assert chain.lines[0] == "sum-plain: changed: a"
    assert chain.lines[2] == "square: changed: sum-plain/sum.txt"


def test_a_stage_whose_sources_come_out_the_same_is_not_made_again(chain):
    chain.made()
    chain.values["a"] = 1.1
    assert chain.made() == ["sum"], "the sum is rounded in the file"


def test_a_file_counts_by_what_it_holds(chain):
    chain.made()
    other = chain.folder / "other.txt"
    other.write_text("3")
    chain.file = other
    assert chain.made() == []
    other.write_text("4")
    assert chain.made() == ["square"]
    assert chain.lines[1] == "square: changed: third"


def test_a_value_that_goes_and_one_that_comes_are_changes(chain):
    chain.made()
    chain.values = {"a": 3.0}
    assert chain.made() == ["sum"]
    assert "changed: a and 1 more" in chain.lines[0]


def test_an_output_that_is_missing_is_made_again(chain):
    chain.made()
    (chain.folder / "out" / "sum-plain" / "sum.txt").unlink()
    assert chain.made() == ["sum"]
    assert "sum-plain: sum.txt is missing" in chain.lines


def test_what_failed_is_made_again_and_nothing_before_it(chain):
    chain.made()
    chain.file.write_text("7")
    chain.broken = "the disk is on fire"
    with pytest.raises(CaseError, match="the disk is on fire"):
        chain.made()
    chain.broken = ""
    chain.file.write_text("3")  # the inputs of the last one that was made: its files may be torn all the same
    assert chain.made() == ["square"]
    assert "square: not made yet" in chain.lines


def test_a_torn_record_is_none(chain):
    chain.made()
    record = chain.folder / "out" / "square" / "stage.json"
    record.write_text(record.read_text()[:40])
    assert chain.made() == ["square"]


def test_a_stage_alone_is_made_from_what_is_there(chain):
    with pytest.raises(
        CaseError, match=r"stage = 'square': it reads the files of sum-plain, which was not made"
    ):
        chain.made(only=["square"])
    assert chain.made(only=["sum-plain"]) == ["sum"]
    assert chain.made(only=["square"]) == ["square"]
    chain.values["a"] = 5.0
    chain.file.write_text("8")
    assert chain.made(only=["square"]) == ["square"]
    assert chain.lines[0] == "note: sum-plain is not up to date (changed: a)"
    assert chain.stages().record("square")["result"] == {"square": 17}


def test_a_name_stands_for_a_stage_or_for_all_of_a_kind(chain):
    stages = chain.stages()
    assert stages.chosen("square") == ("square",)
    assert stages.chosen("sum") == ("sum-plain",)
    with pytest.raises(CaseError, match="stage = 'squ': no such stage, expected one of sum-plain, square"):
        stages.chosen("squ")


def test_a_file_that_cannot_be_read_is_named(chain):
    chain.file = chain.folder / "none.txt"
    with pytest.raises(CaseError, match="none.txt: cannot read this file: No such file"):
        chain.made()


def test_the_record_says_what_it_was_made_from(chain):
    chain.made()
    found = json.loads((chain.folder / "out" / "square" / "stage.json").read_text())
    assert found["inputs"].keys() == {"third", "sum-plain/sum.txt"}
    assert all(len(value) == 64 for value in found["inputs"].values())
    assert {"date", "wall_s", "valvefsi"} <= found.keys()


def test_stages_out_of_order_are_refused(tmp_path):
    later = Stage(name="b", inputs={}, make=lambda folder: {}, outputs=(), after=("a",))
    with pytest.raises(ValueError, match="b: expected a name of its own, after a"):
        Stages(tmp_path, [later])
    first = Stage(name="a", inputs={}, make=lambda folder: {}, outputs=())
    with pytest.raises(ValueError, match="a: expected"):
        Stages(tmp_path, [first, first])


def test_an_input_that_is_no_value_is_refused(tmp_path):
    odd = Stages(tmp_path, [Stage(name="a", inputs={"x": {1, 2}}, make=lambda folder: {}, outputs=())])
    with pytest.raises(TypeError, match="found set"):
        odd.make()


def test_a_folder_takes_one_call_at_a_time(chain):
    first = chain.stages()
    refused = []

    def second(folder):
        with pytest.raises(CaseError, match="another run or study holds this folder, process") as error:
            chain.stages().make()
        refused.append(error.value.file)
        return chain.sum(folder)

    first.stages["sum-plain"] = replace(first.stages["sum-plain"], make=second)
    first.make()
    assert refused == [chain.folder / "out"]
    assert chain.calls == ["sum", "square"]
    assert chain.made() == []
