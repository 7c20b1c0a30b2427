"""The hand-written loop over linear tetrahedra of HGO material against the weak form."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box
from valvefsi.solid.elements.force_loop import HgoLoop
from valvefsi.solid.materials import NeoHookean, fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.structure import Discretisation, Structure

pytestmark = pytest.mark.serial
MATRIX = {"c10": 100.0, "c01": 2.0}
FAMILIES = [
    FibreFamily(k1=300.0, k2=3.0, kappa=0.2, fibre="around"),
    FibreFamily(k1=200.0, k2=1.0, kappa=0.0, fibre=(1.0, 2.0, -1.0)),
]


def make(material, cell="tetrahedron", **options):
    mesh = box(MPI.COMM_SELF, elements=(3, 2, 4), cell=cell)
    mesh = mesh.with_fibres(around=fibres.circumferential(mesh, through=(2.0, 2.0, 0.0), angle=30.0))
    return Structure(mesh, material, discretisation=Discretisation(**options))


def deformed(solid, size=0.1):
    return solid.X + size * np.sin(3 * solid.X[:, [1, 2, 0]] + solid.X)


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("kappa", [None, 0.0])
def test_the_loop_gives_the_forces_of_the_weak_form(count, kappa):
    solid = make(HGO(**MATRIX, families=FAMILIES[:count]), kappa=kappa)
    chi = deformed(solid)
    assembled, loop = solid.elasticity.force(chi), HgoLoop(solid).force(chi)
    np.testing.assert_allclose(loop, assembled, atol=1e-11 * np.abs(assembled).max())
    assert np.abs(HgoLoop(solid).force(solid.X)).max() < 1e-9


def test_an_inverted_cell_is_nan_in_both():
    solid = make(HGO(**MATRIX, families=FAMILIES))
    chi = solid.X * [-1.0, 1.0, 1.0]
    assert np.isnan(HgoLoop(solid).force(chi)).all()
    assert np.isnan(solid.elasticity.force(chi)).all()


def test_one_quadrature_point_is_exact_where_the_cell_is_even():
    # The weak form takes one point on linear tetrahedra; a fibre field of degree 1, constant, keeps it from that.
    solid = make(HGO(**MATRIX, families=FAMILIES[1:]))
    straight = fibres.from_function(solid.mesh, lambda X: np.ones((len(X), 3)), degree=1)
    full = Structure(
        solid.mesh.with_fibres(straight=straight),
        solid.material,
        discretisation=Discretisation(quadrature_degree=4),
    )
    chi = deformed(solid)
    assembled = solid.elasticity.force(chi).copy()
    np.testing.assert_allclose(full.elasticity.force(chi), assembled, atol=1e-11 * np.abs(assembled).max())
    assert full.jacobian(chi).size > solid.jacobian(chi).size


def test_what_the_loop_cannot_do_is_refused():
    material = HGO(**MATRIX, families=FAMILIES)
    for solid in (
        make(NeoHookean(c1=1.0)),
        make(material, cell="hexahedron"),
        make(material, degree=2),
        make(material, volumetric="quadratic"),
    ):
        with pytest.raises(CaseError, match="the loop is for linear tetrahedra"):
            HgoLoop(solid)
