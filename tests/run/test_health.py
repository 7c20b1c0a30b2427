"""What a run warns of: points of a solid that have moved too far apart, so that fluid leaks between them."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import block_model, coupled, moved, simulation, slipping
from valvefsi import fsi
from valvefsi.benchmarks.immersed.cavity_solids import DiskInCavity
from valvefsi.bodies.elastic_plan import LONGEST_GAP
from valvefsi.bodies.slip import DarcySlip, UnresolvedSlip
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.run.health import Health
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["quadrilateral", "triangle", "hexahedron", "tetrahedron"])
def test_the_largest_gap_is_that_of_the_stretched_edges(kind, degree):
    dim = 2 if kind in ("quadrilateral", "triangle") else 3
    shape, size = (rectangle, (4, 3)) if dim == 2 else (box, (3, 2, 2))
    lengths = np.array([0.8, 0.6, 0.6])[:dim]
    mesh = shape(MPI.COMM_WORLD, lower=(0.5,) * dim, size=tuple(lengths), elements=size, cell=kind)
    solid = Structure(mesh, NeoHookean(c1=1.0), discretisation=Discretisation(degree=degree))
    stretch = np.array([5.0, 1.0, 1.0])
    cell = (lengths / size) * stretch[:dim]
    diagonal = kind in ("triangle", "tetrahedron")  # of the cell that was cut into simplices
    expected = np.linalg.norm(cell) if diagonal else cell.max()
    assert solid.longest_gap(solid.X * stretch) == pytest.approx(expected / degree, rel=1e-9)


def stretched(model, factor):
    state = fsi.initial_state(model, 0.01)
    return replace(moved(state, chi=state.bodies[0]["chi"] * np.array([factor, 1.0, 1.0])), t=0.3)


def test_a_stretched_solid_is_warned_of_once_with_ratio_and_remedy(comm):
    model = block_model(cells=16)
    health = Health(model)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        for factor in (1.0, 1.3, 1.6, 1.4):
            health.look(stretched(model, factor))
    assert len(heard) == (1 if comm.rank == 0 else 0)
    (found,) = health.report()
    assert found["text"] == (
        "fluid may leak through block: neighbouring points are 1.300 h apart at t = 0.3 s, at most 1.25 h is safe; "
        'refine the mesh or take coupling = "elemental"'
    )
    assert found["solid"] == "block"
    assert found["largest_gap_per_h"] == pytest.approx(1.6)


@pytest.mark.parametrize(("law", "elemental"), [(DarcySlip, True), (UnresolvedSlip, False)])
def test_a_law_of_slip_that_is_for_nodes_alone_is_not_sent_to_elements(law, elemental):
    health = Health(slipping(block_model(cells=16), 1e-4, law))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        health.look(stretched(slipping(block_model(cells=16), 1e-4, law), 1.6))
    assert ("elemental" in health.report()[0]["text"]) == elemental


def test_points_that_follow_the_elements_are_not_warned_of():
    model = block_model(cells=16)
    solid = model.bodies[0].solid
    for gap, warned in ((0.5, 0), (1.5, 1)):
        coupling = ElementalCoupling(model.grid, "bspline3", ElementPoints(solid), gap)
        health = Health(coupled(model, coupling))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            health.look(stretched(model, 1.6))
        assert len(health.report()) == warned
        assert all("lower point_gap" in found["text"] for found in health.report())


@pytest.mark.filterwarnings("ignore:fluid leaks")
def test_a_run_keeps_its_warnings_with_its_timing(shared_tmp):
    sim = simulation(shared_tmp, model=block_model(cells=24), steps=5)
    timing = sim.run().timing(sim.model.grid)
    (found,) = timing["warnings"]
    assert found["solid"] == "block"
    assert found["t_s"] == 0.0
    assert found["largest_gap_per_h"] >= 1.5


def area_change(ratio, coupling, t_end=2.5):
    """Relative change of area of the disk in the cavity, and the largest gap of its points over h."""
    model = DiskInCavity(grid=24, ratio=ratio, coupling=coupling).model(24, MPI.COMM_WORLD)
    solid, dt = model.bodies[0].solid, 1.0 / 8.0 / 24
    state = fsi.initial_state(model, dt)
    for _ in range(round(t_end / dt)):
        state = fsi.step(model, state, dt)
    gap = model.bodies[0].gap(state.bodies[0]) / model.grid.spacing[0]
    return solid.volume(state.bodies[0]["chi"]) / solid.reference_volume - 1.0, gap


def test_a_disk_leaks_where_its_nodes_are_drawn_apart_and_not_with_a_finer_mesh_or_points_that_follow():
    coarse, gap = area_change(1.5, "nodal")
    tight, followed = area_change(1.5, "elemental")
    assert gap > 2.0 * LONGEST_GAP
    assert followed < LONGEST_GAP
    assert coarse > 0.02
    assert abs(tight) < 0.1 * coarse
    fine, gap = area_change(0.4, "nodal")
    assert gap < 1.1 * LONGEST_GAP
    assert abs(fine) < 0.01 * coarse
