"""Compressed block (Lee2020, E.1), immersed, against exactly incompressible statics solved in the same run.

A neo-Hookean block of 20 x 10 cm in a box of 40 x 40 cm of fluid, walls at rest. A dead load of 200 dyn/cm^2 acts on
the central 10 cm of the top; u_x = 0 on the whole top and u_y = 0 on the bottom are held by tethers. The load grows
smoothly over the first 40 % of the run; displacement and area are averaged over its last 20 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job, Report, Result, Single
from valvefsi.benchmarks.immersed.study import GridStudy, Numerics
from valvefsi.benchmarks.options import Values, option, quantities, read_parameters, read_quantities
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.running import History, history_of, late, late_mean
from valvefsi.benchmarks.statics.solids import block_displacement
from valvefsi.case import Case, parse_case
from valvefsi.case.build import build, write_case
from valvefsi.case.overrides import split_override
from valvefsi.case.resuming import clear, run_folder
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError
from valvefsi.run.planning import plan as make_plan
from valvefsi.run.recording import Probe
from valvefsi.run.simulation import Simulation
from valvefsi.solid import statics
from valvefsi.solid.structure import Structure

RAMP = 0.4
"""Part of the run over which the load grows."""
GRID, BOX, LENGTH = 16, 40.0, 20.0
"""Cells along the box of the coarsest grid of a series; edge of the box and length of the block [cm]."""
TOP = (20.0, 25.0)
"""Centre of the top [cm]."""
KEY = "u_y_top_centre_cm"
DAMPING = 0.05
"""Body damping over c1, where it is not set [s/cm^2]."""
PARAMETERS = quantities(
    """traction = 200 dyn/cm^2, c1 = 80.194 dyn/cm^2, rho = 1 g/cm^3, mu = 0.01 dyn*s/cm^2, t_end = 60 s,
    dt_per_h = 0.005 s/cm, tether_stiffness = 1e5 dyn/cm^3, tether_damping = 0 dyn*s/cm^3""",
    damping=(DAMPING * 80.194, "dyn*s/cm^4"),
)
"""Default and unit of the parameters that ``--set NAME=value`` reaches; dotted keys reach the whole case."""


@dataclass(frozen=True, kw_only=True)
class Compression(Single):
    """The block on one grid, against statics on its own mesh; or on a series of grids, stabilised and not."""

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
    """Whether a run that the folder holds may be replaced."""

    def read(self) -> Values:
        return {}

    def check(self, values: Values) -> None:
        if self.refine:
            self.series()
        else:
            self.case()

    def overwrite(self) -> Compression:
        """Return the same, allowed to replace a run that its folder holds."""
        return replace(self, replaces=True)

    @property
    def discretisation(self) -> dict[str, Any]:
        """Elements, cells, kernel and stabilisation of the block on one grid."""
        nu = "off" if self.nu_stab is None else self.nu_stab
        size = {"elements": self.elements or 32, "grid": self.grid or 64}
        return {**size, "kernel": self.kernel, "nu_stab": nu}

    @property
    def folder(self) -> str:
        if self.refine:
            return "compression-series"
        return "compression-M{elements}-N{grid}-{kernel}-{nu_stab}".format(**self.discretisation)

    def series(self) -> BlockSeries:
        """Return the series of grids.

        Raises:
            CaseError: The ends of the load would lie between nodes, or a case is not valid.
        """
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

    def case(self) -> Case:
        """Return the case of the block on one grid, with overrides.

        Raises:
            CaseError: An override or the outcome is not a valid case.
        """
        plain, dotted = _split(self.overrides)
        values = read_quantities(PARAMETERS, list(plain))
        if "damping" not in plain.values():
            values["damping"] = DAMPING * values["c1"]
        return parse_case(_raw_case(self.discretisation, values), list(dotted))

    def plan(self, out: Path, comm: MPI.Comm) -> Result:
        """Return size, step limits and expected time of the run (collective)."""
        if self.refine:
            raise CaseError("a plan is of one run", key="--plan", value="--refine")
        return {"plan": make_plan(build(self.case(), out, comm))}

    def execute(self, session: Job) -> Result:
        return self.series().execute(session) if self.refine else super().execute(session)

    def measured(self, job: Job) -> Report:
        case, replaces, size = self.case(), self.replaces, self.discretisation
        with run_folder(case, job.folder, job.comm, resume=job.resume, overwrite=replaces) as changes:
            simulation = build(case, job.folder, job.comm, changes)
            if replaces and not job.resume:
                clear(job.folder, job.comm)
            write_case(case, job.folder, job.comm, changes)
            exact = static_reference(simulation, case)
            outcome = simulation.run(resume=job.resume, progress=job.progress)
        lines = {KEY: ("statics", exact), "block_area_change_percent": ("incompressible", 0.0)}
        title = "Compressed block, {elements} elements, {grid}$^2$ cells, {kernel}".format(**size)
        simulation.pictures(outcome.state, title=title, references=lines)
        history = history_of(job.folder, job.comm)
        q = late_numbers(history) | {"u_y_top_centre_swing_cm": float(np.ptp(history[KEY][late(history)]))}
        parameters, u_y = case_parameters(case), q[KEY]
        source = "mixed u-p statics, same mesh, this run"
        table = [row("u_y of the top centre", u_y, exact, source, unit="cm")]
        if all(parameters[key] == PARAMETERS[key][0] for key in ("traction", "c1")):
            table.append(row("", u_y, block_displacement(), "mixed elements, converged", unit="cm"))
        table += [
            row("area change", q["area_change_percent"], 0.0, "incompressible", unit="%", relative=False),
            row("smallest J", q["J_min"], source="1 when incompressible"),
            row("largest J", q["J_max"], source="1 when incompressible"),
        ]
        return Report(
            parameters=size | parameters,
            quantities=q,
            reference={KEY: exact},
            more={"relative_error": (u_y - exact) / abs(exact)},
            table=table,
            timing=outcome.timing(simulation.model.grid),
        )


@dataclass(frozen=True, kw_only=True)
class BlockSeries(GridStudy):
    """The block on a series of grids; every run is the one that `Compression` makes of the same options (S4 c, d)."""

    name = "compression"
    title = "Compressed block (E.1), immersed"
    parameters = PARAMETERS
    body = "block"
    probe = Probe(name="top_centre", body=0, at=TOP)

    def read(self) -> Values:
        plain, dotted = _split(self.overrides)
        values = read_parameters(PARAMETERS, list(plain))
        if "damping" not in plain.values():
            values.pop("damping")
        return values | {key: text.partition("=")[2].strip() for text, key in dotted.items()}

    def check(self, values: Values) -> None:
        super().check(values)
        self.case_of(self.runs()[0])

    def elements(self, numerics: Numerics) -> int:
        return round(LENGTH * numerics.grid / (numerics.ratio * BOX))

    def settings(self, numerics: Numerics) -> Values:
        return self.values

    def case_of(self, numerics: Numerics) -> Case:
        """Return the case of one run."""
        return Compression(
            elements=self.elements(numerics),
            grid=numerics.grid,
            kernel=numerics.kernel,
            nu_stab=numerics.nu_stab,
            overrides=[f"{key}={value}" for key, value in self.settings(numerics).items()],
        ).case()

    def simulation(self, numerics: Numerics, folder: Path, comm: MPI.Comm) -> Simulation:
        return build(self.case_of(numerics), folder, comm)

    def quantities(self, history: History) -> dict[str, float]:
        largest = float(np.abs(history[self.change]).max())
        return super().quantities(history) | {"largest_change_percent": largest} | late_numbers(history)

    def incompressible(self, numerics: Numerics, comm: MPI.Comm) -> tuple[float, str]:
        return self.same_mesh(numerics, comm), "mixed u-p statics, finest mesh"

    def same_mesh(self, numerics: Numerics, comm: MPI.Comm) -> float:
        case = self.case_of(numerics)
        return static_reference(build(case, Path(), comm), case)

    def elsewhere(self) -> list[tuple[float | str, str]]:
        converged: list[tuple[float | str, str]] = [(block_displacement(), "mixed elements, converged")]
        return converged if self.published("traction", "c1") else []


def _split(overrides: Sequence[str]) -> tuple[dict[str, str], dict[str, str]]:
    """Return overrides of the parameters and those of the whole case, each with its key."""
    keys = {text: split_override(text)[0] for text in overrides}
    one, whole = ({text: key for text, key in keys.items() if ("." in key) is dots} for dots in (False, True))
    return one, whole


def _raw_case(size: Mapping[str, Any], v: Values) -> dict[str, Any]:
    grid, elements = size["grid"], size["elements"]
    steps = round(v["t_end"] * grid / (v["dt_per_h"] * BOX)) if v["dt_per_h"] > 0 else 0
    tether = {"stiffness": v["tether_stiffness"], "damping": v["tether_damping"]}
    ramp = {"ramp": RAMP * v["t_end"], "ramp_shape": "smooth"}
    mesh = {"lower": [10.0, 15.0], "size": [20.0, 10.0], "elements": [elements, elements // 2]}
    block = {
        "name": "block",
        "mesh": {"shape": "compressed_block", **mesh, "load_width": 10.0},
        "kernel": size["kernel"],
        "damping": v["damping"],
        "nu_stab": size["nu_stab"],
        "material": {"model": "neo_hookean", "c1": v["c1"]},
        "tether": [
            {"on": ["bottom"], "components": ["y"], **tether},
            {"on": ["top_loaded", "top_outer"], "components": ["x"], **tether},
        ],
        "load": [{"on": ["top_loaded"], "traction": [0.0, -v["traction"]], **ramp}],
        "probe": [{"name": "top_centre", "at": list(TOP)}],
    }
    every = {"history_every": max(1, steps // 600), "checkpoint_every": max(1, steps // 4)}
    return {
        "title": "Compressed block (Lee2020, E.1)",
        "grid": {"lower": [0.0, 0.0], "upper": [BOX, BOX], "cells": [grid, grid]},
        "fluid": {"density": v["rho"], "viscosity": v["mu"], "advection": "centred"},
        "time": {"dt_per_h": v["dt_per_h"], "t_end": v["t_end"]},
        "output": {"frames": 20, **every},
        "solid": [block],
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


def late_numbers(history: History) -> dict[str, float]:
    """Return means and extremes over the last part of a run."""
    last = late(history)
    return {
        KEY: late_mean(history, KEY),
        "area_change_percent": late_mean(history, "block_area_change_percent"),
        "J_min": float(history["block_J_min"][last].min()),
        "J_max": float(history["block_J_max"][last].max()),
    }
