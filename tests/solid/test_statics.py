"""The incompressible reference solver: closed form, published set-ups, load steps, ranks."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem
from mpi4py import MPI

from tests.ordering import assert_order
from valvefsi.benchmarks import references
from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.geometry.shapes import box, compressed_block, rectangle
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import LeeSacks, MooneyRivlin, NeoHookean

MATERIAL = NeoHookean(c1=80.194)


def compress(comm, elements, cell="quadrilateral", **options):
    mesh = compressed_block(comm, elements=elements, cell=cell)
    return statics.solve(
        mesh,
        MATERIAL,
        fixed=[
            statics.Fixed(on=("bottom",), components=("y",)),
            statics.Fixed(on=("top_loaded", "top_outer"), components=("x",)),
        ],
        loads=[DeadLoad(on=("top_loaded",), traction=(0.0, -200.0))],
        options=statics.SolverOptions(**options),
    )


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_the_compressed_block_goes_down_by_the_reference_value(comm, cell):
    expected = references.read("compression_statics").column("u_y_top_centre_cm")[-1]
    solution = compress(comm, (32, 16), cell)
    u = solution.displacement_at((20.0, 25.0))
    assert u[1] == pytest.approx(expected, rel=5e-4)
    assert abs(u[0]) < 1e-12
    assert solution.volume_ratio() == pytest.approx(1.0, abs=1e-10)
    assert all(step.converged for step in solution.load_steps)
    top = solution.displacement_at([(x, 25.0) for x in (11.0, 14.0, 16.0, 19.0)])
    assert np.abs(top[:, 0]).max() < 1e-12
    mirrored = solution.displacement_at([(14.0, 20.0), (26.0, 20.0)])
    np.testing.assert_allclose(mirrored[0], mirrored[1] * [-1, 1], atol=1e-8)


class Bending:
    """Rivlin's bending of an incompressible block (-a..a) x (-b..b) into a sector, outer surface free.

    r^2 = 2 A X + B, angle = Y/A, so J = 1; the radial stress c1/2 (r^2/A^2 + A^2/r^2) + K is zero outside.
    """

    A, B, c1, outer = 2.0, 4.0, 50.0, 0.5

    def position(self, X):
        r = np.sqrt(2 * self.A * X[0] + self.B)
        return np.stack([r * np.cos(X[1] / self.A) - 2.0, r * np.sin(X[1] / self.A)])

    def radial_stress(self, r):
        return self.c1 / 2 * (r**2 / self.A**2 + self.A**2 / r**2)

    def pressure(self, X):
        r = np.sqrt(2 * self.A * X[0] + self.B)
        invariant = (self.A / r) ** 2 + (r / self.A) ** 2 + 1
        edge = np.sqrt(2 * self.A * self.outer + self.B)
        stress = self.radial_stress(r) - self.radial_stress(edge)
        return self.c1 * ((self.A / r) ** 2 - invariant / 3) - stress

    def solve(self, comm, n, cell):
        mesh = rectangle(comm, lower=(-0.5, -1.0), size=(1.0, 2.0), elements=(n, 2 * n), cell=cell)

        def value(X, s):
            u = np.zeros_like(X)
            u[:, :2] = s * (self.position(X.T).T - X[:, :2])
            return u

        fixed = [statics.Fixed(on=("x_lower", "y_lower", "y_upper"), value=value)]
        options = statics.SolverOptions(quadrature_degree=8, first_increment=0.5)
        return statics.solve(mesh, NeoHookean(c1=self.c1), fixed=fixed, options=options)


def l2_error(function, exact, size):
    """L2 norm of the difference to ``exact(x)``, interpolated into a space of higher degree."""
    mesh = function.function_space.mesh
    shape = (size,) if size > 1 else ()
    fine = fem.Function(fem.functionspace(mesh, ("Lagrange", 4, shape)))
    fine.interpolate(exact)
    form = compat.compile_form(ufl.inner(function - fine, function - fine) * ufl.dx(degree=8))
    return float(np.sqrt(mesh.comm.allreduce(fem.assemble_scalar(form))))


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
def test_bending_into_a_sector_converges_to_the_closed_form(comm, cell):
    bending = Bending()
    solved = {n: bending.solve(comm, n, cell) for n in (2, 4, 8)}

    def displacement(n):
        return l2_error(solved[n].displacement, lambda x: bending.position(x) - x[:2], 2)

    def pressure(n):
        return l2_error(solved[n].pressure, bending.pressure, 1)

    assert_order(displacement, (2, 4, 8), order=2.8, below=1e-4)
    assert_order(pressure, (2, 4, 8), order=1.8, below=0.2)


def test_torsion_of_a_column_raises_its_top(comm):
    mesh = box(comm, size=(1.0, 6.0, 1.0), elements=(2, 12, 2))

    def turn(X, s):
        c, d = np.cos(s * np.pi), np.sin(s * np.pi)
        x, z = X[:, 0] - 0.5, X[:, 2] - 0.5
        return np.stack([c * x + d * z - x, 0 * x, -d * x + c * z - z], axis=1)

    solution = statics.solve(
        mesh,
        MooneyRivlin(c1=9000.0, c2=9000.0),
        fixed=[
            statics.Fixed(on=("y_lower",)),
            statics.Fixed(on=("y_upper",), components=("x", "z"), value=turn),
        ],
    )
    u = solution.displacement_at((0.5, 6.0, 0.5))
    expected = references.read("torsion_statics").value("u_y_top_centre_cm", theta_over_pi="1.0")
    assert u[1] == pytest.approx(expected, rel=0.03)
    corner = solution.displacement_at((0.0, 6.0, 0.0))
    np.testing.assert_allclose(corner[[0, 2]], [1.0, 1.0], atol=1e-12)


def test_the_answer_does_not_depend_on_the_number_of_ranks(comm):
    points = [(20.0, 25.0), (13.0, 17.0), (27.0, 22.0)]
    shared, alone = compress(comm, (8, 4)), compress(MPI.COMM_SELF, (8, 4))
    np.testing.assert_allclose(shared.displacement_at(points), alone.displacement_at(points), atol=1e-10)
    np.testing.assert_allclose(shared.pressure_at(points), alone.pressure_at(points), atol=1e-8)


def test_load_steps_that_fail_are_cut_and_the_answer_stays(comm):
    direct = compress(comm, (8, 4))
    cut = compress(comm, (8, 4), first_increment=1.0, max_iterations=4)
    assert not cut.load_steps[0].converged
    assert cut.load_steps[-1].factor == 1.0
    u, v = (solution.displacement_at((20.0, 25.0)) for solution in (direct, cut))
    np.testing.assert_allclose(u, v, atol=1e-8)


def test_a_load_that_cannot_be_reached_is_a_convergence_error(comm):
    with pytest.raises(ConvergenceError, match="no equilibrium beyond"):
        compress(comm, (8, 4), max_iterations=1, smallest_increment=0.1)


def test_a_position_outside_the_body_is_refused(comm):
    solution = compress(comm, (8, 4))
    with pytest.raises(CaseError, match="outside the body"):
        solution.displacement_at((0.0, 0.0))


def test_bad_supports_and_options_are_refused(comm):
    mesh = compressed_block(comm, elements=(8, 4))
    for fixed, message in ((("block",), "tags of facets"), (("floor",), "no such tag")):
        with pytest.raises(CaseError, match=message):
            statics.solve(mesh, MATERIAL, fixed=[statics.Fixed(on=fixed)])
    with pytest.raises(CaseError, match="expected tags"):
        statics.Fixed(on=())
    with pytest.raises(CaseError, match="first_increment"):
        statics.SolverOptions(first_increment=2.0)


def test_the_path_meets_its_stops_and_each_is_the_equilibrium_of_its_load(comm):
    mesh, found = compressed_block(comm, elements=(8, 4)), {}

    def keep(factor, solution):
        found[factor] = solution.displacement_at((20.0, 25.0))[1]

    def press(load, **options):
        return statics.solve(
            mesh,
            MATERIAL,
            fixed=[
                statics.Fixed(on=("bottom",), components=("y",)),
                statics.Fixed(on=("top_loaded", "top_outer"), components=("x",)),
            ],
            loads=[DeadLoad(on=("top_loaded",), traction=(0.0, -load))],
            **options,
        )

    stops = statics.SolverOptions(stops=(0.3, 0.65, 1.0))
    last = press(200.0, options=stops, on_stop=keep)
    assert list(found) == [0.3, 0.65, 1.0]
    assert set(found) <= {step.factor for step in last.load_steps}
    assert found[1.0] == last.displacement_at((20.0, 25.0))[1]
    assert found[0.65] == pytest.approx(press(130.0).displacement_at((20.0, 25.0))[1], rel=1e-7)


@pytest.mark.parametrize("stops", [(0.5, 0.2), (0.0,), (1.2,), (0.5, 0.5)])
def test_stops_that_no_path_meets_are_refused(stops):
    with pytest.raises(CaseError, match="stops = "):
        statics.SolverOptions(stops=stops)


def test_a_thin_strip_with_a_large_bulk_modulus_bends_under_a_force(comm):
    """Its linear steps lengthen it: a line search on the size of the residual finds no equilibrium at all."""
    thickness, tip = 0.0386, 0.02
    material = LeeSacks(c0=676080.0, c1=132848.0, c2=38.1878)
    strip = rectangle(comm, lower=(0.0, -thickness / 2), size=(1.0, thickness), elements=(10, 1))
    force = 3 * tip * 4 * material.c0 * thickness**3 / 12  # 3 D w / L^3, D of the incompressible plate
    load = DeadLoad(on=("x_upper",), traction=(0.0, force / thickness))
    deflections = [
        statics.solve(
            strip, material, fixed=[statics.Fixed(on=("x_lower",))], loads=[load], formulation=formulation
        ).displacement_at((1.0, 0.0))[1]
        for formulation in (statics.TaylorHood(), statics.NearlyIncompressible(kappa=1e8))
    ]
    assert deflections == pytest.approx([tip, tip], rel=0.1)
