"""``valvefsi mesh show``: a mesh, or the meshes of a case, to look at."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.options import Out, Trust
from valvefsi.cli.tables import print_lines, terminal
from valvefsi.errors import CaseError


def show(
    file: Annotated[Path, typer.Argument(metavar="FILE|CASE", help="A mesh, .msh in cm, or a case, .toml.")],
    out: Out = None,
    trust: Trust = False,
) -> None:
    """Draw the tags, thickness and fibres of a mesh, or of each solid of a case; print how good its cells are.

    The pictures go to --out, else to the folder of the file. A surface or another kind of file: mesh import first.
    """
    from mpi4py import MPI

    from valvefsi.cli.mesh_pictures import show_mesh

    if MPI.COMM_WORLD.size > 1:
        raise CaseError("call it without mpirun", key="mesh show")
    if file.suffix not in (".msh", ".toml"):
        message = "expected a mesh, .msh, or a case, .toml; mesh import makes a .msh of other files"
        raise CaseError(message, key="FILE", value=str(file))
    folder = out if out is not None else file.parent
    if file.suffix == ".msh":
        from valvefsi.geometry.mesh import read_mesh

        shown = {file.stem: read_mesh(file, MPI.COMM_SELF)}
    else:
        from valvefsi.case import load_case
        from valvefsi.case.fibre_pictures import meshes_of

        shown = meshes_of(load_case(file, trust=trust), MPI.COMM_SELF)
        if not shown:
            raise CaseError("this case has no solid", file=file, key="solid")
    for name, mesh in shown.items():
        made = show_mesh(name, mesh, folder)
        print_lines(terminal(), [str(path) for path in made])
