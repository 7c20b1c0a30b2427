"""Flow on a mesh that fits: closed forms with their orders, the force on a sliding wall, ranks."""

from __future__ import annotations

import resource

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.runtime import dolfinx_compat  # noqa: F401  # isort: skip
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh

from valvefsi.benchmarks.flows.fitted import FittedFlow
from valvefsi.errors import StabilityError

WORLD = MPI.COMM_WORLD


def rectangle(n, low=(0.0, 0.0), high=(1.0, 1.0), comm=WORLD):
    return dolfinx_mesh.create_rectangle(comm, [low, high], (n, n))


def facets(mesh, where):
    return dolfinx_mesh.locate_entities_boundary(mesh, 1, where)


def on(d, value):
    return lambda x: np.isclose(x[d], value)


def everywhere(x):
    return np.ones(x.shape[1], dtype=bool)


def error(flow, exact):
    """Largest difference at the nodes of the velocity."""
    space, there = flow.space.sub(0).collapse()
    function = fem.Function(space)
    function.interpolate(exact)
    found = np.abs(function.x.array - flow.velocity.x.array[there]).max(initial=0.0)
    return flow.comm.allreduce(float(found), op=MPI.MAX)


def couette(mesh, mu=1.0, *, open_end=False):
    ends = facets(mesh, lambda x: np.isclose(x[0], 0.0) | (np.isclose(x[0], 1.0) & (not open_end)))
    sides = {
        "ends": (ends, (lambda x: 2.0 * x[1], 0.0)),
        "low": (facets(mesh, on(1, 0.0)), (0.0, 0.0)),
        "high": (facets(mesh, on(1, 1.0)), (2.0, 0.0)),
    }
    return FittedFlow(mesh, sides, rho=1.7, mu=mu, dt=0.05)


def test_a_side_that_slides_is_pulled_by_the_shear_stress():
    flow = couette(rectangle(4))
    for _ in range(100):
        forces = flow.step()
    assert error(flow, lambda x: np.stack([2.0 * x[1], 0.0 * x[0]])) < 1e-10
    assert flow.t == pytest.approx(5.0)
    assert forces["high"][0] == pytest.approx(-2.0, rel=1e-9)
    assert forces["low"][0] == pytest.approx(2.0, rel=1e-9)


def kovasznay(x, reynolds=40.0):
    """A steady flow behind a lattice (Kovasznay 1948)."""
    rate = reynolds / 2 - np.sqrt(reynolds**2 / 4 + 4 * np.pi**2)
    wave = np.exp(rate * x[0])
    angle = 2 * np.pi * x[1]
    return np.stack([1 - wave * np.cos(angle), rate / (2 * np.pi) * wave * np.sin(angle)])


def test_a_steady_flow_with_advection_is_found_with_order_three():
    errors = []
    for n in (8, 16):
        mesh = rectangle(n, (-0.5, -0.5), (1.0, 1.0))
        given = tuple(lambda x, d=d: kovasznay(x)[d] for d in range(2))
        flow = FittedFlow(mesh, {"all": (facets(mesh, everywhere), given)}, rho=1.0, mu=1 / 40, dt=0.01)
        flow.start(kovasznay)
        for _ in range(150):
            flow.step()
        errors.append(error(flow, kovasznay))
    assert errors[1] < 5e-3
    assert np.log2(errors[0] / errors[1]) > 2.6


def vortex(t, rho=2.0, mu=0.25):
    """A vortex in a box whose sides slip, as it decays."""
    size = np.exp(-2.0 * mu / rho * np.pi**2 * t)
    return lambda x: (
        size
        * np.stack(
            [np.sin(np.pi * x[0]) * np.cos(np.pi * x[1]), -np.cos(np.pi * x[0]) * np.sin(np.pi * x[1])]
        )
    )


def test_a_vortex_decays_with_order_two_in_time():
    mesh = rectangle(16)
    sides = {
        "x": (facets(mesh, lambda x: np.isclose(x[0] * (1 - x[0]), 0.0)), (0.0, None)),
        "y": (facets(mesh, lambda x: np.isclose(x[1] * (1 - x[1]), 0.0)), (None, 0.0)),
    }
    errors = []
    for dt in (0.1, 0.05):
        flow = FittedFlow(mesh, sides, rho=2.0, mu=0.25, dt=dt)
        flow.start(vortex(0.0), vortex(-dt))
        for _ in range(round(0.8 / dt)):
            flow.step()
        errors.append(error(flow, vortex(0.8)))
    assert errors[1] < 0.01
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2


def test_forces_do_not_depend_on_the_number_of_ranks():
    found = []
    for comm in (WORLD, MPI.COMM_SELF):
        flow = couette(rectangle(6, comm=comm), open_end=True)
        flow.start(lambda x: np.stack([x[1] ** 2, x[0] * x[1]]))
        found.append([flow.step() for _ in range(3)][-1])
    for name, force in found[1].items():
        np.testing.assert_allclose(found[0][name], force, rtol=1e-8, atol=1e-9)


def test_steps_leave_no_memory_behind():
    """On several ranks PETSc keeps every vector that is dropped: 13 MB here before they were made once."""
    flow = couette(rectangle(60))
    for _ in range(5):
        flow.step()
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(40):
        flow.step()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 5 * 1024
    flow.destroy()


def test_a_flow_that_breaks_down_says_so():
    flow = couette(rectangle(2), mu=1e-6)
    flow.start(lambda x: 1e200 * np.stack([x[1] ** 2, x[0] * x[1]]))
    with pytest.raises(StabilityError, match="not finite at t = 0.*try a shorter step"):
        [flow.step() for _ in range(5)]
