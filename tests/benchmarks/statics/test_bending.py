"""A strip of solid-shell elements beside incompressible ones, and linear hexahedra beside both."""

from __future__ import annotations

import pytest
from mpi4py import MPI

from valvefsi.benchmarks.statics.bending import (
    REFERENCE,
    Bending,
    Counts,
    Strip,
    clamped,
    deflection,
    energy_of,
    free_to_thin,
    pull,
)
from valvefsi.errors import CaseError
from valvefsi.solid import statics
from valvefsi.solid.statics import SolidShell, TaylorHood

WORLD = MPI.COMM_WORLD


def test_a_strip_of_solid_shells_bends_as_it_should_and_one_of_linear_hexahedra_locks():
    (strip,) = Bending(edge=1.0).runs()
    expected = deflection(strip, REFERENCE, TaylorHood(), WORLD)
    shell = expected / deflection(strip, strip.counts, SolidShell(kappa=strip.kappa), WORLD)
    linear = statics.NearlyIncompressible(degree=1, kappa=strip.kappa)
    assert shell == pytest.approx(1.0, abs=0.05)
    assert expected / deflection(strip, strip.counts, linear, WORLD) > 5.0


def test_a_pulled_strip_is_as_stiff_as_it_should_be_and_a_clamp_that_holds_its_thickness_adds_a_part_of_an_edge():
    strips = [Strip(edge=edge) for edge in (0.1, 0.05)]
    free, held = (
        [energy_of(s, s.counts, SolidShell(kappa=s.kappa), WORLD, fixed=ends(pull)) for s in strips]
        for ends in (free_to_thin, clamped)
    )
    expected = energy_of(strips[0], Counts(10, 4, 1), TaylorHood(), WORLD, fixed=free_to_thin(pull))
    assert free[0] == pytest.approx(expected, rel=0.01)
    assert free[1] == pytest.approx(expected, rel=0.004)
    added = [a / b - 1 for a, b in zip(held, free, strict=True)]
    assert added == pytest.approx(
        [2 * 0.1 * s.edge for s in strips], rel=0.05
    )  # two ends, a tenth of an edge each


@pytest.mark.slow
def test_a_strip_turned_by_a_right_angle_needs_the_pressure_it_should(shared_tmp):
    """A minute and a half."""
    result = Bending(edge=1.0).run(out=shared_tmp)
    ratios = result["quantities"]
    assert ratios["stiffness_ratio"] == pytest.approx(1.0, abs=0.05)
    assert ratios["stiffness_ratio_90"] == pytest.approx(1.0, abs=0.05)
    assert ratios["twist_ratio"] == pytest.approx(1.0, abs=0.05)
    assert result["series"]["layers_1"][1] == pytest.approx(ratios["stiffness_ratio"], rel=1e-6)
    assert min(result["series"]["linear_hexahedra"]) > 3.0  # they lock
    if WORLD.rank == 0:
        assert (shared_tmp / "bending.png").stat().st_size > 0


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
