"""What every fit leaves behind: its numbers with their uncertainty, ``fit.json`` and a table."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import valvefsi
from valvefsi.fitting import uncertainty
from valvefsi.fitting.least_squares import Fit
from valvefsi.fitting.uncertainty import Bootstrap, HeldOut, Linear, Profile

PACKAGES = ("numpy", "scipy")


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
    """

    fit: Fit
    linear: Linear
    profiles: tuple[Profile, ...]
    verdicts: Mapping[str, str]
    bootstrap: Bootstrap | None
    held_out: tuple[HeldOut, ...]


def assess(fit: Fit, *, with_profiles: bool = True, draws: int = 50, seed: int = 0) -> Assessment:
    """Return everything that is known about the uncertainty of a fit.

    Args:
        fit: The fit.
        with_profiles: Compute profiles.
        draws: Draws of the bootstrap, 0 for none.
        seed: Seed of the bootstrap.
    """
    linear = uncertainty.linearised(fit)
    profiles = uncertainty.profiles(fit) if with_profiles else ()
    return Assessment(
        fit=fit,
        linear=linear,
        profiles=profiles,
        verdicts=uncertainty.verdicts(fit, linear, profiles),
        bootstrap=uncertainty.bootstrap(fit, draws=draws, seed=seed) if draws else None,
        held_out=uncertainty.leave_one_out(fit),
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
    """

    kind: str
    model: str
    assessment: Assessment
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()
    extra: Mapping[str, object] = field(default_factory=dict)

    @property
    def fit(self) -> Fit:
        """The fit."""
        return self.assessment.fit

    def parameters(self) -> dict[str, dict[str, object]]:
        """Return value, unit, deviation, intervals and verdict of each parameter by name."""
        found = {}
        assessment, linear = self.assessment, self.assessment.linear
        profiles = {p.name: p for p in assessment.profiles}
        for parameter, value in zip(self.fit.problem.parameters, self.fit.values, strict=True):
            entry: dict[str, object] = {"value": float(value), "unit": parameter.unit}
            if parameter.value is not None:
                found[parameter.name] = {**entry, "std": None, "ci95": None, "verdict": "held"}
                continue
            k = linear.names.index(parameter.name)
            covariance = linear.intervals[k].tolist()
            profile = profiles.get(parameter.name)
            entry |= {
                "std": float(linear.std[k]),
                "ci95": list(profile.interval) if profile else covariance,
                "ci95_method": "profile likelihood" if profile else "covariance",
                "ci95_covariance": covariance,
                "bounds": list(parameter.bounds),
            }
            if profile:
                entry["ci95_ends_at_bound"] = list(profile.open_ends)
            if assessment.bootstrap is not None:
                entry["ci95_bootstrap"] = assessment.bootstrap.intervals[k].tolist()
            found[parameter.name] = {**entry, "verdict": assessment.verdicts[parameter.name]}
        return found

    def as_dict(self) -> dict[str, object]:
        """Return what ``fit.json`` holds; numbers that do not exist are null."""
        fit, linear = self.fit, self.assessment.linear
        data = {
            "kind": self.kind,
            "model": self.model,
            "parameters": self.parameters(),
            "cost": fit.cost,
            "half_sum_of_squares": fit.half_squares,
            **measures(fit.problem.data, fit.curve),
            **uncertainty.information(fit),
            "n_points": len(fit.problem.data),
            "n_free": len(fit.problem.free),
            "data_unit": fit.problem.unit,
            "blocks": self._blocks(),
            "correlation": {"names": list(linear.names), "matrix": linear.correlation.tolist()},
            "singular_values": linear.singular_values.tolist(),
            "residual_std": linear.sigma,
            "held_out": [vars(block) for block in self.assessment.held_out],
            "starts": self._starts(),
            "loss": fit.loss,
            **self.extra,
            "notes": list(self.notes),
            "data": [{"file": path.name, "sha256": sha256(path)} for path in self.files],
            "versions": versions(),
            "seconds": fit.seconds,
        }
        return _plain(data)

    def _blocks(self) -> dict[str, dict[str, float]]:
        problem, found = self.fit.problem, {}
        for block in np.unique(problem.block_of):
            here = problem.block_of == block
            name = problem.block_names.get(int(block), str(block))
            found[name] = measures(problem.data[here], self.fit.curve[here])
        return found

    def _starts(self) -> dict[str, object]:
        fit = self.fit
        return {
            "count": len(fit.starts),
            "converged": fit.converged,
            "reached_best": fit.reached,
            "seed": fit.seed,
            "costs": [start.cost for start in fit.starts],
        }

    def rows(self) -> list[tuple[str, str, str, str, str, str]]:
        """Return name, value, unit, deviation, interval and verdict of each parameter as text."""
        found = []
        for name, entry in self.parameters().items():
            deviation, interval = entry["std"], entry["ci95"]
            found.append(
                (
                    name,
                    number(entry["value"]),
                    str(entry["unit"]),
                    "" if deviation is None else number(deviation),
                    "" if interval is None else f"{number(interval[0])} ... {number(interval[1])}",
                    str(entry["verdict"]),
                )
            )
        return found

    def lines(self) -> list[str]:
        """Return what is said below the table."""
        fit, size = self.fit, measures(self.fit.problem.data, self.fit.curve)
        linear = self.assessment.linear
        said = [
            f"half sum of squares {fit.half_squares:.8g} ({fit.problem.unit})^2, R2 {size['r_squared']:.5f}, "
            f"NRMSE {100 * size['nrmse']:.3g} %, relative L2 {100 * size['relative_l2']:.3g} %, "
            f"Linf {100 * size['relative_linf']:.3g} %, {len(fit.problem.data)} numbers",
            f"{fit.reached} of {fit.converged} converged starts reached it ({len(fit.starts)} starts, "
            f"{fit.seconds:.1f} s)",
        ]
        if len(linear.singular_values) > 1:
            condition = linear.singular_values[0] / max(linear.singular_values[-1], 1e-300)
            said.append(f"condition of the scaled Jacobian {condition:.3g}")
        if self.assessment.held_out:
            parts = [f"{b.block}: {100 * b.relative_l2:.1f} %" for b in self.assessment.held_out]
            said.append("error on each block predicted by the others, relative L2: " + ", ".join(parts))
        return said

    def summary(self) -> str:
        """Return the table and what belongs to it as text."""
        heading = ("parameter", "value", "unit", "std", "95 % interval", "verdict")
        rows = [heading, *self.rows()]
        widths = [max(len(row[k]) for row in rows) for k in range(len(heading))]
        table = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        return "\n".join([f"{self.kind} fit, {self.model}", *self.notes, *table, *self.lines()])

    def write(self, out: Path) -> Path:
        """Write ``fit.json`` and return its path."""
        path = Path(out) / "fit.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.as_dict(), indent=2) + "\n", encoding="utf-8")
        return path


def measures(data: NDArray, curve: NDArray) -> dict[str, float]:
    """Return how far a curve is from data.

    relative L2 = |curve - data|_2 / |data|_2, relative Linf alike          (S24)
    NRMSE = rms(curve - data) / (max data - min data), R2 = 1 - sum (curve - data)^2 / sum (data - mean)^2
    """
    error = curve - data
    spread = float(np.sum((data - data.mean()) ** 2))
    return {
        "r_squared": float(1 - np.sum(error**2) / spread) if spread > 0 else float("nan"),
        "nrmse": _over(np.sqrt(np.mean(error**2)), np.ptp(data)),
        "relative_l2": _over(np.linalg.norm(error), np.linalg.norm(data)),
        "relative_linf": _over(np.abs(error).max(), np.abs(data).max()),
    }


def versions() -> dict[str, str]:
    """Return the versions that belong to a result."""
    found = {"valvefsi": valvefsi.__version__, "python": platform.python_version()}
    return found | {name: importlib.metadata.version(name) for name in PACKAGES}


def sha256(path: Path) -> str:
    """Return the hash of a file."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def number(value: float | None) -> str:
    """Return a number as people read it."""
    return "-" if value is None or not np.isfinite(value) else f"{value:.5g}"


def correlated(linear: Linear, above: float = 0.95) -> Sequence[tuple[str, str, float]]:
    """Return the pairs of parameters that are correlated more than ``above``."""
    names, matrix = linear.names, linear.correlation
    pairs = [(i, j) for i in range(len(names)) for j in range(i) if abs(matrix[i, j]) > above]
    return [(names[j], names[i], float(matrix[i, j])) for i, j in pairs]


def _over(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else float("nan")


def _plain(value: object) -> object:
    """Return what JSON can hold: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, int | str | bool) or value is None else str(value)
