"""The meshes of a case with their fibre fields, and pictures of these, before anything is run."""

from __future__ import annotations

import re
from pathlib import Path

from mpi4py import MPI

from valvefsi.case.fibres import add_fibres
from valvefsi.case.meshes import build_mesh
from valvefsi.case.models import Case
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.post.plots.fibre import fibre_picture
from valvefsi.solid.materials.fibres import on_root

MOST = 5000
"""Fibres of a field that are drawn at most."""


def meshes_of(case: Case, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, SolidMesh]:
    """Return the mesh of every solid by its name, with the fibre fields that its material can use. Collective."""
    made = {}
    for solid in case.solid:
        mesh = build_mesh(solid.mesh, case.file, comm, case.grid.spacing)
        key = f"solid.{solid.name}"
        made[solid.name] = add_fibres(mesh, solid.fibre, key, solid.material, solid.mesh.leaflets)
    return made


def draw_fibres(case: Case, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> list[Path]:
    """Draw every fibre field of every solid as ``fibres_SOLID_NAME.png``: those of the case, of valves, of materials.

    Args:
        case: The case.
        out: Folder of the pictures, made if need be.
        comm: Communicator.

    Returns:
        The pictures; none on other ranks than 0.

    Raises:
        CaseError: No solid has a fibre field, or one cannot be made on its mesh.

    Note:
        Collective.
    """
    meshes = meshes_of(case, comm)
    if not any(mesh.fibres for mesh in meshes.values()):
        raise CaseError("no solid of this case has a fibre field to draw", file=case.file, key="solid.fibre")
    return [
        path
        for name, mesh in meshes.items()
        for path in draw_fields(name, mesh, Path(out), "fibres_{}_{}.png")
    ]


def heading(field: str) -> str:
    """Return the name of a fibre field in words: "fibres" and "fibres 2", else the field's own, as "sheet fibres"."""
    found = re.fullmatch(r"fibre(?:[ _]?(\d+))?", field)
    return f"fibres {found[1] or ''}".strip() if found else f"{field.replace('_', ' ')} fibres"


def draw_fields(solid: str, mesh: SolidMesh, out: Path, name: str) -> list[Path]:
    """Draw every fibre field of a mesh; fields that are one and the same are drawn once.

    Args:
        solid: Name of the solid.
        mesh: Its mesh.
        out: Folder of the pictures, made if need be.
        name: Name of a picture, with places for the solid and the field.

    Note:
        Collective; rank 0 draws.
    """
    made, fields = [], dict[int, str]()
    for field, function in mesh.fibres.items():
        fields.setdefault(id(function), field)
    for field in fields.values():
        found = on_root(mesh, field)
        if found is None:
            continue
        out.mkdir(parents=True, exist_ok=True)
        every = -(-len(found[0]) // MOST)
        title = f"{solid.replace('_', ' ')}: {heading(field)}"
        caption = f"{len(found[0][::every])} lines along the fibres, coloured by their direction"
        path = out / name.format(solid, re.sub("[^A-Za-z0-9]+", "_", field))
        made.append(fibre_picture(path, found[0][::every], found[1][::every], title=title, caption=caption))
    return made
