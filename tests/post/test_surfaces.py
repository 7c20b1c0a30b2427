"""Surfaces of meshes as triangles."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.geometry.shapes import box
from valvefsi.post.diagnostics.surfaces import surface_triangles
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("kind", ["hexahedron", "tetrahedron"])
def test_the_surface_of_a_box_is_its_outside(kind, degree):
    mesh = box(MPI.COMM_SELF, lower=(0, 0, 0), size=(2, 1, 1), elements=(3, 2, 2), cell=kind)
    solid = Structure(mesh, NeoHookean(c1=1.0), discretisation=Discretisation(degree=degree))
    x, cells, _ = solid.cells_on_root(solid.X)
    triangles = np.concatenate([surface_triangles(k, nodes) for k, nodes in cells.items()])
    corners = x[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.min() > 0.0
    assert area.sum() == pytest.approx(10.0)
    outside = np.any((np.abs(x) < 1e-9) | (np.abs(x - [2, 1, 1]) < 1e-9), axis=1)
    assert set(triangles.ravel()) == set(np.flatnonzero(outside))
    # no two triangles overlap: on the plane z = 0 the points of a fine raster lie in one triangle each
    flat = corners[np.all(np.abs(corners[..., 2]) < 1e-9, axis=1)][..., :2]
    a, b = np.meshgrid(np.linspace(0.013, 1.987, 57), np.linspace(0.017, 0.983, 41), indexing="ij")
    points = np.stack([a.ravel(), b.ravel()], axis=1)
    edges = np.roll(flat, -1, axis=1) - flat
    away = points[:, None, None, :] - flat[None]
    side = np.sign(edges[..., 0] * away[..., 1] - edges[..., 1] * away[..., 0])
    inside = np.all(side > 0, axis=2) | np.all(side < 0, axis=2)
    assert (inside.sum(axis=1) == 1).all()
