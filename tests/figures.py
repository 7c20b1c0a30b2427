"""Faults of a picture that a reader would see, found in the figure that was saved; `conftest` looks at every one.

Tick labels that overlap or say the same, text beyond the edge of the figure, headings that run into one another, axes
with nothing in them, and legends over the curves they explain.
"""

from __future__ import annotations

from itertools import combinations, pairwise

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

SLACK = 1.0
"""Pixels that texts may share or lie beyond the edge."""
COVERED = 0.05
"""Part of a curve that a legend may cover."""


def faults(figure):
    """Return what is wrong with a figure that was drawn, one line each."""
    before = figure.canvas
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.set_canvas(before)
    found = [f"empty axes at {_place(axes)}" for axes in _shown(figure) if _is_empty(axes)]
    for axes in _shown(figure):
        if axes.axison and axes.name != "3d":
            found += [f"{fault} at {_place(axes)}" for fault in _of_ticks(axes, renderer)]
        found += [f"{fault} at {_place(axes)}" for fault in _of_legend(axes, renderer)]
    whole = figure.bbox.padded(SLACK)
    for text in _texts(figure):
        box = text.get_window_extent(renderer)
        if box.x0 < whole.x0 or box.x1 > whole.x1 or box.y0 < whole.y0 or box.y1 > whole.y1:
            found.append(f"cut off: {text.get_text()!r}")
    headings = [(text.get_text(), text.get_window_extent(renderer)) for text in _headings(figure)]
    found += [f"overlap: {a!r} and {b!r}" for (a, x), (b, y) in combinations(headings, 2) if _meet(x, y)]
    return found


def _place(axes):
    names = [axes.get_title(loc=where) for where in ("left", "center", "right")]
    names += [axes.get_ylabel(), axes.get_xlabel()]
    return repr(next((name for name in names if name), "axes without a name"))


def _shown(figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def _is_empty(axes):
    """Whether axes hold no artist that could be seen."""
    lines = [line for line in axes.lines if np.isfinite(np.asarray(line.get_xydata(), dtype=float)).any()]
    return not (lines or axes.collections or axes.patches or axes.images or axes.texts or axes.tables)


def _of_ticks(axes, renderer):
    """Yield faults of the tick labels of axes in the plane."""
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        ticks = axis._update_ticks() if axis.get_visible() else []
        for side in ("label1", "label2"):
            labels = [getattr(tick, side) for tick in ticks]
            labels = [label for label in labels if label.get_visible() and label.get_text().strip()]
            boxes = [label.get_window_extent(renderer) for label in labels]
            along = sorted(boxes, key=lambda box: (box.x0, box.y0) if name == "x" else (box.y0, box.x0))
            upright = all(label.get_rotation() % 90 == 0 for label in labels)
            if upright and any(_meet(a, b) for a, b in pairwise(along)):
                yield f"tick labels of {name} overlap: {[label.get_text() for label in labels]}"
            texts = [label.get_text() for label in labels]
            if len(set(texts)) < len(texts):
                yield f"equal tick labels of {name}: {texts}"


def _of_legend(axes, renderer):
    """Yield curves that the legend of axes covers."""
    legend = axes.get_legend()
    if legend is None or not legend.get_visible():
        return
    box = legend.get_window_extent(renderer)
    frame = axes.get_window_extent(renderer)
    for line in axes.lines:
        if line.get_transform() != axes.transData or not line.get_visible():
            continue
        xy = axes.transData.transform(np.asarray(line.get_xydata(), dtype=float))
        xy = xy[np.isfinite(xy).all(axis=1)]
        xy = np.concatenate([a + (b - a) * np.linspace(0, 1, 9)[:, None] for a, b in pairwise(xy)] or [xy])
        seen = xy[_inside(frame, xy)]
        covered = float(np.mean(_inside(box, seen))) if len(seen) else 0.0
        if covered > COVERED:
            yield f"legend covers {100 * covered:.0f} % of {line.get_label()!r}"


def _inside(box, xy):
    return (xy[:, 0] > box.x0) & (xy[:, 0] < box.x1) & (xy[:, 1] > box.y0) & (xy[:, 1] < box.y1)


def _texts(figure):
    """All texts that are drawn."""
    found = list(figure.texts)
    for axes in _shown(figure):
        if axes.axison and axes.name != "3d":
            axles = (axes.xaxis, axes.yaxis)
            drawn = {label for axis in axles for tick in axis._update_ticks() for label in _labels(tick)}
            every = {label for axis in axles for tick in _ticks(axis) for label in _labels(tick)}
            found += [text for text in axes.findobj(Text) if text not in every or text in drawn]
        else:
            found += [axes.title, axes._left_title, axes._right_title, *axes.texts]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


def _ticks(axis):
    return (*axis.majorTicks, *axis.minorTicks)


def _labels(tick):
    return (tick.label1, tick.label2)


def _headings(figure):
    """Texts of the figure, titles and labels of its axes."""
    found = list(figure.texts)
    for axes in _shown(figure):
        found += [axes.title, axes._left_title, axes._right_title]
        if axes.axison and axes.name != "3d":
            found += [axes.xaxis.label, axes.yaxis.label]
    return [text for text in found if text.get_visible() and text.get_text().strip()]


def _meet(a, b):
    """Whether two boxes share more than the slack."""
    return min(a.x1, b.x1) - max(a.x0, b.x0) > SLACK and min(a.y1, b.y1) - max(a.y0, b.y0) > SLACK
