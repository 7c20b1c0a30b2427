"""Viscous forces of a solid: rigid motions, the power of uniform flows, and where the energy of a coupled run goes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from tests.test_fsi import march, soft_square, swirl
from valvefsi.bodies.elastic import Elastic
from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.post import diagnostics
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Damping, Discretisation, Structure

ETA = 30.0


def body(comm, kind, degree=1, viscosity=ETA):
    """A body of two by three (by two) elements, 0.5 x 0.6 (x 0.4) cm."""
    if kind in ("triangle", "quadrilateral"):
        mesh = rectangle(comm, lower=(0.2, 0.1), size=(0.5, 0.6), elements=(2, 3), cell=kind)
    else:
        mesh = box(comm, lower=(0.2, 0.1, 0.3), size=(0.5, 0.6, 0.4), elements=(2, 3, 2), cell=kind)
    given = Discretisation(degree=degree)
    return Structure(mesh, NeoHookean(c1=5.0), discretisation=given, damping=Damping(viscosity=viscosity))


def gradient(rng, dim, size):
    """A random gradient, in two dimensions in the plane."""
    A = np.zeros((3, 3))
    A[:dim, :dim] = size * rng.uniform(-1, 1, (dim, dim))
    return A


def wavy(X, dim, size=0.03):
    """Positions that are not affine in X."""
    chi = X.copy()
    for axis in range(dim):
        chi[:, axis] += size * np.sin(5.0 * X[:, (axis + 1) % dim] + axis) * np.cos(3.0 * X[:, axis])
    return chi


CELLS = [("triangle", 1), ("quadrilateral", 2), ("tetrahedron", 1), ("hexahedron", 1)]


@pytest.mark.parametrize(("kind", "degree"), CELLS)
def test_a_rigid_motion_of_a_deformed_body_makes_no_force(comm, kind, degree):
    solid = body(comm, kind, degree)
    chi = wavy(solid.X, solid.dim)
    spin = np.array([0.0, 0.0, 3.0]) if solid.dim == 2 else np.array([1.0, -2.0, 3.0])
    U = np.cross(spin, chi) + np.array([2.0, -1.0, 0.5])
    U[:, solid.dim :] = 0.0
    F = solid.viscosity.force(chi, U).copy()
    scale = np.abs(solid.viscosity.force(chi, chi)).max(initial=0.0)
    assert np.abs(F).max(initial=0.0) < 1e-12 * comm.allreduce(scale, op=MPI.MAX)


@pytest.mark.parametrize(("kind", "degree"), CELLS)
def test_the_power_of_a_uniform_flow_is_that_of_newtons_stress(comm, kind, degree):
    """chi = A X and U = L chi: d = sym L everywhere, and the power is 2 eta d : d times the deformed volume."""
    rng = np.random.default_rng(3)
    solid = body(comm, kind, degree)
    A = np.eye(3) + gradient(rng, solid.dim, 0.3)
    L, other = gradient(rng, solid.dim, 2.0), gradient(rng, solid.dim, 1.0)
    chi = solid.X @ A.T
    F = solid.force(chi, chi @ L.T, 0.0) - solid.force(chi, 0.0 * chi, 0.0)
    d, e = 0.5 * (L + L.T), 0.5 * (other + other.T)
    volume = np.linalg.det(A) * {2: 0.5 * 0.6, 3: 0.5 * 0.6 * 0.4}[solid.dim]
    for rate, virtual in ((d, L), (e, other)):
        power = comm.allreduce(float(np.vdot(F, chi @ virtual.T)))
        assert power == pytest.approx(-2.0 * ETA * np.vdot(d, rate) * volume, rel=1e-10)


def test_forces_of_a_wavy_flow_keep_momentum_and_angular_momentum(comm):
    solid = body(comm, "hexahedron")
    chi = wavy(solid.X, 3)
    F = solid.viscosity.force(chi, wavy(chi, 3, 0.7) - chi).copy()
    size = comm.allreduce(float(np.abs(F).sum()))
    assert size > 1.0
    for total in (F.sum(axis=0), np.cross(chi, F).sum(axis=0)):
        np.testing.assert_allclose(comm.allreduce(total), 0.0, atol=1e-13 * size)


def test_what_a_coupled_run_loses_is_what_the_viscous_forces_took():
    """Kinetic and elastic energy without the fluid's viscosity; the rest is of the order of the step."""

    def rest(dt):
        model = soft_square(mu=0.0)
        old = model.bodies[0].solid
        given = {"discretisation": old.discretisation, "nu_stab": old.nu_stab}
        given["damping"] = Damping(viscosity=0.05)
        solid = Structure(old.mesh, old.material, **given)
        model = replace(model, bodies=(Elastic(solid, model.bodies[0].coupling),))
        states = march(model, dt, round(0.2 / dt), swirl(model.grid, 0.5))
        energy = [
            diagnostics.kinetic_energy(model.grid, s.u, 1.0) + solid.energy(s.bodies[0]["chi"])
            for s in states
        ]
        power = []
        for s in states:
            U = model.bodies[0].coupling.at(s.bodies[0]["chi"]).interpolate(s.u)
            power.append(-np.vdot(solid.viscosity.force(s.bodies[0]["chi"], U), U[:, :2]))
        power = MPI.COMM_WORLD.allreduce(np.array(power))
        taken = dt * (power.sum() - 0.5 * (power[0] + power[-1]))
        assert taken > 0.05 * energy[0]
        return abs(energy[0] - energy[-1] - taken) / taken

    coarse, fine = rest(4e-3), rest(2e-3)
    assert fine < 0.02
    assert fine < 0.65 * coarse


def test_a_viscosity_that_is_negative_is_refused(comm):
    with pytest.raises(CaseError, match="viscosity"):
        body(comm, "triangle", viscosity=-1.0)
