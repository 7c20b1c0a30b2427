"""A grid study of an immersed problem, stabilised and not: runs, table, observed order, picture."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, public
from valvefsi.benchmarks.immersed.numerics import COUPLINGS, Numerics
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import History, attempt
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError
from valvefsi.run.simulation import Simulation
from valvefsi.verification.convergence import observed_order, ratios_of

if TYPE_CHECKING:
    from valvefsi.post.plots.immersed import Line

KINDS = {True: "stabilised", False: "not stabilised"}
HELD = {"on": (True,), "off": (False,), "both": (True, False)}


@dataclass(frozen=True, kw_only=True)
class Incompressible:
    """The incompressible answer that all runs tend to.

    Attributes:
        value: The value.
        source: Where it is from.
        same_mesh: The value on the mesh of each grid, to be drawn over the grids; empty where it is not computed.
    """

    value: float
    source: str
    same_mesh: Mapping[int, float]


@dataclass(frozen=True, kw_only=True)
class Compared:
    """A column of the history that is compared: its name, the key of its value in the end, label and unit."""

    column: str
    key: str
    label: str
    unit: str


@dataclass(frozen=True, kw_only=True)
class GridStudy(Benchmark[Numerics, Incompressible]):
    """A grid study; it states its simulation, what is read off a history and the incompressible answer."""

    keeps = True
    title: ClassVar[str]
    main: ClassVar[Compared]
    change: ClassVar[Compared]
    factors: ClassVar[tuple[float, ...]] = (1.0, 2.0, 4.0, 8.0)
    """The grids in multiples of the coarsest."""

    grid: int = option(16, "Cells along the box.", least=4)
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))
    coupling: str = option("nodal", "nodal, elemental or lumped.", choices=COUPLINGS)
    ratio: float = option(0.5, "Element size over grid spacing.", least=0.1, most=4.0)
    nu_stab: float | None = option(
        0.4, "Numerical Poisson ratio of stabilised runs.", metavar="V|off", between=(-1.0, 0.5)
    )
    stabilised: str = option("both", "on, off or both.", choices=tuple(HELD))
    refine: int = option(0, "Number of finer grids; gives the observed order.", least=0)

    def check(self, values: Values) -> None:
        most = len(self.factors) - 1
        if self.refine > most:
            raise CaseError(f"expected at most {most} finer grids", key="--refine", value=self.refine)

    @abstractmethod
    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        """Return the simulation of one run (collective)."""

    @abstractmethod
    def quantities(self, history: History) -> dict[str, float]:
        """Return what is compared, from the columns of a history."""

    @abstractmethod
    def incompressible(self, numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
        """Return the answer that the runs tend to and its source (collective)."""

    def same_mesh(self, numerics: Numerics, comm: MPI.Comm) -> float | None:
        """Return the incompressible answer on the mesh of one grid, None where it is not computed (collective)."""
        return None

    def elsewhere(self) -> list[tuple[float | str, str]]:
        """Return further values to compare with and their sources."""
        return []

    def runs(self) -> list[Numerics]:
        numerics = Numerics(grid=self.grid, ratio=self.ratio, kernel=self.kernel, coupling=self.coupling)
        kinds = HELD[self.stabilised] if self.nu_stab is not None else (False,)
        return [
            replace(numerics, grid=round(self.grid * factor), nu_stab=self.nu_stab if held else None)
            for held in kinds
            for factor in self.factors[: self.refine + 1]
        ]

    def label(self, run: Numerics) -> str:
        return run.name

    def place(self, run: Numerics, out: Path) -> Path:
        return out / self.name / run.name

    def references(self, comm: MPI.Comm) -> Incompressible:
        runs = self.runs()
        value, source = self.incompressible(runs[-1], comm)
        same = {run.grid: self.same_mesh(run, comm) for run in runs}
        known = {grid: one for grid, one in same.items() if one is not None}
        return Incompressible(value=value, source=source, same_mesh=known)

    def one(self, run: Numerics, job: Job) -> Record:
        simulation = self.simulation(run, job.folder, job.comm)
        done = attempt(simulation, job, clear=True)
        return {
            "problem": self.name,
            "numerics": asdict(run),
            "values": dict(self.values),
            "quantities": self.quantities(done.history) if done.failed is None else {},
            "history": {name: column.tolist() for name, column in done.history.items()},
            "failed": done.failed,
            "steps": done.steps,
            "cells": math.prod(simulation.model.grid.cells),
        }

    def report(self, records: Sequence[Record], known: Incompressible) -> Report:
        series = [r for r in records if not r["failed"]]
        orders = [line for kind in KINDS for line in self._orders(series, kind, known.value)]
        main = self.main
        further = [
            row(f"{main.label}, elsewhere", value, source=source, unit=main.unit)
            for value, source in self.elsewhere()
        ]
        lines = [line for record in records for line in self._lines(record, known)]
        return Report(
            parameters=self.values | {"refine": self.refine, "stabilised": self.stabilised},
            quantities={Numerics(**r["numerics"]).name: r["quantities"] for r in records},
            reference={main.key: known.value, "source": known.source, "same_mesh": known.same_mesh},
            more={"runs": [public(r, "history") for r in records]},
            table=lines + further + orders + self._gain(series),
        )

    def _lines(self, record: Record, known: Incompressible) -> list[Row]:
        main, change, label = self.main, self.change, _label(record)
        if record["failed"]:
            return [row(f"{main.label}, {label}", "broke down", source=record["failed"][:70])]
        q = record["quantities"]
        lines = [row(f"{main.label}, {label}", q[main.key], known.value, known.source, unit=main.unit)]
        names = {f"  {change.label}": change.key, "  the most during the run": "largest_change_percent"}
        lines += [
            row(name, q[key], 0.0, "incompressible", unit="%", relative=False)
            for name, key in names.items()
            if key in q
        ]
        return [*lines, row("  J, smallest ... largest", f"{q['J_min']:.2f} ... {q['J_max']:.2f}")]

    def _orders(self, series: Sequence[Record], kind: bool, exact: float) -> list[Row]:
        chosen = [r for r in series if held(r) is kind]
        ratios, lines = ratios_of([r["numerics"]["grid"] for r in chosen]), []
        for compared, limit in ((self.main, exact), (self.change, 0.0)):
            order = observed_order([r["quantities"][compared.key] for r in chosen], ratios, exact=limit)
            if order is not None:
                name = f"observed order, {compared.label}, {KINDS[kind]}"
                lines.append(row(name, order, source="last two grids"))
        return lines

    def _gain(self, series: Sequence[Record]) -> list[Row]:
        """How many times smaller the change of volume is with the stabilisation, grid by grid."""
        free = {r["numerics"]["grid"]: r["quantities"][self.change.key] for r in series if not held(r)}
        kept = {r["numerics"]["grid"]: r["quantities"][self.change.key] for r in series if held(r)}
        name = f"{self.change.label}, not stabilised / stabilised, N = {{}}"
        return [row(name.format(n), abs(free[n] / kept[n])) for n in kept if n in free]

    def draw(self, records: Sequence[Record], known: Incompressible, out: Path) -> None:
        from valvefsi.post.plots.immersed import Line, Panel, panels

        main, change = self.main, self.change
        same = {"reference": known.value, "reference_label": "incompressible statics"}
        time = _over_time(records, main.column), _over_time(records, change.column, labels=False)
        name = f"{main.label} [{main.unit}]"
        shown = [
            Panel(lines=time[0], xlabel="t [s]", ylabel=name, **same),  # type: ignore[arg-type]
            Panel(lines=time[1], xlabel="t [s]", ylabel=f"{change.label} [%]", reference=0.0),
        ]
        if self.refine:
            grids = [_over_grids(records, compared.key) for compared in (main, change)]
            if known.same_mesh:
                x, y = list(known.same_mesh), list(known.same_mesh.values())
                grids[0].append(Line(label="mixed elements, same mesh", x=x, y=y, colour=2, style="^:"))
            size = f"size of the {change.label} at the end [%]"
            shown += [
                Panel(lines=grids[0], xlabel="cells N", ylabel=name, log="x", **same),  # type: ignore[arg-type]
                Panel(lines=grids[1], xlabel="cells N", ylabel=size, log="xy"),
            ]
        n = records[0]["numerics"]
        caption = f"{n['kernel']}, {n['coupling']}, elements of {n['ratio']:g} h"
        panels(out / f"{self.name}.png", shown, title=self.title, caption=caption, columns=2)


def held(record: Record) -> bool:
    """Whether a run was stabilised."""
    return record["numerics"]["nu_stab"] is not None


def _label(record: Record) -> str:
    return f"N = {record['numerics']['grid']}, {KINDS[held(record)]}"


def _over_time(records: Sequence[Record], column: str, *, labels: bool = True) -> list[Line]:
    from valvefsi.post.plots.immersed import Line

    grids = sorted({r["numerics"]["grid"] for r in records})
    return [
        Line(
            label=_label(r) if labels else "",
            x=r["history"]["t_s"],
            y=r["history"][column],
            colour=grids.index(r["numerics"]["grid"]),
            style="-" if held(r) else "--",
        )
        for r in records
    ]


def _over_grids(records: Sequence[Record], key: str) -> list[Line]:
    """Return a quantity over the cells, one line for each kind of run."""
    from valvefsi.post.plots.immersed import Line

    lines = []
    for colour, (kind, text) in enumerate(KINDS.items()):
        series = [r for r in records if held(r) is kind and not r["failed"]]
        x, y = [r["numerics"]["grid"] for r in series], [r["quantities"][key] for r in series]
        if series:
            lines.append(Line(label=text, x=x, y=y, colour=colour, style="o-" if kind else "s--"))
    return lines
