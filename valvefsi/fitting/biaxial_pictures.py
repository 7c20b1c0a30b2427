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
    from numpy.typing import NDArray

    from valvefsi.fitting.biaxial_records import BiaxialData
    from valvefsi.fitting.biaxial_results import BiaxialFit

MEASURES = {
    "pk1": "first Piola-Kirchhoff stress",
    "pk2": "second Piola-Kirchhoff stress",
    "cauchy": "Cauchy stress",
}

SYMBOLS = {"pk1": "P", "pk2": "S", "cauchy": "$\\sigma$"}


def draw_fit(path: Path, found: BiaxialFit) -> Path:
    """Draw data, curves, 95 % bands and residuals of each protocol, those that were predicted last."""
    blocks = []
    fitted = found.problem.data.names
    for name in sorted(found.records.names, key=lambda name: name not in fitted):
        part = found.records.select([name])
        blocks.append(
            Block(title=f"protocol {name}", curves=_curves(found, part, name), predicted=name not in fitted)
        )
    size = measures(found.fit.problem.data, found.fit.curve)
    measure = found.problem.data.measure
    caption = (
        f"{MEASURES[measure]}; R2 {size['r_squared']:.4f}, relative L2 {100 * size['relative_l2']:.2f} %"
    )
    return blocks_picture(
        path,
        blocks,
        x_label="stretch [-]",
        y_label=f"{SYMBOLS[measure]} [kPa]",
        title=f"Biaxial fit, {found.problem.material.model}",
        caption=caption,
    )


def _curves(found: BiaxialFit, part: BiaxialData, name: str) -> list[Curve]:
    """Return the curves of one protocol, a fitted one as it was fitted, offsets included."""
    if name in found.problem.data.names:
        rows = np.tile(
            found.problem.data.protocol == found.problem.data.names.index(name), len(part.components)
        )
        curve = found.fit.curve[rows].reshape(len(part.components), -1)
        wide = band(found.fit, found.report.assessment.linear)[rows].reshape(curve.shape)
    else:
        curve = found.predict(part).T
        wide = band(found.fit, found.report.assessment.linear, lambda v: _by_parameters(found, part, v))
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


def _by_parameters(found: BiaxialFit, part: BiaxialData, v: NDArray) -> NDArray:
    """Return the derivative of the predicted stress by all parameters, ``(components n, parameters)``."""
    problem = found.problem
    gradient = problem.material.gradient(v[: problem.count], PlanarState.of(part.F))
    rows = np.einsum("knj,pjn->knp", measured_from_pk2(part, part.F), gradient).reshape(-1, problem.count)
    return np.pad(rows, ((0, 0), (0, len(v) - problem.count)))
