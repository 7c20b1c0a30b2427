"""The page of the example of ASME V&V 40: goal, evidence and gap of every factor, with numbers from ``docs/results``.

The words are those of ``docs/credibility.toml``; no number of a result stands there. A factor without evidence says so,
and must not be called reached.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "docs" / "credibility.toml"
RESULTS = ROOT / "docs" / "results"
REACHED = ("yes", "in part", "no")
NOTHING = "**No evidence.**"


def credibility(source: Path = SOURCE, results: Path = RESULTS) -> str:
    """Return the page.

    Raises:
        ValueError: Evidence is not there, or a factor without any is called reached.
    """
    told = tomllib.loads(source.read_text(encoding="utf-8"))
    answer = told["answer"]
    parts = [
        f"# {told['title']}",
        "After this page you know what evidence there is that a run of a valve answers one question, and what is "
        "missing. The scheme is that of ASME V&V 40-2018, put in our own words; read the standard for its own. Numbers "
        "are those of the pages they lead to.",
        "## Question, use and risk",
        f"**Question of interest.** {told['question']}",
        f"**Context of use.** {told['context'].strip()}",
        f"**Risk of the model.** Influence on the decision: {told['influence']}. Consequence of a wrong decision: "
        f"{told['consequence']}. Together: {told['risk']}.",
        "## What the run says",
        f"{answer['text']}:",
        *_evidence(answer["evidence"], results),
        answer["limits"].strip(),
        "## In one table",
        _summary(told["factor"]),
    ]
    group = ""
    for factor in told["factor"]:
        if factor["group"] != group:
            group = factor["group"]
            parts.append(f"## {group}")
        parts += _factor(factor, results)
    return "\n\n".join(parts) + "\n"


def _factor(factor: Mapping[str, Any], results: Path) -> list[str]:
    """Return the paragraphs of a factor."""
    evidence = factor.get("evidence", [])
    if factor["reached"] not in REACHED:
        raise ValueError(
            f"{factor['name']}: reached is one of {', '.join(REACHED)}, found {factor['reached']!r}"
        )
    if not evidence and factor["reached"] != "no":
        raise ValueError(f"{factor['name']}: there is no evidence, so that the goal cannot be reached")
    lines = [f"### {factor['name']}", f"*{factor['asks']}*", f"**Goal.** {factor['goal']}."]
    lines += ["**Evidence.**", *_evidence(evidence, results)] if evidence else [NOTHING]
    return [*lines, f"**Goal reached:** {factor['reached']}. **Gap.** {factor['gap']}"]


def _evidence(items: list[Mapping[str, Any]], results: Path) -> list[str]:
    """Return the evidence as one list: numbers with their page, tests with their file."""
    return ["\n".join(f"- {_one(item, results)}" for item in items)]


def _one(item: Mapping[str, Any], results: Path) -> str:
    if "test" in item:
        if not (ROOT / item["test"]).is_file():
            raise ValueError(f"there is no test {item['test']}")
        return f"{item['says']}: `{item['test']}`"
    row = _row(item, results)
    unit = row.get("unit", "")
    known = row.get("reference")
    compared = "" if known is None else f" (reference {_number(known)})"
    if not (ROOT / "docs" / item["page"]).is_file():
        raise ValueError(f"there is no page {item['page']}")
    number = f"{_number(row['computed'])} {unit}".rstrip()
    return f"{item['says']}: {number}{compared}; [page](../{item['page']})"


def _row(item: Mapping[str, Any], results: Path) -> Mapping[str, Any]:
    """Return the first row of a result that matches."""
    path = results / f"{item['results']}.json"
    if not path.is_file():
        raise ValueError(f"there is no result {item['results']}")
    for row in json.loads(path.read_text(encoding="utf-8"))["quantities"]:
        if re.search(item["case"], row["case"]) and re.search(item["quantity"], row["quantity"]):
            return row
    raise ValueError(f"{item['results']}: no quantity matches {item['case']!r}, {item['quantity']!r}")


def _number(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _summary(factors: list[Mapping[str, Any]]) -> str:
    """Return a line for each factor."""
    lines = ["| factor | goal reached | evidence |", "| --- | --- | --- |"]
    for factor in factors:
        count = len(factor.get("evidence", []))
        lines.append(f"| {factor['name']} | {factor['reached']} | {count if count else NOTHING} |")
    return "\n".join(lines)
