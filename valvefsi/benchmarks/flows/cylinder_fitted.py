"""The cylinder of `valvefsi.benchmarks.flows.cylinder` on a mesh that fits it: an independent answer in the same box.

Nothing is immersed here and no staggered grid is involved: Taylor-Hood elements on curved triangles that are small at
the cylinder and in its near wake, see `fitted`. The box and what is given on its sides are those of the immersed
cylinder; diameter, speed and density are 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.flows.fitted import FittedFlow
from valvefsi.benchmarks.flows.shedding import Forces, draw_forces, numbers, published, table_of
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.options import Values, option
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh
from valvefsi.grid import Array

PARAMETERS = {
    "reynolds": (100.0, "1"),
    "t_end": (90.0, "1"),
    "width": (60.0, "1"),
    "courant": (0.16, "1"),
}
"""Default and unit; ``courant`` is the step over the size of the elements at the cylinder."""
GROWTH = 0.12
"""By how much elements become longer per length away from the cylinder."""
WAKE = (9.0, 1.8, 4.0)
"""Length and half width of the near wake, and the size of its elements over that at the cylinder."""


def mesh_around(size: float, width: float, comm: MPI.Comm) -> SolidMesh:
    """Mesh the box around the cylinder with curved triangles; tags "inlet", "sides", "outlet" and "cylinder".

    Args:
        size: Length of the elements at the cylinder, in diameters.
        width: Width of the box in diameters; the box is ten longer, behind the cylinder.
        comm: Communicator.

    Note:
        Collective.
    """
    half = 0.5 * width

    def build(gmsh: Any) -> None:
        shapes, field = gmsh.model.occ, gmsh.model.mesh.field
        box = shapes.addRectangle(-half, -half, 0.0, width + 10.0, width)
        shapes.cut([(2, box)], [(2, shapes.addDisk(0.0, 0.0, 0.0, 0.5, 0.5))])
        shapes.synchronize()
        sides: dict[str, list[int]] = {"inlet": [], "sides": [], "outlet": [], "cylinder": []}
        for _, line in gmsh.model.getEntities(1):
            x, y, _ = gmsh.model.occ.getCenterOfMass(1, line)
            on_side = abs(abs(y) - half) < 1e-6
            end = "inlet" if abs(x + half) < 1e-6 else "outlet"
            sides["cylinder" if math.hypot(x, y) < 1.0 else "sides" if on_side else end].append(line)
        for name, lines in sides.items():
            gmsh.model.addPhysicalGroup(1, lines, name=name)
        gmsh.model.addPhysicalGroup(2, [tag for _, tag in gmsh.model.getEntities(2)], name="fluid")
        away = field.add("MathEval")
        field.setString(away, "F", f"{size} + {GROWTH} * (sqrt(x * x + y * y) - 0.5)")
        wake = field.add("Box")
        length, across, coarser = WAKE
        within = {"XMin": 0.0, "XMax": length, "YMin": -across, "YMax": across, "Thickness": half}
        for key, value in {**within, "VIn": coarser * size, "VOut": half / 8.0}.items():
            field.setNumber(wake, key, value)
        least = field.add("Min")
        field.setNumbers(least, "FieldsList", [away, wake])
        field.setAsBackgroundMesh(least)
        for key in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
            gmsh.option.setNumber(f"Mesh.MeshSize{key}", 0)
        gmsh.model.mesh.generate(2)
        gmsh.model.mesh.setOrder(2)

    return mesh_from_gmsh(build, comm, source="box around a cylinder")


@dataclass(frozen=True, kw_only=True)
class CylinderFitted(Benchmark[float, None]):
    """The flow on the mesh that fits, run until it sheds vortices regularly."""

    name = "cylinder-fitted"
    parameters = PARAMETERS

    size: float = option(0.03, "Length of the elements at the cylinder, in diameters.")

    def check(self, values: Values) -> None:
        """Refuse elements and boxes that cannot be meshed."""
        if not 0.0 < self.size <= 0.2:
            message = "expected a size above 0 and up to 0.2 diameters"
            raise CaseError(message, key="--size", value=self.size)
        if not values["width"] >= 4.0:
            raise CaseError("expected at least 4 diameters", file="--set", key="width", value=values["width"])

    def runs(self) -> list[float]:
        """Return the mesh."""
        return [self.size]

    def one(self, run: float, job: Job) -> Record:
        """Run to the end and read off drag and lift."""
        flow, cells = flow_around(run, self.values, job.comm)
        forces = march(flow, self.values["t_end"], job)
        flow.destroy()
        mesh = {"size": run, "cells": cells, "unknowns": flow.space.dofmap.index_map.size_global}
        return {"mesh": mesh | {"dt": flow.dt}, "quantities": numbers(forces), "_forces": forces}

    def report(self, records: Sequence[Record], known: None) -> Report:
        """Return drag, lift and frequency beside the published ranges."""
        (r,), reynolds = records, self.values["reynolds"]
        return Report(
            parameters=self.values | r["mesh"],
            quantities=r["quantities"],
            reference={key: list(band) for key, (band, _) in published(reynolds).items()},
            table=table_of(r["quantities"], reynolds),
            timing={"steps": len(r["_forces"].t)},
        )

    def draw(self, records: Sequence[Record], known: None, out: Path) -> None:
        """Write and draw the forces."""
        (r,), reynolds = records, self.values["reynolds"]
        title = f"Cylinder at Re {reynolds:g}, {r['mesh']['cells']} triangles that fit it"
        draw_forces(out, r["_forces"], reynolds, title)


def flow_around(size: float, values: Values, comm: MPI.Comm) -> tuple[FittedFlow, int]:
    """Return the flow at its start, a stream with a short push across it, and the number of triangles (collective)."""
    box = mesh_around(size, values["width"], comm)

    def facets(name: str) -> Array:
        tags: Any = box.facet_tags
        return tags.find(box.tag(name)[1])

    sides = {
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
