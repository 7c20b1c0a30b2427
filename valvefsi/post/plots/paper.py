"""Figures for papers: any picture of this package as vector PDF, one column wide, with the numbers behind it as CSV.

`paper` switches it on for all pictures that are saved in it. One of several panels across is two columns wide. Colours
are those of the screen: lines are Okabe and Ito's, maps are viridis or diverge from red to blue, which colour-blind
readers can tell apart.
"""

from __future__ import annotations

import contextlib
import csv
from collections.abc import Iterator
from contextvars import ContextVar
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import Collection, LineCollection, PolyCollection, QuadMesh
from matplotlib.image import AxesImage
from matplotlib.text import Text

from valvefsi.io.folder import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

INCH = 25.4
ONE, TWO = 85.0 / INCH, 174.0 / INCH
"""One column of a journal, 85 mm, and two, 174 mm [in]."""
LEAST, MOST, PART = 6.0, 8.0, 0.72
"""Smallest and largest type [pt], and the part of the size on the screen in between."""
MARGIN = 0.03
"""Left free above and below [in]."""
TALLER = 1.3
"""How much taller a figure one column wide is for its width than on the screen: its type is larger for its size."""
DPI = 600
"""Pixels to an inch of what is no vector, such as the field of a flow."""
NUMBER = "{:.7g}"
HEADINGS = ("panel", "axes", "kind", "series", "x", "y", "value")
_for_paper: ContextVar[bool] = ContextVar("for_paper", default=False)


@contextlib.contextmanager
def paper(on: bool = True) -> Iterator[None]:
    """Save pictures for papers within it."""
    token = _for_paper.set(on)
    try:
        yield
    finally:
        _for_paper.reset(token)


def for_paper() -> bool:
    """Whether pictures are for papers now."""
    return _for_paper.get()


def save_for_paper(figure: Figure, path: Path) -> Path:
    """Write a figure as ``NAME.pdf`` and its numbers as ``NAME_data.csv``; return the first.

    Headings leave the figure, a paper has its own; they are the first lines of the CSV.
    """
    said = _take_headings(figure)
    _write_numbers(figure, path.with_name(f"{path.stem}_data.csv"), said)
    _resize(figure)
    _crop(figure)
    with replacing(path.with_suffix(".pdf")) as temporary, mpl.rc_context({"pdf.fonttype": 42}):
        figure.savefig(temporary, dpi=DPI)
    return path.with_suffix(".pdf")


def _take_headings(figure: Figure) -> list[str]:
    """Remove what stands above all axes, and return it."""
    top = max((axes.get_position().y1 for axes in figure.axes), default=1.0)
    heads = [text for text in figure.texts if text.get_position()[1] > top]
    for text in heads:
        text.remove()
    return [str(text.get_text()) for text in heads if text.get_text()]


def _resize(figure: Figure) -> None:
    """Make a figure one column wide, or two where panels stand side by side, its type and lines to match."""
    specs = [axes.get_subplotspec() for axes in figure.axes]
    across = max((_columns(spec) for spec in specs if spec is not None), default=1)
    stretched = across == 1 and all(axes.get_aspect() == "auto" for axes in figure.axes)
    width, height = figure.get_size_inches()
    new = TWO if across > 1 else ONE
    figure.set_size_inches(new, height * new / width * (TALLER if stretched else 1.0))
    for artist in figure.findobj(Text):
        artist.set_fontsize(float(np.clip(PART * artist.get_fontsize(), LEAST, MOST)))
    for line in figure.findobj(mpl.lines.Line2D):
        line.set_linewidth(0.6 * line.get_linewidth())
        line.set_markersize(0.6 * line.get_markersize())
    for axes in figure.axes:
        axes.tick_params(length=2.0, pad=2.0)
    _bars_as_vectors(figure)
    if across == 1 and None not in specs:
        figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.02)
        _narrow_legends(figure)
    else:
        _narrow_legends(figure)
        for _ in range(3):
            _fit(figure)
        _break_legends(figure)
    _thin_ticks(figure)


def _bars_as_vectors(figure: Figure) -> None:
    """Draw colour bars as vectors, which matplotlib turns into pixels where they have many colours.

    A colour bar is a mesh one cell across. Edges of the cells' own colours close the hairlines between them.
    """
    for mesh in figure.findobj(QuadMesh):
        if min(np.shape(mesh.get_coordinates())[:2]) == 2:
            mesh.set(rasterized=False, edgecolor="face", linewidth=0.3)


def _narrow_legends(figure: Figure) -> None:
    """Put legends of axes that are wider than these above them, in the columns for which there is width."""
    legends = [(axes, legend) for axes in figure.axes if (legend := axes.get_legend()) is not None]
    for _, legend in legends:
        legend.set_in_layout(False)  # the width of the axes is that without them
    figure.draw_without_rendering()
    for axes, legend in legends:
        width, count = axes.get_window_extent().width, len(legend.get_texts())
        legend.set_in_layout(True)
        if legend.get_window_extent().width <= width:
            continue
        how = {"labels": [text.get_text() for text in legend.get_texts()], "handles": legend.legend_handles}
        how |= {"fontsize": legend.get_texts()[0].get_fontsize(), "frameon": False}
        how |= {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0), "borderaxespad": 0.3}
        made = (axes.legend(ncols=n, **how) for n in range(count, 0, -1))
        next((one for one in made if one.get_window_extent().width <= width), None)


def _thin_ticks(figure: Figure) -> None:
    """Leave out every second tick along x where the numbers at them meet."""
    figure.draw_without_rendering()
    for axes in figure.axes:
        while axes.axison and axes.name != "3d" and _ticks_meet(axes):
            low, high = sorted(axes.get_xlim())
            places = [x for x in axes.xaxis.get_majorticklocs() if low <= x <= high]
            axes.xaxis.set_major_locator(mpl.ticker.FixedLocator(places[::2]))
            figure.draw_without_rendering()


def _ticks_meet(axes: Axes) -> bool:
    """Whether numbers along x lie closer to one another than half of their height."""
    low, high = sorted(axes.get_xlim())
    labels = [tick.label1 for tick in axes.xaxis.get_major_ticks() if low <= tick.get_loc() <= high]
    boxes = [label.get_window_extent() for label in labels if label.get_visible() and label.get_text()]
    boxes.sort(key=lambda box: float(box.x0))
    return any(b.x0 - a.x1 < 0.5 * a.height for a, b in pairwise(boxes))


def _break_legends(figure: Figure) -> None:
    """Put the legends of a figure that are wider than it into two columns, which grow upwards."""
    figure.draw_without_rendering()
    for legend in list(figure.legends):
        box = legend.get_window_extent().transformed(figure.transFigure.inverted())
        if box.x1 > 1.0 or box.x0 < 0.0:
            labels = [text.get_text() for text in legend.get_texts()]
            size = legend.get_texts()[0].get_fontsize()
            where = {"loc": "lower left", "bbox_to_anchor": (max(box.x0, 0.0), box.y0)}
            figure.legend(legend.legend_handles, labels, ncols=2, frameon=False, fontsize=size, **where)
            legend.remove()


def _columns(spec: SubplotSpec) -> int:
    return int(spec.get_topmost_subplotspec().get_gridspec().ncols)


def _fit(figure: Figure) -> None:
    """Move and shrink the axes so that they lie in the figure with all that belongs to them."""
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    size = figure.bbox.size
    whole = mpl.transforms.Bbox.union([box for box in boxes if box is not None])
    low, high = whole.min / size, whole.max / size
    pad = 0.012
    shrink = np.minimum((1.0 - 2 * pad) / np.maximum(high - low, 1e-9), 1.0)
    for axes in figure.axes:
        place = axes.get_position(original=True)
        start = pad + (np.array([place.x0, place.y0]) - low) * shrink
        axes.set_position((*start, *(np.array([place.width, place.height]) * shrink)))


def _crop(figure: Figure) -> None:
    """Take away what is empty above and below."""
    figure.draw_without_rendering()
    drawn, old = figure.get_tightbbox(), float(figure.get_figheight())
    figure.set_layout_engine("none")
    start, new = drawn.y0 - MARGIN, drawn.y1 - drawn.y0 + 2 * MARGIN
    places = [(axes, axes.get_position()) for axes in figure.axes]
    for legend in figure.legends:
        box = legend.get_bbox_to_anchor().transformed(figure.transFigure.inverted())
        legend.set_bbox_to_anchor((box.x0, (box.y0 * old - start) / new, box.width, box.height * old / new))
    for text in figure.texts:
        text.set_y((text.get_position()[1] * old - start) / new)
    figure.set_figheight(new)
    for axes, box in places:
        axes.set_position((box.x0, (box.y0 * old - start) / new, box.width, box.height * old / new))


def _write_numbers(figure: Figure, path: Path, said: list[str]) -> None:
    """Write the numbers behind a figure, one row a point."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        for line in said:
            file.write(f"# {' '.join(line.split())}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADINGS)
        for number, axes in enumerate(figure.axes):
            titles = [axes.get_title(loc=where) for where in ("left", "center", "right")]
            named = " | ".join([*filter(None, titles), axes.get_xlabel(), axes.get_ylabel()])
            for kind, series, points in _numbers(axes):
                series = "" if series.startswith("_") else series  # it has no name in the legend
                for point in points:
                    cells = ["" if v is None else NUMBER.format(v) for v in (*point, None)[:3]]
                    writer.writerow([number, named, kind, series, *cells])


def _numbers(axes: Axes) -> Iterator[tuple[str, str, Any]]:
    """Yield kind, name and points of everything that is drawn in axes; points are (x, y) or (x, y, value)."""
    for line in axes.get_lines():
        yield "line", str(line.get_label()), np.column_stack([np.asarray(v, float) for v in line.get_data()])
    for made in axes.collections:
        yield from _collected(made)
    for image in axes.images:
        yield from _pixels(image)
    for bar in axes.patches:
        if isinstance(bar, mpl.patches.Rectangle):
            (x, y), (w, h) = bar.get_xy(), (bar.get_width(), bar.get_height())
            yield "bar", "", [(x, y), (x + w, y + h)]


def _collected(made: Collection) -> Iterator[tuple[str, str, Any]]:
    """Yield the points of a collection: cells with their value, polygons and segments by number, or markers."""
    name, values = str(made.get_label()), made.get_array()
    if isinstance(made, QuadMesh):
        corners = np.asarray(made.get_coordinates())
        middle = 0.25 * (corners[1:, 1:] + corners[:-1, 1:] + corners[1:, :-1] + corners[:-1, :-1])
        flat = np.ma.filled(np.ma.asarray(values, float), np.nan).ravel()
        yield "cell", name, np.column_stack([middle.reshape(-1, 2), flat])
    elif isinstance(made, PolyCollection | LineCollection):
        kind = "polygon" if isinstance(made, PolyCollection) else "segment"
        known = None if values is None else np.ravel(values)
        for k, path in enumerate(made.get_paths()):
            value = float(known[k]) if known is not None and k < len(known) else float(k)
            yield kind, name, [(*point, value) for point in np.asarray(path.vertices)]
    elif len(made.get_offsets()):
        yield "marker", name, np.asarray(made.get_offsets(), float)


def _pixels(image: AxesImage) -> Iterator[tuple[str, str, Any]]:
    """Yield the values of an image in their places; one of colours has no numbers."""
    values = np.ma.filled(np.ma.asarray(image.get_array(), float), np.nan)
    if values.ndim != 2:
        yield "picture of colours, without numbers", str(image.get_label()), [(None, None)]
        return
    left, right, low, high = image.get_extent()
    rows, columns = values.shape
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    y = low + (np.arange(rows) + 0.5) * (high - low) / rows
    y = y if image.origin == "lower" else y[::-1]
    yield (
        "pixel",
        str(image.get_label()),
        np.column_stack([*(g.ravel() for g in np.meshgrid(x, y)), values.ravel()]),
    )
