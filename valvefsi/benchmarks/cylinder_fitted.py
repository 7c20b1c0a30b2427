"""The cylinder of `valvefsi.benchmarks.cylinder` on a mesh that fits it: an independent answer in the same box.

Nothing is immersed here and no staggered grid is involved: Taylor-Hood elements on curved triangles that are small at
the cylinder and in its near wake, see `valvefsi.fluid.fitted`. The box and what is given on its sides are those of the
immersed cylinder; diameter, speed and density are 1.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks.cylinder import PUBLISHED, compared, numbers, write_forces
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, write_result
from valvefsi.errors import CaseError
from valvefsi.fluid.fitted import FittedFlow
from valvefsi.geometry.mesh import SolidMesh, mesh_from_gmsh
from valvefsi.grid import Array

Progress = Callable[[int, float, float, dict[str, float]], None]

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

    def build(gmsh: object) -> None:
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


def run(
    *,
    size: float = 0.03,
    out: Path = Path("results/cylinder-fitted"),
    overrides: Sequence[str] = (),
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run the flow until it sheds vortices regularly; write ``result.json``, ``forces.csv`` and ``forces.png``.

    Args:
        size: Length of the elements at the cylinder, in diameters.
        out: Folder of the results.
        overrides: ``reynolds``, ``t_end``, ``width`` or ``courant`` as ``key=value``.
        comm: Communicator.
        progress: Called after every step.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: A size or parameter cannot be used.

    Note:
        Collective.
    """
    values = read_parameters(PARAMETERS, overrides)
    if not 0.0 < size <= 0.2:
        raise CaseError("expected a size above 0 and up to 0.2 diameters", key="--size", value=size)
    if not values["width"] >= 4.0:
        raise CaseError("expected at least 4 diameters", file="--set", key="width", value=values["width"])
    started = time.perf_counter()
    flow, cells = flow_around(size, values, comm)
    t, drag, lift = march(flow, values["t_end"], progress)
    flow.destroy()
    found = numbers(t, drag, lift)
    published = PUBLISHED.get(values["reynolds"], {})
    unknowns = flow.space.dofmap.index_map.size_global
    result = {
        "benchmark": "cylinder-fitted",
        "parameters": values | {"size": size, "cells": cells, "unknowns": unknowns, "dt": flow.dt},
        "quantities": found,
        "reference": {key: list(value) for key, value in published.items()},
        "table": compared(found, values["reynolds"]),
        "timing": {"steps": len(t), "wall_s": time.perf_counter() - started},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    title = f"Cylinder at Re {values['reynolds']:g}, {cells} triangles that fit it"
    write_forces(out, (t, drag, lift), published, title, comm)
    return result


def flow_around(size: float, values: dict[str, float], comm: MPI.Comm) -> tuple[FittedFlow, int]:
    """Return the flow at its start, a stream with a short push across it, and the number of triangles (collective)."""
    box = mesh_around(size, values["width"], comm)

    def facets(name: str) -> Array:
        return box.facet_tags.find(box.tag(name)[1])

    sides = {
        "sides": (facets("sides"), (None, 0.0)),
        "inlet": (facets("inlet"), (1.0, 0.0)),
        "cylinder": (facets("cylinder"), (0.0, 0.0)),
    }
    dt = values["courant"] * size
    flow = FittedFlow(box.mesh, sides, rho=1.0, mu=1.0 / values["reynolds"], dt=dt)
    flow.start(lambda x: np.stack([1.0 + 0.0 * x[0], 0.5 * np.exp(-((x[0] - 1.5) ** 2) - x[1] ** 2)]))
    return flow, box.mesh.topology.index_map(2).size_global


def march(flow: FittedFlow, t_end: float, progress: Progress | None = None) -> tuple[Array, Array, Array]:
    """Run to the end; return times, drag and lift coefficients (collective)."""
    rows = []
    for k in range(max(1, round(t_end / flow.dt))):
        force = flow.step()["cylinder"]
        rows.append((flow.t, 2.0 * force[0], 2.0 * force[1]))
        if progress is not None:
            progress(k + 1, flow.t, t_end, {"drag": rows[-1][1], "lift": rows[-1][2]})
    t, drag, lift = np.array(rows).T
    return t, drag, lift
