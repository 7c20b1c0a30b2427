"""A cylinder that sheds vortices at Re 100 and 200: drag, lift and frequency read off, compared, drawn."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.benchmarks import references
from valvefsi.benchmarks.frame import Benchmark, R, Record, Report
from valvefsi.benchmarks.results import row
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


@dataclass(frozen=True, kw_only=True)
class Shedding(Benchmark[R, None]):
    """One run until the cylinder sheds vortices regularly; its record holds ``grid``, ``steps`` and ``_forces``."""

    @abstractmethod
    def mesh_of(self, record: Record) -> str:
        """Return what a run was on, for the title of the picture."""

    @property
    def bands(self) -> dict[str, tuple[Band, str]]:
        """The published range and its source by quantity; empty for Reynolds numbers that are not published."""
        return {
            line["quantity"]: ((float(line["low"]), float(line["high"])), line["source"])
            for line in references.read("cylinder").rows
            if float(line["reynolds"]) == self.values["reynolds"]
        }

    def report(self, records: Sequence[Record], reference: None) -> Report:
        (r,), bands, table = records, self.bands, []
        for key, label in LABELS.items():
            band, source = bands.get(key, (None, ""))
            table.append(row(label, r["quantities"][key], sum(band) / 2 if band else None, source))
        return Report(
            parameters=self.values | r["grid"],
            quantities=r["quantities"],
            reference={key: list(band) for key, (band, _) in bands.items()},
            table=table,
            timing={"steps": r["steps"]},
        )

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        """Write ``forces.csv`` and ``forces.png``, with the published ranges."""
        from valvefsi.post.plots.decay import forces as draw

        (r,), reynolds = records, self.values["reynolds"]
        forces, title = r["_forces"], f"Cylinder at Re {reynolds:g}, {self.mesh_of(r)}"
        curves = (forces.t, forces.drag, forces.lift)
        columns = np.stack(curves, axis=1)[:: max(1, len(forces.t) // 5000)]
        with replacing(out / "forces.csv") as path:
            np.savetxt(path, columns, delimiter=",", comments="", header="t,drag,lift")
        draw(out / "forces.png", curves, {key: band for key, (band, _) in self.bands.items()}, title=title)


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
