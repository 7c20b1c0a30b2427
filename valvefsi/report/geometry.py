"""The grid, and the meshes of the bodies with their quality, from the first frame of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from valvefsi.case.valve import find_valve
from valvefsi.errors import CaseError
from valvefsi.geometry.valve import mesh_valve
from valvefsi.geometry.valve_quality import quality
from valvefsi.io.series import read_times
from valvefsi.io.solid_body import Body, read_body
from valvefsi.post.mesh_numbers import mesh_numbers
from valvefsi.report.blocks import Block, Cell, Section, Table, missing
from valvefsi.report.runs import Run


def the_geometry(run: Run) -> Section:
    """Return grid, meshes and quality."""
    return Section(title="Geometry and mesh", blocks=[*_grid(run), *_meshes(run), *_valve(run)])


def _grid(run: Run) -> list[Block]:
    if run.case is None:
        return []
    rows = []
    for axis, edges in zip("xyz", run.case.grid.edges, strict=False):
        widths = 10.0 * np.diff(edges)
        ends = (float(edges[0]), float(edges[-1]), len(widths), float(widths.min()), float(widths.max()))
        rows.append((axis, *ends))
    headings = ("axis", "from [cm]", "to [cm]", "cells", "finest [mm]", "coarsest [mm]")
    return [Table(caption="The grid of the fluid", headings=headings, rows=rows)]


def solid_series(folder: Path) -> list[Path]:
    """Return the series of the solids of a run, without those of the fluid and of stresses."""
    found = sorted((Path(folder) / "paraview").glob("*.pvd"))
    return [
        path for path in found if path.stem not in ("fluid", "averages") and not path.stem.endswith("_stress")
    ]


def first_bodies(folder: Path) -> dict[str, Body]:
    """Return the bodies of a run by name, as they were without load: first frames, and files that stay."""
    found = {}
    for series in solid_series(folder):
        for _, name in read_times(series)[:1]:
            if (series.parent / name).suffix == ".vtu" and (series.parent / name).is_file():
                found[series.stem] = read_body(series.parent / name)
    for path in sorted((Path(folder) / "paraview").glob("*.vtu")):
        found[path.stem] = read_body(path)
    return found


def _meshes(run: Run) -> list[Block]:
    try:
        bodies = first_bodies(run.folder)
    except CaseError as error:
        return [missing(f"The frames cannot be read: {error}")]
    if not bodies:
        return [missing(_without_bodies(run))]
    h = run.case.grid.spacing if run.case is not None else None
    rows: list[tuple[Cell, ...]] = []
    for name, body in bodies.items():
        n = mesh_numbers(body)
        over = None if h is None else n["mean_edge_cm"] / h
        edges = (10.0 * n["smallest_edge_cm"], 10.0 * n["largest_edge_cm"])
        rows.append((name, int(n["nodes"]), int(n["cells"]), *edges, over, n["smallest_scaled_jacobian"]))
    edges_of = ("shortest edge [mm]", "longest edge [mm]", "mean edge over h")
    headings = ("body", "nodes", "cells", *edges_of, "smallest scaled Jacobian")
    caption = (
        "Meshes of the bodies without load (a scaled Jacobian is 1 for the best corner, 0 for a flat one)"
    )
    return [Table(caption=caption, headings=headings, rows=rows)]


def _without_bodies(run: Run) -> str:
    """Return why there are no meshes."""
    if run.case is not None and not run.case.solid:
        return "The case has no solids: there are no meshes but the grid."
    why = f" (output.frames = {run.case.output.frames})" if run.case is not None else ""
    return f"The run has no frames of bodies{why}: nothing is known of its meshes here."


def _valve(run: Run) -> list[Block]:
    """Return the quality table of a valve that was meshed from its formula."""
    valve = None if run.case is None else find_valve(run.case)
    if run.case is None or valve is None:
        return []
    shape = run.case.solid[valve.number].mesh.valve
    if shape is None:
        return [
            missing("The leaflets are from a file: the quality table of the parametric valve does not apply.")
        ]
    geometry = shape.geometry()
    numbers = quality(
        geometry, mesh_valve(geometry, size=shape.ratio * run.case.grid.spacing, layers=shape.layers)
    )
    rows = [(name.replace("_", " "), value) for name, value in numbers.items()]
    return [
        Table(
            caption="Shape and mesh of the leaflets", headings=("number, its unit last", "value"), rows=rows
        )
    ]
