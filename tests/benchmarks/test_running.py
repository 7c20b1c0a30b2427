"""What benchmarks that are simulations share: the outline of a strip."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.benchmarks.running import outline_of


def test_the_outline_of_a_strip_encloses_its_area_and_leaves_its_middle_out():
    along, across = (x.ravel() for x in np.meshgrid(np.linspace(0.0, 3.0, 7), np.linspace(-0.2, 0.2, 5)))
    mixed = np.random.default_rng(3).permutation(len(along))
    along, across = along[mixed], across[mixed]
    around = outline_of(along, across, 0.2, 3.0)
    x, y = along[around], across[around]
    assert 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) == pytest.approx(3.0 * 0.4, rel=1e-12)
    assert len(around) == len(set(around)) == 7 + 3 + 7
    assert np.all((np.abs(y) > 0.2 - 1e-12) | (x > 3.0 - 1e-12))
