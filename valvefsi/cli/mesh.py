"""``valvefsi mesh``: make the mesh of a valve from a few lengths, take one from elsewhere, show one."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from valvefsi.cli.mesh_show import show
from valvefsi.cli.options import HELP, not_a_folder, plain
from valvefsi.errors import CaseError

mesh = typer.Typer(help="Make meshes, and look at them.", **HELP)

OutMesh = Annotated[Path, typer.Option("--out", metavar="FILE.msh", help="The mesh.", callback=not_a_folder)]


@mesh.callback()
def _group() -> None:
    """Make meshes, and look at them."""


mesh.command("show")(show)


@mesh.command()
def valve(
    kind: Annotated[str, typer.Option("--type", help="pericardial or porcine.")] = "pericardial",
    diameter: Annotated[str, typer.Option(help="Diameter of the stent.")] = "25mm",
    h: Annotated[str, typer.Option("--h", help="Spacing of the fluid's grid.")] = "1mm",
    ratio: Annotated[float, typer.Option(min=0.05, max=4.0, help="Element size over h.")] = 0.5,
    layers: Annotated[int, typer.Option(min=1, help="Elements through the thickness.")] = 1,
    cell: Annotated[str, typer.Option(help="hexahedron or tetrahedron.")] = "hexahedron",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=LENGTH", help="Set a length, such as gap=0.5mm. Repeatable."),
    ] = None,
    out: OutMesh = Path("valve.msh"),
) -> None:
    """Mesh the three leaflets of a valve; writes FILE.msh, FILE.json (quality) and FILE.png."""
    from valvefsi.geometry.leaflets import TYPES
    from valvefsi.geometry.valve import mesh_valve, write_valve
    from valvefsi.geometry.valve_quality import quality
    from valvefsi.io.folder import replacing, write_text
    from valvefsi.post.plots.valve import valve as draw

    if kind not in TYPES:
        raise CaseError(f"expected one of {', '.join(TYPES)}", key="--type", value=kind)
    _check_name(out)
    geometry = TYPES[kind](diameter=_length("--diameter", diameter))
    lengths: dict[str, Any] = _lengths(overrides or [])
    geometry = replace(geometry, **lengths)
    made = mesh_valve(geometry, size=ratio * _length("--h", h), layers=layers, cell=cell)
    with replacing(out) as temporary:
        write_valve(temporary, made)
    numbers = quality(geometry, made)
    write_text(out.with_suffix(".json"), json.dumps(numbers, indent=1) + "\n")
    title = f"{kind} valve, {diameter}"
    draw(out.with_suffix(".png"), made.points, made.facets, title=title, caption=_sizes(numbers))
    for name, value in numbers.items():
        typer.echo(f"{name:34s} {value:.6g}")
    typer.echo(f"written: {out}, {out.with_suffix('.json')}, {out.with_suffix('.png')}")


@mesh.command("import")
def import_(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Closed surface or volume mesh: .stl, .vtu, .msh ...")
    ],
    unit: Annotated[str, typer.Option(help="Length of the file's unit.")] = "1mm",
    size: Annotated[
        str | None,
        typer.Option(help="Edge aimed at for the tetrahedra in a surface; some are up to twice as long."),
    ] = None,
    angle: Annotated[
        float, typer.Option(min=1.0, max=179.0, help=plain("Turn of the normal at which patches part [deg]."))
    ] = 40.0,
    out: OutMesh = Path("body.msh"),
) -> None:
    """Take a leaflet from elsewhere; a closed surface is filled with tetrahedra. Writes FILE.msh in cm.

    FILE_tags.png shows the parts of its surface in colours, each with the tag that a case names to clamp it, and
    FILE_thickness.png its thickness; tables say how good the cells are, and area, middle and normal of each tag.
    """
    from mpi4py import MPI

    from valvefsi.geometry.importing import import_mesh
    from valvefsi.geometry.mesh import read_mesh
    from valvefsi.io.folder import replacing

    _check_name(out)
    edge = None if size is None else _length("--size", size)
    with replacing(out) as temporary:
        numbers = import_mesh(file, temporary, scale=_length("--unit", unit), size=edge, angle=angle)
    typer.echo(f"volume  {1e3 * numbers['volume_cm3']:.5g} mm^3")
    typer.echo(f"extent  {' x '.join(f'{10.0 * length:.5g}' for length in numbers['extent_cm'])} mm")
    from valvefsi.cli.mesh_pictures import show_mesh

    made = show_mesh(out.stem, read_mesh(out, MPI.COMM_SELF), out.parent)
    typer.echo("\n".join(f"written: {path}" for path in (out, *made)))


def _sizes(numbers: dict[str, float]) -> str:
    """Return the lengths of a valve that stand in its picture."""
    ends = dict.fromkeys(f"{10.0 * numbers[f'{end}_thickness_cm']:.3g}" for end in ("smallest", "largest"))
    gap, edge = (10.0 * numbers[key] for key in ("gap_cm", "free_edge_length_cm"))
    return f"thickness {' to '.join(ends)} mm, gap {gap:.3g} mm, free edge {edge:.3g} mm"


def _check_name(out: Path) -> None:
    """Refuse a name that no mesh is written to."""
    if out.suffix != ".msh" or not out.parent.is_dir():
        raise CaseError(
            "expected a name that ends in .msh, in a folder that exists", key="--out", value=str(out)
        )


def _length(key: str, text: str) -> float:
    """Read a length with its unit [cm]."""
    from pydantic_core import PydanticCustomError

    from valvefsi.case.quantities import Quantity

    try:
        value = Quantity("cm").parse(text)
    except PydanticCustomError as error:
        raise CaseError(error.message(), key=key, value=text) from None
    if not value > 0:
        raise CaseError("expected a positive length", key=key, value=text)
    return value


def _lengths(overrides: list[str]) -> dict[str, float]:
    """Read ``name=length`` pairs."""
    from valvefsi.geometry.leaflets import ValveGeometry

    names = [item.name for item in fields(ValveGeometry) if item.name not in ("fibre_angles", "belly")]
    found = {}
    for text in overrides:
        name, _, value = text.partition("=")
        if name not in names:
            raise CaseError(f"expected one of {', '.join(names)}", key="--set", value=text)
        found[name] = _length(name, value)
    return found
