"""Compressed block (Lee2020, E.1), immersed, against exactly incompressible statics solved in the same run.

A neo-Hookean block of 20 x 10 cm in a box of 40 x 40 cm of fluid, walls at rest. A dead load of 200 dyn/cm^2 acts on
the central 10 cm of the top; u_x = 0 on the whole top and u_y = 0 on the bottom are held by tethers. The load grows
smoothly over the first 40 % of the run; displacement and area are averaged over its last 20 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Announce, Benchmark, Command, Job, Record, Report, Result
from valvefsi.benchmarks.immersed.numerics import Numerics
from valvefsi.benchmarks.immersed.study import Compared, GridStudy
from valvefsi.benchmarks.options import Parameters, Values, option, read_parameters, read_quantities
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.running import AVERAGED, History, late_mean, late_size
from valvefsi.benchmarks.statics.compression import converged
from valvefsi.case import Case, parse_case
from valvefsi.case.build import build, write_case
from valvefsi.case.overrides import split_override
from valvefsi.case.resuming import clear, run_folder
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError
from valvefsi.io.history import read_history
from valvefsi.run.planning import plan as make_plan
from valvefsi.run.simulation import Simulation
from valvefsi.solid import statics
from valvefsi.solid.structure import Structure

RAMP = 0.4
"""Part of the run over which the load grows."""
GRID, BOX, LENGTH = 16, 40.0, 20.0
"""Cells along the box of the coarsest grid of a series; edge of the box and length of the block [cm]."""
TOP = (20.0, 25.0)
"""Centre of the top [cm]."""
PARAMETERS: Parameters = {
    "traction": (200.0, "dyn/cm^2"),
    "c1": (80.194, "dyn/cm^2"),
    "rho": (1.0, "g/cm^3"),
    "mu": (0.01, "dyn*s/cm^2"),
    "damping": (0.05 * 80.194, "dyn*s/cm^4"),
    "t_end": (60.0, "s"),
    "dt_per_h": (0.005, "s/cm"),
    "tether_stiffness": (1.0e5, "dyn/cm^3"),
    "tether_damping": (0.0, "dyn*s/cm^3"),
}
"""Default and unit of the parameters that ``--set NAME=value`` reaches; dotted keys reach the whole case."""
MAIN = Compared(column="u_y_top_centre_cm", key="u_y_top_centre_cm", label="u_y of the top centre", unit="cm")


@dataclass(frozen=True, kw_only=True)
class Block:
    """One block.

    Attributes:
        elements: Elements M along the block's 20 cm.
        grid: Cells N along each edge of the box.
        kernel: Name of the regularised delta function.
        nu_stab: Numerical Poisson ratio (S22), None for no volumetric energy.
        overrides: ``key=value``, a name in `PARAMETERS` or a dotted key of the case.
        replace: Whether a run that the folder holds may be replaced.
    """

    elements: int = 32
    grid: int = 64
    kernel: str = "bspline3"
    nu_stab: float | None = 0.4
    overrides: Sequence[str] = ()
    replace: bool = False


@dataclass(frozen=True, kw_only=True)
class Compression(Command):
    """The block on one grid, or on a series of grids, stabilised and not."""

    name = "compression"
    resumable = True

    elements: int | None = option(
        None, "Elements along the block's 20 cm; 32, a series: as many as cells.", least=2
    )
    grid: int | None = option(None, "Cells along each edge of the box; 64, a series: 16 and finer.", least=4)
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))
    nu_stab: float | None = option(
        0.4, "Numerical Poisson ratio of the volumetric term.", metavar="V|off", between=(-1.0, 0.5)
    )
    refine: int = option(0, "Number of finer grids: a series, stabilised and not.", least=0, most=4)

    replaces: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        super().__post_init__()
        self.chosen()

    def overwrite(self) -> Compression:
        """Return the same, allowed to replace a run that its folder holds."""
        return replace(self, replaces=True)

    @property
    def folder(self) -> str:
        if self.refine:
            return "compression-series"
        held = "off" if self.nu_stab is None else self.nu_stab
        return f"compression-M{self.block.elements}-N{self.block.grid}-{self.kernel}-{held}"

    @property
    def block(self) -> Block:
        """The block on one grid."""
        return Block(
            elements=self.elements or 32,
            grid=self.grid or 64,
            kernel=self.kernel,
            nu_stab=self.nu_stab,
            overrides=self.overrides,
            replace=self.replaces,
        )

    def chosen(self) -> OneBlock | BlockSeries:
        """Return the block or the series."""
        if not self.refine:
            return OneBlock(block=self.block)
        grid = self.grid or GRID
        elements = self.elements or grid
        if elements % 4:
            message = "expected a multiple of 4, so that the ends of the load are on nodes"
            raise CaseError(message, key="--elements", value=elements)
        return BlockSeries(
            grid=grid,
            ratio=LENGTH / elements * grid / BOX,
            kernel=self.kernel,
            nu_stab=self.nu_stab,
            refine=self.refine,
            overrides=self.overrides,
        )

    def plan(self, out: Path, comm: MPI.Comm) -> Result:
        """Return size, step limits and expected time of the run (collective)."""
        if self.refine:
            raise CaseError("a plan is of one run", key="--plan", value="--refine")
        return {"plan": make_plan(build(compression_case(self.block), out, comm))}

    def run(
        self,
        *,
        out: Path,
        comm: MPI.Comm = MPI.COMM_WORLD,
        progress: Announce | None = None,
        resume: bool = False,
    ) -> Result:
        """Run the block or the series, see `Command.run`."""
        return self.chosen().run(out=out, comm=comm, progress=progress, resume=resume)


@dataclass(frozen=True, kw_only=True)
class OneBlock(Benchmark[Block, None]):
    """The block on one grid, against statics on its own mesh."""

    name = "compression"

    block: Block

    def check(self, values: Values) -> None:
        compression_case(self.block)

    def runs(self) -> list[Block]:
        return [self.block]

    def one(self, run: Block, job: Job) -> Record:
        case = compression_case(run)
        with run_folder(case, job.folder, job.comm, resume=job.resume, overwrite=run.replace) as changes:
            simulation = build(case, job.folder, job.comm, changes)
            if run.replace and not job.resume:
                clear(job.folder, job.comm)
            write_case(case, job.folder, job.comm, changes)
            reference = static_reference(simulation, case)
            outcome = simulation.run(resume=job.resume, progress=job.progress)
        lines = {MAIN.column: ("statics", reference), "block_area_change_percent": ("incompressible", 0.0)}
        title = f"Compressed block, {run.elements} elements, {run.grid}$^2$ cells, {run.kernel}"
        simulation.pictures(outcome.state, title=title, references=lines)
        return {
            "quantities": job.comm.bcast(_quantities(job.folder, case) if job.comm.rank == 0 else None),
            "reference": reference,
            "case": case_parameters(case),
            "timing": outcome.timing(simulation.model.grid),
        }

    def report(self, records: Sequence[Record], known: None) -> Report:
        (r,), block = records, self.block
        q, u_y, statics_ = r["quantities"], r["quantities"][MAIN.key], r["reference"]
        table = [row(MAIN.label, u_y, statics_, "mixed u-p statics, same mesh, this run", unit="cm")]
        if all(r["case"][key] == PARAMETERS[key][0] for key in ("traction", "c1")):
            table.append(row("", u_y, converged(), "mixed elements, converged", unit="cm"))
        area = q["area_change_percent"]
        table += [
            row("area change", area, 0.0, "incompressible", unit="%", relative=False),
            row("smallest J", q["J_min"], source="1 when incompressible"),
            row("largest J", q["J_max"], source="1 when incompressible"),
        ]
        chosen = {"elements": block.elements, "grid": block.grid, "kernel": block.kernel}
        held = {"nu_stab": "off" if block.nu_stab is None else block.nu_stab}
        return Report(
            parameters=chosen | held | r["case"],
            quantities=q,
            reference={MAIN.key: statics_},
            more={"relative_error": (u_y - statics_) / abs(statics_)},
            table=table,
            timing=r["timing"],
        )


@dataclass(frozen=True, kw_only=True)
class BlockSeries(GridStudy):
    """The block on a series of grids; every run is the one that `OneBlock` makes of the same options (S4 c, d)."""

    name = "compression"
    title = "Compressed block (E.1), immersed"
    parameters = PARAMETERS
    main = MAIN
    change = Compared(column="block_area_change_percent", key="change_percent", label="area change", unit="%")

    def read(self) -> Values:
        keys = {text: split_override(text)[0] for text in self.overrides}
        plain = [text for text, key in keys.items() if "." not in key]
        values = read_parameters(PARAMETERS, plain)
        if "damping" not in keys.values():
            values.pop("damping")
        return values | {key: text.partition("=")[2].strip() for text, key in keys.items() if "." in key}

    def check(self, values: Values) -> None:
        super().check(values)
        self.case_of(self.runs()[0])

    def case_of(self, numerics: Numerics) -> Case:
        """Return the case of one block."""
        block = Block(
            elements=round(LENGTH * numerics.grid / (numerics.ratio * BOX)),
            grid=numerics.grid,
            kernel=numerics.kernel,
            nu_stab=numerics.nu_stab,
            overrides=[f"{key}={value}" for key, value in self.values.items()],
        )
        return compression_case(block)

    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        return build(self.case_of(numerics), folder, comm)

    def quantities(self, history: History) -> dict[str, float]:
        late = history["t_s"] >= (1.0 - AVERAGED) * history["t_s"][-1]
        return {
            "u_y_top_centre_cm": late_mean(history, "u_y_top_centre_cm"),
            "change_percent": late_size(history, "block_area_change_percent"),
            "largest_change_percent": float(np.abs(history["block_area_change_percent"]).max()),
            "area_change_percent": late_mean(history, "block_area_change_percent"),
            "J_min": float(history["block_J_min"][late].min()),
            "J_max": float(history["block_J_max"][late].max()),
        }

    def incompressible(self, numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
        return self.same_mesh(numerics, comm), "mixed u-p statics, finest mesh"

    def same_mesh(self, numerics: Numerics, comm: MPI.Comm) -> float:
        case = self.case_of(numerics)
        return static_reference(build(case, Path(), comm), case)

    def elsewhere(self) -> list[tuple[float | str, str]]:
        return [(converged(), "mixed elements, converged")] if self.published("traction", "c1") else []


def compression_case(block: Block) -> Case:
    """Return the case of the benchmark, with overrides.

    Raises:
        CaseError: An override or the outcome is not a valid case.
    """
    keys = {text: split_override(text)[0] for text in block.overrides}
    dotted = [text for text, key in keys.items() if "." in key]
    values = read_quantities(PARAMETERS, [text for text, key in keys.items() if "." not in key])
    chosen = keys.values()
    if "c1" in chosen and "damping" not in chosen:
        values["damping"] = 0.05 * values["c1"]
    return parse_case(_raw_case(block, values), dotted)


def _raw_case(block: Block, v: Values) -> dict[str, Any]:
    steps = round(v["t_end"] * block.grid / (v["dt_per_h"] * 40.0)) if v["dt_per_h"] > 0 else 0
    return {
        "title": "Compressed block (Lee2020, E.1)",
        "grid": {"lower": [0.0, 0.0], "upper": [40.0, 40.0], "cells": [block.grid, block.grid]},
        "fluid": {"density": v["rho"], "viscosity": v["mu"]},
        "time": {"dt_per_h": v["dt_per_h"], "t_end": v["t_end"]},
        "output": {
            "history_every": max(1, steps // 600),
            "frames": 20,
            "checkpoint_every": max(1, steps // 4),
        },
        "solid": [_raw_block(block, v)],
    }


def _raw_block(block: Block, v: Values) -> dict[str, Any]:
    tether = {"stiffness": v["tether_stiffness"], "damping": v["tether_damping"]}
    return {
        "name": "block",
        "mesh": {
            "shape": "compressed_block",
            "lower": [10.0, 15.0],
            "size": [20.0, 10.0],
            "elements": [block.elements, block.elements // 2],
            "load_width": 10.0,
        },
        "kernel": block.kernel,
        "damping": v["damping"],
        "nu_stab": "off" if block.nu_stab is None else block.nu_stab,
        "material": {"model": "neo_hookean", "c1": v["c1"]},
        "tether": [
            {"on": ["bottom"], "components": ["y"], **tether},
            {"on": ["top_loaded", "top_outer"], "components": ["x"], **tether},
        ],
        "load": [
            {
                "on": ["top_loaded"],
                "traction": [0.0, -v["traction"]],
                "ramp": RAMP * v["t_end"],
                "ramp_shape": "smooth",
            }
        ],
        "probe": [{"name": "top_centre", "at": [20.0, 25.0]}],
    }


def case_parameters(case: Case) -> dict[str, Any]:
    """Return the parameters of a case, whatever set them."""
    solid = case.solid[0]
    return {
        "traction": -solid.load[0].traction[1],
        "c1": solid.material.parameters["c1"],
        "rho": case.fluid.density,
        "mu": case.fluid.viscosity,
        "damping": solid.damping,
        "t_end": case.time.t_end,
        "dt": case.dt,
        "tether_stiffness": solid.tether[0].stiffness,
        "tether_damping": solid.tether[0].damping,
    }


def static_reference(simulation: Simulation, case: Case) -> float:
    """Return u_y of the top centre [cm] of the same block, exactly incompressible, on its own mesh (collective)."""
    body: Any = simulation.model.bodies[0]
    solid: Structure = body.solid
    fixed = [statics.Fixed(on=t.on, components=t.components) for t in case.solid[0].tether]
    solution = statics.solve(solid.mesh, solid.material, fixed=fixed, loads=solid.loads)
    return float(solution.displacement_at(TOP)[1])


def _quantities(folder: Path, case: Case) -> dict[str, float]:
    """Means over the last part of the run, and how much the displacement still moves there."""
    history = {k: np.array(v) for k, v in read_history(folder / "history.csv").items()}
    late = history["t_s"] >= (1.0 - AVERAGED) * case.time.t_end
    u_y = history["u_y_top_centre_cm"][late]
    return {
        "u_y_top_centre_cm": float(u_y.mean()),
        "u_y_top_centre_swing_cm": float(np.ptp(u_y)),
        "area_change_percent": float(history["block_area_change_percent"][late].mean()),
        "J_min": float(history["block_J_min"][late].min()),
        "J_max": float(history["block_J_max"][late].max()),
    }
