"""Contact with rigid planes: a block on a plane, a leaflet in its sector."""

from __future__ import annotations

import math

import pytest

from valvefsi.runtime import dolfinx_compat as compat  # noqa: F401  (before dolfinx)

# isort: split
from dolfinx import fem
from scipy.optimize import brentq

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box
from valvefsi.solid import statics
from valvefsi.solid.loads import DeadLoad
from valvefsi.solid.materials import NeoHookean

C1, STIFFNESS, TRACTION, GAP = 50.0, 4000.0, 30.0, 0.02
MATERIAL = NeoHookean(c1=C1)


def pressed(comm, plane, traction=-TRACTION):
    """A block of neo-Hookean material, free to slide, pressed in y."""
    mesh = box(comm, size=(1.0, 1.0, 1.0), elements=(1, 1, 1))
    fixed = [statics.Fixed(on=(f"{axis}_lower",), components=(axis,)) for axis in "xz"]
    load = DeadLoad(on=("y_upper",), traction=(0.0, traction, 0.0))
    return mesh, statics.solve(mesh, MATERIAL, fixed=[*fixed, plane], loads=[load])


def test_a_block_on_a_plane_is_compressed_and_passes_it_by_pressure_over_stiffness(comm):
    """P = c1 (s - 1/s^2) for the stretch s of the incompressible block (W = c1/2 (I1 - 3)): its upper face bears the
    load, its lower face the plane, which stands a gap below it."""
    plane = statics.Contact(on=("y_lower",), normal=(0.0, -2.0, 0.0), offset=GAP, stiffness=STIFFNESS)
    mesh, solution = pressed(comm, plane)
    stretch = brentq(lambda s: C1 * (s - 1 / s**2) + TRACTION, 0.3, 1.0)
    lower, upper = solution.displacement_at([(0.5, 0.0, 0.5), (0.5, 1.0, 0.5)])
    assert lower[1] == pytest.approx(-GAP - TRACTION / STIFFNESS, rel=1e-7)
    assert upper[1] - lower[1] == pytest.approx(stretch - 1, rel=1e-7)
    assert statics.contact_area(mesh, solution.displacement, [plane]) == pytest.approx(1.0)


def test_a_plane_that_is_not_reached_does_nothing(comm):
    far = statics.Contact(on=("y_upper",), normal=(0.0, 1.0, 0.0), offset=1.0 + GAP, stiffness=STIFFNESS)
    near = statics.Contact(on=("y_lower",), normal=(0.0, -1.0, 0.0), stiffness=STIFFNESS)
    mesh = box(comm, size=(1.0, 1.0, 1.0), elements=(1, 1, 1))
    fixed = [statics.Fixed(on=(f"{axis}_lower",), components=(axis,)) for axis in "xz"]
    load = DeadLoad(on=("y_upper",), traction=(0.0, -TRACTION, 0.0))
    tops = []
    for planes in ([near], [near, far]):
        solution = statics.solve(mesh, MATERIAL, fixed=[*fixed, *planes], loads=[load])
        tops.append(solution.displacement_at((0.5, 1.0, 0.5))[1])
    assert tops[0] == pytest.approx(tops[1], rel=1e-12)
    assert statics.contact_area(mesh, solution.displacement, [far]) == 0.0


@pytest.mark.parametrize(("normal", "offset", "area"), [((1, 0, 0), 0.25, 0.75), ((1, 1, 0), 1.2, 0.5)])
def test_the_area_in_contact_is_that_beyond_the_plane(comm, normal, offset, area):
    """Of the face z = 0 of a cube: x > 0.25 is three quarters; moved so that x + y > 1 is beyond, one half."""
    mesh = box(comm, size=(1.0, 1.0, 1.0), elements=(4, 4, 1))
    u = fem.Function(fem.functionspace(mesh.mesh, ("Lagrange", 1, (3,))))
    u.x.array[0::3] = (1.2 * math.sqrt(2) - 1.0) if normal[1] else 0.0  # moved along x, the plane stays
    plane = statics.Contact(on=("z_lower",), normal=normal, offset=offset, stiffness=1.0)
    assert statics.contact_area(mesh, u, [plane]) == pytest.approx(area, abs=0.03 if normal[1] else 1e-12)


@pytest.mark.parametrize(
    "wrong",
    [{"normal": (0.0, 0.0, 0.0)}, {"stiffness": 0.0}, {"on": ()}, {"stiffness": math.inf}],
)
def test_a_plane_that_cannot_be_is_refused(wrong):
    given = {"on": ("y_lower",), "normal": (0.0, 1.0, 0.0), "stiffness": 1.0}
    with pytest.raises(CaseError, match="expected tags, a normal and a positive stiffness"):
        statics.Contact(**{**given, **wrong})
