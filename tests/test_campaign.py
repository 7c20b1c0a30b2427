"""A short slice of the campaign, and that the campaign sees what it is for."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from tests.campaign import fuzz
from tests.campaign.__main__ import COUNTS
from tests.campaign.fuzz import ACCEPTED, REFUSED, one
from valvefsi.errors import CaseError

pytestmark = pytest.mark.serial
SLICE = {"cases": 40, "csv": 60, "meshes": 20, "folders": 5}


@pytest.mark.parametrize("kind", SLICE)
def test_damaged_files_are_refused_in_one_line_or_give_what_they_say(kind, tmp_path):
    found = Counter(one(kind, 20, number, tmp_path) for number in range(SLICE[kind]))
    good = (REFUSED, ACCEPTED, fuzz.FAILED, "resumed, same answer", "resumed, rows of the history lost")
    assert {outcome: times for outcome, times in found.items() if outcome not in good} == {}
    assert found[REFUSED] > 0 or kind == "folders"
    assert sum(found[outcome] for outcome in good if outcome != REFUSED) > 0 or kind == "meshes"


@pytest.mark.parametrize(
    ("fault", "outcome"),
    [
        (ZeroDivisionError("division by zero"), "TRACEBACK: ZeroDivisionError: 'division by zero'"),
        (CaseError("x" * 3000), REFUSED),
        (OSError("a\nb"), "NOT ONE LINE: 'a\\nb'"),
    ],
)
def test_the_campaign_tells_a_fault_from_a_refusal(fault, outcome, tmp_path, monkeypatch):
    def fail(rng, folder):
        raise fault

    monkeypatch.setitem(fuzz.ATTACKS, "cases", fail)
    assert one("cases", 1, 0, tmp_path) == outcome


def test_the_campaign_sees_a_hang(tmp_path, monkeypatch):
    def hang(rng, folder):
        while True:
            pass

    monkeypatch.setitem(fuzz.ATTACKS, "cases", hang)
    monkeypatch.setattr(fuzz, "PATIENCE", 1)
    assert one("cases", 1, 0, tmp_path) == "HANG"


def test_the_campaign_sees_another_answer(tmp_path, monkeypatch):
    real = fuzz.difference
    monkeypatch.setattr(fuzz, "difference", lambda ours, theirs: 1e-3 + real(ours, theirs))
    monkeypatch.setattr(fuzz, "last_gap", lambda ours, theirs: 1e-3)
    found = {one("folders", 20, number, tmp_path) for number in range(3)}
    assert any(outcome.startswith("WRONG: 1.0e-03 off") for outcome in found)


def test_an_item_follows_from_its_seed_alone():
    texts = [fuzz.mutated(fuzz.SMALL, random.Random("cases 1 7"), ",") for _ in range(2)]
    assert texts[0] == texts[1] != fuzz.SMALL
    assert set(COUNTS) == {*fuzz.ATTACKS, "kills"}
