"""The example of V&V 40: every factor has goal, evidence or its absence, and gap; numbers are those of results."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest

from tests.test_documents import program

credibility = program("credibility")
ROOT = Path(__file__).parents[1]
FACTOR = """
[[factor]]
group = "A"
name = "Something"
asks = "Is it?"
goal = "It is"
reached = "{reached}"
gap = "All of it."
"""
EVIDENCE = """
[[factor.evidence]]
results = "channel"
case = ""
quantity = "^womersley: observed order"
says = "order"
page = "validation/fluid.md"
"""


def page_of(tmp_path, tail, **change):
    """The page of the source with other factors at its end."""
    text = credibility.SOURCE.read_text(encoding="utf-8").split("[[factor]]")[0] + tail
    source = tmp_path / "source.toml"
    source.write_text(text, encoding="utf-8")
    return credibility.credibility(source, **change)


def test_every_factor_has_a_goal_evidence_or_its_absence_and_a_gap():
    page = credibility.credibility()
    factors = page.split("\n### ")[1:]
    assert len(factors) == 13, "those of the standard"
    for factor in factors:
        assert "**Goal.** " in factor
        assert ("**Evidence.**" in factor) != (credibility.NOTHING in factor)
        assert re.search(r"\*\*Gap\.\*\* \S", factor)
    assert sum(credibility.NOTHING in factor for factor in factors) >= 1, (
        "there are gaps, and the page says them"
    )
    assert page.count("| **No evidence.** |") == sum(credibility.NOTHING in factor for factor in factors)


def test_its_numbers_are_those_of_the_results(tmp_path):
    shutil.copytree(credibility.RESULTS, tmp_path / "results")
    path = tmp_path / "results" / "channel.json"
    result = json.loads(path.read_text(encoding="utf-8"))
    next(row for row in result["quantities"] if row["quantity"] == "womersley: observed order")[
        "computed"
    ] = 1.2345
    path.write_text(json.dumps(result), encoding="utf-8")
    tail = FACTOR.format(reached="yes") + EVIDENCE
    assert "order: 1.86 (reference 2);" in page_of(tmp_path, tail)
    assert "order: 1.234 (reference 2);" in page_of(tmp_path, tail, results=tmp_path / "results")


def test_no_measured_number_of_this_program_is_typed_into_its_source():
    text = credibility.SOURCE.read_text(encoding="utf-8")
    typed = set(re.findall(r"\d+\.\d+ ?(?:%|mm|ms|ml|mmHg|cm)", text))
    assert typed <= {"0.53 mm", "2.5 %", "97.5 %"}, "a spacing, and the names of rows"


def test_a_factor_without_evidence_says_so_and_must_not_be_called_reached(tmp_path):
    assert credibility.NOTHING in page_of(tmp_path, FACTOR.format(reached="no"))
    for reached in ("yes", "in part"):
        with pytest.raises(ValueError, match="Something: there is no evidence"):
            page_of(tmp_path, FACTOR.format(reached=reached))
    with pytest.raises(ValueError, match="reached is one of yes, in part, no, found 'nearly'"):
        page_of(tmp_path, FACTOR.format(reached="nearly"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"channel"', '"chanel"', "there is no result chanel"),
        ("womersley: observed", "womersly", "no quantity matches"),
        ("fluid.md", "fluids.md", "there is no page validation/fluids.md"),
        ('results = "channel"', 'test = "tests/test_nothing.py"', "there is no test tests/test_nothing.py"),
    ],
)
def test_evidence_that_is_not_there_is_noticed(tmp_path, old, new, said):
    with pytest.raises(ValueError, match=said):
        page_of(tmp_path, FACTOR.format(reached="yes") + EVIDENCE.replace(old, new))
