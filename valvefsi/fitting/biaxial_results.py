"""What a biaxial fit leaves behind: report, predictions, comparison, ``material.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from valvefsi.fitting import uncertainty
from valvefsi.fitting.biaxial_problem import Biaxial
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.least_squares import Fit
from valvefsi.fitting.planar_stability import Stability, stability
from valvefsi.fitting.report import Report, assess, measures, number, sha256


class Choices(Protocol):
    """What of the options matters here."""

    draws: int
    profiles: bool
    seed: int


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
    predictions: Mapping[str, Mapping[str, float]]
    comparison: Mapping[str, Mapping[str, float]]
    stability: Stability

    @classmethod
    def of(
        cls, fit: Fit, problem: Biaxial, *, records: BiaxialData, options: Choices, others: Mapping[str, Fit]
    ) -> BiaxialFit:
        """Return a fit with everything that is said about it."""
        predictions = _predictions(fit, problem, records)
        comparison = {name: _compared(other) for name, other in others.items()}
        if others:
            comparison = {problem.material.model: _compared(fit), **comparison}
        checked = stability(problem.material, fit.values[: problem.count], problem.data.F)
        report = Report(
            kind="biaxial",
            model=problem.material.model,
            assessment=assess(fit, with_profiles=options.profiles, draws=options.draws, seed=options.seed),
            files=records.files,
            notes=(*records.notes, *_remarks(fit, problem)),
            extra={
                "protocols": list(problem.data.names),
                "measure": problem.data.measure,
                "prediction": predictions,
                "comparison": comparison,
                "stability": checked.as_dict(),
            },
        )
        return cls(
            fit=fit,
            problem=problem,
            report=report,
            records=records,
            predictions=predictions,
            comparison=comparison,
            stability=checked,
        )

    @property
    def parameters(self) -> dict[str, float]:
        """Values by name: stresses in kPa, angles in degrees."""
        return self.fit.named

    def predict(self, data: BiaxialData) -> NDArray:
        """Return the stress at the deformations of other records, ``(n, components)`` [kPa]."""
        return self.problem.predict(self.fit.values, data)

    def lines(self) -> list[str]:
        """Return what is said below the table of parameters."""
        said = self.report.lines()
        for name, size in self.predictions.items():
            said.append(
                f"protocol {name}, predicted: relative L2 {100 * size['relative_l2']:.3g} %, "
                f"R2 {size['r_squared']:.4f}"
            )
        for name, size in self.comparison.items():
            said.append(
                f"{name}: half sum of squares {size['half_sum_of_squares']:.6g}, {size['n_free']} parameters, "
                f"AICc {size['aicc']:.5g}, BIC {size['bic']:.5g}, held-out error {100 * size['held_out']:.3g} %"
            )
        return [*said, *self.stability.lines()]

    def summary(self) -> str:
        """Return the fit in words and a table."""
        head = self.report.summary().splitlines()
        head = head[: len(head) - len(self.report.lines())]
        return "\n".join([*head, *self.lines()])

    def material_toml(self) -> str:
        """Return the material as a case file takes it."""
        own = {p.name: float(v) for p, v in zip(self.fit.problem.parameters, self.fit.values, strict=True)}
        units = {p.name: p.unit for p in self.fit.problem.parameters}
        entries = self.problem.material.entries({k: v for k, v in own.items() if not k.startswith("offset")})
        sources = (
            ", ".join(f"{path.name} (sha256 {sha256(path)[:12]})" for path in self.records.files) or "arrays"
        )
        lines = [
            f"# fitted to {sources}, protocols {', '.join(self.problem.data.names)}",
            f"# R2 {measures(self.fit.problem.data, self.fit.curve)['r_squared']:.5f}; angles are to axis 1 of "
            "the test; a mesh with curved fibres names a fibre field instead",
            f'model = "{self.problem.material.model}"',
        ]
        families = entries.pop("families", [])
        lines += [_entry(name, value, units) for name, value in entries.items()]
        for family in families:
            lines += ["", "[[families]]", *(_entry(name, value, units) for name, value in family.items())]
        return "\n".join(lines) + "\n"

    def write(self, out: str | Path) -> Path:
        """Write ``fit.json``, ``material.toml``, ``fit.png`` and ``profiles.png``; return the folder."""
        from valvefsi.fitting.biaxial_pictures import draw_fit
        from valvefsi.fitting.fit_pictures import draw_profiles

        folder = Path(out)
        self.report.write(folder)
        (folder / "material.toml").write_text(self.material_toml(), encoding="utf-8")
        draw_fit(folder / "fit.png", self)
        if self.report.assessment.profiles:
            draw_profiles(folder / "profiles.png", self.report)
        return folder


def _entry(name: str, value: object, units: Mapping[str, str]) -> str:
    """Return a line of TOML: a stress with its unit, a bare number otherwise."""
    stress = units.get(name, units.get(f"{name}_1", "-")) == "kPa"
    return f'{name} = "{value!r} kPa"' if stress else f"{name} = {float(value)!r}"


def _predictions(fit: Fit, problem: Biaxial, records: BiaxialData) -> dict[str, dict[str, float]]:
    """Return the measures of the protocols that were not fitted."""
    left = [name for name in records.names if name not in problem.data.names]
    found = {}
    for name in left:
        part = records.select([name])
        found[name] = measures(part.stress.T.ravel(), problem.predict(fit.values, part).T.ravel())
    return found


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
    said = []
    if problem.material.model == "fung" and not getattr(problem.material, "shear", True):
        said.append("no shear in the data: a4 is that of an isotropic sheet, a1 + a2 - 2 a3")
    names = [p.name for p in fit.problem.parameters]
    if (
        "angle" in names
        and not problem.data.shear
        and fit.problem.parameters[names.index("angle")].value is None
    ):
        said.append(
            f"without shear in the data the fibres may lie at +{number(fit.named['angle'])} or at minus that angle"
        )
    return said
