"""``valvefsi movie``: a field of a run in a plane over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from valvefsi.cli.options import not_a_folder
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.post.slices import Plane

Cut = Annotated[
    str | None,
    typer.Option("--slice", metavar="AXIS=POSITION", help="Plane, such as z=0 or y=2mm; not in 2-D."),
]


def read_plane(text: str | None) -> Plane | None:
    """Read ``axis=position`` as a plane, None as None."""
    from pydantic_core import PydanticCustomError

    from valvefsi.case.quantities import Quantity
    from valvefsi.post.slices import Plane

    if text is None:
        return None
    axis, equals, position = text.partition("=")
    if axis not in ("x", "y", "z") or not equals:
        raise CaseError("expected an axis and a position, such as z=0 or y=2mm", key="--slice", value=text)
    try:
        at = Quantity("cm").parse(float(position) if _is_number(position) else position)
    except PydanticCustomError as error:
        raise CaseError(error.message(), key="--slice", value=text) from None
    return Plane(axis="xyz".index(axis), position=at)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def movie(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a run.")],
    cut: Cut = None,
    field: Annotated[str, typer.Option("--field", help="What is shown, such as vorticity.")] = "speed",
    fps: Annotated[int, typer.Option("--fps", min=1, max=60, help="Frames a second.")] = 20,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="The movie, .mp4 (needs ffmpeg) or .gif.",
            callback=not_a_folder,
        ),
    ] = None,
) -> None:
    """Make a movie of the fluid in a plane with the solids over it; no display is needed."""
    from mpi4py import MPI
    from rich.progress import Progress as Bar

    from valvefsi.post.movies import draw_movie, find_ffmpeg

    if MPI.COMM_WORLD.rank != 0:
        return
    suffix = ".mp4" if find_ffmpeg() else ".gif"
    plane = read_plane(cut)
    path = out if out is not None else Path(folder) / f"movie_{field}{suffix}"
    with Bar() as bar:
        task = bar.add_task(path.name, total=None)
        made = draw_movie(
            folder,
            path,
            plane=plane,
            field=field,
            fps=fps,
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    typer.echo(str(made))
