"""Quadrature of the volumetric energy: what it frees, and what it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.errors import CaseError
from valvefsi.geometry.shapes import box, rectangle
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Discretisation, Structure

MATERIAL = NeoHookean(c1=3.0)
KAPPA = 5e4


def strip(comm, kind, nu_stab=None, **options):
    """One layer of elements, 4 x 0.5 (x 1) cm."""
    if kind == "quadrilateral":
        mesh = rectangle(comm, lower=(0, 0), size=(4, 0.5), elements=(4, 1), cell=kind)
    else:
        mesh = box(comm, lower=(0, 0, 0), size=(4, 0.5, 1), elements=(4, 1, 1), cell=kind)
    given = {"degree": 1, "kappa": KAPPA, "volumetric": "quadratic"} | options
    return Structure(mesh, MATERIAL, nu_stab=nu_stab, discretisation=Discretisation(**given))


def bent(X, curvature):
    """A strip bent as far as linear elements can: fibres above the middle stretched, those below shortened."""
    chi = X.copy()
    chi[:, 0] += curvature * X[:, 0] * (X[:, 1] - 0.25)
    return chi


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_the_midpoint_rule_frees_bending_from_the_bulk_modulus(comm, kind):
    # J = 1 + c (y - 1/4): the exact volumetric energy is kappa/2 times the integral of c^2 (y - 1/4)^2; at the
    # middles of the elements J = 1, and the energy is that of the isochoric part alone.
    curvature, volume = 0.1, 2.0
    full, freed, soft = (
        strip(comm, kind, **options) for options in ({}, {"volumetric_degree": 1}, {"kappa": 0.0})
    )
    chi = bent(full.X, curvature)
    exact = 0.5 * KAPPA * volume * curvature**2 * 0.5**2 / 12
    assert full.energy(chi) - soft.energy(chi) == pytest.approx(exact, rel=1e-10)
    assert freed.energy(chi) == pytest.approx(soft.energy(chi), rel=1e-12)
    assert np.allclose(freed.force(chi, 0 * chi, 0.0), soft.force(chi, 0 * chi, 0.0), atol=1e-9)


@pytest.mark.parametrize("kind", ["quadrilateral", "hexahedron"])
def test_the_midpoint_rule_keeps_the_whole_stiffness_against_swelling(comm, kind):
    full, freed = strip(comm, kind), strip(comm, kind, volumetric_degree=1)
    chi = full.X.copy()
    chi[:, : full.dim] *= 1.02
    assert freed.energy(chi) == pytest.approx(full.energy(chi), rel=1e-12)
    assert freed.energy(chi) == pytest.approx(0.5 * KAPPA * (1.02**full.dim - 1) ** 2 * 2.0, rel=0.02)


def test_the_part_that_nu_stab_gives_keeps_the_quadrature_of_the_forces(comm):
    held = strip(comm, "hexahedron", nu_stab=0.4, volumetric_degree=1)
    soft = strip(comm, "hexahedron", nu_stab=0.4, kappa=None)
    chi = bent(held.X, 0.1)
    assert soft.kappa == pytest.approx(2 * 3.0 * 1.4 / (3 * 0.2))
    assert held.energy(chi) == pytest.approx(soft.energy(chi), rel=1e-12)
    grown = 1.02 * held.X
    assert held.energy(grown) == pytest.approx(0.5 * KAPPA * (1.02**3 - 1) ** 2 * 2.0, rel=1e-10)


@pytest.mark.parametrize(("degree", "volumetric_degree"), [(1, 1), (2, 3)])
def test_forces_are_minus_the_gradient_of_the_energy(comm, degree, volumetric_degree):
    solid = strip(comm, "hexahedron", degree=degree, volumetric_degree=volumetric_degree)
    X = solid.X
    chi = X + 0.05 * np.sin(
        np.stack([2 * X[:, 1] + X[:, 0], 3 * X[:, 0] - X[:, 1], X[:, 0] * X[:, 2]], axis=1)
    )
    d = np.cos(np.stack([X[:, 2] + X[:, 0], X[:, 0] - X[:, 1], X[:, 1]], axis=1))
    step = 1e-5
    slope = (solid.energy(chi + step * d) - solid.energy(chi - step * d)) / (2 * step)
    work = comm.allreduce(float(np.sum(solid.force(chi, 0 * chi, 0.0) * d)))
    assert work == pytest.approx(-slope, rel=1e-6)


def test_a_degree_above_that_of_the_forces_is_refused():
    with pytest.raises(CaseError, match=r"volumetric_degree.*expected 1 to quadrature_degree = 3"):
        Discretisation(degree=1, volumetric_degree=4)
    with pytest.raises(CaseError, match="volumetric_degree.*give kappa"):
        Discretisation(volumetric_degree=1)
