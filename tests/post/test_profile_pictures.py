"""Pictures of profiles and averages that a run with lines leaves."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread
from mpi4py import MPI

from tests.case_text import written
from valvefsi.case.build import run_case
from valvefsi.post.plots.profile import draw_profiles, largest_velocity, read_profiles

CASE = """
[grid]
lower = [0, 0, 0]
upper = [1, 1, 2]
cells = [8, 8, 16]
[fluid]
viscosity = 0.1
[fluid.sides]
z_lower = {velocity_expression = ["0", "0", "6 * x * (1 - x)"]}
z_upper = {type = "open"}
[time]
dt = "5 ms"
t_end = "0.1 s"
[output]
history_every = 1
frames = 1
averages_from = "50 ms"
[[output.line]]
name = "upper"
start = [0.1, 0.5, 1.5]
end = [0.9, 0.5, 1.5]
points = 9
[[output.line]]
name = "lower"
start = [0.1, 0.5, 0.5]
end = [0.9, 0.5, 0.5]
points = 9
"""
PLANES = ("slice_y0.5_mean_velocity_z.png", "slice_y0.5_turbulence_kinetic_energy.png")


def pictures(folder):
    return {path.name for path in folder.glob("*.png")}


def test_a_run_with_lines_draws_them_and_the_plane_that_holds_them(shared_tmp):
    out = shared_tmp / "run"
    run_case(written(shared_tmp, CASE), out=out)
    MPI.COMM_WORLD.barrier()
    assert pictures(out) == {"histories.png", "profiles.png", *PLANES}
    for name in ("profiles.png", *PLANES):
        assert np.ptp(imread(out / name)[..., :3]) > 0.5
    found = read_profiles(out / "profiles")
    assert list(found) == ["lower", "upper"]
    assert largest_velocity(found) == "mean_u_z_cm_per_s"
    assert found["lower"]["mean_u_z_cm_per_s"].max() > 0.5


CHANGES = {
    "no averages yet": ('averages_from = "50 ms"', 'averages_from = "0.2 s"'),
    "no common plane": ("end = [0.9, 0.5, 1.5]", "end = [0.9, 0.6, 1.4]"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_without_averages_or_a_common_plane_only_profiles_are_drawn(change, shared_tmp):
    out = shared_tmp / "run"
    run_case(written(shared_tmp, CASE.replace(*change)), out=out)
    MPI.COMM_WORLD.barrier()
    assert pictures(out) == {"histories.png", "profiles.png"}


@pytest.mark.serial
def test_six_profiles_fill_two_rows_of_panels(tmp_path):
    s = np.linspace(0.0, 2.8, 57)
    profiles = {
        f"z_{k}0mm": {"s_cm": s, "x_cm": s - 1.4, "y_cm": 0.0 * s, "z_cm": 0.0 * s + k}
        | {"mean_u_x_cm_per_s": 0.1 * s, "mean_u_z_cm_per_s": (150 - 10 * k) * np.exp(-((s - 1.4) ** 2))}
        | {"tke_cm2_per_s2": 900 * np.sin(np.pi * s / 2.8) ** 2}
        for k in range(1, 7)
    }
    path = draw_profiles(tmp_path / "profiles.png", profiles, title="A jet", caption="closed form")
    assert np.ptp(imread(path)[..., :3]) > 0.5
    assert largest_velocity(profiles) == "mean_u_z_cm_per_s"
