"""What a page is made of: sections of tables, notes, pictures, charts and scenes. All text in it is plain text."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from valvefsi.types import Array, Indices

Cell = str | int | float | bool | None
"""A cell of a table; a number is shown in five digits and kept in all of them, None is said to be missing."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table; the first column names its rows.

    Attributes:
        caption: What it shows.
        headings: Of the columns.
        rows: Cells of each row, as many as there are headings.
        folded: Heading under which it is folded away, "" for one that is open.
    """

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    folded: str = ""
    kind: Literal["table"] = "table"

    @property
    def of_numbers(self) -> list[bool]:
        """Whether each column holds numbers and nothing else, but for what is missing."""
        columns = [[row[k] for row in self.rows] for k in range(len(self.headings))]
        return [
            any(is_numeric(c) for c in column) and all(c is None or c == "-" or is_numeric(c) for c in column)
            for column in columns
        ]


@dataclass(frozen=True, kw_only=True)
class Note:
    """A line of text.

    Attributes:
        text: The text.
        tone: ``plain``, ``missing`` for what is not there, ``warning`` for what a reader must know.
    """

    text: str
    tone: Literal["plain", "missing", "warning"] = "plain"
    kind: Literal["note"] = "note"


@dataclass(frozen=True, kw_only=True)
class Picture:
    """A picture.

    Attributes:
        source: The picture as a ``data:`` address.
        alt: What is seen, for those who do not see it.
        caption: Line under it.
    """

    source: str
    alt: str
    caption: str
    kind: Literal["picture"] = "picture"


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Something drawn by the page itself.

    Attributes:
        kind: ``chart``, curves over time; ``scene``, bodies and planes to turn, over time.
        alt: What is seen, for those who do not see it.
        caption: Line under it.
        data: What is drawn; arrays as `packed` gives them.
    """

    kind: Literal["chart", "scene"]
    alt: str
    caption: str
    data: Mapping[str, Any]


def is_numeric(cell: object) -> bool:
    """Whether a cell holds a number."""
    return isinstance(cell, int | float) and not isinstance(cell, bool)


Text = Table | Note | Picture
Block = Text | Figure


@dataclass(frozen=True, kw_only=True)
class Section:
    """A part of a page with a heading.

    Attributes:
        title: The heading.
        blocks: What is in it.
    """

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """All that is said of one folder, or of two compared.

    Attributes:
        title: The heading.
        about: Line under it.
        sections: Its sections.
    """

    title: str
    about: str
    sections: Sequence[Section]


@dataclass(frozen=True, kw_only=True)
class Page:
    """A page.

    Attributes:
        title: Its title.
        made: What made it and when.
        parts: Its parts.
    """

    title: str
    made: str
    parts: Sequence[Chapter] = field(default_factory=tuple)


@dataclass(frozen=True, kw_only=True)
class View:
    """What the head of a page on a run that goes on shows.

    Attributes:
        layout: What the page must be loaded again for when it changes.
        state: State of the run, one word.
        line: State of the run, one line.
        share: Part of the run that is done, None where that is not known.
        told: What else is said of it.
    """

    layout: str
    state: str
    line: str
    share: float | None
    told: Sequence[Text]


def missing(what: str) -> Note:
    """Return the note on something that is not there."""
    return Note(text=what, tone="missing")


def picture(path: Path, alt: str, caption: str = "") -> Picture:
    """Return a PNG file as a picture."""
    coded = base64.b64encode(Path(path).read_bytes()).decode("ascii")
    return Picture(source=f"data:image/png;base64,{coded}", alt=alt, caption=caption or alt)


def packed(values: Array | Indices, kind: str = "f8") -> dict[str, Any]:
    """Return an array as the page reads it, its bytes in base 64: ``f8`` as it is, ``u2`` in 65535 steps of its range.

    Args:
        values: The array, of any shape, finite.
        kind: ``f8``, ``u2`` (16 bits, with ``low`` and ``step``) or ``u4`` (whole numbers).
    """
    array = np.asarray(values)
    said: dict[str, Any] = {"type": kind, "shape": list(array.shape)}
    if kind == "u2":
        low, high = float(array.min(initial=np.inf)), float(array.max(initial=-np.inf))
        step = (high - low) / 65535 or 1.0
        said |= {"low": low, "step": step}
        array = np.rint((array - low) / step)
    said["data"] = base64.b64encode(np.ascontiguousarray(array, dtype=f"<{kind}").tobytes()).decode("ascii")
    return said
