"""What ``mesh show`` and ``mesh import`` show of a mesh: tags, thickness, fibres, quality."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.cli.tables import print_lines, print_table, terminal

if TYPE_CHECKING:
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.types import Array

EVEN, LIMITS = 3.0, 10.0
"""Largest edge over the smallest up to which edges are even, and above which the smallest limits the time step."""
FLAT = 0.999
"""Length of the summed area vectors over the area, above which a tag's facets lie in a plane."""

SPREAD = 0.25
"""Least spread of the colours of a thickness over the thickness: what is uniform is drawn in one colour."""


def show_mesh(name: str, mesh: SolidMesh, folder: Path) -> list[Path]:
    """Print quality and tags of a mesh, and draw it; return the pictures."""
    from valvefsi.case.fibre_pictures import draw_fields
    from valvefsi.geometry.looks import facets_by_tag, thickness_through

    groups = facets_by_tag(mesh)
    thickness = None
    if mesh.dim == 3:
        thickness = thickness_through(np.concatenate(list(groups.values())))
    _quality(name, mesh, groups, thickness)
    folder.mkdir(parents=True, exist_ok=True)
    fibres = draw_fields(name, mesh, folder, "{}_fibres_{}.png")
    if thickness is None:
        return [_draw_plane(name, mesh, groups, folder), *fibres]
    return [
        _draw_tags(name, groups, folder),
        _draw_thickness(name, groups, thickness, folder),
        *fibres,
    ]


def _quality(name: str, mesh: SolidMesh, groups: Mapping[str, Array], thickness: Array | None) -> None:
    """Print the two tables: cells with a verdict, facets by tag."""
    from valvefsi.geometry.looks import quality_of

    found = quality_of(mesh)
    edges = 10.0 * np.percentile(found.edges, [0, 50, 100])
    kind = mesh.mesh.basix_cell().name
    rows = [
        ("cells", f"{found.cells} ({kind})", ""),
        ("nodes", f"{found.nodes}", ""),
        ("edges: least, median, largest [mm]", " ".join(f"{x:.3g}" for x in edges), edges_say(edges)),
        (
            "scaled Jacobian: least, median",
            f"{found.scaled.min():.2f} {np.median(found.scaled):.2f}",
            found.verdict(),
        ),
    ]
    if thickness is not None:
        seen = thickness[np.isfinite(thickness)]
        middle = 10.0 * float(np.median(seen)) if len(seen) else float("nan")
        rows.append(
            ("thickness behind a facet, median [mm]", f"{middle:.3g}", _layers_say(kind, edges[1], middle))
        )
    page = terminal()
    print_table(page, name, {"": "left", "value": "right", "verdict": "left"}, rows)
    if thickness is not None:
        print_table(
            page,
            f"{name}: tags of facets",
            {
                "tag": "left",
                "area [mm^2]": "right",
                "middle [mm]": "right",
                "mean normal": "right",
                "shape": "left",
            },
            [_tag_row(tag or "(no tag)", polygons) for tag, polygons in groups.items()],
        )
    cells = [tag for tag, (of, _) in mesh.names.items() if of == mesh.dim]
    print_lines(page, [f"tags of cells: {', '.join(cells) or 'none'}"])


def edges_say(edges: Array) -> str:
    """Say what edges of very different lengths mean."""
    ratio = edges[2] / edges[0]
    if ratio <= EVEN:
        return "even"
    return f"{ratio:.2g} to 1" + (": the smallest edge limits the time step" if ratio > LIMITS else "")


def _layers_say(kind: str, edge: float, thickness: float) -> str:
    """Say how many cells a body has through its thickness."""
    if kind == "hexahedron" or not thickness < 3.0 * edge:
        return ""
    return "few cells through it: linear tetrahedra are too stiff there; take degree = 2, or hexahedra"


def _tag_row(tag: str, polygons: Array) -> tuple[str, ...]:
    """Return area, middle, normal and shape of the facets of a tag."""
    from valvefsi.post.plots.views import area_vectors

    vectors = 100.0 * area_vectors(polygons)
    size = np.linalg.norm(vectors, axis=1)
    area, whole = float(size.sum()), float(np.linalg.norm(vectors.sum(axis=0)))
    middle = 10.0 * size @ polygons.mean(axis=1) / area
    normal = vectors.sum(axis=0) / max(whole, 1e-300)
    shape = "flat" if whole > FLAT * area else "closed" if whole < 0.01 * area else "curved"
    return (
        tag,
        f"{area:.4g}",
        ", ".join(f"{x + 0.0:.3g}" for x in np.round(middle, 3)),
        "" if shape == "closed" else ", ".join(f"{x + 0.0:.2f}" for x in np.round(normal, 2)),
        shape,
    )


def _extent(groups: Mapping[str, Array]) -> str:
    """Return how far a body reaches along the axes."""
    x = 10.0 * np.concatenate(list(groups.values())).reshape(-1, 3)
    return " x ".join(f"{length:.3g}" for length in np.ptp(x, axis=0)) + " mm"


def _draw_plane(name: str, mesh: SolidMesh, groups: Mapping[str, Array], folder: Path) -> Path:
    from valvefsi.geometry.looks import plane_cells
    from valvefsi.post.plots.views import outlines

    return outlines(folder / f"{name}_tags.png", groups, plane_cells(mesh), title=name)


def _draw_tags(name: str, groups: Mapping[str, Array], folder: Path) -> Path:
    from valvefsi.post.plots.views import PLAIN, tagged_surface, views

    surface, colours = tagged_surface(groups, named=len(groups) <= 12)
    legend = colours | ({"no tag": PLAIN} if "" in groups else {})
    caption = f"{_extent(groups)}; tags of facets, as a case names them in on = [...]"
    return views(folder / f"{name}_tags.png", surface, title=name, caption=caption, legend=legend)


def _draw_thickness(name: str, groups: Mapping[str, Array], thickness: Array, folder: Path) -> Path:
    import matplotlib as mpl
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    from valvefsi.post.plots.views import PLAIN, Surface, area_vectors, views

    polygons, mm = np.concatenate(list(groups.values())), 10.0 * thickness
    low, high = _range(mm, np.linalg.norm(area_vectors(polygons), axis=1))
    middle, reach = 0.5 * (low + high), 0.6 * max(high - low, SPREAD * high)
    colours = mpl.colormaps["viridis"].with_extremes(over=PLAIN)
    scale = ScalarMappable(Normalize(max(middle - reach, 0.0), middle + reach), colours)
    surface = Surface(polygons=polygons, colours=scale.to_rgba(mm), names={}, shade=0.12)
    caption = (
        f"{_extent(groups)}; how far the body reaches behind each facet, along its normal; grey: further"
    )
    bar = (scale, "thickness [mm]")
    return views(folder / f"{name}_thickness.png", surface, title=name, caption=caption, scale=bar)


def _range(values: Array, areas: Array) -> tuple[float, float]:
    """Return what all but a fiftieth and a tenth of the area lie between: rims are no part of a sheet's thickness."""
    order = np.argsort(values[np.isfinite(values)])
    if not len(order):
        return 0.0, 1.0
    part = np.cumsum(areas[np.isfinite(values)][order])
    low, high = (values[np.isfinite(values)][order][np.searchsorted(part, k * part[-1])] for k in (0.02, 0.9))
    return float(low), float(high)
