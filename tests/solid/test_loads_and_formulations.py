"""Statics beyond dead loads: follower pressure, tethers, symmetry, rotations; the other formulations and solver."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.ordering import assert_order
from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, compressed_block, rectangle
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad, Pressure, Tether
from valvefsi.solid.materials import HGO, MayNewmanYin, NeoHookean
from valvefsi.solid.materials.fibre_reinforced import FibreFamily
from valvefsi.solid.statics import EqualOrder, Fixed, NearlyIncompressible, SolverOptions, Symmetry

MATERIAL = NeoHookean(c1=80.194)
SUPPORTS = [
    Fixed(on=("bottom",), components=("y",)),
    Fixed(on=("top_loaded", "top_outer"), components=("x",)),
]
LOAD = DeadLoad(on=("top_loaded",), traction=(0.0, -200.0))
TOP = (20.0, 25.0)


def sector(comm, n, angle):
    """A thick ring's sector, radii 1 to 2 and polar angles 0 to ``angle``: a rectangle bent over."""
    mesh = rectangle(comm, lower=(1.0, 0.0), size=(1.0, angle), elements=(n, 2 * n))
    x = mesh.mesh.geometry.x
    r, theta = x[:, 0].copy(), x[:, 1].copy()
    x[:, 0], x[:, 1] = r * np.cos(theta), r * np.sin(theta)
    return mesh


def ring_pressure(mu, inner):
    """Pressure that opens an incompressible neo-Hookean ring 1..2 to the inner radius, int mu (l^2 - l^-2) dr/r."""
    R, weight = np.polynomial.legendre.leggauss(40)
    R = 1.5 + R / 2
    r2 = R**2 + inner**2 - 1
    return float(np.sum(weight / 2 * mu * (r2 / R**2 - R**2 / r2) * R / r2))


@pytest.mark.parametrize(("angle", "floor"), [(math.pi / 2, 1e-12), (math.pi / 3, 3e-4)])
def test_a_ring_under_follower_pressure_opens_as_the_closed_form_says(comm, angle, floor):
    mu, inner = 50.0, 1.5
    load = Pressure(on=("x_lower",), value=ring_pressure(mu, inner))

    def error(n):
        planes = [Symmetry(on=("y_lower",)), Symmetry(on=("y_upper",))]
        solution = statics.solve(sector(comm, n, angle), NeoHookean(c1=mu), fixed=planes, loads=[load])
        u = solution.displacement_at([(1.0, 0.0), (2.0, 0.0)])
        np.testing.assert_allclose(u[:, 1], 0.0, atol=1e-11)
        expected = [inner - 1, math.sqrt(4 + inner**2 - 1) - 2]
        return max(np.abs(u[:, 0] - expected).max() - floor, 1e-8)

    assert_order(error, (2, 4, 8), order=1.8, below=3e-3)


def test_an_even_pressure_all_around_only_raises_the_pressure(comm):
    mesh = box(comm, elements=(2, 2, 2), cell="tetrahedron")
    sides = ("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper")
    load = Pressure(on=sides, value=1000.0)
    planes = [Symmetry(on=(f"{axis}_lower",)) for axis in "xyz"]
    solution = statics.solve(mesh, MATERIAL, fixed=planes, loads=[load])
    # The solver stops at 1e-9 of the residual, a strain of 1e-9 p/mu.
    assert np.abs(solution.displacement.x.array).max() < 1e-9 * 1000.0 / 80.194
    np.testing.assert_allclose(solution.pressure.x.array, 1000.0, rtol=1e-9)


def test_a_follower_pressure_turns_with_the_body_and_a_dead_load_does_not(comm):
    mesh = rectangle(comm, size=(1.0, 1.0), elements=(2, 2))
    turned = Fixed(on=("x_lower",), value=statics.rotation(math.pi / 2))
    soft = NeoHookean(c1=1000.0)

    def length(load):
        u = statics.solve(mesh, soft, fixed=[turned], loads=[load]).displacement_at((1.0, 0.5))
        return np.array([1.0, 0.5]) + u

    # After a quarter turn the side x = 1 looks upwards: a suction lengthens the body, a dead pull along x shears it.
    followed = length(Pressure(on=("x_upper",), value=-100.0))
    dead = length(DeadLoad(on=("x_upper",), traction=(100.0, 0.0)))
    assert followed[1] > 1.02
    assert abs(followed[0] + 0.5) < 0.01
    assert dead[0] > -0.45


def test_a_rotation_of_more_than_half_a_turn_leaves_the_body_without_stress(comm):
    mesh = box(comm, size=(1, 1, 1), elements=(2, 1, 1))
    turn = statics.rotation(1.5 * math.pi, axis=(1.0, 1.0, 0.0), through=(0.5, 0.5, 0.5))
    solution = statics.solve(mesh, MATERIAL, fixed=[Fixed(on=("x_lower", "x_upper"), value=turn)])
    X = np.array([[0.5, 1.0, 0.0], [0.5, 0.0, 1.0]])
    np.testing.assert_allclose(solution.displacement_at(X), turn(X, 1.0), atol=1e-7)
    assert np.abs(solution.pressure.x.array).max(initial=0.0) < 1e-4
    with pytest.raises(CaseError, match="rotation"):
        statics.rotation(1.0, axis=(0, 0, 0))


@pytest.mark.parametrize(
    ("on", "measure"), [(("y_lower",), 1.0), (None, 0.5), (("body",), 0.5)], ids=["facets", "body", "cells"]
)
def test_a_tethered_body_gives_way_by_load_over_stiffness(comm, on, measure):
    mesh = rectangle(comm, size=(1.0, 0.5), elements=(4, 2), cell="triangle")
    sides = Fixed(on=("x_lower", "x_upper"), components=("x",))
    load = DeadLoad(on=("y_upper",), traction=(0.0, -30.0))
    tether = Tether(on=on, components=("y",), stiffness=600.0)
    solution = statics.solve(mesh, MATERIAL, fixed=[sides], loads=[load], tethers=[tether])
    u = solution.displacement_at([(0.2, 0.0), (0.7, 0.3)])
    np.testing.assert_allclose(u[:, 1], -30.0 / (600.0 * measure), rtol=1e-8)


def test_the_displacement_form_has_the_closed_form_of_uniaxial_strain(comm):
    mesh = rectangle(comm, size=(1.0, 1.0), elements=(2, 2))
    stretch, kappa = 1.2, 300.0
    squeeze = [
        Fixed(on=("x_lower", "x_upper"), components=("x",)),
        Fixed(on=("y_lower",), components=("y",)),
        Fixed(on=("y_upper",), components=("y",), value=lambda X, s: s * (stretch - 1) * np.ones_like(X)),
    ]
    for degree in (1, 2):
        form = NearlyIncompressible(degree=degree, kappa=kappa)
        solution = statics.solve(mesh, MATERIAL, fixed=squeeze, formulation=form)
        np.testing.assert_allclose(
            solution.displacement_at((0.3, 0.6)), [0.0, 0.6 * (stretch - 1)], atol=1e-9
        )
        np.testing.assert_allclose(solution.pressure.x.array, -kappa * math.log(stretch) / stretch, rtol=1e-8)


def compress(comm, elements=(16, 8), **options):
    mesh = compressed_block(comm, elements=elements, cell=options.pop("cell", "quadrilateral"))
    return statics.solve(mesh, MATERIAL, fixed=SUPPORTS, loads=[LOAD], **options)


@pytest.mark.parametrize("volumetric", ["log", "quadratic", "simo_taylor"])
def test_the_displacement_form_tends_to_the_incompressible_answer(comm, volumetric):
    mu, inner = 50.0, 1.5
    load = Pressure(on=("x_lower",), value=ring_pressure(mu, inner))
    planes = [Symmetry(on=("y_lower",)), Symmetry(on=("y_upper",))]
    mesh = sector(comm, 8, math.pi / 2)

    def difference(kappa):
        form = NearlyIncompressible(kappa=kappa, volumetric=volumetric)
        solution = statics.solve(mesh, NeoHookean(c1=mu), fixed=planes, loads=[load], formulation=form)
        return solution.displacement_at((1.0, 0.0))[0] - (inner - 1)

    soft, stiff, stiffer = (difference(mu * ratio) for ratio in (10, 100, 200))
    assert soft > 0.02
    assert 0 < stiff < 0.005
    assert stiff / stiffer == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_the_stabilised_equal_order_form_converges_to_the_reference(comm, cell):
    def error(n):
        solution = compress(comm, (n, n // 2), cell=cell, formulation=EqualOrder())
        return abs(solution.displacement_at(TOP)[1] + 3.9212)

    assert_order(error, (16, 32, 64), order=1.0, below=0.06)


def test_the_equal_order_pressure_does_not_oscillate(comm):
    pressure = compress(comm, (32, 16), formulation=EqualOrder()).pressure
    taylor_hood = compress(comm, (16, 8)).pressure_at([(x, 20.0) for x in np.linspace(11, 29, 19)])
    from valvefsi.solid.statics import evaluate_at

    stabilised = evaluate_at(pressure, [(x, 20.0) for x in np.linspace(11, 29, 19)])
    assert np.abs(stabilised - taylor_hood).max() < 0.05 * np.abs(taylor_hood).max()


FIBRED = HGO(c10=30.0, c01=1.0, families=[FibreFamily(k1=50.0, k2=1.0, kappa=0.1, fibre=30.0)])


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@pytest.mark.parametrize("formulation", [statics.TaylorHood(), EqualOrder()], ids=lambda f: type(f).__name__)
def test_the_block_solver_gives_the_answer_of_the_direct_one(comm, cell, formulation):
    mesh = box(comm, elements=(2, 2, 2), cell=cell)
    problem = {
        "fixed": [Fixed(on=("x_lower",)), Symmetry(on=("y_lower",))],
        "loads": [Pressure(on=("z_upper",), value=8.0)],
        "formulation": formulation,
    }
    points = [(1.0, 1.0, 1.0), (0.5, 0.7, 0.3)]
    answers = [
        statics.solve(mesh, FIBRED, options=SolverOptions(solver=solver), **problem).displacement_at(points)
        for solver in ("direct", "fieldsplit")
    ]
    assert np.abs(answers[0]).max() > 0.05
    np.testing.assert_allclose(answers[0], answers[1], atol=1e-7)


def test_what_cannot_be_solved_is_refused(comm):
    mesh = compressed_block(comm, elements=(8, 4))
    flat = sector(comm, 2, 1.0)
    cases = [
        (
            {"options": SolverOptions(solver="fieldsplit"), "formulation": NearlyIncompressible()},
            "with a pressure",
        ),
        ({"loads": [Pressure(on=("block",), value=1.0)]}, "expected tags of facets"),
        ({"loads": [Tether(on=("bottom",), stiffness=1.0)]}, "expected DeadLoad, Pressure or PointLoad"),
    ]
    for options, message in cases:
        with pytest.raises(CaseError, match=message):
            statics.solve(mesh, MATERIAL, **{"fixed": SUPPORTS, **options})
    soft = MayNewmanYin(c0=5.0, c1=0.8, c2=3.0)
    for formulation in (EqualOrder(), NearlyIncompressible()):
        with pytest.raises(CaseError, match="no stiffness at F = I"):
            statics.solve(mesh, soft, fixed=SUPPORTS, formulation=formulation)
    with pytest.raises(CaseError, match="must be flat"):
        statics.solve(flat, MATERIAL, fixed=[Symmetry(on=("x_lower",))])
    with pytest.raises(CaseError, match="pressure = nan"):
        Pressure(on=("x_lower",), value=math.nan)
    with pytest.raises(CaseError, match="alpha"):
        EqualOrder(alpha=0.0)
    with pytest.raises(CaseError, match="solver = 'lu'"):
        SolverOptions(solver="lu")
