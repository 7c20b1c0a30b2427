"""Viscous shear stress of a run with a valve, in space and along the paths of particles, from its frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.valve import valve_of
from valvefsi.case.walls import wall_radius
from valvefsi.io.grid_files import GridFields, read_grid, times_of
from valvefsi.post.diagnostics.particles import Particles, Written, seeds_on_disk
from valvefsi.post.diagnostics.shear import cell_gradient, shear_stress, volume_percentiles
from valvefsi.post.valve_phases import Window
from valvefsi.solid.peaks import percentile
from valvefsi.types import Array, Mask

PASCAL = 10.0
"""[dyn/cm^2]"""
PARTS = {"p50": 0.5, "p95": 0.95, "p99": 0.99, "max": 1.0}
BATCHES, SEEDS = 8, 64
"""Times in forward flow at which particles are released, and how many at each."""
WIDTH = 0.9
"""Radius of the disk where they are, of that of the orifice."""
MEANINGS = {
    "shear": "viscous shear stress mu sqrt(2 S:S) in the cells of the frames between the housing's walls, one grid "
    "spacing off them: percentiles by volume and maximum, the largest of the cycle's frames with their times, and the "
    "means over the frames of forward flow; the grid resolves no thinner layer than a spacing, so the maximum is that "
    "of this grid",
    "exposure": "integral of the viscous shear stress over the time along the paths of particles that are released "
    "upstream of the valve at eight times of forward flow, 64 points of a disk of nine tenths of its radius each, and "
    "followed to the end of the cycle or until they leave the box; velocities are linear between the frames, whose "
    "spacing in time is beside them; percentiles by the flow that a particle stands for",
}


@dataclass
class Release:
    """Particles released at one time.

    Attributes:
        t: When [s].
        particles: The particles.
        weights: Flow that each stands for, none where it is backwards.
    """

    t: float
    particles: Particles
    weights: Array = field(default_factory=lambda: np.zeros(0))


def shear_numbers(case: Case, folder: Path, window: Window) -> dict[str, Any]:
    """Return the viscous shear stress and its exposure in a part of a run.

    Args:
        case: A case with a valve.
        folder: Folder of the run.
        window: Part of the run.
    """
    series = Path(folder) / "paraview" / "fluid.pvd"
    if not series.is_file():
        return {name: {"reason": "the run has written no frames"} for name in MEANINGS}
    files = [(t, path) for t, path in times_of(series) if window.start - 1e-9 <= t <= window.end + 1e-9]
    if len(files) < 2 or not case.fluid.viscosity > 0.0:
        reason = "fewer than two frames" if len(files) < 2 else "the fluid has no viscosity"
        return {name: {"reason": reason} for name in MEANINGS}
    first = read_grid(files[0][1], files[0][0])
    inside, releases = _lumen(case, first), _releases(case, first, window)
    rows, before, fault = [], None, ""
    for frame in _frames(case, files):
        rows.append(volume_percentiles(frame.values[..., 3], frame.edges, inside, list(PARTS.values())))
        if before is not None and not fault:
            fault = _carry(releases, before, frame)
        before = frame
    t = np.array([t for t, _ in files])
    exposure: dict[str, Any] = {"reason": fault} if fault else _exposure(releases)
    found = {"shear": _shear(t, np.array(rows), window), "exposure": exposure}
    found["exposure"]["frame_spacing_ms"] = 1e3 * float(np.median(np.diff(t)))
    return found


def _frames(case: Case, files: list[tuple[float, Path]]) -> Iterator[Written]:
    """Read the frames with their shear stress, one after the other."""
    for t, path in files:
        grid = read_grid(path, t)
        u = grid.fields["velocity"].astype(float)
        tau = shear_stress(cell_gradient(u, grid.centres), case.fluid.viscosity)
        yield Written(t=t, edges=grid.edges, values=np.concatenate([u, tau[..., None]], axis=-1))


def _lumen(case: Case, grid: GridFields) -> Mask:
    """Cells whose centres are at least a spacing within the housing; all of them without one."""
    x, y, z = grid.centres
    X, Y = np.meshgrid(x, y, indexing="ij")
    radius = wall_radius(case, np.arctan2(Y, X).ravel(), z)
    if radius is None:
        return np.ones((len(x), len(y), len(z)), dtype=bool)
    return np.hypot(X, Y)[..., None] < radius.reshape(*X.shape, len(z)) - case.grid.spacing


def _releases(case: Case, grid: GridFields, window: Window) -> list[Release]:
    """Release particles on a disk upstream of the valve, a radius before it, evenly over forward flow."""
    radius = 0.5 * valve_of(case).diameter
    base = case.housing.annulus if case.housing is not None else 0.0
    z = max(base - radius, float(grid.edges[2][0]) + 2.0 * case.grid.spacing)
    start, end = window.forward
    times = start + (end - start) * (np.arange(BATCHES) + 0.5) / BATCHES
    return [Release(t=float(t), particles=Particles(seeds_on_disk(WIDTH * radius, z, SEEDS))) for t in times]


def _carry(releases: list[Release], before: Written, after: Written) -> str:
    """Carry particles on from one frame to the next, from when they are released on; return why it cannot be."""
    for release in releases:
        if release.t >= after.t:
            continue
        if not len(release.weights):
            release.weights = np.maximum(release.particles.velocity(before, after, release.t)[:, 2], 0.0)
        try:
            release.particles.advance(before, after, max(release.t, before.t))
        except ValueError as error:
            return str(error)
    return ""


def _shear(t: Array, rows: Array, window: Window) -> dict[str, Any]:
    """Largest percentiles of the frames, and their means over forward flow."""
    forward = (t >= window.forward[0]) & (t <= window.forward[1])
    found: dict[str, Any] = {}
    for name, column in zip(PARTS, rows.T / PASCAL, strict=True):
        k = int(np.argmax(column))
        found[f"{name}_Pa"] = {"value": float(column[k]), "t_s": float(t[k])}
        if forward.any():
            found[f"{name}_Pa"]["mean_in_forward_flow"] = float(column[forward].mean())
    return found


def _exposure(releases: list[Release]) -> dict[str, Any]:
    """Percentiles of the dose of all particles that were carried."""
    moved = [release for release in releases if len(release.weights)]
    weights = np.concatenate([release.weights for release in moved] or [np.zeros(0)])
    if not weights.sum() > 0.0:
        return {"reason": "no particle goes forward"}
    dose, age = (
        np.concatenate([getattr(release.particles, name) for release in moved]) for name in ("dose", "age")
    )
    gone = np.concatenate([~release.particles.inside for release in moved])
    found: dict[str, Any] = {
        f"{name}_Pa_s": percentile(dose, weights, part) / PASCAL for name, part in PARTS.items()
    }
    total = weights.sum()
    return found | {
        "mean_Pa_s": float(dose @ weights / total) / PASCAL,
        "mean_time_ms": 1e3 * float(age @ weights / total),
        "left_percent": 100.0 * float(weights[gone].sum() / total),
        "particles": len(dose),
    }
