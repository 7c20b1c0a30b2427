"""Solids that slip through the fluid: confined compression in closed form, limits, ranks, and the keys of a case."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import block_model, moved, simulation, slipping
from tests.run.test_stable_step import stays_calm
from valvefsi import fsi
from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.slip import DarcySlip
from valvefsi.case.build import build
from valvefsi.case.reading import parse_case
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.geometry.shapes import rectangle
from valvefsi.grid import MacGrid
from valvefsi.run.planning import step_limits
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure

WORLD = MPI.COMM_WORLD


def slab(c1, permeability):
    """A slab across a periodic box, 0.5 cm thick, without lateral contraction (nu_stab = 0)."""
    mesh = rectangle(WORLD, lower=(0.25, 0.0), size=(0.5, 1.0), elements=(20, 16))
    solid = Structure(mesh, NeoHookean(c1=c1), name="slab", nu_stab=0.0)
    grid = MacGrid([0, 0], [1, 1], [16, 16], [True, True])
    fluid = NavierStokes(grid, Boundary(grid), rho=1.0, mu=0.05)
    body = Elastic(solid, Coupling(grid, "bspline3"), slip=DarcySlip(permeability, solid.weights[:, None]))
    return fsi.Model(grid=grid, fluid=fluid, bodies=(body,))


def test_confined_compression_relaxes_as_in_biphasic_theory():
    """The fluid cannot move in one dimension: u_t = k H u_xx with H = kappa + 4/3 mu (Mow et al. 1980).

    Free ends: u = A cos(pi x / L) decays with k H (pi/L)^2; mu = c1, and kappa = 2/3 mu for nu_stab = 0.
    """
    c1, k, size = 6.0, 2e-2, 1e-4
    model, dt, steps = slab(c1, k), 2e-4, 400
    solid = model.bodies[0].solid
    mode = np.cos(np.pi * (solid.X[:, 0] - 0.25) / 0.5)
    state = fsi.initial_state(model, dt)
    chi = solid.X.copy()
    chi[:, 0] += size * mode
    state = moved(state, chi=chi)
    for _ in range(steps):
        state = fsi.step(model, state, dt)

    def amplitude(chi):
        total = WORLD.allreduce(np.array([np.vdot(mode, chi[:, 0] - solid.X[:, 0]), np.vdot(mode, mode)]))
        return total[0] / total[1]

    rate = k * (2.0 * c1) * (np.pi / 0.5) ** 2
    assert np.exp(-rate * steps * dt) < 0.5
    measured = -np.log(amplitude(state.bodies[0]["chi"]) / size) / (steps * dt)
    assert measured == pytest.approx(rate, rel=2e-3)
    fastest = max(float(np.abs(c).max()) for c in state.u)
    assert fastest < 1e-3 * rate * size


def test_without_it_the_slab_stays_compressed():
    model = slipping(slab(6.0, 1e-2), None)
    state = fsi.initial_state(model, 2e-4)
    chi = model.bodies[0].solid.X.copy()
    chi[:, 0] += 1e-4 * np.cos(2 * np.pi * (chi[:, 0] - 0.25))
    state = moved(state, chi=chi)
    for _ in range(20):
        state = fsi.step(model, state, 2e-4)
    assert np.abs(state.bodies[0]["chi"] - chi).max(initial=0.0) < 1e-9


def seeping(comm=WORLD, permeability=0.05):
    model = block_model(comm, load=2.0, tether=50.0)
    return slipping(model, permeability)


def test_the_limit_of_the_plan_is_on_the_safe_side():
    model = slipping(block_model(load=2.0, tether=50.0), 2.0)
    limits = step_limits(model)
    limit = limits["Darcy slip, block"]
    assert limit < 0.5 * limits["elastic, block"]
    assert stays_calm(model, limit)
    assert not stays_calm(model, 8.0 * limit)


def test_it_does_not_depend_on_the_number_of_ranks():
    energies = []
    for comm in (WORLD, MPI.COMM_SELF):
        model = seeping(comm)
        state = fsi.initial_state(model, 0.02)
        for _ in range(20):
            state = fsi.step(model, state, 0.02)
        energies.append(model.bodies[0].solid.energy(state.bodies[0]["chi"]))
    assert energies[0] == pytest.approx(energies[1], rel=1e-10)
    model = block_model(MPI.COMM_SELF, load=2.0, tether=50.0)
    state = fsi.initial_state(model, 0.02)
    for _ in range(20):
        state = fsi.step(model, state, 0.02)
    assert abs(model.bodies[0].solid.energy(state.bodies[0]["chi"]) / energies[0] - 1) > 1e-6


def test_a_run_lets_its_solids_seep_as_the_step_does(shared_tmp):
    model = seeping()
    state = fsi.initial_state(model, 0.02)
    for _ in range(10):
        state = fsi.step(model, state, 0.02)
    last = simulation(shared_tmp, model=model, steps=10, dt=0.02).run().state
    np.testing.assert_allclose(last.bodies[0]["chi"], state.bodies[0]["chi"], rtol=1e-12)


def test_a_case_gives_permeability_and_viscosity(tmp_path):
    mesh = {"shape": "rectangle", "lower": [1, 1], "size": [1, 1], "elements": [2, 2]}
    material = {"model": "neo_hookean", "c1": 10.0}
    given = {"permeability": "1e-13 m^4/(N*s)", "viscosity": "2 Pa*s"}
    solid = {"name": "body", "mesh": mesh, "material": material, **given}
    grid = {"lower": [0, 0], "upper": [4, 4], "cells": [16, 16]}
    case = parse_case({"grid": grid, "time": {"dt": "1 ms", "t_end": "1 s"}, "solid": [solid]})
    model = build(case, tmp_path, MPI.COMM_SELF).model
    body = model.bodies[0].solid
    assert body.viscosity.eta == pytest.approx(20.0)
    assert isinstance(model.bodies[0].slip, DarcySlip)
    assert model.bodies[0].slip.permeability == pytest.approx(1e-10)
