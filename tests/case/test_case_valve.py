"""A valve in a test section, from the case file of the demo: ranks, restart, what is refused, what is reported."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.case import load_case
from valvefsi.case.build import build, run_case
from valvefsi.case.meshes import valve_mesh
from valvefsi.case.valve_report import report_valve
from valvefsi.case.valve_tables import ValveShape
from valvefsi.case.walls import build_rigid
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.errors import CaseError
from valvefsi.geometry.leaflets import pericardial
from valvefsi.geometry.stent import FormulaEdge, stent_wall
from valvefsi.grid.grading import core_edges
from valvefsi.io.history import read_history
from valvefsi.post.diagnostics.surfaces import surface_triangles

DEMO = Path(__file__).parents[2] / "demos" / "pericardial_valve.toml"
COARSE = (
    "grid.h=2mm",
    "grid.core_lower=['-2.1 cm', '-2.1 cm', '-2 cm']",
    "grid.core_upper=['2.1 cm', '2.1 cm', '6 cm']",
    "solid.leaflets.mesh.valve.ratio=1.5",
    "time.dt_per_h='0.0002 s/cm'",
    "output.history_every=2",
    "output.frames=0",
)


def coarse(steps: int, *more: str):
    return load_case(DEMO, [*COARSE, f"time.t_end='{40 * steps} us'", *more])


def columns(folder: Path) -> dict[str, list[float]]:
    return read_history(folder / "history.csv")


@pytest.fixture(scope="module")
def shared_tmp_module(tmp_path_factory):
    """One folder for all ranks and the whole file."""
    folder = tmp_path_factory.mktemp("valve") if MPI.COMM_WORLD.rank == 0 else None
    return MPI.COMM_WORLD.bcast(folder)


@pytest.fixture(scope="module")
def whole(shared_tmp_module):
    folder = shared_tmp_module / "whole"
    return folder, run_case(coarse(6), out=folder)


def test_the_demo_runs_and_reports(whole):
    folder, result = whole
    history = columns(folder)
    assert np.isfinite([history[name] for name in history]).all()
    assert 0.0 < history["pdva_cm2"][0] < 0.2 * np.pi * 1.25**2  # the valve is nearly closed at rest
    assert history["q_z_lower_ml_s"] == pytest.approx(-np.array(history["q_z_upper_ml_s"]), abs=1e-6)
    assert "valve" in result or MPI.COMM_WORLD.rank > 0
    if MPI.COMM_WORLD.rank == 0:
        numbers = json.loads((folder / "summary.json").read_text())["valve"]
        assert any("incomplete" in reason for reason in numbers["cycles"][0]["missing"])
        assert (folder / "valve.png").stat().st_size > 10000


def test_one_rank_gives_the_same(whole, shared_tmp_module):
    alone = shared_tmp_module / f"alone-{MPI.COMM_WORLD.rank}"
    run_case(coarse(6), out=alone, comm=MPI.COMM_SELF)
    mine, expected = columns(whole[0]), columns(alone)
    for name in mine:
        scale = np.abs(expected[name]).max() + 1e-12
        assert mine[name] == pytest.approx(expected[name], rel=1e-6, abs=1e-8 * scale + 1e-11), name


def test_a_run_that_was_stopped_goes_on_the_same(whole, shared_tmp_module):
    folder = shared_tmp_module / "resumed"
    case = coarse(6, "output.checkpoint_every=2")
    simulation = build(case, folder)
    half = build(coarse(6, "time.t_end='160 us'", "output.checkpoint_every=2"), folder)
    half.run()
    simulation.run(resume=True)
    mine, expected = columns(folder), columns(whole[0])
    assert mine["t_s"][-1] == pytest.approx(expected["t_s"][-1])
    for name in ("kinetic_energy_erg", "q_z_upper_ml_s", "leaflets_J_max", "pdva_cm2"):
        assert mine[name][-1] == pytest.approx(expected[name][-1], rel=1e-6), name


def test_numbers_of_a_beat_from_a_history(tmp_path):
    """Half sines of forward and closing flow, a leakage, a fixed difference: numbers in closed form."""
    case = load_case(DEMO, ["time.t_end='857 ms'"])
    t = np.linspace(0.0, 0.857, 858)
    systole = (t > 0.05) & (t < 0.35)
    closing = (t > 0.35) & (t < 0.4)
    q = np.where(systole, 350.0 * np.sin(np.pi * (t - 0.05) / 0.3), -2.0)
    q -= np.where(closing, 60.0 * np.sin(np.pi * (t - 0.35) / 0.05), 0.0)
    forward, closed, leaked = 350.0 * 0.3 * 2.0 / np.pi, 60.0 * 0.05 * 2.0 / np.pi + 2.0 * 0.05, 2.0 * 0.507
    rows = {
        "step": np.arange(len(t)),
        "t_s": t,
        "leaflets_volume_change_percent": -0.8 * np.sin(np.pi * t / 0.857) ** 2 + 0.1,
        "pdva_cm2": np.where(systole, 3.5, 0.01),
        "p_z_lower_mmHg": np.where(systole, 108.0, 10.0),
        "p_z_upper_mmHg": np.full(len(t), 98.0),
        "q_z_upper_ml_s": q,
    }
    table = np.stack(list(rows.values()), axis=1)
    np.savetxt(tmp_path / "history.csv", table, delimiter=",", header=",".join(rows), comments="")
    numbers = report_valve(case, tmp_path)["valve"]
    cycle, plausible = numbers["cycles"][0], numbers["plausible"]
    assert cycle["net_volume_ml"] == pytest.approx(forward - closed - leaked, rel=1e-3)
    assert cycle["forward_volume_ml"] == pytest.approx(forward, rel=1e-3)
    assert cycle["peak_reynolds"] == pytest.approx(4 * 350.0 / (np.pi * 2.5 * 0.035), rel=1e-3)
    assert cycle["mean_aortic_pressure_mmHg"] == pytest.approx(98.0)
    assert plausible["mean difference"]["value"] == pytest.approx(10.0, rel=0.02)
    assert plausible["largest open area"]["value"] == pytest.approx(100.0 * 3.5 / (np.pi * 1.25**2))
    assert plausible["largest open area"]["plausible"]
    # Closing ends where 2 % of the peak flow are left, 7 ml/s: 0.4 % of the closing sine later counts as leakage.
    assert plausible["closing volume"]["value"] == pytest.approx(100 * closed / forward, rel=0.01)
    assert plausible["leakage volume"]["value"] == pytest.approx(100 * leaked / forward, rel=0.02)
    assert plausible["volume change of the leaflets"]["value"] == pytest.approx(-0.7, rel=1e-5)


def test_the_table_of_a_valve_says_place_size_and_layers():
    world = MPI.COMM_WORLD

    def made(h=0.2, **change):
        mesh = valve_mesh(ValveShape(**change), h, world).mesh
        z = mesh.geometry.x[:, 2]
        ends = (
            world.allreduce(z.min(initial=np.inf), MPI.MIN),
            world.allreduce(z.max(initial=-np.inf), MPI.MAX),
        )
        return mesh.topology.index_map(3).size_global, np.array(ends)

    (cells, ends), (moved_cells, moved) = made(), made(base=0.3)
    assert moved_cells == cells
    assert moved == pytest.approx(ends + 0.3)
    assert made(layers=2)[0] == 2 * cells
    assert made(h=0.1, ratio=1.5)[0] == cells < made(ratio=0.5)[0]


def test_leaflets_away_from_their_stent_are_warned_of(shared_tmp, monkeypatch, comm):
    case = coarse(2)
    grid = build(case, shared_tmp).model.grid
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        build_rigid(case, grid)
    monkeypatch.setattr("valvefsi.case.walls.SEAM", 0.01)
    if comm.rank == 0:
        with pytest.warns(
            UserWarning, match=r"beside the leaflets: .* is 0\.\d\d h from .* at most 0\.01 h is safe"
        ):
            build_rigid(case, grid)
    else:
        build_rigid(case, grid)


def test_the_housing_has_its_stent_and_is_held_as_firmly_as_asked(shared_tmp):
    case = coarse(2, "housing.hold=0.1")
    grid, section = build(case, shared_tmp).model.grid, case.housing.section()
    rigid, filling = build_rigid(case, grid)
    tube = section.housing(0.2, (-1.9, 5.9))
    shape = case.solid[0].mesh.valve
    edge = FormulaEdge(shape.geometry(), shape.base)
    stent = stent_wall(edge, section.annulus, lambda phi: np.full_like(phi, section.inlet_radius), 0.2)
    outward = rigid.points - np.concatenate([tube.points, stent.points])
    normals = np.concatenate([tube.normals, stent.normals])
    distance = np.linalg.norm(outward, axis=1)
    np.testing.assert_allclose(outward, distance[:, None] * normals, atol=1e-12)
    # The kernel's offset: one sixth along the grid, at most half the mean distance of two of its positions.
    assert distance.min() == pytest.approx(0.2 / 6.0, rel=0.01)
    assert distance.max() < 0.3 * 0.2
    held = 0.1 * case.fluid.density * 0.2 / largest_square_sum("composite_bspline32")
    assert rigid.stiffness == pytest.approx(held / case.dt**2)
    assert rigid.damping == pytest.approx(held / case.dt)
    # A side's velocity cannot be held: along its normal the points in its reach slip, and nothing else does.
    low, high = case.grid.bounds[2]
    ends = (rigid.X[:, 2] < low + 1.49 * 0.2) | (rigid.X[:, 2] > high - 1.49 * 0.2)
    assert 0 < grid.comm.allreduce(int(ends.sum())) < 0.2 * rigid.num_points
    np.testing.assert_allclose(case.dt * rigid.slip, 0.5 * ends[:, None, None] * np.diag([0.0, 0.0, 1.0]))
    # Beside the lower half of the stent the fluid outside is held: every face half a spacing behind the wall.
    assert filling.stiffness == pytest.approx(0.1 * case.fluid.density / case.dt**2)
    assert filling.damping == pytest.approx(0.1 * case.fluid.density / case.dt)
    middle = 0.5 * (section.annulus + stent.points[:, 2].max())
    for d in range(3):
        faces = filling.X - 0.1 * (np.arange(3) == d)
        behind = np.hypot(*faces[:, :2].T) - section.radius(np.arctan2(faces[:, 1], faces[:, 0]), faces[:, 2])
        beside = (faces[:, 2] > section.annulus) & (faces[:, 2] < middle)
        held = filling.transfer.volumes[:, d] > 0.0
        assert held[beside & (behind > 0.15)].all()
        assert not held[~beside | (behind < 0.09)].any()
    at = filling.comm.allgather(filling.X[:, 2])
    assert np.concatenate(at).min() < section.annulus + 0.2
    assert np.concatenate(at).max() > middle - 0.2
    bare = case.model_copy(update={"housing": case.housing.model_copy(update={"stent": None})})
    (alone,) = build_rigid(bare, grid)  # nothing is shut in it
    assert alone.num_points == len(tube.points)
    open_box = case.model_copy(update={"housing": case.housing.model_copy(update={"fill": False})})
    assert [body.name for body in build_rigid(open_box, grid)] == [rigid.name]


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("housing.stent=valve", r"housing\.stent.*no solid with a valve has this name"),
        ("housing.annulus='1 cm'", r"housing\.annulus.*begins below"),
        ("housing.sinus_depth='1.5 cm'", r"does not fit into the core of the box"),
        ("grid.h=0.3mm", r"grid\.h.*not a whole number of cells"),
        ("solid.leaflets.tether.0.on=['attachd']", r"no such tag"),
        ("solid.leaflets.mesh.valve.gap='12 mm'", r"mesh\.valve\.gap.*nose and gap leave no free edge"),
    ],
)
def test_what_does_not_fit_is_said(override, said, tmp_path):
    with pytest.raises(CaseError, match=said):
        build(load_case(DEMO, [override]), tmp_path)


def test_a_core_of_equal_cells_is_widened_and_the_rest_grows():
    edges = core_edges(-2.5, -1.95, 1.95, 2.5, 0.07)
    widths = np.diff(edges)
    assert (edges[0], edges[-1]) == (-2.5, 2.5)
    core = widths[(edges[:-1] > -1.96) & (edges[1:] < 1.96)]
    assert core == pytest.approx(0.07)
    assert (widths > 0.07 * (1 - 1e-9)).all()
    assert (np.maximum(widths[1:] / widths[:-1], widths[:-1] / widths[1:]) < 1.1).all()


def test_a_spacing_of_few_digits_makes_equal_cells_where_the_core_is_the_whole_axis():
    edges = core_edges(0.0, 0.0, 40.0, 40.0, 1.6666667)
    assert len(edges) == 25
    assert np.ptp(np.diff(edges)) < 1e-12


def test_the_surface_of_a_block_of_hexahedra_is_its_outside():
    n = np.arange(12).reshape(3, 2, 2)
    corner = [
        n[:-1, 0, 0],
        n[1:, 0, 0],
        n[1:, 1, 0],
        n[:-1, 1, 0],
        n[:-1, 0, 1],
        n[1:, 0, 1],
        n[1:, 1, 1],
        n[:-1, 1, 1],
    ]
    triangles = surface_triangles(12, np.stack(corner, axis=1))
    x = np.array(np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0], [0.0, 1.0], indexing="ij")).reshape(3, -1).T
    edges = x[triangles[:, 1:]] - x[triangles[:, :1]]
    area = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum()
    assert area == pytest.approx(10.0)


def test_lengths_of_the_leaflets_may_be_set_one_by_one():
    shape, usual = (
        load_case(DEMO, [f"solid.leaflets.mesh.valve={{type='pericardial'{more}}}"])
        .solid[0]
        .mesh.valve.geometry()
        for more in (", gap='1.2 mm'", "")
    )
    own = pericardial(diameter=2.5)
    assert (shape.gap, shape.thickness, shape.height) == (pytest.approx(0.12), own.thickness, own.height)
    assert usual == own
