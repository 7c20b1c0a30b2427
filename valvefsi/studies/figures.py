"""The figures S6 to S19 of Lee2020's supplement from runs: ``valvefsi plot --figure S8 DIR [DIR2]``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.values import case_differences
from valvefsi.case.valve import valve_of
from valvefsi.case.valve_motion import STRESSES
from valvefsi.case.valve_views import read_leaflets
from valvefsi.errors import CaseError
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.io.grid_files import GridFields, nearest_time, read_grid
from valvefsi.io.history import read_history
from valvefsi.io.solid_body import read_body
from valvefsi.post.movies import bodies_at
from valvefsi.post.plots import supplement as plots
from valvefsi.post.plots.profile import TKE, read_profiles
from valvefsi.post.slices import Plane, cut, field_of, outline
from valvefsi.post.valve_beat import QUANTITIES, Beat
from valvefsi.studies.figure_runs import FigureRun, instants, near, opening_and_closing, read_runs
from valvefsi.types import Array
from valvefsi.verification.norms import normalised_difference

MIDDLE = Plane(axis=1, position=0.0)
"""The middle plane, y = 0, with the flow upwards."""
MOST, FEW = 8, 6
"""Most instants of leaflets and of planes in a row."""
BETWEEN = 57.6e-3
"""From one instant of the flow to the next (S18, S19) [s]."""
SYMBOLS = {"p_lv": "P_LV", "p_ao": "P_Ao", "q_ao": "Q", "pdva": "area"}
Made = Callable[["Figure", list[FigureRun], list[Beat], Path], Path]


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A figure of the supplement.

    Attributes:
        name: Its name there.
        shows: What it shows.
        make: What draws it.
        field: Field of the fluid.
        increments: From one instant to the next while the valve opens, and while it closes [s].
        runs: How many runs it takes at least.
    """

    name: str
    shows: str
    make: Made
    field: str = ""
    increments: tuple[float, float] = (0.0, 0.0)
    runs: int = 1


def draw_figure(
    name: str, paths: Sequence[Path], out: Path | None = None, *, start: float = 0.0, trust: bool = False
) -> Path:
    """Draw a figure of the supplement from finished runs.

    Args:
        name: Its name, such as S8.
        paths: Folders of runs or of studies; S6 and S7 take a record, too (CSV).
        out: Folder of the picture; the first folder unless given.
        start: Time in a record at which a run's cycle begins [s].
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: There is no such figure, or a folder lacks what it needs.
    """
    known = {figure.name.lower(): figure for figure in FIGURES}
    figure = known.get(name.lower())
    if figure is None:
        listed = ", ".join(f.name for f in FIGURES)
        raise CaseError(f"expected one of {listed}", key="--figure", value=name)
    files = [path for path in map(Path, paths) if path.is_file() and path.suffix == ".csv"]
    if files and figure.make is not _waves:
        raise CaseError(f"figure {figure.name} is of runs, this is a file", file=files[0])
    records = [_from(read_bench_beat(path), start) for path in files]
    runs = read_runs([path for path in map(Path, paths) if path not in files], trust=trust)
    if len(runs) < figure.runs:
        several = f"{figure.runs} run{'s' * (figure.runs > 1)}"
        message = f"figure {figure.name} sets {several} side by side, found {len(runs)}; name another folder"
        raise CaseError(message, file=Path(paths[0]))
    folder = out if out is not None else runs[0].folder
    return figure.make(figure, runs, records, Path(folder) / f"figure_{figure.name}.png")


def _from(beat: Beat, start: float) -> Beat:
    """Return a beat that begins at a time of another."""
    if start == 0.0:
        return beat
    t = beat.grid[:-1]
    values = {name: beat.at(name, t + start) for name in beat.values}
    deviations = {name: beat.deviation_at(name, t + start) for name in beat.deviations}
    return replace(beat, t=t, values=values, deviations=deviations)


def _title(figure: Figure) -> str:
    return f"As Figure {figure.name}: {figure.shows}"


# Waveforms (S6, S7)


def _waves(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """Waveforms of whole cycles over one another, S7 with the leaflets below."""
    beats = [_whole(run) for run in runs]
    lines = [_wave(beat) for beat in (*records, *beats)]
    caption = _apart(beats, records) or "the last whole cycle of each"
    if any(record.deviations for record in records):
        caption += "\nband: two standard deviations of the record"
    if figure.name == "S6":
        return plots.waves_figure(path, lines, QUANTITIES, title=_title(figure), caption=caption)
    rows = {run.name: _moments(run, runs[0]) for run in runs}
    radius = 0.5 * valve_of(runs[0].case).diameter
    heading: dict[str, Any] = {"title": _title(figure), "caption": caption}
    return plots.leaflet_rows(path, rows, radius=radius, waves=lines, **heading)


def _whole(run: FigureRun) -> Beat:
    """The last whole cycle of a run."""
    if run.beat is None:
        length = run.last - run.first
        raise CaseError(f"no whole cycle of the run, it covers {1e3 * length:.4g} ms of one", file=run.folder)
    return run.beat


def _wave(beat: Beat) -> plots.Wave:
    t = beat.grid
    values = {name: beat.at(name, t) for name in beat.values}
    deviations = {name: beat.deviation_at(name, t) for name in beat.deviations}
    return plots.Wave(name=beat.name, t=t, values=values, deviations=deviations, measured=beat.measured)


def _apart(beats: Sequence[Beat], records: Sequence[Beat]) -> str:
    """Differences of each run to the next (S24, S25) and to each record, in words."""
    told = []
    for a, b in [*pairwise(beats), *((a, b) for b in records for a in beats)]:
        t = b.grid
        both = [name for name in QUANTITIES if name in a.values and name in b.values]
        norms = [100 * normalised_difference(t, a.at(name, t), b.at(name, t)) for name in both]
        said = ", ".join(f"{SYMBOLS[name]} {norm:.3g} %" for name, norm in zip(both, norms, strict=True))
        told.append(f"{a.name} less {b.name} in L2: {said}")
    return "\n".join(told)


def _moments(run: FigureRun, clock: FigureRun) -> list[dict[str, Any] | None]:
    """Views of the leaflets from when one run's valve begins to open until it is closed."""
    start, closing = opening_and_closing(clock)
    times = np.array([t for t, _, _ in clock.frames(valve_of(clock.case).name)])
    begin = times[0] if start is None else start
    end = times[-1] if closing is None else min(closing + 0.6 * (closing - begin), times[-1])
    chosen = times[instants(times, begin, (end - begin) / (MOST - 1), MOST)]
    return _views(run, chosen)


# Planes of the flow (S8, S9, S18, S19)


def _planes(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """The field in the middle plane at instants, a row for each run."""
    low = max(run.frames("fluid")[0][0] for run in runs)
    high = min(run.frames("fluid")[-1][0] for run in runs)
    times = np.array([t for t, _, _ in runs[0].frames("fluid") if low - 1e-9 <= t <= high + 1e-9])
    if len(times) < 2:
        raise CaseError("the runs have no two frames at the same times of the cycle", file=runs[0].folder)
    start = opening_and_closing(runs[0])[0]
    begin = low if start is None or start > high else max(start, low)
    step = BETWEEN if high - begin > 2.0 * BETWEEN else (high - begin) / (FEW - 1)
    chosen = times[instants(times, begin, step, FEW)]
    rows = {_fluid_name(figure, run): [_panel(run, figure.field, t) for t in chosen] for run in runs}
    panel = next(panel for row in rows.values() for panel in row if panel is not None)
    label = f"{figure.field.replace('_', ' ')} [{panel.found.unit}]"
    caption = "middle plane, y = 0; flow upwards; times in the cycle"
    caption += _other_differences(runs) if figure.runs > 1 else ""
    return plots.plane_rows(path, rows, label=label, title=_title(figure), caption=caption)


def _fluid_name(figure: Figure, run: FigureRun) -> str:
    """Name of a run's row, with fluid and Reynolds number where fluids are compared."""
    if figure.runs < 2:
        return run.name
    fluid, diameter = run.case.fluid, valve_of(run.case).diameter
    name = f"{run.name}\n{100 * fluid.viscosity:.3g} cP"
    history = read_history(run.folder / "history.csv")
    flow = next((np.array(history[n]) for n in ("q_z_upper_ml_s", "q_z_lower_ml_s") if n in history), None)
    if flow is None:
        return name
    return f"{name}, Re {4 * fluid.density * np.abs(flow).max() / (np.pi * diameter * fluid.viscosity):.0f}"


def _fluids(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """The same for two fluids."""
    found = {run.case.fluid.viscosity for run in runs}
    if len(found) < 2:
        message = f"figure {figure.name} compares two fluids, all of these have {100 * found.pop():.3g} cP"
        raise CaseError(message, file=runs[-1].folder)
    return _planes(figure, runs, records, path)


def _other_differences(runs: Sequence[FigureRun]) -> str:
    """Say in what the cases of runs differ besides their fluids; nothing where they do not."""
    found = {key for run in runs[1:] for key in case_differences(runs[0].case, run.case)}
    others = sorted(key for key in found if not key.startswith(("fluid.", "title", "output.", "time.")))
    if not others:
        return ""
    more = f" and {len(others) - 3} more" if len(others) > 3 else ""
    return f"; besides the fluid the cases differ in {', '.join(others[:3])}{more}"


def _panel(run: FigureRun, field: str, t: float) -> plots.PlanePanel | None:
    """The field of a run in the middle plane at the frame nearest to an instant, with its solids."""
    frames = run.frames("fluid")
    k = near(np.array([frame[0] for frame in frames]), t)
    if k is None:
        return None
    in_cycle, when, file = frames[k]
    solids = [segment for body in bodies_at(run.folder, when) for segment in outline(body, MIDDLE, 3)]
    return plots.PlanePanel(t=in_cycle, found=cut(read_grid(file, when), MIDDLE, field), solids=solids)


# Averages of steady flow (S10 to S13)


def _averages(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """The averaged field in the middle plane, profiles along lines, and how far two runs are apart."""
    planes, grids = {}, {}
    profiles: dict[str, dict[str, tuple[Array, Array]]] = {}
    column = TKE if "turbulence" in figure.field else "mean_u_z_cm_per_s"
    for run in runs:
        series = run.folder / "paraview" / "averages.pvd"
        if not series.is_file():
            raise CaseError("no averages: give output.averages_from to a run in steady flow", file=run.folder)
        when, file = nearest_time(series, None)
        grid = grids[run.name] = read_grid(file, when)
        lines = {
            name: line for name, line in read_profiles(run.folder / "profiles").items() if column in line
        }
        for line in lines.values():
            heading = f"z = {line['z_cm'][0]:.3g} cm"
            profiles.setdefault(heading, {})[run.name] = (line["x_cm"], line[column])
        ends = [
            np.array([[x["x_cm"][0], x["z_cm"][0]], [x["x_cm"][-1], x["z_cm"][-1]]]) for x in lines.values()
        ]
        solids = [segment for body in bodies_at(run.folder, when) for segment in outline(body, MIDDLE, 3)]
        found = cut(grid, MIDDLE, figure.field)
        planes[f"{run.name}\n{_spacing(run)}"] = plots.PlanePanel(
            t=when, found=found, solids=solids, lines=ends
        )
    if not profiles:
        raise CaseError(
            "no profiles: give [[output.line]] across the outflow", file=runs[0].folder / "profiles"
        )
    unit = "cm$^2$/s$^2$" if column == TKE else "cm/s"
    labels = ("TKE" if column == TKE else "mean $u_z$") + f" [{unit}]", "x [cm]"
    caption = "\n".join(_averages_apart(figure, grids) or [f"averaged flow {_flow(run)}" for run in runs])
    heading_: dict[str, str] = {"title": _title(figure), "caption": caption}
    return plots.mean_flow_figure(path, planes, profiles, labels=labels, **heading_)


def _spacing(run: FigureRun) -> str:
    return f"h = {10 * run.case.grid.spacing:.3g} mm, {_flow(run)}"


def _flow(run: FigureRun) -> str:
    """Mean flow through the outlet over the averages in words."""
    history = read_history(run.folder / "history.csv")
    names = [n for n in history if n.startswith("flow_")] or [n for n in history if n.startswith("q_z_upper")]
    if not names:
        return f"to t = {run.last:.3g} s"
    t, flow = np.array(history["t_s"]), np.abs(np.array(history[names[-1]]))
    return f"{flow[t >= (run.case.output.averages_from or 0.0)].mean():.3g} ml/s"


def _averages_apart(figure: Figure, grids: Mapping[str, GridFields]) -> list[str]:
    """Differences of each run to the next in words: L2 over the box that both have, and of the peaks."""
    told = []
    for (a, coarse), (b, fine) in pairwise(grids.items()):
        l2, peak = field_difference(coarse, fine, figure.field)
        told.append(f"{a} less {b}: {100 * l2:.3g} % in L2, peak {100 * peak:+.3g} %")
    return told


def field_difference(a: GridFields, b: GridFields, name: str) -> tuple[float, float]:
    """Return the normalised difference in L2 of a field on two grids over the box of the second, and of its peak.

        ||a - b||/||b||,  (max |a| - max |b|)/max |b|

    Args:
        a: Fields on a grid, linear between its cells.
        b: Fields on another, the reference.
        name: Name of the field.
    """
    from scipy.interpolate import RegularGridInterpolator

    first, second = field_of(a, name)[0], field_of(b, name)[0]
    at = RegularGridInterpolator(tuple(a.centres), first, bounds_error=False, fill_value=None)
    points = np.stack(np.meshgrid(*b.centres, indexing="ij"), axis=-1)
    x, y, z = (np.diff(e) for e in b.edges)
    volume = x[:, None, None] * y[:, None] * z
    apart = np.sqrt((volume * (at(points) - second) ** 2).sum() / (volume * second**2).sum())
    largest = float(np.abs(second).max())
    return float(apart), float(np.abs(first).max()) / largest - 1.0


# Leaflets (S14 to S17)


def _kinematics(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """Leaflets from downstream while the valve opens and closes, at the same instants of all runs."""
    rows = {name: _views(run, chosen) for name, run, chosen in _rows(figure, runs)}
    heading: dict[str, Any] = {"title": _title(figure), "caption": _instants_said(figure, runs)}
    return plots.leaflet_rows(path, rows, radius=0.5 * valve_of(runs[0].case).diameter, **heading)


def _stresses(figure: Figure, runs: list[FigureRun], records: list[Beat], path: Path) -> Path:
    """Von Mises' stress of the leaflets at the same instants of all runs."""
    rows = {name: _views(run, chosen, stress=True) for name, run, chosen in _rows(figure, runs)}
    values = [view["values"] for row in rows.values() for view in row if view is not None]
    scale = (0.0, float(np.percentile(np.concatenate(values), 99.0)), "von Mises [kPa]")
    said = _instants_said(figure, runs) + "; colours go with the power 0.4 of the stress"
    heading: dict[str, Any] = {"title": _title(figure), "caption": said}
    return plots.leaflet_rows(
        path, rows, radius=0.5 * valve_of(runs[0].case).diameter, scale=scale, **heading
    )


def _rows(figure: Figure, runs: Sequence[FigureRun]) -> list[tuple[str, FigureRun, Array]]:
    """Name, run and instants of each row: opening, then closing, of each run that has frames there."""
    clock = runs[0]
    times = np.array([t for t, _, _ in clock.frames(valve_of(clock.case).name)])
    found = []
    for what, start, increment in zip(
        ("opening", "closing"), opening_and_closing(clock), figure.increments, strict=True
    ):
        if start is None:
            continue
        chosen = times[instants(times, start, increment, MOST)]
        for run in runs:
            own = np.array([t for t, _, _ in run.frames(valve_of(run.case).name)])
            if any(near(own, t) is not None for t in chosen):
                found.append((f"{run.name}\n{what}", run, chosen))
    if not found:
        raise CaseError("the valve neither opens nor closes in the frames of this run", file=clock.folder)
    return found


def _instants_said(figure: Figure, runs: Sequence[FigureRun]) -> str:
    """Caption: which instants, and where frames are farther apart than those of the supplement."""
    opening, closing = (1e3 * t for t in figure.increments)
    frames = [t for t, _, _ in runs[0].frames(valve_of(runs[0].case).name)]
    spacing = 1e3 * float(np.median(np.diff(frames))) if len(frames) > 1 else 0.0
    text = f"from downstream, times in the cycle; asked for every {opening:g} and {closing:g} ms"
    return (
        text if spacing <= min(opening, closing) * 1.01 else f"{text}, the frames are {spacing:.3g} ms apart"
    )


def _views(run: FigureRun, chosen: Array, *, stress: bool = False) -> list[dict[str, Any] | None]:
    """Views of a run's leaflets at the frames nearest to instants, None where it has none."""
    name = valve_of(run.case).name
    frames = run.frames(name)
    times = np.array([t for t, _, _ in frames])
    at = [near(times, t) for t in chosen]
    kept = [k for k in at if k is not None]
    if not kept:
        return [None] * len(chosen)
    window = (min(frames[k][1] for k in kept), max(frames[k][1] for k in kept))
    leaflets = read_leaflets(run.case, run.folder, window)
    found: list[dict[str, Any] | None] = []
    for k in at:
        if k is None:
            found.append(None)
            continue
        number = int(np.abs(leaflets.t - frames[k][1]).argmin())
        points = leaflets.points[number]
        view: dict[str, Any] = {
            "radius": 0.5 * valve_of(run.case).diameter,
            "t": times[k],
            "triangles": leaflets.triangles,
            "owner": leaflets.owner,
        }
        view["xyz"] = np.concatenate([points, leaflets.edges(number).reshape(-1, 3)])
        if stress:
            view["values"] = _von_mises(run, frames[k][1])[leaflets.triangles].mean(axis=1)
        else:
            view["free_edges"] = len(points) + np.arange(2 * len(leaflets.edges(number))).reshape(-1, 2)
        found.append(view)
    return found


def _von_mises(run: FigureRun, when: float) -> Array:
    """Von Mises' stress of a run's leaflets at the nodes, at a time [kPa]."""
    series = run.folder / "paraview" / f"{valve_of(run.case).name}_stress.pvd"
    if not series.is_file():
        raise CaseError('no stress in the frames: give output.stress = ["von_mises"]', file=run.folder)
    values = read_body(nearest_time(series, when)[1]).values
    if STRESSES["von_mises"] not in values:
        raise CaseError("the series of the stress has no von Mises stress", file=series)
    return values[STRESSES["von_mises"]] / 1.0e4


PORCINE, PERICARDIAL = (1.92e-3, 9.6e-3), (3.84e-3, 19.2e-3)
STRESSED = (11.52e-3, 30.72e-3)
FIGURES = (
    Figure(name="S6", shows="pressures, flow and open area", make=_waves),
    Figure(name="S7", shows="projected open area", make=_waves),
    Figure(name="S8", shows="vorticity, porcine valve", make=_planes, field="vorticity"),
    Figure(name="S9", shows="vorticity, pericardial valve", make=_planes, field="vorticity"),
    Figure(
        name="S10", shows="mean axial velocity at the largest flow", make=_averages, field="mean_velocity_z"
    ),
    Figure(name="S11", shows="mean axial velocity at half of it", make=_averages, field="mean_velocity_z"),
    Figure(
        name="S12",
        shows="turbulence kinetic energy at the largest flow",
        make=_averages,
        field="turbulence_kinetic_energy",
    ),
    Figure(
        name="S13",
        shows="turbulence kinetic energy at half of it",
        make=_averages,
        field="turbulence_kinetic_energy",
    ),
    Figure(name="S14", shows="leaflets of the porcine valve", make=_kinematics, increments=PORCINE),
    Figure(name="S15", shows="leaflets of the pericardial valve", make=_kinematics, increments=PERICARDIAL),
    Figure(name="S16", shows="stress of the porcine valve", make=_stresses, increments=STRESSED),
    Figure(name="S17", shows="stress of the pericardial valve", make=_stresses, increments=STRESSED),
    Figure(name="S18", shows="two fluids, porcine valve", make=_fluids, field="velocity_z", runs=2),
    Figure(name="S19", shows="two fluids, pericardial valve", make=_fluids, field="velocity_z", runs=2),
)
"""The figures that can be drawn."""
