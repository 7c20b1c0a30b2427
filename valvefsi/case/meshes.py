"""Meshes of the solids of a case: from files, shapes and valves, with the fibre fields that come with them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.case.checks import check_against_mesh
from valvefsi.case.models import Case, Mesh
from valvefsi.case.valve_tables import ValveShape
from valvefsi.errors import CaseError
from valvefsi.geometry import mesh as meshes
from valvefsi.geometry import shapes
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.geometry.valve import ValveMesh, distribute, first_leaflet, mesh_valve
from valvefsi.solid.materials import fibres


def solid_mesh(case: Case, number: int, comm: MPI.Comm) -> SolidMesh:
    """Mesh one solid of a case, and check it against the case.

    Raises:
        CaseError: The mesh cannot be used, or does not fit the case.

    Note:
        Collective.
    """
    given = case.solid[number]
    place = f"solid.{given.name}.mesh"
    try:
        mesh = build_mesh(given.mesh, case.file, comm, case.grid.spacing)
    except CaseError as error:
        key = place + (f".{error.key}" if error.key else "")
        raise CaseError(error.reason, file=error.file or case.file, key=key, value=error.value) from None
    x = mesh.mesh.geometry.x
    bounds = np.concatenate([x.min(axis=0, initial=np.inf), -x.max(axis=0, initial=-np.inf)])
    comm.Allreduce(MPI.IN_PLACE, bounds, op=MPI.MIN)
    if mesh.dim != case.grid.dim:
        message = f"the mesh has {mesh.dim} dimensions and the grid {case.grid.dim}"
        raise CaseError(message, file=case.file, key=place)
    lower, upper = bounds[:3].tolist(), (-bounds[3:]).tolist()
    check_against_mesh(case, number, tags=mesh.names, lower=lower, upper=upper)
    return mesh


def build_mesh(mesh: Mesh, case_file: Path | None, comm: MPI.Comm, h: float) -> SolidMesh:
    """Read or make the mesh of a solid in a grid of spacing h, with the fibre fields that come with it. Collective."""
    if mesh.valve is not None:
        return valve_mesh(mesh.valve, h, comm)
    if mesh.file is not None:
        path = mesh_path(mesh.file, case_file)
        made = meshes.read_mesh(path, comm)
        if mesh.leaflets is None or mesh.leaflets.directions == "tags":
            return made
        try:
            return made.with_fibres(**fibres.read_vectors(made, path))
        except CaseError as error:
            key = "leaflets.directions"
            raise CaseError(error.reason, file=error.file, key=key, value="data") from None
    options: dict[str, Any] = {"lower": mesh.lower, "size": mesh.size, "elements": mesh.elements}
    if mesh.cell:
        options["cell"] = mesh.cell
    if mesh.load_width is not None:
        options["load_width"] = mesh.load_width
    return getattr(shapes, str(mesh.shape))(comm, **options)


def mesh_path(file: str, case_file: Path | None) -> Path:
    """Return where a file of a case is."""
    return (case_file.parent if case_file else Path()) / file


def valve_mesh(shape: ValveShape, h: float, comm: MPI.Comm) -> SolidMesh:
    """Mesh the leaflets of a valve for a grid of spacing h, with fibre fields fibre_1, ... and fibre, the first.

    The leaflets' own directions are the fields circumferential and radial.

    Note:
        Collective.
    """
    return _with_fields(_leaflets(shape, h), comm)


def leaflet_mesh(shape: ValveShape, h: float, comm: MPI.Comm) -> SolidMesh:
    """Mesh one leaflet of a valve, as `valve_mesh` meshes three. Collective."""
    return _with_fields(first_leaflet(_leaflets(shape, h)), comm)


def _leaflets(shape: ValveShape, h: float) -> ValveMesh:
    return _at_height(mesh_valve(shape.geometry(), size=shape.ratio * h, layers=shape.layers), shape.base)


def _with_fields(made: ValveMesh, comm: MPI.Comm) -> SolidMesh:
    mesh = distribute(made, comm)
    middles = made.points[made.cells].mean(axis=1)
    fields = {name: fibres.from_cells(mesh, middles, vectors) for name, vectors in made.fibres.items()}
    return mesh.with_fibres(**fields, fibre=fields["fibre_1"])


def _at_height(mesh: ValveMesh, z: float) -> ValveMesh:
    """Return a valve's mesh, moved along its axis."""
    return replace(mesh, points=mesh.points + [0.0, 0.0, z])
