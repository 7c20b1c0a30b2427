"""What every fit leaves behind: its numbers with their uncertainty, ``fit.json``, profiles, a table, TOML."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

import valvefsi
from valvefsi.fitting import uncertainty
from valvefsi.fitting.least_squares import Fit, Notify
from valvefsi.fitting.profiles import Profile, profiles
from valvefsi.fitting.uncertainty import ALIKE, Bootstrap, HeldOut, Linear
from valvefsi.io.folder import sha256, write_text
from valvefsi.types import Array

PACKAGES = ("numpy", "scipy")
HEADINGS = ("parameter", "value", "unit", "std", "95 % interval", "verdict")
FEW = 0.25
"""Part of the starts below which it is said that few reached the best."""
NARROWER = 1.25
"""Profile over covariance interval from which the difference is said."""


@dataclass(frozen=True, kw_only=True)
class Assessment:
    """A fit with everything that is known about its uncertainty.

    Attributes:
        fit: The fit.
        linear: Covariance, correlation, singular values.
        profiles: Profile of each free parameter, empty where not asked for.
        verdicts: Plain verdict for each free parameter.
        bootstrap: Refits to blocks drawn with replacement, None with fewer than three blocks.
        held_out: Prediction of each block by the others.
        alike: Number of neighbouring observations over which residuals are alike, 1 for independent ones.
    """

    fit: Fit
    linear: Linear
    profiles: tuple[Profile, ...]
    verdicts: Mapping[str, str]
    bootstrap: Bootstrap | None
    held_out: tuple[HeldOut, ...]
    alike: float

    def remarks(self) -> list[str]:
        """Return what must be said before the numbers: few starts at the best, systematic residuals."""
        fit, lines = self.fit, []
        if len(fit.starts) > 1 and fit.reached <= max(1, FEW * len(fit.starts)):
            lines.append(
                f"warning: {fit.reached} of {len(fit.starts)} starts reached the best cost; there may be a better one: "
                "raise --starts, narrow --bounds or --fix a parameter"
            )
        if not any(start.converged and start.cost <= fit.cost for start in fit.starts):
            lines.append(
                "warning: the best start has not met the solver's tolerance, its cost may fall further: narrow "
                "--bounds or --fix a parameter"
            )
        if self.alike > ALIKE:
            lines.append(
                f"warning: neighbouring residuals are alike (over about {self.alike:.0f} samples): the model misses "
                "the data systematically, and intervals for independent errors are too narrow, by about "
                f"{np.sqrt(self.alike):.1f} times"
            )
        return lines

    def covariance(self) -> str:
        """Return what the covariance-based intervals are worth beside the profiles', nothing where they agree."""
        ratios = []
        for k, walked in enumerate(self.profiles):
            width = float(np.diff(self.linear.intervals[k])[0])
            ratio = (walked.interval[1] - walked.interval[0]) / width if width > 0 else np.inf
            if not 1 / NARROWER < ratio < NARROWER and not np.isnan(width):
                ratios.append(f"{walked.name} {ratio:.2g}")
        if not ratios:
            return ""
        return (
            "intervals are profile likelihoods; std and the covariance's intervals suppose a linear model, which this "
            f"is not: width of the profile's interval over the covariance's: {', '.join(ratios)}"
        )


def assess(
    fit: Fit,
    *,
    with_profiles: bool = True,
    draws: int = 50,
    seed: int = 0,
    doubt: str = "",
    notify: Notify | None = None,
) -> Assessment:
    """Return everything that is known about the uncertainty of a fit.

    Args:
        fit: The fit.
        with_profiles: Compute profiles.
        draws: Draws of the bootstrap, 0 for none.
        seed: Seed of the bootstrap.
        doubt: Why no parameter can be called identified; systematic residuals are a reason of their own.
        notify: Called as the work goes on.
    """
    linear = uncertainty.linearised(fit)
    walked = profiles(fit, notify=notify) if with_profiles else ()
    alike = uncertainty.correlation_length(fit.problem.w * fit.residual, fit.problem.series)
    doubt = doubt or ("residuals are systematic" if alike > ALIKE else "")
    return Assessment(
        fit=fit,
        linear=linear,
        profiles=walked,
        verdicts=uncertainty.verdicts(fit, linear, walked, doubt=doubt),
        bootstrap=uncertainty.bootstrap(fit, draws=draws, seed=seed, notify=notify) if draws else None,
        held_out=uncertainty.leave_one_out(fit),
        alike=alike,
    )


@dataclass(frozen=True, kw_only=True)
class Report:
    """A fit as it is written and printed.

    Attributes:
        kind: ``biaxial`` or ``windkessel``.
        model: Name of the material or circuit.
        assessment: The fit and its uncertainty.
        files: The data files.
        notes: Things to say first, one line each (inferred units, repairs, caveats).
        extra: Further entries of ``fit.json``.
        more: Further lines below the table.
    """

    kind: str
    model: str
    assessment: Assessment
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    more: tuple[str, ...] = ()

    @property
    def fit(self) -> Fit:
        """The fit."""
        return self.assessment.fit

    def parameters(self) -> dict[str, dict[str, Any]]:
        """Return value, unit, deviation, intervals and verdict of each parameter by name."""
        entries = {}
        assessment, linear = self.assessment, self.assessment.linear
        by_name = {p.name: p for p in assessment.profiles}
        for parameter, value in zip(self.fit.problem.parameters, self.fit.values, strict=True):
            entry: dict[str, Any] = {"value": float(value), "unit": parameter.unit}
            if parameter.value is not None:
                entries[parameter.name] = {**entry, "std": None, "ci95": None, "verdict": "held"}
                continue
            k = linear.names.index(parameter.name)
            covariance = linear.intervals[k].tolist()
            walked = by_name.get(parameter.name)
            entry |= {
                "std": float(linear.std[k]),
                "ci95": list(walked.interval) if walked else covariance,
                "ci95_method": "profile likelihood" if walked else "covariance",
                "ci95_covariance": covariance,
                "bounds": list(parameter.bounds),
            }
            if walked:
                entry["ci95_ends_at_bound"] = list(walked.open_ends)
            if assessment.bootstrap is not None:
                entry["ci95_bootstrap"] = assessment.bootstrap.intervals[k].tolist()
            entries[parameter.name] = {**entry, "verdict": assessment.verdicts[parameter.name]}
        return entries

    def as_dict(self) -> dict[str, Any]:
        """Return what ``fit.json`` holds; numbers that do not exist are null."""
        fit, linear = self.fit, self.assessment.linear
        problem, blocks = fit.problem, {}
        for block in np.unique(problem.block_of):
            here = problem.block_of == block
            blocks[problem.block_names.get(int(block), str(block))] = measures(
                problem.data[here], fit.curve[here]
            )
        data = {
            "kind": self.kind,
            "model": self.model,
            "parameters": self.parameters(),
            "cost": fit.cost,
            "half_sum_of_squares": fit.half_squares,
            **measures(problem.data, fit.curve),
            **uncertainty.information(fit),
            "n_points": len(problem.data),
            "n_free": len(problem.free),
            "data_unit": problem.unit,
            "blocks": blocks,
            "correlation": {"names": linear.names, "matrix": linear.correlation},
            "singular_values": linear.singular_values,
            "residual_std": linear.sigma,
            "residual_correlation_samples": self.assessment.alike,
            "held_out": [vars(block) for block in self.assessment.held_out],
            "starts": {
                "count": len(fit.starts),
                "converged": fit.converged,
                "reached_best": fit.reached,
                "seed": fit.seed,
                "costs": [start.cost for start in fit.starts],
            },
            "loss": problem.loss,
            **self.extra,
            "notes": self.notes,
            **provenance(self.files),
            "seconds": fit.seconds,
        }
        return dict(plain(data))

    def rows(self) -> list[tuple[str, ...]]:
        """Return name, value, unit, deviation, interval and verdict of each parameter as text."""
        rows: list[tuple[str, ...]] = []
        for name, entry in self.parameters().items():
            deviation, ends = entry["std"], entry["ci95"]
            interval = "" if ends is None else f"{number(ends[0])} ... {number(ends[1])}"
            spread = "" if deviation is None else number(deviation)
            rows.append((name, number(entry["value"]), entry["unit"], spread, interval, entry["verdict"]))
        return rows

    def lines(self) -> list[str]:
        """Return what is said below the table."""
        fit, size = self.fit, measures(self.fit.problem.data, self.fit.curve)
        singular = self.assessment.linear.singular_values
        lines = [
            f"half sum of squares {fit.half_squares:.8g} ({fit.problem.unit})^2, R2 {size['r_squared']:.5f}, "
            f"NRMSE {100 * size['nrmse']:.3g} %, relative L2 {100 * size['relative_l2']:.3g} %, "
            f"Linf {100 * size['relative_linf']:.3g} %, {len(fit.problem.data)} numbers",
            f"{fit.reached} of {len(fit.starts)} starts reached it, {fit.converged} met the solver's tolerance "
            f"({fit.seconds:.1f} s)",
        ]
        if len(singular) > 1:
            lines.append(f"condition of the scaled Jacobian {singular[0] / max(singular[-1], 1e-300):.3g}")
        if self.assessment.held_out:
            parts = [f"{b.block}: {100 * b.relative_l2:.1f} %" for b in self.assessment.held_out]
            lines.append("error on each block predicted by the others, relative L2: " + ", ".join(parts))
        return [*lines, *filter(None, [self.assessment.covariance()]), *self.more]

    def summary(self) -> str:
        """Return the table and what belongs to it as text."""
        rows = [HEADINGS, *self.rows()]
        widths = [max(len(row[k]) for row in rows) for k in range(len(HEADINGS))]
        table = [
            "  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows
        ]
        return "\n".join([f"{self.kind} fit, {self.model}", *self.notes, *table, *self.lines()])

    def write(self, out: Path) -> Path:
        """Write ``fit.json`` and, where there are profiles, ``profiles.png``; return the path of the first."""
        if self.assessment.profiles:
            self._draw_profiles(out / "profiles.png")
        return write_json(out / "fit.json", self.as_dict())

    def _draw_profiles(self, path: Path) -> Path:
        from valvefsi.post.plots.fit import ProfilePanel, profiles_picture

        fit, parameters = self.fit, {p.name: p for p in self.fit.problem.parameters}
        least = max(fit.cost, 1e-300)
        panels = [
            ProfilePanel(
                name=walked.name,
                unit=parameters[walked.name].unit,
                values=walked.values,
                costs=walked.costs / least,
                threshold=walked.threshold / least,
                best=fit.named[walked.name],
                interval=walked.interval,
                verdict=self.assessment.verdicts[walked.name],
                log=parameters[walked.name].log,
                bounds=walked.open_ends,
            )
            for walked in self.assessment.profiles
        ]
        title = f"Profile likelihood, {self.model.replace('_', '-')}"
        caption = "dots: computed, dashed: 95 % threshold, shaded: the interval it leaves"
        if any(any(panel.bounds) for panel in panels):
            caption += ", dotted: a bound of the parameter"
        return profiles_picture(path, panels, title=title, caption=caption)


def measures(data: Array, curve: Array, t: Array | None = None) -> dict[str, float]:
    """Return how far a curve is from data.

    relative L2 = |curve - data|_2 / |data|_2, relative Linf alike; over time by the trapezoidal rule      (S24)
    NRMSE = rms(curve - data) / (max data - min data), R2 = 1 - sum (curve - data)^2 / sum (data - mean)^2

    Args:
        data: Observations, ``(m,)``.
        curve: The model there, ``(m,)``.
        t: Times, ``(m,)`` [s], for the two norms over time alone; without them all four measures.
    """
    error, largest = curve - data, np.abs(data).max()
    linf = {"relative_linf": _over(np.abs(error).max(), largest)}
    if t is not None:
        squares = np.trapezoid(error**2, t), np.trapezoid(data**2, t)
        return {"relative_l2": _over(*np.sqrt(squares)), **linf}
    spread = float(np.sum((data - data.mean()) ** 2))
    return {
        "r_squared": float(1 - np.sum(error**2) / spread) if spread > 0 else float("nan"),
        "nrmse": _over(np.sqrt(np.mean(error**2)), np.ptp(data)),
        "relative_l2": _over(float(np.linalg.norm(error)), float(np.linalg.norm(data))),
        **linf,
    }


def provenance(files: Sequence[Path]) -> dict[str, Any]:
    """Return the files a result is from, with their hashes, and the versions that belong to it."""
    versions = {"valvefsi": valvefsi.__version__, "python": platform.python_version()}
    versions |= {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"data": [{"file": path.name, "sha256": sha256(path)} for path in files], "versions": versions}


def number(value: float | None) -> str:
    """Return a number as people read it."""
    return "-" if value is None or not np.isfinite(value) else f"{value:.5g}"


def write_json(path: Path, data: Any) -> Path:
    """Write JSON; numbers that are not finite become null."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(plain(data), indent=2) + "\n")
    return path


def toml(table: Mapping[str, Any], remarks: Sequence[str] = ()) -> str:
    """Return TOML with remarks above it."""
    return "".join(f"# {line}\n" for line in remarks) + tomli_w.dumps(table)


def plain(value: Any) -> Any:
    """Return what JSON can hold: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, int | str) or value is None else str(value)


def _over(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else float("nan")
