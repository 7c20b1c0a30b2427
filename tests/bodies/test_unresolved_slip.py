"""Slip of what the grid does not resolve: no seepage, Darcy's law for short waves, energy, limits, keys."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.bodies.test_seepage import slab
from tests.coupled_case import slipping
from tests.run.test_stable_step import stays_calm
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.slip import DarcySlip, UnresolvedSlip
from valvefsi.case.build import build
from valvefsi.case.reading import parse_case
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.shapes import rectangle
from valvefsi.grid import MacGrid
from valvefsi.run.planning import step_limits
from valvefsi.run.stable_step import measured_limit
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD
H = 1.0 / 16


def points(n=40, seed=0):
    """Points in the middle of a periodic box with their weights, the same on all ranks, and the rows of this rank."""
    rng = np.random.default_rng(seed)
    x = np.zeros((n, 3))
    x[:, :2] = 0.4 + 0.2 * rng.random((n, 2))
    mine = np.array_split(np.arange(n), WORLD.size)[WORLD.rank]
    return x, (0.1 + rng.random((n, 1))) * 1e-3, mine


def transfer_at(x):
    return Coupling(MacGrid([0, 0], [1, 1], [16, 16], [True, True]), "bspline3").at(x)


def quadratic_spline(r):
    r = abs(r)
    return 0.75 - r**2 if r < 0.5 else 0.5 * (1.5 - r) ** 2 if r < 1.5 else 0.0


def felt(x, component):
    """What each point feels of a unit force at each other one, from the spline itself, ``(n, n)`` [1/cm^2]."""
    stagger = [0.5, 0.5]
    stagger[component] = 0.0
    weights = np.array(
        [
            np.outer(*([quadratic_spline(p[a] / H - (i + stagger[a])) for i in range(16)] for a in range(2)))
            for p in x
        ]
    ).reshape(len(x), -1)
    return weights @ weights.T / H**2


@pytest.mark.parametrize("component", [0, 1])
def test_the_velocity_is_the_sum_over_pairs(component):
    x, w, mine = points()
    f = np.random.default_rng(1).standard_normal((len(x), 3))
    S = felt(x, component)
    expected = 0.3 * (S * (f[:, None, component] - f[None, :, component])) @ w[:, 0]
    V = UnresolvedSlip(0.3, w[mine]).velocity((w * f)[mine], transfer_at(x[mine]))
    np.testing.assert_allclose(V[:, component], expected[mine], rtol=1e-12, atol=1e-12)


def test_a_uniform_load_drives_nothing():
    x, w, mine = points()
    V = UnresolvedSlip(0.3, w[mine]).velocity(w[mine] * np.array([3.0, -2.0, 0.0]), transfer_at(x[mine]))
    assert np.abs(V).max(initial=0.0) < 1e-13
    V = DarcySlip(0.3, w[mine]).velocity(w[mine] * np.array([3.0, -2.0, 0.0]), transfer_at(x[mine]))
    np.testing.assert_allclose(V, np.broadcast_to([0.9, -0.6, 0.0], V.shape))


def relaxed(law, dt=2e-4, steps=100):
    """Energies over time of a slab in which every other node is moved, which the grid does not see."""
    model = slipping(slab(6.0, 0.0), 1e-3, law)
    state = fsi.initial_state(model, dt)
    solid = model.bodies[0].solid
    odd = np.rint((solid.X[:, 0] - 0.25) / 0.025) + np.rint(solid.X[:, 1] / 0.0625)
    state.bodies[0]["chi"][:, 0] += 1e-4 * (-1.0) ** odd
    energies = [solid.energy(state.bodies[0]["chi"])]
    for _ in range(steps):
        state = fsi.step(model, state, dt)
        energies.append(solid.energy(state.bodies[0]["chi"]))
    return np.array(energies)


def test_short_waves_lose_their_energy_as_by_darcys_law():
    energies = relaxed(UnresolvedSlip)
    assert (np.diff(energies) < 0.0).all()
    assert energies[-1] < 0.5 * energies[0]
    rate, darcy = (-np.log(e[-1] / e[0]) for e in (energies, relaxed(DarcySlip)))
    assert 0.85 * darcy < rate < darcy  # phi is 1 inside, less at the free ends
    assert relaxed(None)[-1] > 0.95 * energies[0]


def test_the_limits_of_plan_and_measurement_hold():
    model = slipping(slab(6.0, 0.0), 1e-2, UnresolvedSlip)
    limit = step_limits(model)["Darcy slip, slab"]
    assert measured_limit(model, limit, 0) > limit
    for _ in range(12):
        limit = measured_limit(model, limit, 0)
    assert limit < 0.9 * measured_limit(slipping(model, None), limit, 0)
    assert stays_calm(model, 0.95 * limit)
    assert not stays_calm(model, 1.2 * limit)


@pytest.mark.parametrize("thickness", [H / 4, H / 2])
def test_the_limit_of_the_plan_knows_how_little_of_a_kernel_a_thin_body_fills(thickness):
    """Slip is smaller by the part that the body fills, the step larger: within a factor of three, on the safe side."""
    mesh = rectangle(WORLD, lower=(0.5, 0.0), size=(thickness, 1.0), elements=(1, 32))
    solid = Structure(mesh, NeoHookean(c1=6.0), name="sheet", nu_stab=0.0)
    grid = MacGrid([0, 0], [1, 1], [16, 16], [True, True])
    body = Elastic(
        solid,
        Coupling(grid, "bspline3"),
        slip=UnresolvedSlip(permeability=0.1, weights=solid.weights[:, None]),
    )
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.05)
    model = fsi.Model(grid=grid, fluid=fluid, bodies=(body,))
    planned = limit = step_limits(model)["Darcy slip, sheet"]
    for _ in range(12):
        limit = measured_limit(model, limit, 0)
    assert limit / 3.0 < planned < limit


def case_of(**given):
    mesh = {"shape": "rectangle", "lower": [1, 1], "size": [1, 1], "elements": [2, 2]}
    material = {"model": "neo_hookean", "c1": 10.0}
    solid = {"name": "body", "mesh": mesh, "material": material, "permeability": 1e-3, **given}
    grid = {"lower": [0, 0], "upper": [4, 4], "cells": [16, 16]}
    return parse_case({"grid": grid, "time": {"dt": "1 ms", "t_end": "1 s"}, "solid": [solid]})


def test_a_case_gives_it(tmp_path):
    model = build(case_of(seepage="unresolved"), tmp_path, MPI.COMM_SELF).model
    assert isinstance(model.bodies[0].slip, UnresolvedSlip)
    assert model.bodies[0].slip.permeability == 1e-3


def test_elemental_coupling_has_none():
    with pytest.raises(CaseError, match="nodal") as caught:
        case_of(seepage="unresolved", coupling="elemental")
    assert caught.value.key == "solid.body.seepage"
