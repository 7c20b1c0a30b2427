"""Thick shells, the HGO strip and the cardiac problems: closed forms, orders, second-hand ranges."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from tests.solid.pointwise import Pointwise
from valvefsi.benchmarks import references
from valvefsi.benchmarks.options import defaults
from valvefsi.benchmarks.statics import hgo_strip, land, thick_shells
from valvefsi.benchmarks.statics.study import Mesh
from valvefsi.errors import CaseError
from valvefsi.geometry.benchmark_shapes import truncated_ellipsoid
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.cardiac import Contracting, Guccione, ellipsoid_fibres
from valvefsi.solid.stress import Stress, stress_of_solution

SHELL = defaults(thick_shells.PARAMETERS)
STRIP = defaults(hgo_strip.PARAMETERS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return Path(MPI.COMM_WORLD.bcast(str(tmp_path_factory.mktemp("shells")), root=0))


@pytest.mark.parametrize("shape", ["cylinder", "sphere"])
def test_the_closed_form_balances_the_radial_stress(shape):
    """The pressure by quadrature of (s_hoop - s_r)/r, from the stretches alone."""
    n, (A, B) = thick_shells.DIM[shape], (SHELL["inner"], SHELL["outer"])
    inner, outer = thick_shells.closed_form(shape, SHELL)
    R = np.linspace(A, B, 20001)
    r = (R**n + (A + inner) ** n - A**n) ** (1 / n)
    hoop, radial = r / R, (R / r) ** (n - 1)
    integrand = (n - 1) * SHELL["c1"] * (hoop**2 - radial**2) / r * radial  # dr = radial stretch dR
    assert np.trapezoid(integrand, R) == pytest.approx(SHELL["pressure"], rel=1e-7)
    assert r[-1] - B == pytest.approx(outer, rel=1e-12)


@pytest.mark.parametrize(("cell", "order"), [("triangle", 2.5), ("quadrilateral", 3.5)])
def test_the_thick_cylinder_converges_to_its_closed_form(folder, cell, order):
    result = thick_shells.ThickCylinder(cell=cell, refine=2).run(out=folder / cell)
    found = result["quantities"][cell]
    expected = thick_shells.closed_form("cylinder", SHELL)
    for name, value in zip(("u_r_inner_cm", "u_r_outer_cm"), expected, strict=True):
        assert found[name] == pytest.approx(value, rel=1e-5)
        assert found[f"{name}_order"] > order


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_the_thick_sphere_comes_closer_to_its_closed_form(folder, cell):
    result = thick_shells.ThickSphere(cell=cell, refine=1).run(out=folder / cell)
    expected = thick_shells.closed_form("sphere", SHELL)[0]
    errors = [abs(level["values"]["u_r_inner_cm"] / expected - 1) for level in result["levels"]]
    assert errors[1] < 0.005
    assert errors[1] < errors[0] / 4


def test_the_stress_of_the_thick_cylinder_is_that_of_the_closed_form(comm):
    solution, material = thick_shells.solution_of(
        "cylinder", SHELL, Mesh(cell="quadrilateral", elements=6), comm
    )
    sigma = stress_of_solution(solution, material).at_nodes("cauchy")["cauchy"]
    rest = [0.0] * 9
    a, b = (
        SHELL[k] + u
        for k, u in zip(("inner", "outer"), thick_shells.closed_form("cylinder", SHELL), strict=True)
    )
    at_inner = statics.evaluate_at(sigma, (SHELL["inner"], 0.0))
    at_outer = statics.evaluate_at(sigma, (SHELL["outer"], 0.0))
    assert len(at_inner) == len(rest)
    assert at_inner[0] == pytest.approx(-SHELL["pressure"], rel=0.02)
    assert abs(at_outer[0]) < 0.02 * SHELL["pressure"]
    for values, r, R in ((at_inner, a, SHELL["inner"]), (at_outer, b, SHELL["outer"])):
        hoop = SHELL["c1"] * ((r / R) ** 2 - (R / r) ** 2)
        assert values[4] - values[0] == pytest.approx(hoop, rel=0.01)


def test_a_pressure_that_no_shell_bears_is_one_clear_error():
    with pytest.raises(CaseError, match="collapses below") as caught:
        thick_shells.ThickShells(overrides=["pressure=1e5"])
    assert "\n" not in str(caught.value)
    limit = SHELL["c1"] * math.log(SHELL["outer"] / SHELL["inner"])
    growth, _ = thick_shells.closed_form("cylinder", {**SHELL, "pressure": 0.98 * limit})
    assert growth > 1.0


def test_the_fitting_formula_is_the_derivative_of_the_energy():
    """S of an incompressible sheet from dW/d(stretch) of the compiled material: lambda S = dW/d lambda."""
    material = Pointwise(hgo_strip.material_of(STRIP), fibres={"fibre": (1.0, 0.0, 0.0)})

    def W(one, two):
        return material(np.diag([one, two, 1 / (one * two)]))[0]

    one, two, step = 1.08, 1.15, 1e-6
    S = hgo_strip.sheet_stress(STRIP, (one, two))
    assert one * S[0] == pytest.approx((W(one + step, two) - W(one - step, two)) / (2 * step), rel=1e-6)
    assert two * S[1] == pytest.approx((W(one, two + step) - W(one, two - step)) / (2 * step), rel=1e-6)


@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_a_flat_hgo_strip_is_stretched_as_the_formulas_say(folder, cell):
    result = hgo_strip.Flat(cell=cell).run(out=folder / f"flat_{cell}")
    found = result["quantities"][cell]
    assert found["stretch_1"] == pytest.approx(STRIP["stretch_1"], rel=1e-7)
    assert found["stretch_2"] == pytest.approx(STRIP["stretch_2"], rel=1e-7)
    assert found["thickness_mm"] == pytest.approx(1 / (STRIP["stretch_1"] * STRIP["stretch_2"]), rel=1e-7)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_an_inflated_hgo_ring_converges_to_the_quadrature(folder, cell):
    result = hgo_strip.Ring(cell=cell, refine=1).run(out=folder / f"ring_{cell}")
    expected = hgo_strip.ring_growth(STRIP)
    errors = [abs(level["values"]["u_r_inner_cm"] / expected - 1) for level in result["levels"]]
    assert errors[1] < 5e-4
    assert errors[1] < errors[0] / 3


def test_guccione_is_stress_free_at_rest_and_stiffest_along_its_fibres():
    material = Guccione(C=2e4, bf=8.0, bt=2.0, bfs=4.0, fibre=(1.0, 0.0, 0.0))
    at = Pointwise(material)
    W, P = at(np.eye(3))
    assert pytest.approx(0.0, abs=1e-12) == W
    np.testing.assert_allclose(P, 0.0, atol=1e-9)
    E = 0.1 * np.random.default_rng(2).uniform(-1, 1, (3, 3))
    E = (E + E.T) / 2
    Q = 8 * E[0, 0] ** 2 + 2 * (E[1, 1] ** 2 + E[2, 2] ** 2 + 2 * E[1, 2] ** 2)
    Q += 4 * 2 * (E[0, 1] ** 2 + E[0, 2] ** 2)
    values, vectors = np.linalg.eigh(2 * E + np.eye(3))
    F = vectors @ np.diag(np.sqrt(values)) @ vectors.T
    assert at(F)[0] == pytest.approx(1e4 * (math.exp(Q) - 1), rel=1e-10)


def test_the_active_tension_adds_to_the_stress_along_the_fibre(comm):
    mesh = box(comm, elements=(1, 1, 2))
    mesh = mesh.with_fibres(f=fibres.constant(mesh, (0.6, 0.8, 0.0)))
    material = Contracting(mesh, Guccione(C=2e4, bf=8.0, bt=2.0, bfs=4.0, fibre="f"), 5e4, "f")
    assert np.all(material.follow(np.zeros((4, 3)), 0.5) == 0)
    formulation = statics.NearlyIncompressible(degree=1)
    sides = [statics.Fixed(on=("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper"))]
    at_rest = statics.solve(mesh, material.passive, fixed=sides, formulation=formulation)
    stress = Stress(at_rest.displacement, material, fibres=mesh.fibres)
    found = stress.at_points("pk2")["pk2"]
    expected = 2.5e4 * np.outer([0.6, 0.8, 0.0], [0.6, 0.8, 0.0])
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), rtol=1e-9, atol=1e-6)


def test_the_fibres_of_the_ellipsoid_turn_through_the_wall_and_lie_in_it(comm):
    mesh = truncated_ellipsoid(comm, elements=(2, 6))
    make = ellipsoid_fibres(land.SHORT, land.LONG, (90.0, -90.0))
    field = fibres.from_function(mesh, make, degree=2)
    assert field.function_space.dofmap.index_map.size_global > 0
    inside, outside = np.array([[0.7, 0.0, 0.0]]), np.array([[0.0, -1.0, 0.0]])
    np.testing.assert_allclose(make(inside), [[0.0, 0.0, 1.0]], atol=1e-9)
    np.testing.assert_allclose(make(outside), [[0.0, 0.0, -1.0]], atol=1e-9)
    np.testing.assert_allclose(make(np.array([[0.85, 0.0, 0.0]])), [[0.0, 1.0, 0.0]], atol=1e-9)


def test_the_beam_of_the_cardiac_benchmark_ends_in_the_quoted_range(folder):
    quoted = references.read("land2015_beam").value("z_tip_mm", what="quoted")
    result = land.Beam(cell="hexahedron").run(out=folder / "beam")
    assert result["quantities"]["hexahedron"]["z_tip_mm"] == pytest.approx(quoted, rel=0.01)


@pytest.mark.slow
def test_the_inflated_ellipsoid_gives_the_same_on_both_kinds_of_cell(folder):
    result = land.Land(cell="both", elements=1, refine=1, problem=(2,)).run(out=folder / "inflation")
    found = result["quantities"]["land-2-inflation"]
    values = [found[cell]["z_apex_endo_mm"] for cell in ("tetrahedron", "hexahedron")]
    assert values[0] == pytest.approx(values[1], rel=2e-3)
