"""Patches that reach their faces at once take the step of forces spread from, and velocities read at, every point."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi import fsi
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import explicit_springs
from valvefsi.coupling.transfer import Coupling
from valvefsi.fluid.boundary import Boundary, Disk, Mixed, Open
from valvefsi.fluid.navier_stokes import ExplicitViscosity
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.geometry.patches import SINGLE, patch_labels
from valvefsi.grid import MacGrid
from valvefsi.run.checkpoints import load_state, memory_of, save_state
from valvefsi.run.recording import Output

WORLD, H, LENGTH, DT, STEPS = MPI.COMM_WORLD, 0.1, 1.6, 5e-5, 4
KERNEL = "composite_bspline32"
SECTION = AorticSection(inlet_radius=0.55, outlet_radius=0.6, sinus_height=0.9, sinus_depth=0.15, annulus=0.3)
SURFACE = SECTION.housing(H, (0.5 * H, LENGTH - 0.5 * H))
LABELS = patch_labels([SURFACE], H, (0.5 * H, LENGTH - 0.5 * H))
CLOSE = 1e-13


class PointByPoint(PatchedSurface):
    """The same surface with a kernel at every point, whose mean over patches is taken afterwards."""

    def felt(self, u):
        return self.held(self.transfer.interpolate(u))


def section(slips, comm=WORLD):
    """A section of an aorta between two open disks, along which a pressure difference drives fluid."""
    grid = MacGrid([-1.0, -1.0, 0.0], [1.0, 1.0, LENGTH], (20, 20, 16), [False] * 3, comm)
    sides = {
        name: Mixed(open=Open(pressure=p), where=Disk(centre=(0.0, 0.0, z), radius=0.5))
        for name, z, p in (("z_lower", 0.0, 2e4), ("z_upper", LENGTH, 0.0))
    }
    fluid = ExplicitViscosity(grid, Boundary(grid, sides), rho=1.0, mu=0.04, advection="xsppm7")
    slip = np.zeros((len(LABELS), 3, 3))
    slip[LABELS == SINGLE, 2, 2] = 0.5 / DT
    springs = explicit_springs(KERNEL, H, DT, 0.25)
    options = {"name": "wall", "slip": slip if slips else 0.0, **springs}
    wall = PatchedSurface(SURFACE, LABELS, Coupling(grid, KERNEL), **options)
    return fsi.Model(grid=grid, fluid=fluid, bodies=(wall,))


def point_by_point(model):
    (wall,) = model.bodies
    slow = copy(wall)
    slow.__class__ = PointByPoint
    slow.transfer = Coupling(model.grid, KERNEL).stay(wall.X)
    return replace(model, bodies=(slow,))


def steps(model, state, number):
    for k in range(number):
        state = fsi.step(model, state, DT * (1.0 if k % 2 else 0.8))
    return state


def largest(a):
    return WORLD.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX)


def assert_same(found, expected, grid):
    """All of the state, in parts of what is largest in it."""
    pairs = {f"u_{d}": (found.u[d], expected.u[d]) for d in range(3)}
    pairs |= {key: (found.bodies[0][key], values) for key, values in expected.bodies[0].items()}
    pairs |= {"p": (found.p[grid.owned], expected.p[grid.owned]), "given": (found.given, expected.given)}
    speed = max(largest(u) for u in expected.u)
    for name, (a, b) in pairs.items():
        scale = speed if name.startswith("u") else largest(b)
        assert scale > 1e-9
        assert largest(a - b) < CLOSE * scale, name


@pytest.mark.parametrize("slips", [False, True])
def test_the_step_is_that_of_every_point(slips):
    model = section(slips)
    slow = point_by_point(model)
    start = fsi.initial_state(model, DT)
    assert_same(steps(model, start, STEPS), steps(slow, start, STEPS), model.grid)


def test_a_run_that_is_gone_on_with_is_that_of_every_point(shared_tmp):
    model = section(True)
    slow = point_by_point(model)
    start, output = fsi.initial_state(model, DT), Output(directory=shared_tmp)
    save_state(model, steps(model, start, STEPS), output, memory_of(model, output))
    found = load_state(model, output, memory_of(model, output))
    expected = steps(slow, steps(slow, start, STEPS), STEPS)
    assert_same(steps(model, found, STEPS), expected, model.grid)


def test_spreading_is_the_adjoint_of_interpolation_for_what_patches_hold():
    model = section(False)
    grid, (wall,), rng = model.grid, model.bodies, np.random.default_rng(1)
    u = grid.zero_faces()
    for d in range(3):
        u[d][grid.owned_faces(d)] = rng.standard_normal(u[d][grid.owned_faces(d)].shape)
    F = wall.force(wall.held(rng.standard_normal(wall.X.shape)), np.zeros_like(wall.X))
    f = wall.transfer.spread(F)
    power = grid.cell_volume * sum(
        np.vdot(f[d][grid.owned_faces(d)], u[d][grid.owned_faces(d)]) for d in range(3)
    )
    grid.exchange(u)
    felt = WORLD.allreduce(float(np.vdot(F, wall.felt(u))))
    assert WORLD.allreduce(float(power)) == pytest.approx(felt, rel=1e-11)
    total = np.array([grid.cell_volume * f[d][grid.owned_faces(d)].sum() for d in range(3)])
    np.testing.assert_allclose(
        WORLD.allreduce(total), WORLD.allreduce(F.sum(axis=0)), atol=1e-11 * np.abs(F).sum()
    )


def test_a_patch_reaches_each_of_its_faces_once():
    model = section(False, MPI.COMM_SELF)
    (wall,) = model.bodies
    together = int((wall.patches.labels >= 0).sum())
    for reach in wall.transfer.reach:
        numbers = np.repeat(np.arange(wall.patches.size), np.diff(reach.starts.astype(int)))
        assert len(np.unique(numbers * 10**6 + reach.faces)) == len(numbers) == len(reach.faces)
        assert len(numbers) < 12 * together  # as many as points of a kernel reach one by one


def test_a_point_of_a_patch_must_not_slip_by_itself():
    grid = MacGrid([-1.0, -1.0, 0.0], [1.0, 1.0, LENGTH], (20, 20, 16), [False] * 3, MPI.COMM_SELF)
    slip = np.zeros((len(LABELS), 3, 3))
    slip[np.flatnonzero(LABELS != SINGLE)[0]] = np.eye(3)
    with pytest.raises(ValueError, match="in patches not to slip"):
        PatchedSurface(
            SURFACE, LABELS, Coupling(grid, KERNEL), name="wall", stiffness=1.0, damping=1.0, slip=slip
        )
