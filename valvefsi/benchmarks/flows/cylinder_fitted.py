"""The cylinder of `valvefsi.benchmarks.flows.cylinder` on a mesh that fits it: an independent answer in the same box.

Nothing is immersed here and no staggered grid is involved: Taylor-Hood elements on curved triangles that are small at
the cylinder and in its near wake, see `fitted`. The box and what is given on its sides are those of the immersed
cylinder; diameter, speed and density are 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.flows.fitted import FittedFlow, Velocity
from valvefsi.benchmarks.flows.shedding import Forces, Shedding, numbers
from valvefsi.benchmarks.frame import Job, Record
from valvefsi.benchmarks.options import Values, option, require
from valvefsi.errors import CaseError
from valvefsi.geometry.flow_shapes import box_around_cylinder
from valvefsi.types import Indices

PARAMETERS = {
    "reynolds": (100.0, "1"),
    "t_end": (90.0, "s"),  # in units of D / U, which are 1 cm and 1 cm/s
    "width": (60.0, "1"),
    "courant": (0.16, "1"),
}
"""Default and unit; ``courant`` is the step over the size of the elements at the cylinder."""


@dataclass(frozen=True, kw_only=True)
class CylinderFitted(Shedding[float]):
    """The flow on the mesh that fits, run until it sheds vortices regularly."""

    name = "cylinder-fitted"
    parameters = PARAMETERS

    size: float = option(0.03, "Length of the elements at the cylinder, in diameters.")

    def check(self, values: Values) -> None:
        if not 0.0 < self.size <= 0.2:
            message = "expected a size above 0 and up to 0.2 diameters"
            raise CaseError(message, key="--size", value=self.size)
        require(values["width"] >= 4.0, "expected at least 4 diameters", values, "width")

    def mesh_of(self, record: Record) -> str:
        return f"{record['grid']['cells']} triangles that fit it"

    def runs(self) -> list[float]:
        return [self.size]

    def one(self, run: float, job: Job) -> Record:
        flow, cells = flow_around(run, self.values, job.comm)
        forces = march(flow, self.values["t_end"], job)
        flow.destroy()
        mesh = {
            "size": run,
            "cells": cells,
            "unknowns": flow.space.dofmap.index_map.size_global,
            "dt": flow.dt,
        }
        return {"grid": mesh, "steps": len(forces.t), "quantities": numbers(forces), "_forces": forces}


def flow_around(size: float, values: Values, comm: MPI.Comm) -> tuple[FittedFlow, int]:
    """Return the flow at its start, a stream with a short push across it, and the number of triangles (collective)."""
    box = box_around_cylinder(size, values["width"], comm)

    def facets(name: str) -> Indices:
        tags: Any = box.facet_tags
        return tags.find(box.tag(name)[1])

    sides: dict[str, tuple[Indices, Velocity]] = {
        "sides": (facets("sides"), (None, 0.0)),
        "inlet": (facets("inlet"), (1.0, 0.0)),
        "cylinder": (facets("cylinder"), (0.0, 0.0)),
    }
    dt = values["courant"] * size
    flow = FittedFlow(box.mesh, sides, rho=1.0, mu=1.0 / values["reynolds"], dt=dt)
    flow.start(lambda x: np.stack([1.0 + 0.0 * x[0], 0.5 * np.exp(-((x[0] - 1.5) ** 2) - x[1] ** 2)]))
    return flow, box.mesh.topology.index_map(2).size_global


def march(flow: FittedFlow, t_end: float, job: Job) -> Forces:
    """Run to the end; return the forces over time (collective)."""
    rows = []
    for k in range(max(1, round(t_end / flow.dt))):
        force = flow.step()["cylinder"]
        rows.append((flow.t, 2.0 * force[0], 2.0 * force[1]))
        job.show(k + 1, flow.t, t_end, drag=rows[-1][1], lift=rows[-1][2])
    return Forces(*np.array(rows).T)
