"""Pictures of the fibre fields of a case, drawn before anything is run."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from valvefsi.case.fibres import add_fibres
from valvefsi.case.meshes import build_mesh
from valvefsi.case.models import Case
from valvefsi.errors import CaseError
from valvefsi.post.plots.fibre import fibre_picture
from valvefsi.solid.materials.fibres import on_root


def draw_fibres(case: Case, out: Path, comm: MPI.Comm = MPI.COMM_WORLD) -> list[Path]:
    """Draw every fibre field of every solid as ``fibres_SOLID_NAME.png``.

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
    if not any(solid.fibre for solid in case.solid):
        raise CaseError("no solid of this case has a fibre field to draw", file=case.file, key="solid.fibre")
    made = []
    for solid in case.solid:
        if not solid.fibre:
            continue
        mesh = build_mesh(solid.mesh, case.file, comm, case.grid.spacing)
        mesh = add_fibres(mesh, solid.fibre, f"solid.{solid.name}")
        for fibre in solid.fibre:
            found = on_root(mesh, fibre.name)
            if found is None:
                continue
            Path(out).mkdir(parents=True, exist_ok=True)
            title = f"{solid.name}, {fibre.name}: {len(found[0])} fibres (red x, green y, blue z)"
            path = Path(out) / f"fibres_{solid.name}_{fibre.name}.png"
            made.append(fibre_picture(path, *found, title=title))
    return made
