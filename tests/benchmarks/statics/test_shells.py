"""Thin shells that turn far: the elastica, Newton's method, forces on nodes, the table."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.benchmarks.frame import Job
from valvefsi.benchmarks.statics.shells import Cantilever, Hemisphere, Shells
from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, PointLoad
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.statics import Fixed, NearlyIncompressible
from valvefsi.verification.closed_forms import elastica

WORLD = MPI.COMM_WORLD


def test_the_elastica_under_a_small_force_is_the_beam_of_linear_theory():
    back, down = elastica(1e-3, 10.0, 100.0)
    assert down == pytest.approx(1e-3 * 10**3 / 300, rel=1e-6)
    slope = np.linspace(0, 10, 2001)
    angle = 1e-3 * (10 * slope - slope**2 / 2) / 100
    assert back == pytest.approx(np.trapezoid(angle**2 / 2, slope), rel=1e-4)


def test_the_elastica_has_the_length_and_height_of_its_first_integral():
    """B theta'^2/2 + P sin(theta) is the same all along: quadrature over the angle, no initial value problem."""
    force, stiffness = 4.0, 100.0
    ends = np.linspace(0.5, 1.4, 901)
    lengths, heights = np.transpose([_by_quadrature(end, force, stiffness) for end in ends])
    back, down = elastica(force, 10.0, stiffness)
    assert down == pytest.approx(np.interp(10.0, lengths, heights), rel=1e-5)
    end = np.interp(10.0, lengths, ends)
    x = math.sqrt(2 * stiffness * math.sin(end) / force)  # P x = B theta' at the clamp
    assert 10.0 - back == pytest.approx(x, rel=1e-5)


def _by_quadrature(end, force, stiffness):
    """Length and height of an elastica whose end has an angle; sin(theta) = sin(end) (1 - t^2)."""
    t = (np.arange(2000) + 0.5) / 2000
    sine = math.sin(end) * (1 - t**2)
    ds = np.sqrt(2 * math.sin(end) * stiffness / force / (1 - sine**2))
    return ds.mean(), (sine * ds).mean()


def test_a_cantilever_turned_by_its_end_force_follows_the_elastica():
    """Eight elements, thickness a hundredth of the length; the elastica has neither shear nor stretch."""
    (mesh, *_) = Cantilever(refine=0).runs()
    found = Cantilever(refine=0).one(mesh, Job(folder=None, comm=WORLD))["values"]
    known = elastica(4.0, 10.0, 1.2e6 * 1e-3 / 12)
    assert found["shortening"] == pytest.approx(known[0], rel=5e-3)
    assert found["deflection"] == pytest.approx(known[1], rel=5e-3)


def test_newtons_method_takes_a_thin_strip_to_its_full_load_in_few_steps():
    """A first residual 1e4 times the load's is that of the nodes of elements that turned, and no failure."""
    shell = Cantilever(refine=0)
    mesh = box(WORLD, lower=(0.0, 0.0, -0.05), size=shell.size, elements=(8, 1, 1))
    setting = shell.setting()
    solution = statics.solve(
        mesh,
        shell.material,
        fixed=setting.fixed,
        loads=setting.loads,
        formulation=statics.SolidShell(),
        options=statics.SolverOptions(first_increment=0.5),
    )
    assert all(step.converged for step in solution.load_steps)
    assert sum(step.iterations for step in solution.load_steps) <= 15


@pytest.mark.slow
def test_all_shells_are_within_a_hundredth_of_the_table():
    """Five minutes."""
    quantities = Shells(refine=2)
    for part, member in quantities.members().items():
        finest = member.runs()[-1]
        found = member.one(finest, Job(folder=None, comm=WORLD))["values"]
        for name, references in member.references(WORLD).items():
            assert found[name] == pytest.approx(references[0].value, rel=0.01), (part, name)


@pytest.mark.parametrize("formulation", [NearlyIncompressible(degree=1), statics.TaylorHood()])
def test_forces_on_the_ends_of_a_side_are_a_traction_on_it(formulation):
    """Of linear elements the same for a whole side of two nodes; mixed ones have a node between them."""
    mesh = rectangle(WORLD, size=(2.0, 1.0), elements=(3, 1))
    ends = ((2.0, 0.0), (2.0, 1.0))
    shares = [(ends, 1.0)] if formulation.degrees == (1,) else [(ends, 1 / 3), (((2.0, 0.5),), 2 / 3)]
    force = np.array([0.02, 0.05])
    solved = []
    for loads in (
        [DeadLoad(on=("x_upper",), traction=tuple(force))],
        [PointLoad(at=at, force=tuple(share * force)) for at, share in shares],
    ):
        solution = statics.solve(
            mesh, NeoHookean(c1=3.0), fixed=[Fixed(on=("x_lower",))], loads=loads, formulation=formulation
        )
        solved.append(solution.displacement_at((2.0, 0.5)))
    np.testing.assert_allclose(solved[1], solved[0], rtol=1e-7)


def test_a_force_where_no_node_is_is_refused():
    mesh = rectangle(WORLD, elements=(2, 2))
    load = PointLoad(at=((0.3, 0.3),), force=(1.0, 0.0))
    held = [Fixed(on=("x_lower",))]
    with pytest.raises(CaseError, match="one node where a force acts"):
        statics.solve(mesh, NeoHookean(c1=1.0), fixed=held, loads=[load])
    with pytest.raises(CaseError, match="2 or 3 finite components"):
        PointLoad(at=(), force=(1.0, 0.0))
    options = statics.SolverOptions(solver="fieldsplit")
    with pytest.raises(CaseError, match="need the direct solver"):
        statics.solve(mesh, NeoHookean(c1=1.0), fixed=held, loads=[load], options=options)


def test_the_forces_of_a_hemisphere_balance():
    forces = [load.force for load in Hemisphere().setting().loads]
    assert forces == [(200.0, 0.0, 0.0), (0.0, -200.0, 0.0)]
