"""From a page to one HTML file that needs no network: template, style, program and plotly's own program in it."""

from __future__ import annotations

import importlib.resources
import importlib.util
import math
from pathlib import Path

from valvefsi.errors import SurroundingsError
from valvefsi.io.folder import write_text
from valvefsi.report.blocks import Page, is_numeric

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
        raise SurroundingsError(
            f"a report needs {' and '.join(absent)}: pip install 'valvefsi[report]', or make setup"
        )


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
    from jinja2 import Environment, StrictUndefined
    from plotly.offline import get_plotlyjs

    own = importlib.resources.files("valvefsi.report")
    place = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    place.filters |= {"shown": shown, "exact": exact}
    place.tests["numeric"] = is_numeric
    template = place.from_string(own.joinpath("page.html").read_text(encoding="utf-8"))
    style, program = (own.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "page.js"))
    library = get_plotlyjs() if _drawn(page) else ""
    return template.render(page=page, style=style, program=program, library=library)


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
