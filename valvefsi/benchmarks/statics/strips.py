"""Many strips of leaflet: thin and thick, one and two layers, coarse and fine, with fibres and without, flat, curved.

Each is bent, turned by 90 degrees, pulled and twisted as in `valvefsi.benchmarks.statics.bending`, and compared with
Taylor-Hood elements; what finds no equilibrium says so.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.options import option
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.statics.bending import Strip, answers, ratio_of, reference_counts
from valvefsi.errors import ConvergenceError
from valvefsi.post.plots.bending import ratio_points
from valvefsi.solid.statics import SolidShell, TaylorHood

MATERIALS = {
    "bovine_pericardium_lee_sacks": (0.0,),
    "porcine_leaflet_hgo": (0.0, 90.0, 45.0),
    "bovine_pericardium_hgo": (0.0, 90.0, 45.0),
}
"""Presets, and the angles of the fibres to the strip's length [deg]; the first has none."""
THICKNESSES = (0.2, 0.4, 0.6)
"""Thicknesses [mm]."""
EDGES = (1.0, 0.5)
"""Edges of the elements [mm]."""
SHAPES = ("flat", "curved")
PASS = 0.05
"""What a ratio may differ from 1 by."""
MEMBRANE = 0.01
"""The same of the membrane."""


@dataclass(frozen=True, kw_only=True)
class Strips(Benchmark[Strip, None]):
    """A matrix of strips."""

    name = "strips"
    keeps = True

    materials: tuple[str, ...] = option(tuple(MATERIALS), "Presets.", metavar="M,M", choices=tuple(MATERIALS))
    thicknesses: tuple[float, ...] = option(
        THICKNESSES, "Thicknesses [mm].", metavar="T,T", least=0.1, most=1.0
    )
    edges: tuple[float, ...] = option(
        EDGES, "Edges of the elements [mm].", metavar="E,E", least=0.25, most=2.0
    )
    layers: tuple[int, ...] = option(
        (1, 2), "Elements through the thickness.", metavar="N,N", least=1, most=4
    )
    shapes: tuple[str, ...] = option(SHAPES, "flat, curved with 12 mm.", metavar="S,S", choices=SHAPES)
    kappa: float = option(1e8, "Numerical bulk modulus [dyn/cm^2].")

    def runs(self) -> list[Strip]:
        """Return the strips; those that share a reference follow one another."""
        return [
            Strip(
                thickness=0.1 * thickness,
                edge=0.1 * edge,
                layers=layers,
                material=material,
                radius=1.2 if shape == "curved" else None,
                angle=angle,
                kappa=self.kappa,
            )
            for thickness, material, shape in itertools.product(self.thicknesses, self.materials, self.shapes)
            for angle in MATERIALS[material]
            for edge, layers in itertools.product(self.edges, self.layers)
        ]

    def label(self, run: Strip) -> str:
        shape = "flat" if run.radius is None else "curved"
        fibres = f" {run.angle:g} deg" if len(MATERIALS[run.material]) > 1 else ""
        return (
            f"{run.material}{fibres}, {shape}, {10 * run.thickness:g} mm, {run.layers} x {10 * run.edge:g} mm"
        )

    def place(self, run: Strip, out: Path) -> Path:
        return out / self.label(run).replace(", ", "_").replace(" ", "-")

    @cached_property
    def _references(self) -> dict[Strip, dict[str, float | str]]:
        """References computed so far."""
        return {}

    def one(self, run: Strip, job: Job) -> Record:
        """Return the ratios of a strip; what was not found is a text that says why."""
        same = replace(run, edge=0.1, layers=1)
        if same not in self._references:
            self._references[same] = _all(same, None, job.comm)
        own, references = _all(run, SolidShell(kappa=run.kappa), job.comm), self._references[same]
        numbers: dict[str, float | str] = {}
        for name, value in own.items():
            reference = references[name]
            if isinstance(value, str):
                numbers[name] = f"solid shell: {value}"
            elif isinstance(reference, str):
                numbers[name] = f"reference: {reference}"
            else:
                numbers[name] = ratio_of(name, value, reference)
        return {"strip": asdict(run), "label": self.label(run), "ratios": numbers}

    def report(self, records: Sequence[Record], reference: None) -> Report:
        lines: list[Row] = []
        counts = {"ratios": 0, "passed": 0, "not_found": 0}
        for record in records:
            for name, value in record["ratios"].items():
                counts["ratios"] += 1
                counts["not_found"] += isinstance(value, str)
                counts["passed"] += not isinstance(value, str) and abs(value - 1) <= _bound(name)
                lines.append(row(f"{record['label']}: {name}", value, 1.0, "mixed Q2-Q1 elements"))
        return Report(
            parameters={key: value for key, value in asdict(self).items() if key != "overrides"},
            quantities={**counts, **_extremes(records)},
            reference={"ratio": 1.0, "pass": PASS, "pass_membrane": MEMBRANE},
            more={
                "strips": [{key: record[key] for key in ("strip", "label", "ratios")} for record in records],
                "groups": grouped(records),
            },
            table=lines,
        )

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        ratio_points(out / "strips.png", [(record["strip"], record["ratios"]) for record in records])


Group = dict[str, dict[str, float]]
"""Numbers by name of the ratio: how many were found, not found, and pass, their median, the one furthest from 1."""


def grouped(records: Sequence[Record]) -> dict[str, Group]:
    """Return what the ratios of strips that share a property, or two, say together."""
    members: dict[str, list[Record]] = {}
    for record in records:
        for name in _groups_of(record["strip"]):
            members.setdefault(name, []).append(record)
    return {name: _group(those) for name, those in members.items()}


def _groups_of(strip: Mapping[str, Any]) -> tuple[str, ...]:
    fibres = f" {strip['angle']:g} deg" if len(MATERIALS[strip["material"]]) > 1 else ""
    material, elements = strip["material"] + fibres, f"{strip['layers']} x {10 * strip['edge']:g} mm"
    shape = "flat" if strip["radius"] is None else "curved"
    thickness = f"{10 * strip['thickness']:g} mm thick"
    return "all", elements, thickness, shape, material, f"{material}, {elements}"


def _group(records: Sequence[Record]) -> Group:
    numbers: Group = {}
    for name in dict.fromkeys(name for record in records for name in record["ratios"]):
        said = [record["ratios"][name] for record in records if name in record["ratios"]]
        values = [v for v in said if not isinstance(v, str)]
        within = sum(abs(v - 1) <= _bound(name) for v in values)
        numbers[name] = {"found": len(values), "not_found": len(said) - len(values), "passed": within}
        if values:
            worst = max(values, key=lambda v: abs(v - 1))
            numbers[name] |= {"median": median(values), "worst": worst}
    return numbers


def _bound(name: str) -> float:
    return MEMBRANE if name.startswith("membrane") else PASS


def _all(strip: Strip, shell: SolidShell | None, comm: MPI.Comm) -> dict[str, float | str]:
    """Return what is measured of a strip, with Taylor-Hood elements where no shell is meant (collective)."""
    numbers: dict[str, float | str] = {}
    for name, answer in answers(strip).items():
        counts = strip.counts if shell else reference_counts(name)
        try:
            numbers[name] = answer(strip, counts, shell or TaylorHood(), comm)
        except ConvergenceError as error:
            numbers[name] = str(error)
    return numbers


def _extremes(records: Sequence[Record]) -> Mapping[str, float]:
    """Return the smallest and largest ratio of each kind."""
    ends: dict[str, float] = {}
    for name in dict.fromkeys(name for record in records for name in record["ratios"]):
        values = [v for record in records if isinstance(v := record["ratios"].get(name), float)]
        if values:
            ends |= {f"{name}_min": min(values), f"{name}_max": max(values)}
    return ends
