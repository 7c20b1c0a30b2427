"""A biaxial fit as a picture: stress over stretch, one panel for each protocol."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.fitting.biaxial_problem import measured_from_pk2
from valvefsi.fitting.planar import PlanarState
from valvefsi.fitting.report import measures
from valvefsi.fitting.uncertainty import band
from valvefsi.post.plots.fit import Block, Curve, blocks_picture

if TYPE_CHECKING:
    from valvefsi.fitting.biaxial import BiaxialFit
    from valvefsi.fitting.biaxial_records import BiaxialData
    from valvefsi.types import Array

MEASURES = {
    "pk1": "first Piola-Kirchhoff stress",
    "pk2": "second Piola-Kirchhoff stress",
    "cauchy": "Cauchy stress",
}

SYMBOLS = {"pk1": "P", "pk2": "S", "cauchy": "$\\sigma$"}


def draw_fit(path: Path, result: BiaxialFit) -> Path:
    """Draw data, curves, 95 % bands and residuals of each protocol, those that were predicted last."""
    blocks = []
    fitted = result.problem.data.names
    for name in sorted(result.records.names, key=lambda name: name not in fitted):
        part = result.records.select([name])
        blocks.append(
            Block(title=f"protocol {name}", curves=_curves(result, part, name), predicted=name not in fitted)
        )
    size = measures(result.fit.problem.data, result.fit.curve)
    measure = result.problem.data.measure
    caption = (
        f"{MEASURES[measure]}; R2 {size['r_squared']:.4f}, relative L2 {100 * size['relative_l2']:.2f} %"
    )
    return blocks_picture(
        path,
        blocks,
        x_label="stretch [-]",
        y_label=f"{SYMBOLS[measure]} [kPa]",
        title=f"Biaxial fit, {result.problem.material.model.replace('_', '-')}",
        caption=caption,
    )


def _curves(result: BiaxialFit, part: BiaxialData, name: str) -> list[Curve]:
    """Return the curves of one protocol, a fitted one as it was fitted, offsets included."""
    if name in result.problem.data.names:
        rows = np.tile(
            result.problem.data.protocol == result.problem.data.names.index(name), len(part.components)
        )
        curve = result.fit.curve[rows].reshape(len(part.components), -1)
        wide = band(result.fit, result.report.assessment.linear)[rows].reshape(curve.shape)
    else:
        curve = result.predict(part).T
        wide = band(result.fit, result.report.assessment.linear, lambda v: _by_parameters(result, part, v))
        wide = wide.reshape(curve.shape)
    lengths = np.linalg.norm(part.F, axis=1)
    return [
        Curve(
            name=f"component {component}",
            x=lengths[:, int(component[0]) - 1],
            data=part.stress[:, k],
            curve=curve[k],
            band=wide[k],
        )
        for k, component in enumerate(part.components)
    ]


def _by_parameters(result: BiaxialFit, part: BiaxialData, v: Array) -> Array:
    """Return the derivative of the predicted stress by all parameters, ``(components n, parameters)``."""
    problem = result.problem
    gradient = problem.material.gradient(v[: problem.count], PlanarState.of(part.F))
    rows = np.einsum("knj,pjn->knp", measured_from_pk2(part, part.F), gradient).reshape(-1, problem.count)
    return np.pad(rows, ((0, 0), (0, len(v) - problem.count)))
