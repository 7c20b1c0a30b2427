"""Pictures and ParaView files of deformed solids, and the convergence of answers under refinement.

Bodies in the plane are drawn by matplotlib. Bodies in space are rendered by pyvista off screen, without a display,
through EGL (Debian's ``libegl1`` and ``libgl1-mesa-dri``; a graphics card is not needed). Where pyvista or EGL is
missing matplotlib draws them too, plainer.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from valvefsi.errors import CaseError
from valvefsi.io.series import read_times
from valvefsi.io.solid_body import CORNERS, Body, outer_faces, read_body
from valvefsi.post.columns import LAB, Units, units_of_run
from valvefsi.post.plots.base import DILATION, INK, STYLE, headings, round_up, saved, typeset
from valvefsi.post.plots.ticks import EvenTicks, length_axes, tick_texts
from valvefsi.units import KILOPASCAL, PASCAL

if TYPE_CHECKING:
    from valvefsi.types import Array, Indices

HEAT = mpl.colormaps["viridis"]
CGS = "[dyn/cm^2]"
"""Unit of stresses in files; pictures have kPa, or Pa below `SMALL`."""
NODAL_J = "$J = \\det F$, mean of the cells at each node"
"""What is drawn of J, which differs from point to point of a cell."""
SMALL = 1e3
"""Largest stress that is shown in Pa [dyn/cm^2]."""


def can_render() -> bool:
    """Return whether pyvista is there with a way to render without a display."""
    return importlib.util.find_spec("pyvista") is not None and _off_screen_window() is not None


def _off_screen_window() -> str | None:
    """Return VTK's window for rendering off screen; without EGL or OSMesa VTK would end the process."""
    for library, window in (
        ("libEGL.so.1", "vtkEGLRenderWindow"),
        ("libOSMesa.so.8", "vtkOSOpenGLRenderWindow"),
    ):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        return window
    return None


def deformed(path: Path, body: Body, *, title: str = "", caption: str = "", units: Units = LAB) -> Path:
    """Draw a deformed body coloured by one of its scalars.

    Args:
        path: The picture, PNG or PDF.
        body: The body.
        title: Heading.
        caption: Second line under it.
        units: Units of the lengths.

    Returns:
        The path.
    """
    name, values = body.scalar()
    if name.endswith(CGS):
        unit, size = ("kPa", KILOPASCAL) if np.abs(values).max(initial=0.0) > SMALL else ("Pa", PASCAL)
        name, values = name.replace(CGS, f"[{unit}]"), values / size
    scale = _scale(name, values)
    with mpl.rc_context(STYLE):
        if body.dim == 2:
            figure = _plane(body, values, scale, units)
        elif can_render():
            figure = _framed(_render(body, name, values, scale))
        else:
            figure = _plain_space(body, values, scale, units)
        headings(figure, title, caption)
        _bar(figure, scale, name.replace("J", NODAL_J, 1) if name.split(" ")[0] == "J" else name)
        return saved(figure, path)


def draw_folder(folder: Path, out: Path, *, field: str | None = None, t: float | None = None) -> list[Path]:
    """Draw the solids of a folder of results: every series of a run at one time, every single body.

    Args:
        folder: The folder, or one ``.pvd`` or ``.vtu``.
        out: Folder of the pictures; the folder of a file where ``out`` is one.
        field: What is shown, the start of its name is enough; J where a file has it and nothing is said.
        t: Time of a series [s]; its last one if left out, else the nearest there is.

    Returns:
        The pictures.

    Raises:
        CaseError: There is nothing to draw, or no such field.
    """
    return [path for path, _ in draw_bodies(folder, out, field=field, t=t)]


def draw_bodies(
    folder: Path, out: Path, *, field: str | None = None, t: float | None = None
) -> list[tuple[Path, Body]]:
    """Do what `draw_folder` does; return the pictures, each with what it shows."""
    folder, out = Path(folder), Path(out)
    out = out.parent if out.suffix in (".vtu", ".pvd") else out
    found = [folder] if folder.is_file() else sorted(folder.rglob("*.pvd")) + sorted(folder.glob("*.vtu"))
    made: list[tuple[Path, Body]] = []
    units = units_of_run(folder)
    without = None
    for path in found:
        when, file = _at_time(path, t) if path.suffix == ".pvd" else (None, path)
        if file is None or file.suffix != ".vtu":
            continue
        body = read_body(file)
        try:
            body = replace(body, shown=_field(body, field, file))
        except CaseError as error:  # another series beside it may have the field
            without = error
            continue
        name = "".join(c if c.isalnum() else "_" for c in str(body.shown).split(" [")[0])
        caption = file.name if when is None else f"t = {when:.6g} s"
        picture = out / f"{path.stem}_{name}.png"
        title = path.stem.replace("_", " ")
        made.append((deformed(picture, body, title=title, caption=caption, units=units), body))
    if not made and without is not None:
        raise without
    if not made:
        raise CaseError(_nothing_in(folder), file=folder)
    return made


def _nothing_in(folder: Path) -> str:
    """Say why nothing of a folder or a file is drawn."""
    if folder.suffix == ".toml":
        return "this is a case, nothing of it is drawn but its fibres, with --fibres"
    if folder.suffix == ".pvd":
        return "no solids here; a series of the fluid is drawn from the folder of its run, with --field speed"
    return "no solids here: expected .vtu files or a .pvd series of them, as a run writes with output.frames"


def _at_time(path: Path, t: float | None) -> tuple[float | None, Path | None]:
    """Return time and file of the entry of a series nearest to t, its last one for None."""
    entries = read_times(path)
    if not entries:
        return None, None
    when, file = entries[-1] if t is None else min(entries, key=lambda entry: abs(entry[0] - t))
    return when, path.parent / file


def _field(body: Body, asked: str | None, file: Path) -> str:
    """Return the full name of the field asked for."""
    names = [name for name, values in body.values.items() if np.ndim(values) == 1]
    wanted = asked if asked is not None else ("von Mises" if any("Mises" in n for n in names) else "J")
    for name in names:
        if name.lower().startswith(wanted.lower()):
            return name
    raise CaseError(
        f"no such field; there are {', '.join(names) or 'none'}", file=file, key="field", value=asked
    )


def _scale(name: str, values: Array) -> ScalarMappable:
    """Return the colour scale of a field; J and stretches diverge about 1."""
    low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
    if name.startswith("J") or "stretch" in name:
        reach = max(round_up(max(abs(low - 1), abs(high - 1))), 1e-3)
        return ScalarMappable(TwoSlopeNorm(1.0, 1 - reach, 1 + reach), DILATION)
    least = 2e-3 * max(abs(low), abs(high)) or 1.0  # what is the same all over has no scale of its own
    if high - low < least:
        low, high = (low + high - least) / 2, (low + high + least) / 2
    return ScalarMappable(Normalize(low, high), HEAT)


def _corner_cells(body: Body) -> list[Indices]:
    return [np.asarray(nodes)[:, : CORNERS[int(kind)]] for kind, nodes in body.cells.items() if len(nodes)]


def _plane(body: Body, values: Array, scale: ScalarMappable, units: Units) -> Figure:
    """Draw a plane body with smooth colours, its mesh and its reference outline."""
    low, high = body.points[:, :2].min(axis=0), body.points[:, :2].max(axis=0)
    if body.reference is not None:
        low = np.minimum(low, body.reference[:, :2].min(axis=0))
        high = np.maximum(high, body.reference[:, :2].max(axis=0))
    ratio = float(np.clip((high[1] - low[1]) / (high[0] - low[0]), 0.3, 2.2))
    width = 7.2 if ratio < 1.1 else 5.2
    tall = 0.82 * width * ratio
    height = tall + 2.1
    figure = Figure(figsize=(width, height), dpi=160, facecolor="white")
    axes = figure.add_axes((0.12, 1.35 / height, 0.83, tall / height))
    for nodes in _corner_cells(body):
        corners = nodes.shape[1]
        triangles = nodes if corners == 3 else np.concatenate([nodes[:, [0, 1, 2]], nodes[:, [0, 2, 3]]])
        x, y = body.points[:, 0], body.points[:, 1]
        shading = {"shading": "gouraud", "cmap": scale.cmap, "norm": scale.norm, "rasterized": True}
        axes.tripcolor(x, y, triangles, values, **shading)
        lines = PolyCollection(body.points[nodes, :2], facecolor="none", edgecolor="#1b273340", linewidth=0.3)
        axes.add_collection(lines)
    if body.reference is not None:
        for edge in _outline(body):
            axes.plot(*body.reference[edge, :2].T, color=INK, linewidth=0.9, dashes=(4, 3), zorder=4)
    pad = 0.03 * float((high - low).max())
    axes.set(xlim=(low[0] - pad, high[0] + pad), ylim=(low[1] - pad, high[1] + pad))
    axes.set_aspect("equal")
    length_axes(axes, units)
    return figure


def _outline(body: Body) -> Array:
    """Return the edges of a plane body that belong to one cell only, ``(num_edges, 2)``."""
    edges = np.concatenate(
        [
            np.stack([nodes, np.roll(nodes, -1, axis=1)], axis=2).reshape(-1, 2)
            for nodes in _corner_cells(body)
        ]
    )
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    return edges[first[count == 1]]


def _render(body: Body, name: str, values: Array, scale: ScalarMappable) -> Array:
    """Render a body in space off screen; return the image."""
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", _off_screen_window() or "")
    import pyvista

    cells = {int(kind): np.asarray(nodes) for kind, nodes in body.cells.items() if len(nodes)}
    grid = pyvista.UnstructuredGrid(cells, body.points.astype(float))
    grid.point_data[name] = values
    view, size, half = _view(body)
    plotter = pyvista.Plotter(off_screen=True, window_size=size, lighting="light kit")
    plotter.set_background("white")
    surface = grid.extract_surface(algorithm="dataset_surface", nonlinear_subdivision=1)
    look = {"clim": scale.get_clim(), "cmap": scale.cmap, "show_scalar_bar": False}
    plotter.add_mesh(surface, scalars=name, ambient=0.45, diffuse=0.55, specular=0.0, **look)
    lines = plotter.add_mesh(grid.extract_all_edges(), color="#1b2733", opacity=0.5, line_width=1.2)
    lines.mapper.SetResolveCoincidentTopologyToPolygonOffset()
    if body.reference is not None:
        shadow = pyvista.UnstructuredGrid(cells, body.reference.astype(float))
        edges = shadow.extract_surface(algorithm="dataset_surface").extract_feature_edges(35)
        if edges.n_points:
            plotter.add_mesh(edges, color="#5b6b7a", line_width=1.5)
    plotter.enable_parallel_projection()
    plotter.enable_anti_aliasing("ssaa")
    plotter.camera_position = view
    plotter.camera.parallel_scale = half
    plotter.renderer.ResetCameraClippingRange()
    plotter.add_axes(color=INK, line_width=3, viewport=(0.0, 0.0, 200 / size[0], 200 / size[1]))
    image = plotter.screenshot(return_img=True)
    plotter.close()
    return image


def _view(body: Body) -> tuple[list[tuple[float, ...]], tuple[int, int], float]:
    """Return a view from the front, above and to the right, a window of the body's shape, half its height.

    The y axis is upright where the body is by far the longest along it, else the z axis.
    """
    extent = np.ptp(body.points, axis=0)
    upright = extent[1] > 2 * max(extent[0], extent[2])
    up = np.array([0.0, 1.0, 0.0]) if upright else np.array([0.0, 0.0, 1.0])
    way = np.array([0.9, 0.45, 1.0]) if upright else np.array([-0.75, -1.0, 0.6])
    way /= np.linalg.norm(way)
    right = np.cross(up, way)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(way, right)])
    seen = np.concatenate([body.points, body.points if body.reference is None else body.reference]) @ axes.T
    across, tall = np.ptp(seen, axis=0) * 1.08
    across += 0.12 * max(across, tall)  # room for the arrows of the axes
    shape = float(np.clip(across / tall, 0.4, 1.8))
    size = (1400, round(1400 / shape)) if shape > 1 else (round(1500 * shape), 1500)
    centre = (seen.max(axis=0) + seen.min(axis=0)) / 2 - [0.06 * max(across, tall), 0.0]
    middle = centre @ axes + (body.points.mean(axis=0) @ way) * way
    half = max(tall, across / shape) / 2
    return [tuple(middle + 10 * extent.max() * way), tuple(middle), tuple(up)], size, half


def _framed(image: Array) -> Figure:
    """Put an image into a figure with room for headings and a colour bar, its white margins cut off."""
    ink = np.argwhere((image < 250).any(axis=2))
    top, left = np.maximum(ink.min(axis=0) - 12, 0)
    bottom, right = ink.max(axis=0) + 12
    image = image[top:bottom, left:right]
    width = 6.4
    tall = min(width * 0.9 * image.shape[0] / image.shape[1], 7.5)
    height = tall + 1.9
    figure = Figure(figsize=(width, height), dpi=160, facecolor="white")
    axes = figure.add_axes((0.05, 1.05 / height, 0.9, tall / height))
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_off()
    return figure


def _plain_space(body: Body, values: Array, scale: ScalarMappable, units: Units) -> Figure:
    """Draw the surface of a body in space with matplotlib."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    figure = Figure(figsize=(6.4, 7.2), dpi=160, facecolor="white")
    axes = figure.add_axes((0.02, 0.17, 0.93, 0.71), projection="3d")
    for faces in outer_faces(body):
        colours = scale.to_rgba(values[faces].mean(axis=1))
        look = {"facecolors": colours, "edgecolor": "#1b273355", "linewidth": 0.3}
        axes.add_collection3d(Poly3DCollection(body.points[faces], **look))
    low, high = body.points.min(axis=0), body.points.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    length_axes(axes, units)
    length = units.of("length_cm")
    axes.set_zlabel(f"z [{length.unit}]")
    axes.zaxis.set_major_formatter(EvenTicks(length.factor))
    axes.set_box_aspect(np.maximum(high - low, 1e-3 * (high - low).max()))
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(3, prune="both"))
    return figure


def _bar(figure: Figure, scale: ScalarMappable, label: str) -> None:
    height = figure.get_figheight()
    place = (0.14, 0.55 / height, 0.72, 0.12 / height)
    bar = figure.colorbar(scale, cax=figure.add_axes(place), orientation="horizontal")
    bar.set_label(typeset(label), labelpad=3)
    bar.outline.set_visible(False)
    low, high = scale.get_clim()
    even = MaxNLocator(5).tick_values(low, high)
    even = even[(even >= low) & (even <= high)]
    ticks = even if scale.cmap is HEAT and len(even) > 1 else np.linspace(low, high, 5)
    bar.set_ticks(ticks, labels=tick_texts(ticks))
    bar.ax.tick_params(length=2.5, labelsize=8.5)
