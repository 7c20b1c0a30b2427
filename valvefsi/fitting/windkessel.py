"""Fits of the flow loop's circuits to measured pressures and flows (Lee2020, S4-S10).

The circuit is driven by measured flows and pressures, stepped exactly, and its parameters and initial pressures are
fitted to one measured pressure. Inside everything is CGS; parameters are given and reported in mmHg, ml and s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from valvefsi.errors import CaseError
from valvefsi.fitting.least_squares import Fit, Parameter, Problem, fit
from valvefsi.fitting.report import Report, assess, number
from valvefsi.fitting.uncertainty import LOST, Linear
from valvefsi.fitting.waveform_repair import find_outliers, find_period, whole_cycles
from valvefsi.fitting.waveforms import Waveforms, read_waveforms
from valvefsi.fitting.windkessel_models import (
    BOUNDS,
    SIZES,
    STARTS,
    STEP,
    TAIL,
    CircuitModel,
    Simulator,
    find_circuit,
    state_unit,
)
from valvefsi.units import MMHG

SEGMENTS = 8
"""Blocks that a record of fewer than three cycles is divided into for the resampling."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a circuit is fitted.

    Attributes:
        fixed: Parameters and initial states (``p_wk_start``) that are held, in mmHg, ml and s.
        bounds: Bounds that replace the usual ones.
        periodic: Solve for the periodic steady state instead of fitting the initial states.
        period: Length of a cycle [s]; found in the record if not given.
        starts: Number of starts.
        seed: Seed of starts and bootstrap.
        profiles: Compute profile likelihoods.
        draws: Draws of the bootstrap.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    periodic: bool = False
    period: float | None = None
    starts: int = 8
    seed: int = 0
    profiles: bool = True
    draws: int = 50


@dataclass(frozen=True, kw_only=True)
class CircuitReport(Report):
    """The fit of a circuit, with all that its files and pictures need.

    Attributes:
        waves: The record that was fitted.
        simulator: The circuit driven by it.
    """

    waves: Waveforms
    simulator: Simulator

    @property
    def circuit(self) -> object:
        """The fitted circuit, CGS."""
        held = {
            name: v * SIZES[u]
            for name, v, u in zip(self.simulator.names, self.fit.values, self.simulator.units, strict=True)
        }
        return self.simulator.model.kind(**{name: held[name] for name in self.simulator.model.parameters})

    @property
    def start(self) -> dict[str, float]:
        """Initial states [mmHg, ml/s]."""
        first = self.simulator.states(self.fit.values)[0]
        states = self.simulator.system(self.fit.values).states
        return {name: float(x / SIZES[state_unit(name)]) for name, x in zip(states, first, strict=True)}

    def lines(self) -> list[str]:
        """Return what is said below the table."""
        size = self.extra["norms_over_time"]
        parts = f"relative L2 {100 * size['relative_l2']:.4g} %, Linf {100 * size['relative_linf']:.4g} %"
        said = [*super().lines(), f"norms over time (S24): {parts}"]
        for name, entry in self.extra["combinations"].items():
            spread = "not fixed by the data" if entry["std"] is None else f"std {number(entry['std'])}"
            said.append(f"together: {name} = {number(entry['value'])} {entry['unit']}, {spread}")
        return said

    def write(self, out: Path) -> Path:
        """Write ``fit.json``, ``circuit.toml``, ``fit.png`` and ``profiles.png``; return the path of the first."""
        from valvefsi.fitting.windkessel_files import draw_fit, write_circuit

        path = super().write(out)
        write_circuit(self, Path(out) / "circuit.toml")
        draw_fit(self, Path(out))
        return path


def fit_windkessel(
    data: str | Path | Waveforms, circuit: str = "downstream", settings: Settings | None = None
) -> CircuitReport:
    """Fit a circuit to a record.

    Args:
        data: The record, or its file.
        circuit: Name in `CIRCUITS`.
        settings: How.

    Returns:
        The fit; ``print(fit_windkessel(data).summary())`` shows it.

    Raises:
        CaseError: The record lacks what the circuit needs, or a setting cannot be used.
        ConvergenceError: No start led anywhere.
    """
    settings = settings or Settings()
    waves = data if isinstance(data, Waveforms) else read_waveforms(data)
    model = find_circuit(circuit)
    waves.require([*model.inputs, model.output], f"circuit {circuit}")
    notes = list(waves.notes) + _remarks(waves, model)
    waves, period, cycles = _cut(waves, model, settings)
    simulator, problem = build_problem(waves, model, settings, (period, cycles))
    found = fit(problem, starts=settings.starts, seed=settings.seed)
    correlated = correlation_length(found.residual)
    if correlated > 2:
        notes.append(
            f"neighbouring residuals are alike (over about {correlated:.0f} samples): the circuit misses the data "
            f"systematically, and intervals for independent errors are about {np.sqrt(correlated):.1f} times too narrow"
        )
    assessment = assess(found, with_profiles=settings.profiles, draws=settings.draws, seed=settings.seed)
    return CircuitReport(
        kind="windkessel",
        model=circuit,
        assessment=assessment,
        files=(waves.file,) if waves.file else (),
        notes=tuple(notes),
        extra={
            "norms_over_time": norms_over_time(waves.t, found.curve, problem.data),
            "periodic": settings.periodic,
            "period_s": period,
            "cycles": cycles,
            "residual_correlation_samples": correlated,
            "combinations": fixed_together(found, model),
            "ci95_correlated_residuals": _widened(assessment.linear, found, correlated),
        },
        waves=waves,
        simulator=simulator,
    )


def compare(reports: Sequence[CircuitReport]) -> list[dict[str, float | str]]:
    """Return name, number of parameters, errors, AICc and BIC (as differences from the best) of several circuits."""
    rows = []
    for report in reports:
        entry = report.as_dict()
        held_out = [block.rmse for block in report.assessment.held_out]
        rows.append(
            {
                "circuit": report.model,
                "n_free": entry["n_free"],
                "relative_l2": entry["relative_l2"],
                "relative_linf": entry["relative_linf"],
                "held_out_rmse": float(np.sqrt(np.mean(np.square(held_out)))) if held_out else None,
                "aicc": entry["aicc"],
                "bic": entry["bic"],
            }
        )
    for name in ("aicc", "bic"):
        least = min(row[name] for row in rows)
        for row in rows:
            row[f"delta_{name}"] = row[name] - least
    return rows


def build_problem(
    waves: Waveforms, model: CircuitModel, settings: Settings, cycles: tuple[float | None, int]
) -> tuple[Simulator, Problem]:
    """Return the circuit driven by a record, and the least-squares problem it makes.

    Args:
        waves: The record, cut to whole cycles where the periodic state is asked for.
        model: The circuit.
        settings: How it is fitted.
        cycles: Length of a cycle [s] (None where the record has no whole one), and how many there are.
    """
    units = {name: unit for name, (unit, _) in model.parameters.items()}
    _check_fixed(model, settings)
    sample = {
        name: settings.fixed.get(name, start[0]) * SIZES[unit]
        for name, (unit, start) in model.parameters.items()
    }
    states = () if settings.periodic else model.kind(**sample).system().states
    units |= {f"{state}{TAIL}": state_unit(state) for state in states}
    unknown = [name for name in (*settings.fixed, *settings.bounds) if name not in units]
    if unknown:
        raise CaseError(
            f"no such parameter, expected one of {', '.join(units)}", key="parameter", value=unknown[0]
        )
    data = waves[model.output] / MMHG
    parameters = tuple(_parameter(name, unit, model, settings, data) for name, unit in units.items())
    simulator = Simulator(
        model=model,
        names=tuple(units),
        units=tuple(units.values()),
        t=waves.t,
        u=np.stack([waves[name] for name in model.inputs], axis=1),
        periodic=settings.periodic,
    )
    blocks, names = _blocks(waves.t, *cycles)
    problem = Problem(
        parameters=parameters,
        data=data,
        model=simulator.curve,
        jacobian=simulator.jacobian,
        blocks=blocks,
        block_names=names,
        unit="mmHg",
    )
    try:
        simulator.curve(np.array([p.value if p.value is not None else sum(p.range) / 2 for p in parameters]))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CaseError(str(error), key="circuit") from None
    return simulator, problem


def norms_over_time(t: NDArray, curve: NDArray, data: NDArray) -> dict[str, float]:
    """Return the normalised norms of a curve against data (S24).

    ||curve - data||_{L^q(0,T)} / ||data||_{L^q(0,T)},    q = 2 (trapezoidal rule) and infinity
    """
    error = curve - data
    size = np.sqrt(np.trapezoid(data**2, t))
    return {
        "relative_l2": float(np.sqrt(np.trapezoid(error**2, t)) / size) if size > 0 else float("nan"),
        "relative_linf": float(np.abs(error).max() / np.abs(data).max()) if size > 0 else float("nan"),
    }


def correlation_length(residual: NDArray) -> float:
    """Return over how many samples residuals are alike: 1 + 2 sum rho_k to the first rho_k <= 0; 1 if independent."""
    z = residual - residual.mean()
    square = float(z @ z)
    total = 1.0
    if square < 1e-20 * max(len(z), 1):
        return total
    for lag in range(1, len(z)):
        rho = float(z[:-lag] @ z[lag:]) / square
        if rho <= 0:
            break
        total += 2 * rho
    return total


def fixed_together(found: Fit, model: CircuitModel) -> dict[str, dict[str, float | str | None]]:
    """Return value and standard deviation of combinations of parameters, by the linearised covariance.

    A combination may be well known where its parameters are not: they then trade against one another. The deviation
    is None where the data do not fix the combination either.
    """
    problem, values = found.problem, found.named
    _, singular, rows = np.linalg.svd(found.jacobian, full_matrices=False)
    known = singular > LOST * singular.max(initial=0.0)
    freedom = max(len(problem.data) - len(problem.free), 1)
    sigma = np.sqrt(2 * found.half_squares / freedom)
    entries: dict[str, dict[str, float | str | None]] = {}
    for name, (unit, function) in model.together.items():
        slopes = []
        for p in problem.free_parameters:
            moved = {**values, p.name: values[p.name] + STEP * 1j}
            slopes.append(np.imag(function(moved)) / STEP * p.slope(values[p.name]))
        along = rows @ np.array(slopes)
        lost = np.linalg.norm(along[~known]) > 1e-6 * np.linalg.norm(slopes)
        deviation = None if lost else float(sigma * np.linalg.norm(along[known] / singular[known]))
        if not any(slopes):
            continue
        entries[name] = {"value": float(np.real(function(values))), "unit": unit, "std": deviation}
    return entries


def _widened(linear: Linear, found: Fit, correlated: float) -> dict[str, list[float]]:
    """Return covariance intervals for residuals that are alike over ``correlated`` samples."""
    freedom = max(linear.freedom / correlated, 1.0)
    reach = stats.t.ppf(0.975, freedom) * np.sqrt(correlated) * linear.std
    return {
        name: [found.named[name] - r, found.named[name] + r]
        for name, r in zip(linear.names, reach, strict=True)
    }


def _check_fixed(model: CircuitModel, settings: Settings) -> None:
    """Refuse values that mean nothing, before anything is computed with them."""
    for name in model.parameters:
        if name in settings.fixed:
            values = {n: settings.fixed[n] if n == name else 1.0 for n in model.parameters}
            try:
                model.kind(**values)
            except ValueError as error:
                raise CaseError(str(error).partition(": ")[2], key=name, value=settings.fixed[name]) from None


def _parameter(name: str, unit: str, model: CircuitModel, settings: Settings, data: NDArray) -> Parameter:
    held = settings.fixed.get(name)
    if name in model.parameters:
        low, high = settings.bounds.get(name, BOUNDS[unit])
        start = model.parameters[name][1]
        if low < 0:
            raise CaseError("expected a lower bound of zero or above", key=name, value=low)
        return Parameter(name=name, unit=unit, lower=low, upper=high, start=start, log=low > 0, value=held)
    low, high = settings.bounds.get(name, STARTS[unit])
    start = (float(data.min()), float(data.max())) if unit == "mmHg" else (-100.0, 100.0)
    start = start if start[0] < start[1] else (start[0] - 1, start[0] + 1)
    return Parameter(name=name, unit=unit, lower=low, upper=high, start=start, value=held, linear=True)


def _blocks(t: NDArray, period: float | None, cycles: int) -> tuple[NDArray, dict[int, str]]:
    """Return the block of each sample: its cycle, or a part of the record where there are fewer than three."""
    since = t - t[0]
    if period is not None and cycles >= 3:
        number = np.minimum((since / period * (1 + 1e-9)).astype(int), cycles - 1)
        return number, {k: f"cycle {k + 1}" for k in range(cycles)}
    count = min(SEGMENTS, len(t) // 4)
    edges = np.linspace(t[0], t[-1], count + 1)
    number = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, count - 1)
    _, number = np.unique(number, return_inverse=True)
    return number, {int(k): f"from {t[number == k][0]:.3g} s" for k in np.unique(number)}


def _cut(waves: Waveforms, model: CircuitModel, settings: Settings) -> tuple[Waveforms, float | None, int]:
    """Return the record as it is fitted, the length of a cycle and the number of whole ones."""
    period = settings.period
    if period is not None and not (np.isfinite(period) and 0 < period < 2 * waves.span):
        raise CaseError(f"expected a time in 0 ... {waves.span:.6g} s", key="period", value=period)
    if period is None:
        period = find_period(waves.t, waves[model.output])
    usual = float(np.median(np.diff(waves.t)))
    if not settings.periodic:
        return waves, period, 0 if period is None else int((waves.span + 1.5 * usual) / period)
    if period is None:
        ends = max(
            abs(waves[q][-1] - waves[q][0]) - 0.01 * np.ptp(waves[q]) for q in (*model.inputs, model.output)
        )
        period = waves.span if ends <= 0 else waves.span + usual
    closed, cycles = whole_cycles(waves, period)
    return closed, period, cycles


def _remarks(waves: Waveforms, model: CircuitModel) -> list[str]:
    """Return what is odd about a record."""
    said = []
    outliers = find_outliers(waves, (*model.inputs, model.output))
    said += [outlier.line() for outlier in outliers]
    if outliers:
        said.append(f"{len(outliers)} outliers are left in the record; --repair outliers replaces them")
    for name in model.inputs:
        if name[0] == "q" and waves[name].mean() < 0:
            said.append(
                f"the mean of {waves.heading(name)} is negative: it is taken as positive downstream; "
                f"--flip {name} turns it round"
            )
    return said
