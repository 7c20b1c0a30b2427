"""Fit a leaflet's material to planar biaxial tests (S1-S3, Figure S1).

fit_biaxial("tests.csv", "hgo").summary()
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting import planar
from valvefsi.fitting.biaxial_problem import Biaxial, biaxial_problem
from valvefsi.fitting.biaxial_records import BiaxialData, Reading, read_biaxial
from valvefsi.fitting.biaxial_results import BiaxialFit
from valvefsi.fitting.least_squares import LOSSES, Fit, fit
from valvefsi.fitting.planar_hgo import HGO, KINDS

MODELS = ("hgo", "lee_sacks", "fung", "may_newman_yin", "neo_hookean", "mooney_rivlin")
"""Materials that have a planar closed form."""
WEIGHTS = ("unit", "balanced")


@dataclass(frozen=True, kw_only=True)
class BiaxialOptions:
    """What is fitted, and how.

    Args:
        families: Families of fibres of ``hgo``: ``1``, ``2``, ``2-kappas`` or ``symmetric``, see `HGO`.
        fibre_angle: Angle of the fibres to axis 1 [deg]; None to fit it.
        fix: Values of parameters that are held, in their unit.
        bounds: Bounds of parameters, in their unit.
        protocols: Names of the protocols that are fitted, the others are predicted; None for all.
        weights: ``unit``, or ``balanced``: each protocol and component weighs the same.
        loss: Loss of `scipy.optimize.least_squares`; all but ``linear`` count outliers less.
        loss_scale: Residual at which the loss turns from squares [kPa].
        offsets: Fit an offset of the stretch for each protocol and axis (preconditioning).
        starts: Number of starts.
        seed: Seed of the starts and of the bootstrap.
        draws: Draws of the bootstrap over protocols, 0 for none.
        profiles: Compute profile likelihoods.
        compare: Other materials to compare with.
    """

    families: str = "1"
    fibre_angle: float | None = None
    fix: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    protocols: Sequence[str] | None = None
    weights: str = "unit"
    loss: str = "linear"
    loss_scale: float = 1.0
    offsets: bool = False
    starts: int = 32
    seed: int = 0
    draws: int = 50
    profiles: bool = True
    compare: Sequence[str] = ()

    def __post_init__(self) -> None:
        for key, known in (("families", KINDS), ("weights", WEIGHTS), ("loss", LOSSES)):
            if str(getattr(self, key)) not in known:
                raise CaseError(f"expected one of {', '.join(known)}", key=key, value=getattr(self, key))
        object.__setattr__(self, "families", str(self.families))
        if self.starts < 1:
            raise CaseError("expected at least one start", key="starts", value=self.starts)
        if not self.loss_scale > 0:
            raise CaseError("expected a positive number", key="loss_scale", value=self.loss_scale)
        if self.fibre_angle is not None and not np.isfinite(self.fibre_angle):
            raise CaseError("expected a finite angle, or free", key="fibre_angle", value=self.fibre_angle)


def fit_biaxial(
    data: BiaxialData | str | Path | Sequence[str | Path],
    model: str = "hgo",
    *,
    reading: Reading | None = None,
    **options: object,
) -> BiaxialFit:
    """Fit a material to biaxial tests.

    Args:
        data: The records, or the file or files that hold them.
        model: One of `MODELS`.
        reading: How files are to be read where their header does not say.
        options: See `BiaxialOptions`.

    Returns:
        The fit; ``summary()`` says it in words, ``write(folder)`` leaves files behind.

    Raises:
        CaseError: The data or an option cannot be used.
        ConvergenceError: No start led to a finite cost.
    """
    known = [item.name for item in fields(BiaxialOptions)]
    for key in options:
        if key not in known:
            raise CaseError(f"unknown option, expected one of {', '.join(known)}", key=key)
    chosen = BiaxialOptions(**options)
    records = data if isinstance(data, BiaxialData) else read_biaxial(data, reading)
    used = records if chosen.protocols is None else records.select(chosen.protocols)
    fitted, problem = _fit_model(used, model, chosen)
    return BiaxialFit.of(
        fitted, problem, records=records, options=chosen, others=_others(used, model, chosen)
    )


def planar_material(model: str, extent: planar.Extent, options: BiaxialOptions) -> planar.PlanarMaterial:
    """Return the planar form of a material.

    Raises:
        CaseError: The material is not known, or has no planar closed form here.
    """
    name = model.strip().lower().replace("-", "_")
    if name in planar.SIMPLE:
        return planar.SIMPLE[name]()
    if name == "hgo":
        return HGO(families=options.families, angle=options.fibre_angle)
    if name == "may_newman_yin":
        return planar.MayNewmanYin(angle=options.fibre_angle)
    if name == "fung":
        angle = options.fibre_angle
        if angle is None and not extent.shear:
            angle = 0.0
        turned = angle is None or abs(np.sin(2 * angle * planar.DEGREE)) > 1e-6
        return planar.Fung(angle=angle, shear=extent.shear or turned)
    raise CaseError(f"no such planar material, expected one of {', '.join(MODELS)}", key="model", value=model)


def _fit_model(data: BiaxialData, model: str, options: BiaxialOptions) -> tuple[Fit, Biaxial]:
    """Return the fit of one material and what was fitted."""
    state = planar.PlanarState.of(data.F)
    extent = planar.Extent.of(state, float(np.abs(data.stress).max()))
    material = planar_material(model, extent, options)
    problem = biaxial_problem(data, material, extent, options)
    found = fit(
        problem.problem,
        starts=options.starts,
        seed=options.seed,
        loss=options.loss,
        loss_scale=options.loss_scale,
    )
    return problem.canonical(found), problem


def _others(data: BiaxialData, model: str, options: BiaxialOptions) -> dict[str, Fit]:
    """Return the fits of the materials to compare with; what was fixed or bounded counts for the first only."""
    found = {}
    plain = replace(options, fix={}, bounds={})
    for name in options.compare:
        key = name.strip().lower().replace("-", "_")
        if key != model.strip().lower().replace("-", "_"):
            found[key] = _fit_model(data, key, plain)[0]
    return found
