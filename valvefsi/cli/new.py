"""``valvefsi new``: a commented case of each kind, or the commands of a fit, with data that they run with."""

from __future__ import annotations

import difflib
import shlex
from pathlib import Path
from typing import Annotated

import typer

from valvefsi.cli.options import folder_of_results
from valvefsi.errors import CaseError

STARTS = Path(__file__).parent / "starts"
RUN = ("valvefsi run {0}.toml --plan", "valvefsi run {0}.toml", "valvefsi plot results/{0}")
NEXT = {
    "channel": RUN[:2],
    "beam": RUN,
    "valve": RUN,
    "own-mesh": ("valvefsi mesh import flap.stl --unit 1mm --size 1.2mm --out flap.msh", *RUN),
    "leaflet-fit": ("sh fit.sh",),
    "loop-fit": ("sh fit.sh",),
}
"""What there is to start from, and the commands to go on with in the new folder."""


def _starting_with(incomplete: str) -> list[str]:
    """Return what the Tab key completes a name to."""
    return [name for name in NEXT if name.startswith(incomplete)]


def new(
    what: Annotated[
        str,
        typer.Argument(metavar="WHAT", help="One of the names above.", autocompletion=_starting_with),
    ],
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write to, made if need be.")],
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace files that are there.")] = False,
) -> None:
    """Write a commented case, and its data, to start from; each runs in a minute.

    channel: pulsatile flow in a plane channel, no solid

    beam: an elastic beam bent by a flow, in two dimensions

    valve: a valve between the circuits of a pulse duplicator

    leaflet-fit: from biaxial tests of a leaflet to a material

    loop-fit: from pressures and flows to the circuits of a loop

    own-mesh: a body from an STL file in a stream
    """
    if what not in NEXT:
        near = difflib.get_close_matches(what, NEXT, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise CaseError(f"expected one of {', '.join(NEXT)}{hint}", key="WHAT", value=what)
    folder_of_results(folder, "DIR")
    files = sorted((STARTS / what).iterdir())
    there = next((folder / file.name for file in files if (folder / file.name).exists()), None)
    if there is not None and not overwrite:
        raise CaseError("this file is there; --overwrite replaces it", key="DIR", value=str(there))
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        (folder / file.name).write_bytes(file.read_bytes())
        typer.echo(f"written: {folder / file.name}")
    typer.echo("next:")
    typer.echo(f"  cd {shlex.quote(str(folder))}")
    for command in NEXT[what]:
        typer.echo(f"  {command.format(what)}")
