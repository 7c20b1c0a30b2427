"""Leakage test of the aortic test section: what flows through it, closed by a plate, under a pressure difference.

The plate stands in the inflow tract, where the section is closed by its valve in diastole; the pressure acts from the
outflow side, so that the walls of the sinuses bear it too. The springs that hold the surface yield at first; what
flows after that leaks between the points and through the kernel.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.benchmarks.frame import Job, Report, Single
from valvefsi.benchmarks.options import Values, quantities, require
from valvefsi.benchmarks.results import row
from valvefsi.benchmarks.running import Columns, completed, fixed_steps
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import explicit_springs
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary, Disk, Mixed, Open
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.geometry.aortic_section import AorticSection, closing_plate, joined
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.grid import MacGrid
from valvefsi.post.plots.decay import leak
from valvefsi.run.simulation import Simulation
from valvefsi.types import Array
from valvefsi.units import MMHG

PARAMETERS = quantities(
    "h = 0.1 cm, viscosity = 0.035 dyn*s/cm^2, dt = 5e-5 s, t_end = 0.3 s, hold = 0.25",
    pressure=(100.0 * MMHG, "dyn/cm^2"),
    sinuses=("yes", ("yes", "no")),
)
BELOW, ABOVE = 0.8, 0.8
"""Length of the tracts before and behind the sinuses [cm]."""
LATE = 0.25
"""Part of the run over which the leak is averaged."""
KERNEL = "composite_bspline32"
TIGHT = 0.1
"""What a section that is called tight may leak at 100 mmHg and h = 1 mm [cm^3/s]."""


@dataclass(frozen=True, kw_only=True)
class Leakage(Single):
    """The closed section; the leak is the size of the mean flow over the last quarter of the run."""

    name = "leakage"
    resumable = True
    parameters = PARAMETERS

    def check(self, values: Values) -> None:
        require(values["hold"] <= 1.0, "expected a part of the explicit limit, at most 1", values, "hold")

    def simulation(self, folder: Path, comm: MPI.Comm) -> Simulation:
        model, dt = build(self.values, comm), self.values["dt"]
        outflow = Columns(("leak_ml_s",), lambda state: [model.fluid.boundary.outflow(state.u, "z_lower")])
        steps = max(8, round(self.values["t_end"] / dt))
        return fixed_steps(model, folder, dt, steps, rows=steps, observers=(outflow,), provenance=self.values)

    def measured(self, job: Job) -> Report:
        simulation = self.simulation(job.folder, job.comm)
        h, model = completed(simulation, job), simulation.model
        t, flow = h["t_s"][1:], h["leak_ml_s"][1:]
        late = flow[-max(1, round(LATE * len(flow))) :]
        leak = abs(float(late.mean()))
        target: tuple[str | None, str] = (None, "")
        if self.published("h", "pressure"):
            target = (f"below {TIGHT}", "what is asked at 100 mmHg and h = 1 mm")
        return Report(
            parameters=self.values,
            quantities={"leak_ml_s": leak},
            more={"size": {"cells": list(model.grid.cells), "points": model.bodies[0].num_points}},
            table=[
                row("leak, mean of the last quarter", leak, *target, unit="ml/s"),
                row("swing about it", float(0.5 * np.ptp(late)), unit="ml/s"),
                row("largest flow while the springs yield", float(np.abs(flow).max()), unit="ml/s"),
            ],
            timing={"steps": len(flow)},
            draw=lambda out: self._draw(out, t, flow),
        )

    def _draw(self, out: Path, t: Array, flow: Array) -> None:
        v = self.values
        what = "with sinuses" if v["sinuses"] == "yes" else "without sinuses"
        case = f"h = {10 * v['h']:.3g} mm, {v['pressure'] / MMHG:.4g} mmHg"
        leak(out / "leak.png", t, flow, LATE, title=f"Closed test section {what}, {case}")


def build(parameters: Values, comm: MPI.Comm) -> fsi.Model:
    """Return the section with its plate in a box, the pressure on the disk where the fluid leaves in systole.

    Raises:
        CaseError: The step is longer than the viscosity allows.

    Note:
        Collective.
    """
    h, dt, hold = parameters["h"], parameters["dt"], parameters["hold"]
    depth = {"yes": 0.5, "no": 0.0}[parameters["sinuses"]]
    section = AorticSection(sinus_depth=depth)
    outlet, inlet = section.outlet_radius, section.inlet_radius
    across = 2 * int(np.ceil(section.widest / h + 2.5))
    along = int(np.ceil((BELOW + section.sinus_height + ABOVE) / h))
    half, top = 0.5 * across * h, along * h - BELOW
    grid = MacGrid([-half, -half, -BELOW], [half, half, top], (across, across, along), [False] * 3, comm)
    ends = {
        "z_lower": Mixed(open=Open(), where=Disk(centre=(0.0, 0.0, -BELOW), radius=inlet)),
        "z_upper": Mixed(
            open=Open(pressure=parameters["pressure"]), where=Disk(centre=(0.0, 0.0, top), radius=outlet)
        ),
    }
    limit = ExplicitViscosity.limit(grid, rho=1.0, mu=parameters["viscosity"])
    if dt > limit:
        raise CaseError(f"viscosity allows at most {limit:.3g} s", file="--set", key="dt", value=dt)
    fluid = ExplicitViscosity(
        grid, Boundary(grid, ends), rho=1.0, mu=parameters["viscosity"], advection="xsppm7"
    )
    reach = (-BELOW + 0.5 * h, top - 0.5 * h)
    tube, disk = section.housing(h, reach), closing_plate(inlet, -0.5 * BELOW, h)
    labels = patch_labels((tube, disk), h, reach)
    labels[len(tube.points) :] = SINGLE  # the plate stands for leaflets, which are held node by node
    tube = tube.moved(h * surface_offset(KERNEL, tube.normals, (0.0, 0.0, 1.0)))
    spring = explicit_springs(KERNEL, h, dt, hold)
    rigid = PatchedSurface(joined(tube, disk), labels, Coupling(grid, KERNEL), name="section", **spring)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(rigid,))
