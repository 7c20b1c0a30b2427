"""Pictures of the bending stiffness of thin elements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from valvefsi.post.plots.base import INK, LINES, STYLE, headings, plain, saved
from valvefsi.types import Array

NAMES = {
    "layers_1": "solid shell, one layer",
    "layers_2": "solid shell, two layers",
    "linear_hexahedra": "linear hexahedra, all of kappa at every point",
}


def edge_series(path: Path, series: Mapping[str, Sequence[float]], *, title: str) -> Path:
    """Draw ratios of stiffness over the edge of the elements, on logarithmic axes.

    Args:
        path: The picture, PNG or PDF.
        series: "edge_cm" and the ratios at these edges by the names of `NAMES`.
        title: Heading.
    """
    edges = [10.0 * edge for edge in series["edge_cm"]]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 4.2), dpi=160, facecolor="white")
        axes = figure.subplots()
        figure.subplots_adjust(left=0.12, right=0.97, top=0.83, bottom=0.13)
        axes.axhspan(0.95, 1.05, color=INK, alpha=0.08, lw=0)
        for colour, (name, label) in zip(LINES, NAMES.items(), strict=False):
            axes.loglog(edges, series[name], "o-", color=colour, label=label)
        axes.set_xticks(edges, [f"{edge:g}" for edge in edges])
        axes.minorticks_off()
        axes.set_xlabel("edge of the elements [mm]")
        axes.set_ylabel("stiffness over the incompressible one [-]")
        axes.legend(frameon=False)
        plain(axes)
        headings(figure, title, "the band is 5 % either way")
        return saved(figure, path)


def over_kappa(path: Path, columns: Mapping[str, Array], *, title: str) -> Path:
    """Draw volume and shape under load, and the stable step, over the bulk modulus.

    Args:
        path: The picture, PNG or PDF.
        columns: "kappa" and what was found at it, ``(n,)`` each.
        title: Heading.
    """
    kappa = columns["kappa"]
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(7.2, 5.6), dpi=160, facecolor="white")
        upper, lower = figure.subplots(2, 1, sharex=True)
        figure.subplots_adjust(left=0.12, right=0.97, top=0.88, bottom=0.1, hspace=0.12)
        errors = {
            "volume_change_percent": "change of volume",
            "deflection_error_percent": "error of deflection",
        }
        for colour, (name, label) in zip(LINES, errors.items(), strict=False):
            upper.loglog(kappa, np.abs(columns[name]), "o-", color=colour, label=label)
        upper.axhline(1.0, color=INK, lw=0.8, ls="--")
        upper.set_ylabel("size [%]")
        steps = {"stable_step_us": "at rest", "stable_step_loaded_us": "under load"}
        for colour, (name, label) in zip(LINES, steps.items(), strict=False):
            lower.loglog(kappa, columns[name], "o-", color=colour, label=label)
        lower.set_ylabel("stable step [us]")
        lower.set_xlabel("bulk modulus [dyn/cm$^2$]")
        for axes in (upper, lower):
            axes.legend(frameon=False)
        headings(figure, title, "dashed: 1 %")
        return saved(figure, path)


def ratio_points(path: Path, strips: Sequence[tuple[Mapping[str, object], Mapping[str, object]]]) -> Path:
    """Draw the ratios of stiffness of many strips, a panel for each kind; what was not found is missing.

    Args:
        path: The picture, PNG or PDF.
        strips: What each strip is ("material", "angle", "radius", "thickness", "layers") and its ratios by name.
    """
    kinds = list(dict.fromkeys(name for _, ratios in strips for name in ratios))
    rows = list(dict.fromkeys((strip["material"], strip["angle"], strip["radius"]) for strip, _ in strips))
    with mpl.rc_context(STYLE):
        height = 1.9 + 0.3 * len(rows)
        figure = Figure(figsize=(10.6, height), dpi=160, facecolor="white")
        panels = np.atleast_1d(figure.subplots(1, len(kinds), sharey=True))
        edges = {"top": 1 - 0.8 / height, "bottom": 0.65 / height}
        figure.subplots_adjust(left=0.34, right=0.97, wspace=0.22, **edges)
        for axes, kind in zip(panels, kinds, strict=True):
            axes.axvspan(0.95, 1.05, color=INK, alpha=0.08, lw=0)
            for strip, ratios in strips:
                value = ratios.get(kind)
                if isinstance(value, float):
                    at = rows.index((strip["material"], strip["angle"], strip["radius"]))
                    thick, layers = float(str(strip["thickness"])), int(str(strip["layers"]))
                    colour, shift = LINES[layers - 1], 5 * (thick - 0.04)
                    axes.plot(value, at + shift, "o", ms=3.5, color=colour, mew=0)
            axes.set_xlabel(kind.replace("_", " "))
            plain(axes)
        names = [f"{str(m).replace('_', ' ')}, {a:g} deg, {'curved' if r else 'flat'}" for m, a, r in rows]
        panels[0].set_yticks(range(len(rows)), names)
        panels[0].set_ylim(len(rows) - 0.5, -0.5)
        headings(
            figure,
            "Strips of leaflet, solid shell over incompressible",
            "one layer and two (second colour); the band is 5 % either way",
        )
        return saved(figure, path)
