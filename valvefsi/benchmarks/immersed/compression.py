"""Compressed block (Lee2020, E.1), immersed, against exactly incompressible statics solved in the same run.

A neo-Hookean block of 20 x 10 cm in a box of 40 x 40 cm of fluid, walls at rest. A dead load of 200 dyn/cm^2 acts on
the central 10 cm of the top; u_x = 0 on the whole top and u_y = 0 on the bottom are held by tethers. The load grows
smoothly over the first 40 % of the run; displacement and area are averaged over its last 20 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.parameters import read_quantities
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.case import Case, parse_case
from valvefsi.case.build import build, write_case
from valvefsi.case.overrides import split_override
from valvefsi.io.history import read_history
from valvefsi.run.planning import plan as make_plan
from valvefsi.run.simulation import Outcome, Progress, Simulation
from valvefsi.solid import statics

LITERATURE = {"u_y_top_centre_cm": -3.9212}
"""Exactly incompressible, mixed elements refined until the digits stand (tests/reference/compression_statics.csv)."""

RAMP, AVERAGED = 0.4, 0.2
"""Part of the run over which the load grows; part at its end that is averaged over."""

PARAMETERS = {
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


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        elements: Elements M along the block's 20 cm.
        grid: Cells N along each edge of the box.
        kernel: Name of the regularised delta function.
        nu_stab: Numerical Poisson ratio (S22), None for no volumetric energy.
        overrides: ``key=value``, a name in `PARAMETERS` or a dotted key of the case.
    """

    elements: int = 32
    grid: int = 64
    kernel: str = "bspline3"
    nu_stab: float | None = 0.4
    overrides: Sequence[str] = ()


def run(
    setup: Setup,
    *,
    out: Path = Path("results/compression"),
    plan: bool = False,
    resume: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run the benchmark.

    Args:
        setup: What is run.
        out: Folder of the results.
        plan: Return the plan only.
        resume: Go on from the last checkpoint in the folder.
        comm: Communicator.
        progress: Called after every step.

    Returns:
        The contents of ``result.json``, or ``{"plan": ...}``.

    Raises:
        CaseError: The setup is not a valid case.

    Note:
        Collective.
    """
    case = compression_case(setup)
    simulation = build(case, out, comm)
    if plan:
        return {"plan": make_plan(simulation)}
    write_case(case, out, comm)
    reference = static_reference(simulation, case)
    outcome = simulation.run(resume=resume, progress=progress)
    result = _result(case, simulation, outcome, reference)
    result["parameters"] = {
        "elements": setup.elements,
        "grid": setup.grid,
        "kernel": setup.kernel,
        "nu_stab": "off" if setup.nu_stab is None else setup.nu_stab,
        **_parameters(case),
    }
    write_result(out, result, comm)
    lines = {
        "u_y_top_centre_cm": ("statics", reference["u_y_top_centre_cm"]),
        "block_area_change_percent": ("incompressible", 0.0),
    }
    title = f"Compressed block, {setup.elements} elements, {setup.grid}$^2$ cells, {setup.kernel}"
    simulation.pictures(outcome.state, title=title, references=lines)
    return result


def compression_case(setup: Setup) -> Case:
    """Return the case of the benchmark, with overrides.

    Raises:
        CaseError: An override or the outcome is not a valid case.
    """
    keys = {text: split_override(text)[0] for text in setup.overrides}
    dotted = [text for text, key in keys.items() if "." in key]
    values = read_quantities(PARAMETERS, [text for text, key in keys.items() if "." not in key])
    given = keys.values()
    if "c1" in given and "damping" not in given:
        values["damping"] = 0.05 * values["c1"]
    return parse_case(_raw_case(setup, values), dotted)


def _raw_case(setup: Setup, v: Mapping[str, float]) -> dict[str, object]:
    steps = round(v["t_end"] * setup.grid / (v["dt_per_h"] * 40.0)) if v["dt_per_h"] > 0 else 0
    return {
        "title": "Compressed block (Lee2020, E.1)",
        "grid": {"lower": [0.0, 0.0], "upper": [40.0, 40.0], "cells": [setup.grid, setup.grid]},
        "fluid": {"density": v["rho"], "viscosity": v["mu"]},
        "time": {"dt_per_h": v["dt_per_h"], "t_end": v["t_end"]},
        "output": {
            "history_every": max(1, steps // 600),
            "frames": 20,
            "checkpoint_every": max(1, steps // 4),
        },
        "solid": [_raw_block(setup, v)],
    }


def _raw_block(setup: Setup, v: Mapping[str, float]) -> dict[str, object]:
    tether = {"stiffness": v["tether_stiffness"], "damping": v["tether_damping"]}
    return {
        "name": "block",
        "mesh": {
            "shape": "compressed_block",
            "lower": [10.0, 15.0],
            "size": [20.0, 10.0],
            "elements": [setup.elements, setup.elements // 2],
            "load_width": 10.0,
        },
        "kernel": setup.kernel,
        "damping": v["damping"],
        "nu_stab": "off" if setup.nu_stab is None else setup.nu_stab,
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


def _parameters(case: Case) -> dict[str, object]:
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


def static_reference(simulation: Simulation, case: Case) -> dict[str, float]:
    """Solve the same block exactly incompressible, with mixed elements on the solid's own mesh.

    Returns:
        u_y of the top centre [cm].

    Note:
        Collective.
    """
    solid = simulation.model.bodies[0].solid
    fixed = [statics.Fixed(on=t.on, components=t.components) for t in case.solid[0].tether]
    solution = statics.solve(solid.mesh, solid.material, fixed=fixed, loads=solid.loads)
    return {"u_y_top_centre_cm": float(solution.displacement_at((20.0, 25.0))[1])}


def _result(
    case: Case, simulation: Simulation, outcome: Outcome, reference: dict[str, float]
) -> dict[str, object]:
    comm = simulation.model.grid.comm
    quantities = comm.bcast(_quantities(simulation, case) if comm.rank == 0 else None)
    u_y, known = quantities["u_y_top_centre_cm"], reference["u_y_top_centre_cm"]
    table = [
        row("u_y of the top centre", u_y, known, "mixed u-p statics, same mesh, this run", unit="cm"),
        row(
            "area change", quantities["area_change_percent"], 0.0, "incompressible", unit="%", relative=False
        ),
        row("smallest J", quantities["J_min"], unit="", source="1 when incompressible"),
        row("largest J", quantities["J_max"], unit="", source="1 when incompressible"),
    ]
    standard = {key: default for key, (default, _) in PARAMETERS.items() if key in ("traction", "c1")}
    if all(_parameters(case)[key] == default for key, default in standard.items()):
        literature = LITERATURE["u_y_top_centre_cm"]
        table.insert(1, row("", u_y, literature, "mixed elements, converged", unit="cm"))
    return {
        "benchmark": "compression",
        "parameters": {},
        "quantities": quantities,
        "reference": reference,
        "relative_error": (u_y - known) / abs(known),
        "table": table,
        "timing": outcome.timing(simulation.model.grid),
        "environment": environment(comm),
    }


def _quantities(simulation: Simulation, case: Case) -> dict[str, float]:
    """Means over the last part of the run, and how much the displacement still moves there."""
    history = {k: np.array(v) for k, v in read_history(simulation.output.directory / "history.csv").items()}
    late = history["t_s"] >= (1.0 - AVERAGED) * case.time.t_end
    u_y = history["u_y_top_centre_cm"][late]
    return {
        "u_y_top_centre_cm": float(u_y.mean()),
        "u_y_top_centre_swing_cm": float(np.ptp(u_y)),
        "area_change_percent": float(history["block_area_change_percent"][late].mean()),
        "J_min": float(history["block_J_min"][late].min()),
        "J_max": float(history["block_J_max"][late].max()),
    }
