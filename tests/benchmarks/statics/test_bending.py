"""A strip of solid-shell elements beside incompressible ones, and linear hexahedra beside both."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.statics.bending import REFERENCE, Bending, _deflection
from valvefsi.errors import CaseError
from valvefsi.solid import statics
from valvefsi.solid.statics import SolidShell, TaylorHood

WORLD = MPI.COMM_WORLD


def test_a_strip_of_solid_shells_bends_as_it_should_and_one_of_linear_hexahedra_locks():
    (strip,) = Bending(edge=1.0).runs()
    expected = _deflection(strip, REFERENCE, TaylorHood(), WORLD)
    shell = expected / _deflection(strip, strip.counts, SolidShell(kappa=strip.kappa), WORLD)
    linear = statics.NearlyIncompressible(degree=1, kappa=strip.kappa)
    assert shell == pytest.approx(1.0, abs=0.05)
    assert expected / _deflection(strip, strip.counts, linear, WORLD) > 5.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": "round"}, "--radius = 'round': expected a number, or flat"),
        ({"thickness": 8.0}, "expected a length of at most 5 mm"),
        ({"material": "leather"}, "expected one of bovine"),
    ],
)
def test_what_is_no_strip_is_refused(options, message):
    with pytest.raises(CaseError, match=message):
        Bending(**options)
