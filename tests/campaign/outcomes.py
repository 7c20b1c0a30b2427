"""What can come of an attack, the log of what came, and the table of counts."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

REFUSED, ACCEPTED, FAILED = "refused in one line", "accepted, sound", "run failed in one line"
RESUMED, ROWS_LOST = "resumed, same answer", "resumed, rows of the history lost"
GOOD = (
    *(REFUSED, ACCEPTED, FAILED, RESUMED, ROWS_LOST, "accepted or", "rows of"),
    *("kill -9", "full disk", "stopped and", "clock that"),
)
BAD = ("failed:", "another answer", "torn", "hung", "not one line")
RIGHT, LOST, ELSE = "accepted or resumed, right answer", "rows of the history lost, right end", "else"
COLUMNS = {REFUSED: REFUSED, FAILED: FAILED, ACCEPTED: RIGHT, RESUMED: RIGHT, ROWS_LOST: LOST}
"""Columns of the published table of damaged files, by outcome."""
ALWAYS = (REFUSED, RIGHT, LOST, ELSE)
"""Columns that stand in the table with a count of none too."""


def is_bad(outcome: str) -> bool:
    """Return whether an outcome is a fault of the program."""
    return not outcome.startswith(GOOD) or any(word in outcome for word in BAD)


def columns(outcomes: Iterable[str]) -> Counter[str]:
    """Return the counts of damaged files by the columns of the published table."""
    found = Counter(COLUMNS.get(outcome, ELSE) for outcome in outcomes)
    return Counter({**dict.fromkeys(ALWAYS, 0), **found})


class Log:
    """A file of outcomes, one line for each attack as it ends, so that a campaign that was ended goes on.

    Args:
        path: The file; None for none.
        seed: Seed of the campaign; lines of other seeds are passed over.
    """

    def __init__(self, path: Path | None, seed: int) -> None:
        self._path, self._seed = path, seed

    def read(self, attack: str) -> dict[int, list[str]]:
        """Return the outcomes of an attack, by the number of its item."""
        lines = (
            self._path.read_text(encoding="utf-8").splitlines() if self._path and self._path.is_file() else []
        )
        entries = [json.loads(line) for line in lines]
        return {number: out for seed, name, number, out in entries if seed == self._seed and name == attack}

    def add(self, attack: str, number: int, outcomes: list[str]) -> None:
        """Put one line into the file."""
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps([self._seed, attack, number, outcomes]) + "\n")
