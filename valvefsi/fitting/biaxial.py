"""Fit a leaflet's material to planar biaxial tests (S1-S3, Figure S1).

fit_biaxial("tests.csv", "hgo").summary()
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting import planar, uncertainty
from valvefsi.fitting.biaxial_problem import Biaxial, BiaxialOptions
from valvefsi.fitting.biaxial_records import BiaxialData, Reading, read_biaxial
from valvefsi.fitting.least_squares import Fit, Notify, fit
from valvefsi.fitting.planar_hgo import HGO
from valvefsi.fitting.planar_stability import Stability, stability
from valvefsi.fitting.report import Report, assess, measures, number, toml
from valvefsi.io.folder import sha256, write_text
from valvefsi.types import Array

MODELS = ("hgo", "lee_sacks", "fung", "may_newman_yin", "neo_hookean", "mooney_rivlin")
"""Materials that have a planar closed form."""
DIRECTIONS = ("fibre", "sheet")
"""Entries of a material that are directions."""
Measures = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, kw_only=True)
class BiaxialFit:
    """A material fitted to biaxial tests.

    Attributes:
        fit: The least-squares fit.
        problem: Material and records that were fitted.
        report: Its numbers, with their uncertainty.
        records: All records, those that were not fitted included.
        predictions: Measures of each protocol that was not fitted.
        comparison: Measures of each material that was compared.
        stability: Convexity and ellipticity over the range of the data and beyond.
    """

    fit: Fit
    problem: Biaxial
    report: Report
    records: BiaxialData
    predictions: Measures
    comparison: Measures
    stability: Stability

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name: stresses in kPa, angles in degrees."""
        return self.fit.named

    def predict(self, data: BiaxialData) -> Array:
        """Return the stress at the deformations of other records, ``(n, components)`` [kPa]."""
        return self.problem.predict(self.fit.values, data)

    def lines(self) -> list[str]:
        """Return what is said below the table of parameters."""
        return self.report.lines()

    def summary(self) -> str:
        """Return the fit in words and a table."""
        return self.report.summary()

    def material_toml(self) -> str:
        """Return the material as a case file takes it, directions relative to the leaflet's own."""
        units = {p.name: p.unit for p in self.problem.own}
        entries = self.problem.material.entries({name: self.parameters[name] for name in units})
        names = [f"{path.name} (sha256 {sha256(path)[:12]})" for path in self.records.files]
        axis = self.problem.options.axis1
        remarks = [
            f"fitted to {', '.join(names) or 'arrays'}, protocols {', '.join(self.problem.data.names)}",
            f"R2 {measures(self.fit.problem.data, self.fit.curve)['r_squared']:.5f}; axis 1 of the test was taken as "
            + ("the x axis" if axis == "x" else f"the {axis} direction of the leaflet"),
        ]
        return toml({"model": self.problem.material.model, **_entries(entries, units, axis)}, remarks)

    def write(self, out: str | Path) -> Path:
        """Write ``fit.json``, ``material.toml``, ``fit.png`` and ``profiles.png``; return the folder."""
        from valvefsi.fitting.biaxial_pictures import draw_fit

        folder = Path(out)
        self.report.write(folder)
        write_text(folder / "material.toml", self.material_toml())
        draw_fit(folder / "fit.png", self)
        return folder


def fit_biaxial(
    data: BiaxialData | str | Path | Sequence[str | Path],
    model: str = "hgo",
    *,
    reading: Reading | None = None,
    notify: Notify | None = None,
    **options: Any,
) -> BiaxialFit:
    """Fit a material to biaxial tests.

    Args:
        data: The records, or the file or files that hold them.
        model: One of `MODELS`.
        reading: How files are to be read where their header does not say.
        notify: Called as the work goes on.
        options: See `BiaxialOptions`.

    Returns:
        The fit; ``summary()`` says it in words, ``write(folder)`` leaves files behind.

    Raises:
        CaseError: The data or an option cannot be used.
        ConvergenceError: No start led to a finite cost.
    """
    names = [item.name for item in fields(BiaxialOptions)]
    for key in options:
        if key not in names:
            raise CaseError(f"unknown option, expected one of {', '.join(names)}", key=key)
    settings = BiaxialOptions(**options)
    records = data if isinstance(data, BiaxialData) else read_biaxial(data, reading)
    used = records if settings.protocols is None else records.select(settings.protocols)
    best, problem = _fit_model(used, model, settings, notify)
    others, plain = {}, replace(settings, fix={}, bounds={})
    for name in map(_plain, settings.compare):  # what was fixed or bounded counts for the first only
        if name != _plain(model):
            others[name] = _fit_model(used, name, plain, None)[0]
    return _reported(best, problem, records, others, notify)


def planar_material(model: str, data: BiaxialData, options: BiaxialOptions) -> planar.PlanarMaterial:
    """Return the planar form of a material.

    Raises:
        CaseError: The material is not known, or has no planar closed form here.
    """
    name, angle = _plain(model), options.fibre_angle
    if name in planar.SIMPLE:
        return planar.SIMPLE[name]()
    if name == "hgo":
        return HGO(families=options.families, angle=angle)
    if name == "may_newman_yin":
        return planar.MayNewmanYin(angle=angle)
    if name == "fung":
        angle = 0.0 if angle is None and not data.shear else angle
        turned = angle is None or abs(np.sin(2 * angle * planar.DEGREE)) > 1e-6
        return planar.Fung(angle=angle, shear=data.shear or turned)
    raise CaseError(f"no such planar material, expected one of {', '.join(MODELS)}", key="model", value=model)


def _plain(model: str) -> str:
    return model.strip().lower().replace("-", "_")


def _fit_model(
    data: BiaxialData, model: str, options: BiaxialOptions, notify: Notify | None
) -> tuple[Fit, Biaxial]:
    """Return the fit of one material and what was fitted."""
    problem = Biaxial(data=data, material=planar_material(model, data, options), options=options)
    best = fit(problem.problem, starts=options.starts, seed=options.seed, notify=notify)
    return problem.canonical(best), problem


def _reported(
    best: Fit, problem: Biaxial, records: BiaxialData, others: Mapping[str, Fit], notify: Notify | None
) -> BiaxialFit:
    """Return a fit with everything that is said about it."""
    options, data = problem.options, problem.data
    predictions = {}
    for name in (name for name in records.names if name not in data.names):
        part = records.select([name])
        predictions[name] = measures(part.stress.T.ravel(), problem.predict(best.values, part).T.ravel())
    compared = {problem.material.model: best, **others} if others else {}
    comparison = {name: _compared(other) for name, other in compared.items()}
    checked = stability(problem.material, best.values[: problem.count], data.F)
    assessment = assess(
        best, with_profiles=options.profiles, draws=options.draws, seed=options.seed, notify=notify
    )
    report = Report(
        kind="biaxial",
        model=problem.material.model,
        assessment=assessment,
        files=records.files,
        notes=(*records.notes, *_remarks(best, problem), *assessment.remarks()),
        extra={
            "protocols": data.names,
            "measure": data.measure,
            "prediction": predictions,
            "comparison": comparison,
            "stability": checked.as_dict(),
        },
        more=(*_prediction_lines(predictions, comparison), *checked.lines()),
    )
    return BiaxialFit(
        fit=best,
        problem=problem,
        report=report,
        records=records,
        predictions=predictions,
        comparison=comparison,
        stability=checked,
    )


def _prediction_lines(predictions: Measures, comparison: Measures) -> list[str]:
    return [
        f"protocol {name}, predicted: relative L2 {100 * size['relative_l2']:.3g} %, R2 {size['r_squared']:.4f}"
        for name, size in predictions.items()
    ] + [
        f"{name}: half sum of squares {size['half_sum_of_squares']:.6g}, {size['n_free']} parameters, "
        f"AICc {size['aicc']:.5g}, BIC {size['bic']:.5g}, held-out error {100 * size['held_out']:.3g} %"
        for name, size in comparison.items()
    ]


def _compared(fit: Fit) -> dict[str, float]:
    """Return what materials are compared by; the held-out error is over all blocks together."""
    held = uncertainty.leave_one_out(fit)
    problem = fit.problem
    counts = [int(np.sum(problem.block_of == block)) for block in np.unique(problem.block_of)]
    squares = sum(n * h.rmse**2 for n, h in zip(counts, held, strict=False))
    total = float(np.linalg.norm(problem.data))
    return {
        "half_sum_of_squares": fit.half_squares,
        "n_free": len(problem.free),
        "r_squared": measures(problem.data, fit.curve)["r_squared"],
        **uncertainty.information(fit),
        "held_out": float(np.sqrt(squares) / total) if held and total > 0 else float("nan"),
    }


def _remarks(fit: Fit, problem: Biaxial) -> list[str]:
    """Return what should be said of the model and the data together."""
    lines, free = [], [p.name for p in fit.problem.free_parameters]
    if problem.material.model == "fung" and not getattr(problem.material, "shear", True):
        lines.append("no shear in the data: a4 is that of an isotropic sheet, a1 + a2 - 2 a3")
    if "angle" in free and not problem.data.shear:
        angle = number(fit.named["angle"])
        lines.append(f"without shear in the data the fibres may lie at +{angle} or at minus that angle")
    return lines


def _entries(values: Mapping[str, Any], units: Mapping[str, str], axis: str) -> dict[str, Any]:
    """Return the entries of a table of TOML: stresses with their unit, directions relative to the leaflet's own."""
    entries: dict[str, Any] = {}
    for name, value in values.items():
        if name == "families":
            entries[name] = [_entries(family, units, axis) for family in value]
        elif name in DIRECTIONS and axis != "x":
            angle = float(value) if axis == "circumferential" else 90.0 - float(value)
            entries[name] = f"{angle!r} deg from circumferential"
        else:
            stress = units.get(name, units.get(f"{name}_1", "-")) == "kPa"
            entries[name] = f"{float(value)!r} kPa" if stress else float(value)
    return entries
