"""The pictures at the end of a run: histories, and in two dimensions the solids over the flow."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.errors import made_on_root
from valvefsi.fsi import Model, State
from valvefsi.grid import Array, MacGrid
from valvefsi.io.history import read_history
from valvefsi.post import diagnostics
from valvefsi.post.columns import Units
from valvefsi.run.recording import Output, grid_part

if TYPE_CHECKING:
    from valvefsi.post.plots.base import Series
    from valvefsi.solid.structure import Structure

ENDED = "the run itself has ended and is kept: --resume makes its pictures and its summary"
"""What to do where what follows a run fails."""
ASKED: tuple[tuple[str, str], ...] = (
    (r"flow_(?P<name>.+)_cm3_per_s", "flow"),
    (r"pressure_(?P<name>.+)_dyn_per_cm2", "pressure"),
    (r"(?P<name>pdva)_cm2", ""),
    (r"q_(?P<name>.+)_ml_s", "flow through sides"),
    (r"p_(?P<name>.+)_mmHg", "pressure outside sides"),
    (r"(?P<name>u_[xyz]_.+)_cm", ""),
    (r"(?P<name>.+_post_\d+_inward)_mm", "posts"),
    (r"(?P<name>force_.+)_(dyn|dyn_per_cm)", "force"),
    (r"(?P<name>.+_change)_percent", ""),
)
"""Columns of what a case asks for, in the order in which they are drawn, and the panel that those of a kind share."""
DIAGNOSTICS = ("dissipation_erg_per_s", "kinetic_energy_erg", "courant")
"""What is drawn below them."""
MOVES = 1e-6
"""Part of the largest motion below which a point or a volume does not move."""


def draw(
    model: Model,
    state: State,
    output: Output,
    title: str,
    references: Mapping[str, tuple[str, float]],
) -> dict[str, float]:
    """Draw ``histories.png``, and ``flow.png`` in two dimensions, into the folder of a run.

    Where profiles were asked for, also ``profiles.png``, and where the flow was averaged, in space, the mean axial
    velocity and the turbulence kinetic energy in the plane of all lines.

    Args:
        model: The model.
        state: The last state.
        output: Where the run has written its history.
        title: Heading of the pictures.
        references: Line and its value in the plot of a column of the history, by column.

    Returns:
        The last row of the history.

    Raises:
        SurroundingsError: A picture could not be written.

    Note:
        Collective; rank 0 draws.
    """
    solids = [(solid.cells_on_root(chi), solid.cells_on_root(solid.X)) for solid, chi in _pairs(model, state)]
    flow = _plane(model.grid, state) if model.grid.dim == 2 else None

    units = Units(system=output.units, dim=model.grid.dim)

    def pictures() -> dict[str, float]:
        from valvefsi.post.plots import base as plots

        history = read_history(output.directory / "history.csv")
        panels = usual_panels(history, units, references)
        plots.histories(output.directory / "histories.png", history["t_s"], panels, title=title)
        if output.energy:
            _draw_energy(output.directory / "energy.png", history, units, title)
        if flow is not None:
            caption = f"t = {state.t:.4g} s"
            _draw_flow(output, model.grid, flow, solids, (title, caption))
        if output.lines:
            _draw_lines(output, model.grid.dim, title)
        return {name: values[-1] for name, values in history.items()}

    return made_on_root(model.grid.comm, pictures, ENDED)


def _pairs(model: Model, state: State) -> list[tuple[Structure, Array]]:
    pairs = zip(model.bodies, state.bodies, strict=True)
    return [(body.solid, q["chi"]) for body, q in pairs if body.solid is not None]


def _plane(grid: MacGrid, state: State) -> tuple[Array, Array] | None:
    """Velocity and pressure of a two-dimensional grid in the cells, whole on rank 0. Collective."""
    velocity = diagnostics.cell_velocity(grid, state.u)[:, :, 0, :2]
    pressure = grid_part(state.p, grid.owned)[:, :, 0]
    parts = grid.comm.gather((grid.start, velocity, pressure), root=0)
    if parts is None:
        return None
    u, p = np.zeros((*grid.cells[:2], 2)), np.zeros(grid.cells[:2])
    for start, part, q in parts:
        place = tuple(slice(s, s + n) for s, n in zip(start[:2], q.shape, strict=True))
        u[place], p[place] = part, q
    return u, p


def usual_panels(
    history: Mapping[str, Sequence[float] | Array],
    units: Units,
    references: Mapping[str, tuple[str, float]] | None = None,
) -> list[Series]:
    """Return the panels of ``histories.png``: what the case asks for first, energy and Courant number last.

    Args:
        history: The columns of the history.
        units: The units to show them in.
        references: Line and its value by column, in the column's unit.
    """
    references = references or {}
    found = []
    for title, names in _kinds(history, references):
        for start in range(0, len(names), 6):  # the colours of a panel
            found.append(_panel(history, names[start : start + 6], units, title, references))
    return found


def _kinds(
    history: Mapping[str, Sequence[float] | Array], references: Mapping[str, tuple[str, float]]
) -> list[tuple[str, list[str]]]:
    """Return the heading and columns of each panel, the heading "" of one column that goes by its own name."""
    kinds: list[tuple[str, list[str]]] = []
    moving = [name for name in history if re.fullmatch(r"u_[xyz]_.+_cm|.+_change_percent", name)]
    most = max((float(np.ptp(history[name])) for name in moving), default=0.0)
    for pattern, title in ASKED:
        names = [name for name in history if re.fullmatch(pattern, name) and name not in DIAGNOSTICS]
        names = [n for n in names if n not in moving or n in references or np.ptp(history[n]) >= MOVES * most]
        apart = [name for name in names if not title or name in references]
        kinds += [(title, [n for n in names if n not in apart])] if len(apart) < len(names) else []
        kinds += [("", [name]) for name in apart]
    return kinds + [("", [name]) for name in DIAGNOSTICS if name in history]


def _panel(
    history: Mapping[str, Sequence[float] | Array],
    names: Sequence[str],
    units: Units,
    title: str,
    references: Mapping[str, tuple[str, float]],
) -> Series:
    """Return one panel: a column by its name, or several of a kind."""
    from valvefsi.post.plots import base as plots

    shown = {name: units.of(name) for name in names}
    first = shown[names[0]]
    line, value = references.get(names[0], ("", None))
    return plots.Series(
        label=plots.typeset(f"{title} [{first.unit or '-'}]" if len(names) > 1 else first.label),
        lines={
            q.words.removeprefix(f"{title} "): q.factor * np.asarray(history[name])
            for name, q in shown.items()
        },
        reference=None if value is None else first.factor * value,
        reference_label=line,
    )


def _draw_energy(path: Path, history: Mapping[str, list[float]], units: Units, title: str) -> None:
    """Draw the terms of the balance of energy over time, and beside them what each body stores and loses."""
    from valvefsi.post.plots import base as plots

    terms = {n.removeprefix("energy_").removesuffix("_erg"): n for n in history if n.startswith("energy_")}
    bodies = {name: n for name, n in terms.items() if name.startswith(("stored_", "lost_"))}
    left = {name: terms[name] for name in ("residual",)}
    fluid = {name: n for name, n in terms.items() if name not in bodies and name not in left}
    energy = units.of("energy_erg")
    panels = [
        plots.Series(
            label=f"{what} [{energy.unit}]",
            lines={
                name.replace("_", " ", 1): [energy.factor * v for v in history[n]]
                for name, n in group.items()
            },
        )
        for what, group in (("fluid", fluid), ("bodies", bodies), ("left", left))
        if group
    ]
    plots.histories(path, history["t_s"], panels, title=title)


def _draw_lines(output: Output, dim: int, title: str) -> None:
    """Draw profiles, and averages in the plane that holds their lines, with the lines dashed."""
    from valvefsi.post.movies import draw_plane
    from valvefsi.post.plots.profile import draw_profiles, largest_velocity, read_profiles
    from valvefsi.post.slices import Plane

    found = read_profiles(output.directory / "profiles")
    profiles = {name: found[name] for name in output.lines}
    column = largest_velocity(profiles)
    averaged = column.startswith("mean_")
    caption = f"averaged from t = {output.averages_from:.4g} s on" if averaged else "at the end"
    draw_profiles(output.directory / "profiles.png", profiles, title=title, caption=caption)
    ends = np.array([end for line in output.lines.values() for end in (line.start, line.end)])
    flat = np.flatnonzero(np.ptp(ends, axis=0) < 1e-9)
    if dim < 3 or not len(flat) or not averaged:
        return
    plane = Plane(axis=int(flat[0]), position=float(ends[0, flat[0]]))
    kept = [k for k in range(3) if k != plane.axis]
    lines = [np.array([line.start, line.end])[:, kept] for line in output.lines.values()]
    for field in (f"mean_velocity_{column[7]}", "turbulence_kinetic_energy"):
        draw_plane(output.directory, output.directory, plane=plane, field=field, lines=lines)


def _draw_flow(
    output: Output, grid: MacGrid, flow: tuple[Array, Array], solids: list[Any], heading: tuple[str, str]
) -> None:
    from valvefsi.post.plots import base as plots

    x, y = (grid.lower[a] + (np.arange(grid.cells[a]) + 0.5) * grid.spacing[a] for a in range(2))
    plane = plots.PlaneFlow(x=x, y=y, u=flow[0][..., 0], v=flow[0][..., 1])
    drawn = [
        plots.PlaneSolid(points=points, cells=cells, J=J, outline=_outline(*first[:2]))
        for (points, cells, J), first in solids
    ]
    units, path = Units(system=output.units, dim=grid.dim), output.directory / "flow.png"
    plots.flow_and_solid(path, plane, drawn, title=heading[0], caption=heading[1], units=units)


def _outline(points: Array, cells: Mapping[int, Array]) -> Array:
    """Corners of the box around the reference position, closed."""
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    return np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
