"""How the leaflets of a run move, touch and bear load: flutter, coaptation, largest stress by phase and place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.valve import valve_of
from valvefsi.case.valve_views import Leaflets
from valvefsi.io.grid_files import times_of
from valvefsi.io.history import read_history
from valvefsi.io.solid_body import Body, read_body
from valvefsi.post.coaptation import coaptation
from valvefsi.post.flutter import flutter
from valvefsi.post.leaflet_places import PLACES, largest, node_volumes, places
from valvefsi.post.valve_phases import PHASES, Window
from valvefsi.run.recording import FREE_EDGES
from valvefsi.types import Array

REACH = 2.0
"""Distance of leaflets that touch, in grid spacings: their kernels meet."""
EDGE = 0.1
"""How far from an edge a place is at it, as a part of the diameter."""
KILOPASCAL, MILLIMETRE = 1.0e4, 0.1
"""[dyn/cm^2], [cm]"""
STRESSES = {
    "principal_stress": "principal stresses [dyn/cm^2]",
    "von_mises": "von Mises stress [dyn/cm^2]",
}
STRETCHES = "principal stretches [-]"
MEANINGS = {
    "flutter": "swing of the middle of each free edge along its direction from the axis, from opening_end to "
    "closing_start (steady flow: in the window): without its best parabola, weighted by a Hann window; frequency and "
    "amplitude (half of the way) of the highest peak of the spectrum from two periods in the window on, the standard "
    "deviation of all of it, the part of the variance that the peak is; resolution is one over the window's length",
    "coaptation": "where faces of two leaflets towards the inflow face one another, no farther apart than the reach, "
    "two grid spacings, while the valve is shut: area counted once, height (area of all faces in contact over the "
    "length of the free edges) and median distance, means over the frames; the largest area beside them",
    "places": "99th percentile by reference volume and maximum over the nodes of the largest principal Green strain "
    "and Cauchy stress and of von Mises' stress, the largest of a phase's frames; a place is at the free or attached "
    "edge within a tenth of the diameter of it, at a commissure within that of both, else in the belly",
    "posts": "largest displacement of the tip of each flexible post towards the axis in the rows of the history, over "
    "the whole run, and its time; negative for a post that was never inwards; by azimuth",
}


def post_numbers(case: Case, folder: Path) -> dict[str, Any]:
    """Return how far each flexible post was inwards and when, from the history; empty for rigid ones.

    Args:
        case: The case.
        folder: Folder of the run.
    """
    path = Path(folder) / "history.csv"
    if case.housing is None or case.housing.posts is None or not path.is_file():
        return {}
    table, found = read_history(path), {}
    prefix = f"{valve_of(case).name}_post_"
    for name in (name for name in table if name.startswith(prefix)):
        k = int(np.argmax(table[name]))
        number = name.removeprefix(prefix).removesuffix("_inward_mm")
        found[f"post_{number}"] = {"largest_inward_mm": table[name][k], "t_s": table["t_s"][k]}
    return {"posts": found}


def flutter_numbers(folder: Path, window: Window) -> dict[str, Any]:
    """Return frequency and amplitude of each free edge while the valve is open, from its recorded middles.

    Args:
        folder: Folder of the run.
        window: Part of the run.
    """
    path = Path(folder) / FREE_EDGES
    if not path.is_file():
        return {"reason": f"the run has written no {FREE_EDGES}"}
    table = {name: np.array(column) for name, column in read_history(path).items()}
    t = table["t_s"]
    first, last = window.times[1:3] if window.times else (window.start, window.end)
    shift = window.end - window.start if last > window.end + 1e-9 else 0.0
    open_ = (t >= first - shift) & (t <= last - shift)
    if open_.sum() < 2:
        return {"reason": f"{FREE_EDGES} has no rows while the valve is open"}
    found: dict[str, Any] = {"from_s": float(t[open_][0]), "to_s": float(t[open_][-1])}
    found["resolution_Hz"] = 1.0 / (found["to_s"] - found["from_s"])
    for name in (name for name in table if name.startswith("leaflet_")):
        swing = flutter(t[open_], table[name][open_])
        leaflet = name.removesuffix("_middle_cm")
        if isinstance(swing, str):
            found[leaflet] = {"reason": swing}
            continue
        found[leaflet] = {
            "frequency_Hz": swing.frequency,
            "amplitude_mm": swing.amplitude / MILLIMETRE,
            "deviation_mm": swing.deviation / MILLIMETRE,
            "share_percent": 100.0 * swing.share,
        }
    return found


def coaptation_numbers(case: Case, leaflets: Leaflets, window: Window) -> dict[str, Any]:
    """Return area, height and distance of the leaflets' contact while the valve is shut.

    Args:
        case: A case with a valve.
        leaflets: Its leaflets at the frames of the window.
        window: Part of the run.
    """
    if len(np.unique(leaflets.inflow_owner)) < 2:
        return {"reason": "the leaflets hang together, or there is one"}
    shut = np.flatnonzero(window.phase(leaflets.t) == PHASES.index("shut"))
    if not len(shut):
        return {"reason": "no frame of the shut valve"}
    reach = REACH * case.grid.spacing
    found = []
    for k in shut:
        x = leaflets.points[k]
        edge = sum(
            float(np.linalg.norm(np.diff(line.at(x), axis=0), axis=1).sum()) for line in leaflets.lines
        )
        found.append(coaptation(x, leaflets.inflow, leaflets.inflow_owner, edge=edge, reach=reach))
    gaps = [contact.gap for contact in found if contact.gap is not None]
    return {
        "area_cm2": float(np.mean([contact.area for contact in found])),
        "largest_area_cm2": max(contact.area for contact in found),
        "height_mm": float(np.mean([contact.height for contact in found])) / MILLIMETRE,
        "gap_mm": float(np.mean(gaps)) / MILLIMETRE if gaps else None,
        "reach_mm": reach / MILLIMETRE,
        "frames": len(found),
    }


def place_numbers(case: Case, folder: Path, leaflets: Leaflets, window: Window) -> dict[str, Any]:
    """Return largest principal strain and stress by phase and place, from the stresses written with the frames.

    Args:
        case: A case with a valve.
        folder: Folder of the run.
        leaflets: Its leaflets.
        window: Part of the run.
    """
    valve = valve_of(case)
    series = Path(folder) / "paraview" / f"{valve.name}_stress.pvd"
    if not series.is_file():
        return {"reason": "the run has written no stress; give output.stress"}
    frames = [(t, path) for t, path in times_of(series) if window.start - 1e-9 <= t <= window.end + 1e-9]
    if not frames:
        return {"reason": "no frame of the stress in the cycle"}
    body = read_body(frames[0][1])
    if body.reference is None or not loads(body):
        return {"reason": "the series of the stress has no principal values"}
    where = places(body.reference, leaflets.free, leaflets.attached, EDGE * valve.diameter)
    volumes = sum(node_volumes(body.reference, cells) for cells in body.cells.values())
    found: dict[str, Any] = {}
    for (t, path), phase in zip(frames, window.phase(np.array([t for t, _ in frames])), strict=True):
        here = found.setdefault(window.names[phase], {})
        for place, values in largest(loads(read_body(path)), np.asarray(volumes), where).items():
            _keep_largest(here.setdefault(place, {}), values, t)
    return {
        name: {p: found[name][p] for p in PLACES if p in found[name]}
        for name in window.names
        if name in found
    }


def _keep_largest(kept: dict[str, Any], values: dict[str, tuple[float, float]], t: float) -> None:
    """Keep the percentile and the maximum of each value where they are larger than before, with their times."""
    for name, pair in values.items():
        for kind, value in zip(("p99", "max"), pair, strict=True):
            told = f"{name}_{kind}_kPa" if name in STRESSES else f"{name}_{kind}"
            if value > kept.get(told, {"value": -np.inf})["value"]:
                kept[told] = {"value": value, "t_s": t}


def loads(body: Body) -> dict[str, Array]:
    """Return the largest principal Green strain and Cauchy stress and von Mises' stress that a frame holds."""
    found = {}
    if STRETCHES in body.values:
        found["green_strain"] = 0.5 * (body.values[STRETCHES][:, 0] ** 2 - 1.0)
    for name, label in STRESSES.items():
        if label in body.values:
            values = body.values[label]
            found[name] = (values[:, 0] if values.ndim == 2 else values) / KILOPASCAL
    return found
