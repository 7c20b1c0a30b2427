"""What immersed benchmarks share: their coupling, grid studies (stabilised and not), flows past flexible bodies."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report, public, refined
from valvefsi.benchmarks.options import Values, option, require_steps
from valvefsi.benchmarks.results import Row, order_row, row
from valvefsi.benchmarks.running import History, Sights, attempt, fixed_steps, late_mean, late_size
from valvefsi.bodies.elastic import Elastic
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.kernels import KERNELS
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.grid import MacGrid
from valvefsi.post.plots.immersed import Line, Panel, panels
from valvefsi.run.recording import Probe
from valvefsi.run.simulation import Simulation
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.structure import Structure
from valvefsi.verification.convergence import ratios_of

LEAST_STEPS = 5
"""Steps of a run at least, of which the last fifth is averaged."""
COUPLINGS = ("nodal", "elemental", "lumped")


@dataclass(frozen=True, kw_only=True)
class Numerics:
    """How a problem is discretised and coupled.

    Attributes:
        grid: Cells along the box, as the problem counts them.
        ratio: Element size over grid spacing.
        kernel: Name of the regularised delta function.
        coupling: "nodal", "elemental", or "lumped": elemental with the lumped mass.
        nu_stab: Numerical Poisson ratio (S22), None for no volumetric energy.
    """

    grid: int
    ratio: float = 1.0
    kernel: str = "bspline3"
    coupling: str = "nodal"
    nu_stab: float | None = 0.4

    def __post_init__(self) -> None:
        """Check the coupling."""
        if self.coupling not in COUPLINGS:
            message = 'expected "nodal", "elemental" or "lumped"'
            raise CaseError(message, key="--coupling", value=self.coupling)

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        nu = "off" if self.nu_stab is None else f"{self.nu_stab:g}"
        return f"N{self.grid}-r{self.ratio:g}-{self.kernel}-{self.coupling}-{nu}"


def couple(fluid: NavierStokes, solid: Structure, numerics: Numerics) -> Coupling | ElementalCoupling:
    """Return the coupling that the numerics ask for (collective)."""
    grid, signs = fluid.grid, fluid.boundary.signs
    if numerics.coupling == "nodal":
        return Coupling(grid, numerics.kernel, signs)
    mass = "lumped" if numerics.coupling == "lumped" else "consistent"
    return ElementalCoupling(grid, numerics.kernel, ElementPoints(solid, mass), signs=signs)


KINDS = {True: "stabilised", False: "not stabilised"}
STATES = {"on": (True,), "off": (False,), "both": (True, False)}


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
class GridStudy(Benchmark[Numerics, Incompressible]):
    """A grid study; it states its simulation, what is read off a history and the incompressible answer."""

    keeps = True
    title: ClassVar[str]
    body: ClassVar[str]
    """Name of the solid."""
    probe: ClassVar[Probe]
    """The node whose u_y is compared."""
    measure: ClassVar[str] = "area"
    """What the solid should keep: area or volume."""
    factors: ClassVar[tuple[float, ...]] = (1.0, 2.0, 4.0, 8.0)
    """The grids in multiples of the coarsest."""

    grid: int = option(16, "Cells along the box.", least=4)
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))
    coupling: str = option("nodal", "nodal, elemental or lumped.", choices=COUPLINGS)
    ratio: float = option(0.5, "Element size over grid spacing.", least=0.1, most=4.0)
    nu_stab: float | None = option(
        0.4, "Numerical Poisson ratio of stabilised runs.", metavar="V|off", between=(-1.0, 0.5)
    )
    stabilised: str = option("both", "on, off or both.", choices=tuple(STATES))
    refine: int = option(0, "Number of finer grids; gives the observed order.", least=0)

    def check(self, values: Values) -> None:
        most = len(self.factors) - 1
        if self.refine > most:
            raise CaseError(f"expected at most {most} finer grids", key="--refine", value=self.refine)

    @property
    def key(self) -> str:
        """Name of the displacement that is compared, also in the history."""
        return f"u_y_{self.probe.name}_cm"

    @property
    def main(self) -> str:
        """What is compared, in words."""
        return f"u_y of the {self.probe.name.replace('_', ' ')}"

    @property
    def change(self) -> str:
        """Column of the history with the change of area or volume [%]."""
        return f"{self.body}_{self.measure}_change_percent"

    @abstractmethod
    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        """Return the simulation of one run (collective)."""

    def quantities(self, history: History) -> dict[str, float]:
        """Return what is compared, from the columns of a history."""
        return {
            self.key: late_mean(history, self.key),
            "change_percent": late_size(history, self.change),
            "J_min": float(history[f"{self.body}_J_min"].min()),
            "J_max": float(history[f"{self.body}_J_max"].max()),
        }

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
        kinds = STATES[self.stabilised] if self.nu_stab is not None else (False,)
        return [
            replace(numerics, grid=round(self.grid * factor), nu_stab=self.nu_stab if kind else None)
            for kind in kinds
            for factor in self.factors[: self.refine + 1]
        ]

    def label(self, run: Numerics) -> str:
        return run.name

    def place(self, run: Numerics, out: Path) -> Path:
        return out / self.name / run.name

    def references(self, comm: MPI.Comm) -> Incompressible:
        runs = self.runs()
        value, source = self.incompressible(runs[-1], comm)
        grids = {run.grid: run for run in runs}.items()
        same = {grid: one for grid, run in grids if (one := self.same_mesh(run, comm)) is not None}
        return Incompressible(value=value, source=source, same_mesh=same)

    def one(self, run: Numerics, job: Job) -> Record:
        simulation = self.simulation(run, job.folder, job.comm)
        end = attempt(simulation, job, clear=True)
        return {
            "problem": self.name,
            "numerics": asdict(run),
            "values": dict(self.values),
            "quantities": self.quantities(end.history) if end.failed is None else {},
            "history": {name: column.tolist() for name, column in end.history.items()},
            "failed": end.failed,
            "steps": end.steps,
            "cells": math.prod(simulation.model.grid.cells),
        }

    def report(self, records: Sequence[Record], reference: Incompressible) -> Report:
        series = [r for r in records if not r["failed"]]
        table = [line for record in records for line in self._lines(record, reference)]
        for value, source in self.elsewhere():
            table.append(row(f"{self.main}, elsewhere", value, source=source, unit="cm"))
        for kind in KINDS:
            table += self._orders(_of_kind(series, kind), KINDS[kind], reference.value)
        return Report(
            parameters=self.values | {"refine": self.refine, "stabilised": self.stabilised},
            quantities={Numerics(**r["numerics"]).name: r["quantities"] for r in records},
            reference={self.key: reference.value}
            | {k: getattr(reference, k) for k in ("source", "same_mesh")},
            more={"runs": [public(r, "history") for r in records]},
            table=table + self._gain(series),
        )

    def _lines(self, record: Record, reference: Incompressible) -> list[Row]:
        name, q = f"{self.main}, {_label(record)}", record["quantities"]
        if record["failed"]:
            return [row(name, "broke down", source=record["failed"][:70])]
        lines = [row(name, q[self.key], reference.value, reference.source, unit="cm")]
        names = (f"  {self.measure} change", "  the most during the run")
        for name, key in zip(names, ("change_percent", "largest_change_percent"), strict=True):
            if key in q:
                lines.append(row(name, q[key], 0.0, "incompressible", unit="%", relative=False))
        return [*lines, row("  J, smallest ... largest", f"{q['J_min']:.2f} ... {q['J_max']:.2f}")]

    def _orders(self, series: Sequence[Record], kind: str, exact: float) -> list[Row]:
        ratios, lines = ratios_of([r["numerics"]["grid"] for r in series]), []
        compared = (self.main, self.key, exact), (f"{self.measure} change", "change_percent", 0.0)
        for label, key, limit in compared:
            values, source = [r["quantities"][key] for r in series], "last two grids"
            lines += order_row(f"observed order, {label}, {kind}", values, ratios, exact=limit, source=source)
        return lines

    def _gain(self, series: Sequence[Record]) -> list[Row]:
        """How many times smaller the change of volume is with the stabilisation, grid by grid."""
        free, stabilised = (
            {r["numerics"]["grid"]: r["quantities"]["change_percent"] for r in _of_kind(series, kind)}
            for kind in (False, True)
        )
        name = f"{self.measure} change, not stabilised / stabilised, N = {{}}"
        return [row(name.format(n), abs(free[n] / stabilised[n])) for n in stabilised if n in free]

    def draw(self, records: Sequence[Record], reference: Incompressible, out: Path) -> None:
        name, change = f"{self.main} [cm]", f"{self.measure} change"
        same: dict[str, Any] = {"reference": reference.value, "ylabel": name}
        same["reference_label"] = "incompressible statics"
        lines: dict[str, list[Line]] = {self.key: [], self.change: []}
        grids = sorted({r["numerics"]["grid"] for r in records})
        for r in records:
            style: dict[str, Any] = {
                "colour": grids.index(r["numerics"]["grid"]),
                "style": "-" if is_stabilised(r) else "--",
            }
            for (column, own), label in zip(lines.items(), (_label(r), ""), strict=True):
                own.append(Line(label=label, x=r["history"]["t_s"], y=r["history"][column], **style))
        parts = [
            Panel(lines=lines[self.key], xlabel="t [s]", **same),
            Panel(lines=lines[self.change], xlabel="t [s]", ylabel=f"{change} [%]", reference=0.0),
        ]
        if self.refine:
            main, size = (_over_grids(records, key) for key in (self.key, "change_percent"))
            if reference.same_mesh:
                x, y = list(reference.same_mesh), list(reference.same_mesh.values())
                main.append(Line(label="mixed elements, same mesh", x=x, y=y, colour=2, style="^:"))
            parts += [
                Panel(lines=main, xlabel="cells N", log="x", **same),
                Panel(lines=size, xlabel="cells N", ylabel=f"size of the {change} at the end [%]", log="xy"),
            ]
        n = records[0]["numerics"]
        caption = f"{n['kernel']}, {n['coupling']}, elements of {n['ratio']:g} h"
        panels(out / f"{self.name}.png", parts, title=self.title, caption=caption, columns=2)


@dataclass(frozen=True, kw_only=True)
class SolidStudy(GridStudy):
    """A grid study of a solid in a closed box; it states both."""

    width: ClassVar[float]
    """Edge of the box that the cells count along [cm]."""
    rows: ClassVar[int] = 300
    """Rows of the history that are wanted."""

    def check(self, values: Values) -> None:
        super().check(values)
        coarsest = min(run.grid for run in self.runs())
        require_steps(values, values["dt_per_h"] * self.width / coarsest, LEAST_STEPS, "its end is averaged")

    @abstractmethod
    def solid(self, numerics: Numerics, comm: MPI.Comm) -> Structure:
        """Return the solid of one run (collective)."""

    @abstractmethod
    def box(self, cells: int, comm: MPI.Comm) -> MacGrid:
        """Return the grid of the fluid with so many cells along its width (collective)."""

    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        grid, values, solid = self.box(numerics.grid, comm), self.values, self.solid(numerics, comm)
        fluid = NavierStokes(grid, Boundary(grid), rho=values["rho"], mu=values["mu"])
        model = Model(grid=grid, fluid=fluid, bodies=(Elastic(solid, couple(fluid, solid, numerics)),))
        steps = round(values["t_end"] * numerics.grid / (values["dt_per_h"] * self.width))
        more: dict[str, Any] = {"cfl_max": 0.5, "checkpoint_wall_s": 0.0, "probes": (self.probe,)}
        return fixed_steps(model, folder, values["t_end"] / steps, steps, rows=self.rows, **more)


def is_stabilised(record: Record) -> bool:
    """Whether a run was stabilised."""
    return record["numerics"]["nu_stab"] is not None


def _of_kind(records: Sequence[Record], kind: bool) -> list[Record]:
    return [record for record in records if is_stabilised(record) is kind]


def _label(record: Record) -> str:
    return f"N = {record['numerics']['grid']}, {KINDS[is_stabilised(record)]}"


def _over_grids(records: Sequence[Record], key: str) -> list[Line]:
    """Return a quantity over the cells, one line for each kind of run."""
    lines = []
    for colour, (kind, text) in enumerate(KINDS.items()):
        series = [r for r in _of_kind(records, kind) if not r["failed"]]
        x, y = [r["numerics"]["grid"] for r in series], [r["quantities"][key] for r in series]
        if series:
            lines.append(Line(label=text, x=x, y=y, colour=colour, style="o-" if kind else "s--"))
    return lines


REFINEMENT = 1.5
"""Ratio of successive grids of a `Flexible` benchmark."""


@dataclass(frozen=True, kw_only=True)
class Flexible(Benchmark[int, None]):
    """A flow past a flexible body, on one grid or on several, each 1.5 times as fine as the one before."""

    resumable = True

    cells: int
    t_end: float | None = option(None, "End of the run [s], as --set t_end.", between=(0.0, math.inf))
    refine: int = option(0, "Number of finer grids, each 1.5 times as fine.", least=0, most=4)
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))

    @abstractmethod
    def simulation(self, cells: int, folder: Path, comm: MPI.Comm) -> tuple[Simulation, Sights, Record]:
        """Return the simulation on one grid, what is kept for its pictures, what its record says of it (collective)."""

    @abstractmethod
    def read_off(self, h: History) -> Record:
        """Return what a history says: ``quantities``, and more."""

    @abstractmethod
    def lines(self, r: Record) -> list[Row]:
        """Return the lines of a run in the table."""

    @abstractmethod
    def pictures(self, cells: int, folder: Path, h: History, snapshots: Sequence[dict[str, Any]]) -> None:
        """Draw a run (on rank 0)."""

    def runs(self) -> list[int]:
        return refined(self.cells, self.refine, REFINEMENT)

    def place(self, run: int, out: Path) -> Path:
        return out / f"N{run}"

    def one(self, run: int, job: Job) -> Record:
        begin = time.perf_counter()
        simulation, sights, record = self.simulation(run, job.folder, job.comm)
        end, model = attempt(simulation, job), simulation.model
        if job.comm.rank == 0:
            self.pictures(run, job.folder, end.history, [vars(s) for s in sights.snapshots])
        record = {"cells": run, "grid": list(model.grid.cells[:2]), "dt": simulation.schedule.dt} | record
        record |= {"nodes": model.bodies[0].num_points, "steps": int(end.history["step"][-1])}
        record |= {"failed": end.failed, "step_ms": 1e3 * (time.perf_counter() - begin) / max(1, end.steps)}
        return record | self.read_off(end.history)

    def report(self, records: Sequence[Record], reference: None) -> Report:
        return Report(
            parameters=self.values | {"kernel": self.kernel},
            quantities={r["cells"]: r["quantities"] for r in records},
            more={"runs": [public(r) for r in records]},
            table=[line for r in records for line in (*self._broken(r), *self.lines(r))],
        )

    def _broken(self, r: Record) -> list[Row]:
        return [row(self.label(r["cells"]), "broke down", source=r["failed"][:90])] if r["failed"] else []


def cost(r: Record) -> str:
    """Return step and size of a run of a `Flexible` benchmark in words."""
    return f"dt = {r['dt']:.3g} s, {r['steps']} steps, {r['grid'][0]} x {r['grid'][1]} cells"
