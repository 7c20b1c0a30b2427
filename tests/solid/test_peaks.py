"""Largest strain and stress of each leaflet."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from valvefsi.geometry.leaflets import TYPES
from valvefsi.geometry.valve import distribute, mesh_valve
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.peaks import SHARE, Peaks, columns_of, parts_of, percentile
from valvefsi.solid.structure import Structure
from valvefsi.solid.structure_stress import stress_of_structure

C1, NAMES = 80.0, ("leaflet_1", "leaflet_2", "leaflet_3")
MAPS = (np.diag([1.2, 1.0, 0.9]), np.array([[1.0, 0.3, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), np.eye(3))
"""Stretch along x, simple shear, nothing."""


@pytest.fixture(scope="module")
def valve():
    """Leaflets as hexahedra, and their nodes leaflet by leaflet."""
    from mpi4py import MPI

    made = mesh_valve(TYPES["pericardial"](diameter=2.5), size=0.3)
    material = NeoHookean(c1=C1)
    return Structure(distribute(made, MPI.COMM_WORLD), material, nu_stab=None), made.points


def deformed(valve, maps):
    """Peaks of leaflets that each have a homogeneous deformation."""
    solid, points = valve
    owner = cKDTree(points).query(solid.X)[1] * 3 // len(points)
    solid.jacobian(np.einsum("nij,nj->ni", np.array(maps)[owner], solid.X))
    return Peaks(stress_of_structure(solid, quadrature_degree=3), parts_of(solid.mesh)).now()


def test_leaflets_with_a_stretch_of_their_own_have_its_strain_and_stress(valve):
    found = deformed(valve, MAPS)
    assert list(found) == columns_of(NAMES)
    for name, F in zip(NAMES, MAPS, strict=True):
        strain = 0.5 * (np.linalg.eigvalsh(F.T @ F).max() - 1.0)
        J = np.linalg.det(F)
        b = F @ F.T * J ** (-2 / 3)
        deviator = C1 / J * (b - np.trace(b) / 3 * np.eye(3))
        stress = np.sqrt(1.5 * np.sum(deviator**2))
        for kind in ("p99", "max"):
            assert found[f"{name}_green_strain_{kind}"] == pytest.approx(strain, rel=1e-9, abs=1e-12)
            assert found[f"{name}_von_mises_{kind}"] == pytest.approx(stress, rel=1e-9, abs=1e-7)


def test_a_turned_leaflet_has_no_strain(valve):
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])
    found = deformed(valve, (turn, np.eye(3), turn.T))
    assert np.abs([v for k, v in found.items() if "strain" in k]).max() < 1e-12


def test_the_volumes_of_the_points_are_that_of_the_leaflet(valve):
    solid, _ = valve
    stress = stress_of_structure(solid, quadrature_degree=3)
    whole = solid.comm.allreduce(stress.point_volumes().sum())
    assert whole == pytest.approx(solid.reference_volume, rel=1e-12)


def test_the_percentile_is_of_the_volume_not_of_the_points():
    rng = np.random.default_rng(1)
    values = rng.permutation(np.linspace(0.0, 1.0, 2001))
    assert percentile(values, np.ones(2001)) == pytest.approx(SHARE, abs=1e-3)
    # A quarter of the volume holds half of the points.
    values, weights = np.array([1.0, 2.0, 3.0, 4.0]), np.array([3.0, 3.0, 1.0, 1.0])
    assert percentile(values, weights, 0.75) == 2.0
    assert percentile(values, weights, 0.76) == 3.0
    assert percentile(values, weights, 1.0) == 4.0
