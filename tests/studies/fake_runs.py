"""Folders as finished runs leave them, with waveforms, flow, leaflets and stresses of closed form."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from tests.case.test_case_valve import COARSE, DEMO
from tests.case.test_valve_runs import run_folder
from tests.valve_waves import LARGEST_AREA, waves
from valvefsi.case import load_case
from valvefsi.case.meshes import solid_mesh
from valvefsi.case.writing import to_toml
from valvefsi.io.paraview import BodySeries, FluidSeries
from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before dolfinx)

# isort: split
from dolfinx import plot

GRID = COARSE[:4]
SPEED = 100.0
"""Largest velocity on the axis [cm/s]."""


def grid_of(case, cells=(20, 20, 32)):
    """Edges and centres of even cells over the box of a case."""
    edges = [np.linspace(low, high, n + 1) for (low, high), n in zip(case.grid.bounds, cells, strict=True)]
    centres = np.meshgrid(*[0.5 * (e[1:] + e[:-1]) for e in edges], indexing="ij")
    return edges, np.stack(centres, axis=-1)


def opening(t):
    """How far the valve is open, 0 to 1."""
    return waves(np.asarray(t))["pdva"] / LARGEST_AREA


def velocity(x, t):
    """A jet along z that is on while the valve is open."""
    u = np.zeros_like(x)
    u[..., 2] = SPEED * opening(t) * np.exp(-(x[..., 0] ** 2) - x[..., 1] ** 2)
    return u


def write_frames(folder, case, times, stress=True):
    """Write frames of the fluid, of leaflets that go outwards as the valve opens, and of their stress."""
    edges, x = grid_of(case)
    box = [e.tolist() for e in edges]
    size = x.shape[:3]
    fluid = FluidSeries(folder / "paraview", "fluid", MPI.COMM_SELF, size, (0, 0, 0), size, box)
    leaflets = BodySeries(folder / "paraview", "leaflets", MPI.COMM_SELF)
    loads = BodySeries(folder / "paraview", "leaflets_stress", MPI.COMM_SELF) if stress else None
    topology, _, rest = plot.vtk_mesh(solid_mesh(case, 0, MPI.COMM_SELF).mesh)
    cells = {12: topology.reshape(-1, 9)[:, 1:].astype(np.int64)}
    out = rest * [1.0, 1.0, 0.0] * (rest[:, 2:] / rest[:, 2].max()) ** 2
    for t in times:
        fluid.write(t, velocity(x, t), np.zeros(size))
        points = rest + 0.4 * opening(t) * out
        leaflets.write(t, (points, cells, {"J": np.ones(len(rest))}, rest))
        if loads is not None:
            values = {"von Mises stress [dyn/cm^2]": 1e6 * (1.0 - opening(t)) * rest[:, 2]}
            loads.write(t, (points, cells, values, rest))


def beating(folder, times, *, cycles=1.0, overrides=(), stress=True):
    """A run of a beating valve."""
    run_folder(folder, cycles, overrides=(*GRID, *overrides))
    write_frames(folder, load_case(folder / "case.toml"), times, stress)
    return folder


def steady(folder, cells=(20, 20, 32), size=1.0, lines=True):
    """A run in steady flow with averages: a jet of a size, and profiles across it."""
    case = load_case(
        DEMO.parent / "pericardial_valve_steady.toml",
        [*GRID, "output.averages_from='0.1 s'", "time.t_end='0.2 s'"],
    )
    folder.mkdir(parents=True)
    (folder / "case.toml").write_text(to_toml(case), encoding="utf-8")
    rows = ["step,t_s,flow_inlet_cm3_per_s,pdva_cm2", "0,0.0,0.0,1.0", "1,0.1,300.0,2.0", "2,0.2,350.0,2.0"]
    (folder / "history.csv").write_text("\n".join(rows) + "\n")
    edges, x = grid_of(case, cells)
    box = [e.tolist() for e in edges]

    class AverageSeries(FluidSeries):
        fields = (("mean_velocity", 3), ("mean_pressure", 1), ("turbulence_kinetic_energy", 1))

    series = AverageSeries(
        folder / "paraview", "averages", MPI.COMM_SELF, x.shape[:3], (0, 0, 0), x.shape[:3], box
    )
    u = size * velocity(x, 0.2)
    series.write(0.2, u, np.zeros(x.shape[:3]), 0.01 * u[..., 2] ** 2)
    if lines:
        (folder / "profiles").mkdir()
        at = np.linspace(-1.4, 1.4, 15)
        for z in (2.0, 3.0):
            u_z = size * SPEED * np.exp(-(at**2))
            columns = {
                "s_cm": at + 1.4,
                "x_cm": at,
                "y_cm": 0 * at,
                "z_cm": z + 0 * at,
                "mean_u_z_cm_per_s": u_z,
            }
            columns["tke_cm2_per_s2"] = 0.01 * u_z**2
            table = np.stack(list(columns.values()), axis=1)
            path = folder / "profiles" / f"z_{10 * z:.0f}mm.csv"
            np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")
    return folder
