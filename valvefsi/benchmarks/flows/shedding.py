"""Drag and lift of a cylinder that sheds vortices: read off, compared, drawn."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.benchmarks import references
from valvefsi.benchmarks.results import Row, row
from valvefsi.grid import Array
from valvefsi.io.folder import replacing

LABELS = {"drag": "mean drag", "lift": "amplitude of lift", "strouhal": "Strouhal number"}
Band = tuple[float, float]


@dataclass(frozen=True)
class Forces:
    """Times, coefficients of drag and lift, ``(n,)`` each."""

    t: Array
    drag: Array
    lift: Array


def published(reynolds: float) -> dict[str, tuple[Band, str]]:
    """Return the published range and its source by quantity; empty for other Reynolds numbers than 100 and 200."""
    return {
        line["quantity"]: ((float(line["low"]), float(line["high"])), line["source"])
        for line in references.read("cylinder").rows
        if float(line["reynolds"]) == reynolds
    }


def fitted(reynolds: float) -> dict[str, float]:
    """Return what `valvefsi.benchmarks.flows.cylinder_fitted` found, by quantity."""
    rows = references.read("cylinder_fitted").rows
    return {line["quantity"]: float(line["value"]) for line in rows if float(line["reynolds"]) == reynolds}


def table_of(found: Mapping[str, float], reynolds: float) -> list[Row]:
    """Return the rows that compare what was found with the middle of the published ranges."""
    known, lines = published(reynolds), []
    for key, label in LABELS.items():
        band, source = known.get(key, (None, ""))
        lines.append(row(label, found[key], sum(band) / 2 if band else None, source))
    return lines


def numbers(forces: Forces) -> dict[str, float]:
    """Mean drag, amplitude of the lift (mean over periods) and its frequency, in the last third of a record."""
    t, drag, lift = forces.t, forces.drag, forces.lift
    late = t > t[0] + 2.0 / 3.0 * (t[-1] - t[0])
    t, drag, lift = t[late], drag[late], lift[late]
    away = lift - lift.mean()
    up = np.flatnonzero((away[:-1] < 0.0) & (away[1:] >= 0.0))
    if len(up) < 3:
        return {"drag": float(drag.mean()), "lift": float(np.abs(away).max()), "strouhal": float("nan")}
    crossing = t[up] - away[up] * (t[up + 1] - t[up]) / (away[up + 1] - away[up])
    periods = [lift[first:last] for first, last in itertools.pairwise(up)]
    return {
        "drag": float(drag[up[0] : up[-1]].mean()),
        "lift": float(np.mean([0.5 * (period.max() - period.min()) for period in periods])),
        "strouhal": float((len(up) - 1) / (crossing[-1] - crossing[0])),
    }


def draw_forces(out: Path, forces: Forces, reynolds: float, title: str) -> None:
    """Write ``forces.csv`` and ``forces.png``, with the published ranges."""
    from valvefsi.post.plots.decay import forces as draw

    curves = (forces.t, forces.drag, forces.lift)
    columns = np.stack(curves, axis=1)[:: max(1, len(forces.t) // 5000)]
    with replacing(out / "forces.csv") as path:
        np.savetxt(path, columns, delimiter=",", comments="", header="t,drag,lift")
    draw(
        out / "forces.png", curves, {key: band for key, (band, _) in published(reynolds).items()}, title=title
    )
