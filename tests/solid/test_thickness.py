"""The thickness of a body, 2 V / A, on shapes whose volume and surface are known."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from valvefsi.geometry import shapes
from valvefsi.solid.materials import NeoHookean
from valvefsi.solid.structure import Structure


def test_a_plate_has_its_thickness_but_for_its_rim():
    a, t = 2.0, 0.05
    mesh = shapes.box(MPI.COMM_WORLD, lower=(0.0,) * 3, size=(a, a, t), elements=(6, 6, 1))
    found = Structure(mesh, NeoHookean(c1=1.0)).thickness()
    assert found == pytest.approx(2 * a * a * t / (2 * a * a + 4 * a * t), rel=1e-12)


def test_in_two_dimensions_it_is_that_of_a_strip():
    mesh = shapes.rectangle(MPI.COMM_WORLD, lower=(0.0, 0.0), size=(3.0, 0.1), elements=(30, 2))
    found = Structure(mesh, NeoHookean(c1=1.0)).thickness()
    assert found == pytest.approx(2 * 0.3 / 6.2, rel=1e-12)
