"""A leaflet's own directions and a shell's thickness, from the tags of its facets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box
from valvefsi.solid.elements.shell_layers import thickness_axes
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.materials.fibres import at_midpoints
from valvefsi.solid.materials.harmonic import harmonic
from valvefsi.solid.materials.leaflet_directions import leaflet_directions
from valvefsi.solid.structure import Discretisation, Structure

TAGS = {"inflow": ("z_upper",), "outflow": ("z_lower",), "attached": ("y_lower",), "free": ("y_upper",)}


def rolled(comm, *, elements=(12, 6, 2), turn=0.0, radius=1.0, cell="hexahedron"):
    """A part of a tube about the z axis, thin along its radius: x of the box around, y up, z inwards; turned in it."""
    mesh = box(comm, size=(1.2, 0.8, 0.1), elements=elements, cell=cell)
    X = mesh.mesh.geometry.x
    c, s = math.cos(turn), math.sin(turn)
    phi, up, r = (c * X[:, 0] - s * X[:, 1]) / radius, s * X[:, 0] + c * X[:, 1], radius - X[:, 2]
    X[:, 0], X[:, 1], X[:, 2] = -r * np.sin(phi), r * np.cos(phi), up
    return mesh


def directions(mesh):
    found = leaflet_directions(mesh, TAGS)
    X = found["radial"].function_space.tabulate_dof_coordinates()
    return X, *(found[name].x.array.reshape(-1, 3) for name in ("circumferential", "radial"))


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_they_are_those_of_a_tube_that_stands_on_its_attached_edge(comm, cell):
    X, around, up = directions(rolled(comm, cell=cell))
    tangent = np.stack([-X[:, 1], X[:, 0], 0 * X[:, 0]], axis=1) / np.hypot(X[:, 0], X[:, 1])[:, None]
    # Hexahedra are symmetric; the middle of a tetrahedron is off its element's normal by some of an element's turn.
    off = 1e-9 if cell == "hexahedron" else 0.06
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, 1.0], (len(up), 1)), atol=off)
    np.testing.assert_allclose(around, tangent, atol=off)


def test_they_are_at_right_angles_in_the_sheet_and_turn_with_its_edges(comm):
    turn = 0.4
    X, around, up = directions(rolled(comm, turn=turn, elements=(24, 24, 1)))
    radius = np.stack([X[:, 0], X[:, 1], 0 * X[:, 0]], axis=1) / np.hypot(X[:, 0], X[:, 1])[:, None]
    assert np.abs(np.einsum("ni,ni->n", around, up)).max(initial=0.0) < 1e-12
    assert np.abs(np.einsum("ni,ni->n", around, radius)).max(initial=0.0) < 0.02
    # A rectangle that is turned and rolled up: both directions are turned by the angle everywhere.
    assert around[:, 2] == pytest.approx(math.sin(turn), abs=0.02)
    assert up[:, 2] == pytest.approx(math.cos(turn), abs=0.02)


def test_they_lie_in_the_sheet_where_its_edges_are_cut_aslant(comm):
    mesh = box(comm, size=(1.0, 0.5, 0.2), elements=(4, 10, 4))
    mesh.mesh.geometry.x[:, 1] += mesh.mesh.geometry.x[:, 2]
    _, around, up = directions(mesh)
    depth, height = (
        at_midpoints(mesh, ufl.grad(harmonic(mesh, [(TAGS[a], 0.0), (TAGS[b], 1.0)], "")))
        for a, b in (("inflow", "outflow"), ("attached", "free"))
    )
    off = (
        np.einsum("ni,ni->n", depth, height) / np.linalg.norm(depth, axis=1) / np.linalg.norm(height, axis=1)
    )
    assert comm.allreduce(float(np.abs(off).max(initial=0.0)), op=MPI.MAX) > 0.02, (
        "the two are not at right angles"
    )
    own = slice(0, len(depth))
    assert np.abs(np.einsum("ni,ni->n", depth, up[own])).max(initial=0.0) < 1e-9
    assert np.abs(around - [-1.0, 0.0, 0.0]).max(initial=0.0) < 1e-9


def test_a_tag_without_facets_is_said(comm):
    with pytest.raises(CaseError, match="on = 'edge': no such tag"):
        leaflet_directions(rolled(comm), TAGS | {"attached": ("edge",)})
    with pytest.raises(CaseError, match="attached|free = 'body'"):
        leaflet_directions(rolled(comm), TAGS | {"free": ("body",)})


# Thickness of solid shells


@pytest.mark.parametrize("axis", "xyz")
def test_the_thickness_lies_between_the_tagged_faces_whatever_the_lengths(comm, axis):
    mesh = box(comm, size=(0.3, 0.5, 0.4), elements=(3, 2, 4))
    faces = ((f"{axis}_lower",), (f"{axis}_upper",))
    assert set(thickness_axes(mesh, faces)) <= {"xyz".index(axis)}


def test_several_tags_make_one_face_and_the_elements_know_of_them(comm):
    mesh = rolled(comm)
    assert set(thickness_axes(mesh, TAGS_OF_FACES)) <= {2}
    solid = Structure(
        mesh,
        NeoHookean(c1=3.0),
        discretisation=Discretisation(element="solid_shell", kappa=400.0, faces=(("y_lower",), ("y_upper",))),
    )
    across = solid.X[:, 2] > 0.4  # the height of a node is along y of the box
    assert set(thickness_axes(mesh, solid.discretisation.faces)) <= {1}
    corners = solid.elasticity.nodes
    X = solid.space.tabulate_dof_coordinates()[corners]
    assert np.abs(X[:, 4:, 2] - X[:, :4, 2]).min(initial=1.0) > 0.1, (
        "the last four corners lie above the first"
    )
    assert across.any() or not len(across)


TAGS_OF_FACES = (("z_lower",), ("z_upper",))


def test_faces_that_rows_of_elements_do_not_join_are_refused(comm):
    mesh = box(comm, size=(0.3, 0.5, 0.4), elements=(3, 2, 4))
    with pytest.raises(CaseError, match=r"faces: 24 of 24 elements do not lie in one row"):
        thickness_axes(mesh, (("x_lower",), ("y_upper",)))
    with pytest.raises(CaseError, match=r"faces = \['body'\]: expected tags of facets"):
        thickness_axes(mesh, (("body",), ("y_upper",)))


def test_a_body_that_is_thin_this_way_here_and_that_way_there_is_refused(comm):
    """A bar whose elements get longer than it is thick: rows of elements do not say which way its thickness runs."""
    mesh = box(comm, size=(4.0, 0.3, 0.3), elements=(4, 1, 1))
    X = mesh.mesh.geometry.x
    X[:, 1] *= np.where(X[:, 0] > 2.5, 2.0, 0.5)
    with pytest.raises(CaseError, match=r"faces: the thickness direction .* cannot be found: at 4 edges"):
        thickness_axes(mesh)
    assert set(thickness_axes(mesh, TAGS_OF_FACES)) <= {2}
