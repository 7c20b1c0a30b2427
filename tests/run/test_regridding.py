"""A state of one run as the beginning of another on another grid and other meshes."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.test_resuming import RAW
from tests.coupled_case import DT, block_model, heavy, simulation
from valvefsi import fsi
from valvefsi.case import load_case, parse_case
from valvefsi.case.build import plan_case, run_case
from valvefsi.case.resuming import check_shapes
from valvefsi.cli.run import first_line
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model
from valvefsi.geometry.shapes import rectangle
from valvefsi.grid import MacGrid
from valvefsi.io.history import read_history
from valvefsi.run.regridding import regridded
from valvefsi.solid.carrying import at_points
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

DEMO = Path(__file__).parents[2] / "demos" / "pericardial_valve.toml"
SELF = MPI.COMM_SELF
K = 2 * math.pi


def vortices(cells, comm=SELF):
    grid = MacGrid([0, 0], [1, 1], [cells, cells], [True, True], comm)
    return Model(grid=grid, fluid=NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.01))


def exact(grid):
    """Solenoidal and periodic, with its pressure."""
    x, y, _ = grid.points(0)
    u = np.sin(K * x) * np.cos(K * y) + 0 * grid.zeros()
    x, y, _ = grid.points(1)
    v = -np.cos(K * x) * np.sin(K * y) + 0 * grid.zeros()
    x, y, _ = grid.points()
    return (u, v), np.cos(K * x) + 0 * y + 0 * grid.zeros()


def largest(grid, a, b):
    here = [np.abs((p - q)[grid.owned_faces(d)]).max() for d, (p, q) in enumerate(zip(a, b, strict=True))]
    return grid.comm.allreduce(max(here), op=MPI.MAX)


def test_a_flow_is_taken_over_with_second_order_and_without_divergence(comm):
    errors = []
    for cells in (16, 32, 64):
        coarse, fine = vortices(cells), vortices(cells * 3 // 2, comm)
        u, p = exact(coarse.grid)
        start = fsi.initial_state(coarse, DT, coarse.fluid.fill(u, 0.0), p)
        found = regridded(coarse, replace(start, t=0.7), fine, DT)
        assert (found.t, found.step) == (0.7, 0)
        assert np.abs(fine.fluid.divergence(found.u)[fine.grid.owned]).max() < 1e-11
        errors.append(largest(fine.grid, found.u, exact(fine.grid)[0]))
    assert math.log2(errors[0] / errors[1]) > 1.8
    assert math.log2(errors[1] / errors[2]) > 1.8


@pytest.mark.parametrize("kind", [block_model, lambda *a, **k: heavy(block_model(*a, **k))])
def test_the_same_grid_and_mesh_give_the_same_state(kind, comm):
    coarse, fine = kind(SELF, lid=3.0), kind(comm, lid=3.0)
    state = fsi.initial_state(coarse, DT)
    for _ in range(20):
        state = fsi.step(coarse, state, DT)
    state = replace(state, circuits=np.array([7.0]))
    found = regridded(coarse, state, fine, DT)
    np.testing.assert_array_equal(found.circuits, [7.0])
    speed = max(np.abs(c).max() for c in state.u)
    whole = {d: np.array(state.u[d][coarse.grid.owned_faces(d)]) for d in range(2)}
    start = fine.grid.start

    def place(here):
        return tuple(
            slice(start[a], start[a] + s.stop - s.start) if a < 2 else slice(None) for a, s in enumerate(here)
        )

    p = np.array(state.p[coarse.grid.owned])[place(fine.grid.owned)]
    np.testing.assert_allclose(found.p[fine.grid.owned], p, atol=1e-12 * np.abs(state.p).max())
    for d, component in enumerate(found.u):
        here = fine.grid.owned_faces(d)
        there = place(here)
        np.testing.assert_allclose(component[here], whole[d][there], atol=1e-12 * speed)
    ids = {int(k): x for k, x in zip(coarse.bodies[0].ids, state.bodies[0]["chi"], strict=True)}
    expected = np.array([ids[int(k)] for k in fine.bodies[0].ids]).reshape(-1, 3)
    assert np.abs(expected - fine.bodies[0].X).max(initial=0.02) > 0.01, "it has moved"
    np.testing.assert_allclose(found.bodies[0]["chi"], expected, atol=1e-12)
    assert set(found.bodies[0]) == set(state.bodies[0])
    if "V" in found.bodies[0]:  # its mass goes on with the fluid
        U = fine.bodies[0].coupling.at(found.bodies[0]["chi"]).interpolate(found.u)
        np.testing.assert_allclose(found.bodies[0]["V"], U, atol=1e-12 * speed)
        assert np.abs(U).max(initial=1.0) > 1e-3 * speed


def test_a_displacement_is_that_of_the_cell_beside_a_point():
    def sheet(elements, cell):
        mesh = rectangle(SELF, lower=(0.0, 0.0), size=(2.0, 1.0), elements=elements, cell=cell)
        return Structure(mesh, NeoHookean(c1=1.0), name="sheet")

    coarse, fine = sheet((6, 3), "quadrilateral"), sheet((9, 7), "triangle")
    linear = np.array([[0.1, -0.3, 0.0], [0.2, 0.4, 0.0], [0.0, 0.0, 0.0]])
    found = at_points(coarse, coarse.X @ linear + 0.5, fine.X)
    np.testing.assert_allclose(found[:, :2], (fine.X @ linear + 0.5)[:, :2], atol=1e-12)
    beside = fine.X + [0.02, 0.01, 0.0]
    np.testing.assert_allclose(
        at_points(coarse, coarse.X @ linear, beside)[:, :2], (beside @ linear)[:, :2], atol=1e-12
    )


def test_another_box_and_other_bodies_are_refused():
    coarse = vortices(16)
    state = fsi.initial_state(coarse, DT)
    grid = MacGrid([0, 0], [2, 1], [32, 16], [True, True], SELF)
    other = Model(grid=grid, fluid=NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.01))
    with pytest.raises(CaseError, match=r"start\.run: that run has another box"):
        regridded(coarse, state, other, DT)
    with pytest.raises(CaseError, match=r"start\.run: that run has the bodies , this one block"):
        regridded(coarse, state, block_model(SELF), DT)


def test_a_case_begins_from_another_run_and_is_resumed(shared_tmp, comm):
    coarse, fine, again = (shared_tmp / name for name in ("coarse", "fine", "again"))
    run_case(parse_case(RAW), out=coarse, comm=comm)
    changes = ["grid.cells=[24, 24]", "solid.block.mesh.elements=[6, 6]", "time.dt='1 ms'"]
    changes += [f"start.run='{coarse}'", "time.t_end='120 ms'"]
    asked = parse_case(RAW, changes)
    planned = {entry.quantity: entry.value for entry in plan_case(asked, comm)["plan"]}
    assert planned["steps"] == 40  # from 80 ms to 120 ms
    assert planned["expected time"] == pytest.approx(40 * planned["time of a step"])
    assert ", 40 steps of 1 ms\n" in first_line(asked, "fine")
    run_case(asked, out=fine, comm=comm)
    rows, before = read_history(fine / "history.csv"), read_history(coarse / "history.csv")
    assert [rows["t_s"][0], rows["t_s"][-1]] == pytest.approx([0.08, 0.12])
    assert rows["kinetic_energy_erg"][0] == pytest.approx(before["kinetic_energy_erg"][-1], rel=0.05)
    other = [f"start.run='{coarse}'", "time.t_end='120 ms'", "solid.block.mesh.size=[0.3, 0.25]"]
    with pytest.raises(CaseError, match=r"solid\.block\.mesh\.size = .*another unloaded shape"):
        run_case(parse_case(RAW, other), out=shared_tmp / "other", comm=comm)
    short = [*changes[:-1], "time.t_end='100 ms'"]
    run_case(parse_case(RAW, short), out=again, comm=comm)
    comm.barrier()
    if comm.rank == 0:  # a run that goes on needs the other one no more
        shutil.rmtree(coarse)
    comm.barrier()
    run_case(parse_case(RAW, changes), out=again, comm=comm, resume=True)
    np.testing.assert_allclose(
        read_history(again / "history.csv")["kinetic_energy_erg"][-1],
        rows["kinetic_energy_erg"][-1],
        rtol=1e-12,
    )
    for out in (fine, again) if comm.rank == 0 else ():
        assert json.loads((out / "summary.json").read_text())["start"]["t_s"] == pytest.approx(0.08)


def test_what_is_no_run_to_begin_from_is_refused(shared_tmp, comm):
    out = shared_tmp / "run"
    for folder, message in (
        ("nowhere", "no such folder of a run"),
        (shared_tmp, "holds no case.toml of a run"),
    ):
        asked = parse_case(RAW, [f"start.run='{folder}'"])
        with pytest.raises(CaseError, match=message) as error:
            run_case(asked, out=out, comm=comm)
        assert error.value.key == "start.run"
        with pytest.raises(CaseError, match=message):
            plan_case(asked, comm)
    run_case(parse_case(RAW), out=out, comm=comm)
    itself = parse_case(RAW, [f"start.run='{out}'", "time.t_end='90 ms'"])
    with pytest.raises(CaseError, match="cannot begin from itself"):
        run_case(itself, out=out, comm=comm, overwrite=True)
    over = parse_case(RAW, [f"start.run='{out}'", "time.t_end='40 ms'"])
    with pytest.raises(CaseError, match="after this end"):
        run_case(over, out=shared_tmp / "short", comm=comm)
    with pytest.raises(CaseError, match="after this end"):
        plan_case(over, comm)


def test_forty_steps_from_a_taken_over_state_follow_the_run_it_is_of(shared_tmp, comm):
    """On the same grid nothing but the history of the advection term is new."""
    one = simulation(shared_tmp / "one", steps=30, model=block_model(comm, lid=3.0)).run().state
    coarse, fine = block_model(SELF, lid=3.0), block_model(comm, lid=3.0)
    state = fsi.initial_state(coarse, DT)
    for _ in range(20):
        state = fsi.step(coarse, state, DT)
    taken = regridded(coarse, state, fine, DT)
    for _ in range(10):
        taken = fsi.step(fine, taken, DT)
    assert taken.t == pytest.approx(one.t)
    moved = one.bodies[0]["chi"] - fine.bodies[0].X
    np.testing.assert_allclose(
        taken.bodies[0]["chi"], one.bodies[0]["chi"], atol=2e-3 * np.abs(moved).max(initial=1e-3)
    )


@pytest.mark.parametrize(
    ("key", "value"),
    [("gap", "0.5 mm"), ("nose", "0.5 mm"), ("diameter", "23 mm"), ("thickness", "0.5 mm"), ("base", "1 mm")],
)
def test_leaflets_of_another_unloaded_shape_do_not_go_on(key, value):
    there = load_case(DEMO)
    here = load_case(DEMO, [f"solid.leaflets.mesh.valve.{key}='{value}'"])
    with pytest.raises(
        CaseError,
        match=rf"solid\.leaflets\.mesh\.valve\.{key} = .*another unloaded shape.* this was .* there",
    ):
        check_shapes(there, here)


def test_other_elements_and_lengths_that_are_the_type_s_own_are_no_other_shape():
    there = load_case(DEMO)
    mesh = "solid.leaflets.mesh.valve"
    more = [f"{mesh}.ratio=0.5", f"{mesh}.layers=2", f"{mesh}.thickness='0.4 mm'"]
    check_shapes(there, load_case(DEMO, [*more, "solid.leaflets.material.c10='1 kPa'"]))
