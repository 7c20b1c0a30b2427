"""What is reported of a valve's frames: flutter, contact, stress by place, shear stress and its exposure."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from mpi4py import MPI
from typer.testing import CliRunner

from tests.case.test_case_valve import coarse
from tests.post.test_coaptation import plate, together
from valvefsi.case.build import build, run_case
from valvefsi.case.valve_motion import coaptation_numbers, flutter_numbers, loads, place_numbers
from valvefsi.case.valve_report import report_numbers
from valvefsi.case.valve_shear import shear_numbers
from valvefsi.case.valve_views import Leaflets, read_leaflets
from valvefsi.cli import app
from valvefsi.geometry.ribbons import MiddleLine
from valvefsi.io.history import read_history
from valvefsi.io.paraview import FluidSeries
from valvefsi.io.solid_body import read_body
from valvefsi.post.leaflet_places import PLACES
from valvefsi.post.valve_phases import Window
from valvefsi.run.recording import FreeEdges

pytestmark = pytest.mark.serial
CYCLE = Window(start=1.0, end=1.8, times=(1.10, 1.14, 1.30, 1.40), forward=(1.09, 1.39))
"""A cycle whose valve is open from 1.14 to 1.30 s."""


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames") / "run"
    run_case(coarse(6, "output.frames=3"), out=folder)
    return folder


def test_phases_go_round_the_cycle():
    t = np.array([1.05, 1.11, 1.2, 1.35, 1.5, 1.79, 1.91])
    assert list(CYCLE.phase(t)) == [3, 0, 1, 2, 3, 3, 0]
    shifted = Window(start=1.0, end=1.8, times=(1.9, 1.94, 2.1, 2.2), forward=(1.09, 1.39))
    assert list(shifted.phase(t)) == list(CYCLE.phase(t)), "times of the next cycle"
    steady = Window(start=0.0, end=1.0, forward=(0.0, 1.0))
    assert steady.names == ("whole",)
    assert list(steady.phase(t)) == [0] * 7


def test_a_run_follows_the_middles_of_its_free_edges(ran):
    table, history = read_history(ran / "free_edges.csv"), read_history(ran / "history.csv")
    assert table["t_s"] == history["t_s"]
    frames = read_leaflets(coarse(6, "output.frames=3"), ran)
    for k in range(3):
        # The node of the edge next to its middle, on one face of the leaflet.
        assert table[f"leaflet_{k + 1}_middle_cm"][0] == pytest.approx(frames.middles()[0, k], abs=0.03)


def test_a_free_edge_that_moves_is_followed_along_its_own_direction(tmp_path):
    model = (simulation := build(coarse(6), tmp_path)).model
    edges = FreeEdges(model, simulation.output.orifice, tmp_path, None)
    X = model.bodies[0].X
    for step, shift in enumerate(([0.0, 0.0, 0.0], [0.2, 0.0, 0.7], [0.0, 0.1, 0.0])):
        state = SimpleNamespace(step=step, t=1e-3 * step, bodies=({"chi": X + shift},))
        edges.append(state)
    table = read_history(tmp_path / "free_edges.csv")
    assert table["t_s"] == pytest.approx([0.0, 1e-3, 2e-3])
    for k, angle in enumerate(np.radians([0.0, 120.0, 240.0])):
        rest, *moved = table[f"leaflet_{k + 1}_middle_cm"]
        assert rest > 0.0
        assert moved[0] - rest == pytest.approx(0.2 * np.cos(angle), abs=0.01)
        assert moved[1] - rest == pytest.approx(0.1 * np.sin(angle), abs=0.01)


def write_edges(folder, t, *swings):
    names = [f"leaflet_{k + 1}_middle_cm" for k in range(len(swings))]
    rows = [",".join(["step", "t_s", *names])]
    rows += [
        f"{k},{row[0]!r},{','.join(map(repr, row[1:]))}" for k, row in enumerate(zip(t, *swings, strict=True))
    ]
    (folder / "free_edges.csv").write_text("\n".join(rows) + "\n")


def test_flutter_is_that_of_the_open_valve(tmp_path):
    """Outside of it the edge goes much farther."""
    t = np.arange(1.0, 1.8, 1e-3)
    open_ = (t >= 1.14) & (t <= 1.30)
    swing = 0.04 * np.sin(2 * np.pi * 42.0 * t)
    write_edges(
        tmp_path, t.tolist(), np.where(open_, 1.0 + swing, 0.0).tolist(), np.where(open_, 0.9, 0.0).tolist()
    )
    found = flutter_numbers(tmp_path, CYCLE)
    assert found["resolution_Hz"] == pytest.approx(1 / 0.16, rel=0.02)
    assert found["leaflet_1"]["frequency_Hz"] == pytest.approx(42.0, abs=1.0)
    assert found["leaflet_1"]["amplitude_mm"] == pytest.approx(0.4, rel=0.05)
    assert found["leaflet_2"]["reason"].startswith("no peak")
    later = Window(start=1.0, end=1.8, times=(1.9, 1.94, 2.1, 2.2), forward=(1.09, 1.39))
    assert flutter_numbers(tmp_path, later) == found, "phases of the next cycle are those of this one"
    (tmp_path / "free_edges.csv").unlink()
    assert flutter_numbers(tmp_path, CYCLE) == {"reason": "the run has written no free_edges.csv"}


def made_up(gaps):
    """Two plates as leaflets, so far apart at each time of a list."""
    t, points = [], []
    for when, gap in gaps:
        x, faces, owner = together(plate(), plate(gap, -1.0))
        t.append(when)
        points.append(x)
    half = len(x) // 2
    top = np.flatnonzero(np.isclose(x[:half, 2], 1.0))
    lines = tuple(
        MiddleLine(nodes=np.tile(nodes[:, None], 3), weights=np.full((len(nodes), 3), 1 / 3), closed=False)
        for nodes in (top, top + half)
    )
    none = np.zeros((0, 3), dtype=np.int64)
    own = {"inflow": faces, "inflow_owner": owner, "free": (), "attached": ()}
    return Leaflets(
        t=np.array(t),
        points=np.array(points),
        triangles=none,
        owner=none,
        lines=lines,
        area=np.zeros(len(t)),
        **own,
    )


def test_contact_is_that_of_the_shut_valve_within_two_spacings():
    case = coarse(6)
    assert case.grid.spacing == pytest.approx(0.2)
    leaflets = made_up([(1.05, 0.3), (1.2, 0.5), (1.5, 0.39), (1.6, 0.1), (1.7, 0.41)])
    found = coaptation_numbers(case, leaflets, CYCLE)
    assert found["frames"] == 4
    assert found["area_cm2"] == pytest.approx(3 / 4)
    assert found["largest_area_cm2"] == pytest.approx(1.0)
    assert found["height_mm"] == pytest.approx(7.5), "two faces over two edges"
    assert found["gap_mm"] == pytest.approx(10 * (0.3 + 0.39 + 0.1) / 3)
    assert found["reach_mm"] == pytest.approx(4.0)
    steady = Window(start=1.0, end=1.8, forward=(1.0, 1.8))
    assert coaptation_numbers(case, leaflets, steady) == {"reason": "no frame of the shut valve"}


def test_the_largest_loads_by_place_are_those_of_the_frames(ran):
    case = coarse(6, "output.frames=3")
    leaflets = read_leaflets(case, ran)
    window = Window(start=0.0, end=240e-6, forward=(0.0, 240e-6))
    found = place_numbers(case, ran, leaflets, window)["whole"]
    assert set(found) == set(PLACES)
    frames = [loads(read_body(path)) for path in sorted((ran / "paraview" / "leaflets_stress").glob("*.vtu"))]
    names = {"green_strain": "green_strain_max", "principal_stress": "principal_stress_max_kPa"}
    names["von_mises"] = "von_mises_max_kPa"
    assert set(frames[0]) == set(names)
    for load, name in names.items():
        largest = max(float(frame[load].max()) for frame in frames)
        assert max(place[name]["value"] for place in found.values()) == pytest.approx(largest)
        assert largest > 0
    for place in found.values():
        assert place["von_mises_p99_kPa"]["value"] <= place["von_mises_max_kPa"]["value"]
    early = place_numbers(case, ran, leaflets, Window(start=0.0, end=90e-6, forward=(0.0, 90e-6)))["whole"]
    assert early["belly"]["von_mises_max_kPa"]["t_s"] <= 90e-6


def write_flow(folder, case, times, velocity):
    """Write a velocity of closed form as frames of a case."""
    edges = [
        low + case.grid.spacing * np.arange(n + 1)
        for (low, _), n in zip(case.grid.bounds, (25, 25, 40), strict=True)
    ]
    centres = [0.5 * (e[1:] + e[:-1]) for e in edges]
    x = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    box = [e.tolist() for e in edges]
    series = FluidSeries(
        folder / "paraview", "fluid", MPI.COMM_SELF, x.shape[:3], (0, 0, 0), x.shape[:3], box
    )
    for t in times:
        series.write(t, velocity(x, t), np.zeros(x.shape[:3]))


def test_shear_stress_and_exposure_of_a_parabola(tmp_path):
    """u = U (1 - r^2/R^2): the stress at r is mu 2 U r/R^2, and the dose of a particle that over its time."""
    case, U, R = coarse(6), 3.0, 2.0
    times = np.linspace(0.0, 0.2, 5)
    write_flow(
        tmp_path,
        case,
        times,
        lambda x, t: np.stack([0 * x[..., 0], 0 * x[..., 0], U * (1 - (x[..., :2] ** 2).sum(-1) / R**2)], -1),
    )
    window = Window(start=0.0, end=0.2, forward=(0.0, 0.16))
    found = shear_numbers(case, tmp_path, window)
    most = case.fluid.viscosity * 2 * U / R**2 / 10.0  # times r [Pa]
    shear, exposure = found["shear"], found["exposure"]
    # The widest place of the sinuses, 0.2 cm off the wall and to a cell.
    widest = case.housing.section().widest - 0.2
    assert shear["max_Pa"]["value"] == pytest.approx(most * widest, abs=most * 0.15)
    assert 0.5 * most < shear["p50_Pa"]["value"] < shear["p95_Pa"]["value"] < shear["max_Pa"]["value"]
    assert shear["p50_Pa"]["mean_in_forward_flow"] == pytest.approx(shear["p50_Pa"]["value"], rel=1e-6)
    a, since = 0.9 * 1.25, 0.2 - 0.08  # the seeds' disk, mean time since the release
    r = np.linspace(0.0, a, 4001)
    flow, dose = r * (1 - r**2 / R**2), most * r
    assert exposure["mean_Pa_s"] == pytest.approx(since * (flow * dose).sum() / flow.sum(), rel=0.02)
    assert exposure["max_Pa_s"] == pytest.approx(most * a * (0.2 - 0.01), rel=0.02)
    assert exposure["mean_time_ms"] == pytest.approx(1e3 * since, rel=1e-9)
    assert exposure["left_percent"] == 0.0
    assert exposure["particles"] == 512
    assert exposure["frame_spacing_ms"] == pytest.approx(50.0)


def test_backward_flow_has_no_exposure_and_a_run_without_frames_says_so(tmp_path):
    case = coarse(6)
    window = Window(start=0.0, end=0.2, forward=(0.0, 0.2))
    assert shear_numbers(case, tmp_path, window)["shear"] == {"reason": "the run has written no frames"}
    write_flow(
        tmp_path,
        case,
        (0.0, 0.1, 0.2),
        lambda x, t: np.stack([0 * x[..., 0], 0 * x[..., 0], -1 + 0 * x[..., 0]], -1),
    )
    found = shear_numbers(case, tmp_path, window)
    assert found["exposure"]["reason"] == "no particle goes forward"
    assert found["shear"]["max_Pa"]["value"] == pytest.approx(0.0, abs=1e-9)
    assert shear_numbers(case, tmp_path, Window(start=0.15, end=0.2, forward=(0.15, 0.2)))["shear"] == {
        "reason": "fewer than two frames"
    }


def test_particles_that_begin_backwards_do_not_count(tmp_path):
    """u = x |x|: half of the disk begins backwards; the stress at x is mu 2 |x|, the flow goes with x^2."""
    case = coarse(6)

    def halves(x, t):
        return np.stack([0 * x[..., 0], 0 * x[..., 0], x[..., 0] * np.abs(x[..., 0])], -1)

    write_flow(tmp_path, case, (0.0, 0.1, 0.2), halves)
    exposure = shear_numbers(case, tmp_path, Window(start=0.0, end=0.2, forward=(0.0, 0.2)))["exposure"]
    mean = 32 * (0.9 * 1.25) / (15 * np.pi)  # of x by x^2 over half a disk
    assert exposure["mean_Pa_s"] == pytest.approx(0.1 * case.fluid.viscosity * 2 * mean / 10.0, rel=0.03)


def test_a_velocity_beyond_reason_has_no_exposure_and_spoils_nothing_else(tmp_path):
    case = coarse(6)
    write_flow(
        tmp_path,
        case,
        (0.0, 0.1, 0.2),
        lambda x, t: np.stack([0 * x[..., 0], 0 * x[..., 0], 1e6 * x[..., 0]], -1),
    )
    found = shear_numbers(case, tmp_path, Window(start=0.0, end=0.2, forward=(0.0, 0.2)))
    assert "steps of the particles" in found["exposure"]["reason"]
    assert found["shear"]["max_Pa"]["value"] == pytest.approx(case.fluid.viscosity * 1e5, rel=1e-6)


def test_every_number_that_is_reported_has_a_meaning(ran):
    numbers = report_numbers(coarse(6, "output.frames=3"), ran)["valve"]
    for part in ("flutter", "coaptation", "places", "shear", "exposure"):
        assert part in numbers
        assert len(numbers["definitions"][part]) > 50
    assert json.loads((ran / "summary.json").read_text())["valve"]["places"] == json.loads(
        json.dumps(numbers["places"])
    )


def test_the_numbers_of_a_run_are_taken_again_by_a_command(ran, tmp_path):
    done = CliRunner().invoke(app, ["numbers", str(ran), "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "valve.json").read_text())["valve"]
    summary = json.loads((ran / "summary.json").read_text())
    assert found == summary["valve"]
    damaged = summary | {"valve": {"places": {}}}
    (ran / "summary.json").write_text(json.dumps(damaged))
    done = CliRunner().invoke(app, ["numbers", str(ran)])
    assert json.loads((ran / "summary.json").read_text()) == summary
    stress = summary["valve"]["places"]["whole"]["belly"]["von_mises_p99_kPa"]["value"]
    row = next(line for line in done.output.splitlines() if "whole, belly, von Mises stress, 99th" in line)
    assert row.split()[-2:] == [f"{stress:.5g}", "kPa"]
    (tmp_path / "empty").mkdir()
    done = CliRunner().invoke(app, ["numbers", str(tmp_path / "empty")])
    assert "there is no run of a valve here, case.toml is missing" in str(done.exception)
