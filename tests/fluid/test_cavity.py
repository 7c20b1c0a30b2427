"""Lid-driven cavity at Re = 100 against the table of Ghia, Ghia and Shin (1982)."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from valvefsi.fluid.boundary import Boundary, Wall
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.grid import MacGrid

TABLE = Path(__file__).parents[1] / "reference" / "ghia1982_cavity_re100.csv"


def reference(component):
    lines = [line for line in TABLE.read_text().splitlines() if not line.startswith("#")]
    rows = [row for row in csv.DictReader(lines) if row["component"] == component]
    return np.array([[float(row["position"]), float(row["velocity"])] for row in rows]).T


def whole(grid, faces, d):
    out = np.zeros(grid.face_shape(d))
    block = faces[d][grid.owned_faces(d)]
    out[tuple(slice(s, s + n) for s, n in zip(grid.start, block.shape, strict=True))] = block
    return grid.comm.allreduce(out)[:, :, 0]


def test_cavity_at_re_100_agrees_with_ghia_to_one_per_cent_of_the_lid_speed():
    n, dt = 64, 0.5 / 64
    grid = MacGrid([0, 0], [1, 1], [n, n], [False, False])
    fluid = NavierStokes(grid, Boundary(grid, {"y_upper": Wall(velocity=(1.0, 0.0))}), rho=1.0, mu=0.01)
    u, p, f = fluid.fill(grid.zero_faces(), 0.0), grid.zeros(), grid.zero_faces()
    N_old = fluid.advection(u)
    for k in range(round(25 / dt)):
        N = fluid.advection(u)
        before, (u, p) = u, fluid.step(u, p, (N, N_old, 1.0), f, k * dt, dt)
        N_old = N
    change = max(np.abs(a - b)[grid.owned].max() for a, b in zip(u, before, strict=True)) / dt
    assert grid.comm.allreduce(change) < 1e-5, "the flow is not steady yet"
    centres = (np.arange(n) + 0.5) / n
    position = np.concatenate([[0.0], centres, [1.0]])
    profiles = {
        "u": np.concatenate([[0.0], whole(grid, u, 0)[n // 2], [1.0]]),
        "v": np.concatenate([[0.0], whole(grid, u, 1)[:, n // 2], [0.0]]),
    }
    for component, values in profiles.items():
        at, published = reference(component)
        gap = np.abs(CubicSpline(position, values)(at) - published)
        assert gap.max() < 0.01, f"{component}: {gap.max():.4f} at {at[gap.argmax()]}"
        print(component, gap.max())
