"""From a page to one HTML file that needs no network: template, style, program and plotly's own program in it."""

from __future__ import annotations

import functools
import importlib.resources
import importlib.util
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from valvefsi.errors import SurroundingsError
from valvefsi.io.folder import write_text
from valvefsi.report.blocks import Page, Text, View, is_numeric
from valvefsi.runtime.installing import how_to_add

NEEDED = ("jinja2", "plotly")
LARGEST = 25_000_000
"""Bytes that a page should stay below."""


def check_libraries() -> None:
    """Refuse to begin where a library is missing.

    Raises:
        SurroundingsError: It is; says how to install it.
    """
    absent = [name for name in NEEDED if importlib.util.find_spec(name) is None]
    if absent:
        raise SurroundingsError(f"a report needs {' and '.join(absent)}: {how_to_add('report')}")


def write_page(page: Page, path: Path) -> int:
    """Write a page.

    Args:
        page: The page; all of its text is escaped.
        path: The file.

    Returns:
        Its size [bytes].

    Raises:
        SurroundingsError: A library is missing.
    """
    check_libraries()
    text = html(page)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
    return len(text.encode())


def html(page: Page) -> str:
    """Return a page as HTML."""
    return _rendered("page.html", page=page, library=_library(_drawn(page)))


def live_html(page: Page, view: View) -> str:
    """Return a page on a run that goes on as HTML, whose program asks what serves it for what is new."""
    return _rendered(
        "page.live.html", page=page, view=view, library=_library(True), live=_text("page.live.js")
    )


def blocks_html(blocks: Sequence[Text]) -> str:
    """Return tables, notes and pictures as HTML."""
    macros: Any = _templates().get_template("page.blocks.html").module
    return "".join(macros.text(block) for block in blocks)


def _rendered(name: str, **more: Any) -> str:
    return _templates().get_template(name).render(style=_text("page.css"), program=_text("page.js"), **more)


@functools.cache
def _templates() -> Any:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    made = Environment(
        autoescape=True,
        loader=FunctionLoader(_text),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"shown": shown, "exact": exact}
    made.tests["numeric"] = is_numeric
    return made


def _text(name: str) -> str:
    return importlib.resources.files("valvefsi.report").joinpath(name).read_text(encoding="utf-8")


def _library(needed: bool) -> str:
    """Return plotly's own program where anything of a page is drawn."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs() if needed else ""


def _drawn(page: Page) -> bool:
    """Whether anything of a page is drawn by its program."""
    sections = (section for part in page.parts for section in part.sections)
    return any(block.kind in ("chart", "scene") for section in sections for block in section.blocks)


def shown(cell: object) -> str:
    """Return a cell as it is read: numbers in five digits."""
    if cell is None:
        return "missing"
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, float):
        return f"{cell:.5g}" if math.isfinite(cell) else "not finite"
    return str(cell)


def exact(cell: object) -> str:
    """Return a number with all its digits."""
    return repr(float(cell)) if isinstance(cell, float) else str(cell)
