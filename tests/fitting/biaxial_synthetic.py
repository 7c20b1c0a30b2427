"""Synthetic biaxial tests for the fits: known constants, protocols of several stretch ratios, seeded noise."""

from __future__ import annotations

import numpy as np

from valvefsi.fitting.biaxial_problem import measured_from_pk2
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.planar import PlanarState

RATIOS = ((1.0, 1.0), (1.0, 0.6), (0.6, 1.0), (1.0, 0.3), (0.3, 1.0))


def records_of(material, values, *, noise=0.0, seed=0, count=15, reach=(0.18, 0.3), shear=0.0):
    """Return records of a material; ``noise`` is a part of the largest stress."""
    F, protocol = [], []
    for number, (one, two) in enumerate(RATIOS):
        for s in np.linspace(0, 1, count):
            F.append([[1 + reach[0] * one * s, shear * s], [0.5 * shear * s, 1 + reach[1] * two * s]])
            protocol.append(number)
    F, protocol = np.array(F), np.array(protocol)
    empty = np.zeros((len(F), 2))
    names = tuple(str(k + 1) for k in range(len(RATIOS)))
    data = BiaxialData(
        F=F, measure="pk1", components=("11", "22"), stress=empty, protocol=protocol, names=names
    )
    S = material.stress(np.asarray(values, float), PlanarState.of(F))
    stress = np.einsum("knj,jn->nk", measured_from_pk2(data, F), S)
    rng = np.random.default_rng(seed)
    stress = stress + noise * np.abs(stress).max() * rng.standard_normal(stress.shape)
    return BiaxialData(
        F=F, measure="pk1", components=("11", "22"), stress=stress, protocol=protocol, names=names
    )
