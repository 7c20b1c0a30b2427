"""Fits of the flow loop's circuits to measured pressures and flows (Lee2020, S4-S10).

The circuit is driven by measured flows and pressures, stepped exactly, and its parameters and initial pressures are
fitted to one measured pressure. Inside everything is CGS; parameters are given and reported in mmHg, ml and s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting import uncertainty
from valvefsi.fitting.least_squares import Notify, Parameter, Problem, fit
from valvefsi.fitting.report import Assessment, Report, assess, measures, number, toml
from valvefsi.fitting.waveform_repair import find_outliers, find_period, whole_cycles
from valvefsi.fitting.waveforms import Waveforms, read_waveforms
from valvefsi.fitting.windkessel_checks import Lag, coarseness, lag_of
from valvefsi.fitting.windkessel_models import (
    BOUNDS,
    CIRCUITS,
    LAG,
    SIZES,
    STARTS,
    TAIL,
    UNITS,
    CircuitModel,
    Simulator,
    find_circuit,
)
from valvefsi.io.folder import write_text
from valvefsi.types import Array, Indices
from valvefsi.units import MMHG

SEGMENTS = 8
"""Blocks that a record of fewer than three cycles is divided into for the resampling."""
LAG_MOST = 50.0
"""Largest lag [ms]; a record gives up as much at both ends where a lag is fitted."""
SAME = 1e-9
"""Difference of two samples over the range of the record, below which one repeats the other."""
LAGS = ("check", "fit", "off")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How a circuit is fitted.

    Attributes:
        fixed: Parameters and initial states (``p_wk_start``) that are held, in mmHg, ml and s.
        bounds: Bounds that replace the usual ones.
        periodic: Solve for the periodic steady state instead of fitting the initial states.
        period: Length of a cycle [s]; found in the record if not given.
        lag: Time by which the output follows the inputs: ``fit`` it, ``check`` for one and say so, or ``off``.
        starts: Number of starts.
        seed: Seed of starts and bootstrap.
        profiles: Compute profile likelihoods.
        draws: Draws of the bootstrap.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    periodic: bool = False
    period: float | None = None
    lag: str = "check"
    starts: int = 8
    seed: int = 0
    profiles: bool = True
    draws: int = 50

    def __post_init__(self) -> None:
        if self.lag not in LAGS:
            raise CaseError(f"expected one of {', '.join(LAGS)}", key="lag", value=self.lag)


@dataclass(frozen=True, kw_only=True)
class Cycles:
    """Length of a record's cycles [s], None where there is no whole one, and how many there are."""

    period: float | None = None
    count: int = 0


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
    def circuit(self) -> Any:
        """The fitted circuit, CGS."""
        model, named = self.simulator.model, self.fit.named
        return model.kind(**{name: named[name] * SIZES[unit] for name, unit in model.parameters.items()})

    @property
    def start(self) -> dict[str, float]:
        """Initial states [mmHg, ml/s]."""
        first = self.simulator.states(self.fit.values)[0]
        states = self.simulator.system(self.fit.values).states
        return {name: float(x / SIZES[UNITS[name[0]]]) for name, x in zip(states, first, strict=True)}

    def write(self, out: Path) -> Path:
        """Write ``fit.json``, ``circuit.toml``, ``fit.png`` and ``profiles.png``; return the path of the first."""
        from valvefsi.fitting.windkessel_pictures import draw_fit

        path = super().write(Path(out))
        about = {**self.waves.origin, **self.extra["norms_over_time"]}
        about |= {f"verdict_{name}": entry["verdict"] for name, entry in self.parameters().items()}
        text = circuit_text(self.model, self.fit.named, self.start, about)
        write_text(path.parent / "circuit.toml", text)
        draw_fit(self, path.parent)
        return path


def fit_windkessel(
    data: str | Path | Waveforms,
    circuit: str = "downstream",
    settings: Settings | None = None,
    notify: Notify | None = None,
) -> CircuitReport:
    """Fit a circuit to a record.

    Args:
        data: The record, or its file.
        circuit: Name in `CIRCUITS`.
        settings: How.
        notify: Called as the work goes on.

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
    remarks = _remarks(waves, model)
    waves, cycles = _cut(waves, model, settings)
    notes = [*waves.notes, *remarks]
    simulator, problem = build_problem(waves, model, settings, cycles)
    best = fit(problem, starts=settings.starts, seed=settings.seed, notify=notify)
    lag = (
        lag_of(best, *build_problem(waves, model, settings, cycles, lagged=True))
        if settings.lag == "check"
        else None
    )
    lines = [line for line in (lag.line() if lag else "", coarseness(best, simulator)) if line]
    assessment = assess(
        best,
        with_profiles=settings.profiles,
        draws=settings.draws,
        seed=settings.seed,
        doubt="the record has a lag" if lag else "",
        notify=notify,
    )
    return _reported(
        assessment, waves, simulator, circuit, cycles, (*notes, *lines, *assessment.remarks()), lag
    )


def _reported(
    assessment: Assessment,
    waves: Waveforms,
    simulator: Simulator,
    circuit: str,
    cycles: Cycles,
    notes: tuple[str, ...],
    lag: Lag | None,
) -> CircuitReport:
    """Return a fit with everything that is said about it."""
    best, model = assessment.fit, simulator.model
    norms = measures(best.problem.data, best.curve, waves.t[simulator.kept])
    together = uncertainty.combined(best, {name: c.function for name, c in model.together.items()})
    units = {name: model.together[name].unit for name in together}
    lines = [
        f"norms over time (S24): relative L2 {100 * norms['relative_l2']:.4g} %, "
        f"Linf {100 * norms['relative_linf']:.4g} %"
    ]
    for name, (value, deviation) in together.items():
        spread = "not fixed by the data" if deviation is None else f"std {number(deviation)}"
        lines.append(f"together: {name} = {number(value)} {units[name]}, {spread}")
    return CircuitReport(
        kind="windkessel",
        model=circuit,
        assessment=assessment,
        files=(waves.file,) if waves.file else (),
        notes=notes,
        extra={
            "norms_over_time": norms,
            "periodic": simulator.periodic,
            "period_s": cycles.period,
            "cycles": cycles.count,
            "lag": lag.as_dict() if lag else None,
            "combinations": {n: {"value": v, "unit": units[n], "std": d} for n, (v, d) in together.items()},
            "ci95_correlated_residuals": uncertainty.widened(best, assessment.linear, assessment.alike),
        },
        more=tuple(lines),
        waves=waves,
        simulator=simulator,
    )


def circuit_text(
    name: str, values: Mapping[str, float], start: Mapping[str, float], provenance: Mapping[str, Any]
) -> str:
    """Return the text of ``circuit.toml``; values and initial states in mmHg, ml and s."""
    model = CIRCUITS[name]
    table: dict[str, Any] = {"model": name}
    table |= {key: f"{float(values[key])!r} {unit}" for key, unit in model.parameters.items()}
    if start:
        table["start"] = {key: f"{float(value)!r} {UNITS[key[0]]}" for key, value in start.items()}
    use = 'in a case file: [[circuit]], then name = "outlet" and include = "circuit.toml"'
    return toml({**table, "provenance": dict(provenance)}, [model.about, use])


def compare(reports: Sequence[CircuitReport]) -> list[dict[str, Any]]:
    """Return name, number of parameters, errors, AICc and BIC (as differences from the best) of several circuits."""
    rows: list[dict[str, Any]] = []
    for report in reports:
        entry = report.as_dict()
        held_out = [block.rmse for block in report.assessment.held_out]
        keys = ("n_free", "relative_l2", "relative_linf", "aicc", "bic")
        error = float(np.sqrt(np.mean(np.square(held_out)))) if held_out else None
        rows.append({"circuit": report.model, "held_out_rmse": error, **{key: entry[key] for key in keys}})
    for name in ("aicc", "bic"):
        least = min(row[name] for row in rows)
        for row in rows:
            row[f"delta_{name}"] = row[name] - least
    return rows


def build_problem(
    waves: Waveforms, model: CircuitModel, settings: Settings, cycles: Cycles, *, lagged: bool | None = None
) -> tuple[Simulator, Problem]:
    """Return the circuit driven by a record, and the least-squares problem it makes.

    Args:
        waves: The record, cut to whole cycles where the periodic state is asked for.
        model: The circuit.
        settings: How it is fitted.
        cycles: The record's cycles.
        lagged: Whether the lag is a parameter; what the settings say if not given.
    """
    lagged = settings.lag == "fit" if lagged is None else lagged
    units = _units(model, settings, lagged)
    kept = np.arange(len(waves.t))
    if lagged and not settings.periodic:
        most = min(LAG_MOST / 1e3, 0.1 * waves.span)
        kept = np.flatnonzero((waves.t >= waves.t[0] + most) & (waves.t <= waves.t[-1] - most))
    data = waves[model.output][kept] / MMHG
    simulator = Simulator(
        model=model,
        names=tuple(units),
        units=tuple(units.values()),
        t=waves.t,
        u=np.stack([waves[name] for name in model.inputs], axis=1),
        kept=kept,
        periodic=settings.periodic,
    )
    blocks, names = _blocks(waves.t[kept], cycles)
    problem = Problem(
        parameters=tuple(_parameter(name, unit, model, settings, data) for name, unit in units.items()),
        data=data,
        model=simulator.curve,
        jacobian=simulator.jacobian,
        blocks=blocks,
        block_names=names,
        unit="mmHg",
    )
    try:
        simulator.curve(
            np.array([sum(p.range) / 2 if p.value is None else p.value for p in problem.parameters])
        )
    except (ValueError, np.linalg.LinAlgError) as error:
        raise CaseError(str(error), key="circuit") from None
    return simulator, problem


def _units(model: CircuitModel, settings: Settings, lagged: bool) -> dict[str, str]:
    """Return the unit of each parameter: the circuit's, initial states, and the lag; check the names of settings."""
    units = model.parameters
    _check_fixed(model, settings)
    sample = {
        name: settings.fixed.get(name, model.starts[name][0]) * SIZES[unit] for name, unit in units.items()
    }
    states = () if settings.periodic else model.kind(**sample).system().states
    units |= {f"{state}{TAIL}": UNITS[state[0]] for state in states} | ({LAG: "ms"} if lagged else {})
    for name in (*settings.fixed, *settings.bounds):
        if name not in units:
            raise CaseError(
                f"no such parameter, expected one of {', '.join(units)}", key="parameter", value=name
            )
    return units


def _check_fixed(model: CircuitModel, settings: Settings) -> None:
    """Refuse values that mean nothing, before anything is computed with them."""
    for name in model.starts:
        if name in settings.fixed:
            values = {n: settings.fixed[n] if n == name else 1.0 for n in model.starts}
            try:
                model.kind(**values)
            except ValueError as error:
                raise CaseError(str(error).partition(": ")[2], key=name, value=settings.fixed[name]) from None


def _parameter(name: str, unit: str, model: CircuitModel, settings: Settings, data: Array) -> Parameter:
    value = settings.fixed.get(name)
    if name in model.starts:
        low, high = settings.bounds.get(name, BOUNDS[unit])
        if low < 0:
            raise CaseError("expected a lower bound of zero or above", key=name, value=low)
        start = model.starts[name]
        return Parameter(name=name, unit=unit, lower=low, upper=high, start=start, log=low > 0, value=value)
    if name == LAG:
        low, high = settings.bounds.get(name, (-LAG_MOST, LAG_MOST))
        return Parameter(name=name, unit=unit, lower=low, upper=high, start=(-10.0, 10.0), value=value)
    low, high = settings.bounds.get(name, STARTS[unit])
    start = (float(data.min()), float(data.max())) if unit == "mmHg" else (-100.0, 100.0)
    start = start if start[0] < start[1] else (start[0] - 1, start[0] + 1)
    return Parameter(name=name, unit=unit, lower=low, upper=high, start=start, value=value, linear=True)


def _blocks(t: Array, cycles: Cycles) -> tuple[Indices, dict[int, str]]:
    """Return the block of each sample: its cycle, or a part of the record where there are fewer than three."""
    if cycles.period is not None and cycles.count >= 3:
        part = np.minimum(((t - t[0]) / cycles.period * (1 + 1e-9)).astype(int), cycles.count - 1)
        return part, {k: f"cycle {k + 1}" for k in range(cycles.count)}
    count = min(SEGMENTS, len(t) // 4)
    edges = np.linspace(t[0], t[-1], count + 1)
    part = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, count - 1)
    _, part = np.unique(part, return_inverse=True)
    return part, {int(k): f"from {t[part == k][0]:.3g} s" for k in np.unique(part)}


def _cut(waves: Waveforms, model: CircuitModel, settings: Settings) -> tuple[Waveforms, Cycles]:
    """Return the record as it is fitted, and its cycles."""
    period = settings.period
    if period is not None and not (np.isfinite(period) and 0 < period < 2 * waves.span):
        raise CaseError(f"expected a time in 0 ... {waves.span:.6g} s", key="period", value=period)
    if period is None:
        period = find_period(waves.t, waves[model.output])
    usual = float(np.median(np.diff(waves.t)))
    if not settings.periodic:
        count = 0 if period is None else int((waves.span + 1.5 * usual) / period)
        return waves, Cycles(period=period, count=count)
    said = "given" if settings.period else "found in the record"
    if period is None:
        period, said = _length_of_one(waves, [waves[q] for q in (*model.inputs, model.output)], usual)
    whole, count = whole_cycles(waves, period)
    cycles = "cycle" if count == 1 else "cycles"
    note = f"periodic: {count} {cycles} of {period:.6g} s, {said}"
    return replace(whole, notes=(*whole.notes, note)), Cycles(period=period, count=count)


def _length_of_one(waves: Waveforms, records: Sequence[Array], usual: float) -> tuple[float, str]:
    """Return the length of the one cycle that a record holds, and in words why.

    Its end is one interval after its last sample, unless that repeats the first in every column: within the noise any
    record comes back, to the last digit only one that is closed.
    """
    off = {at: max(abs(y[at] - y[0]) / (np.ptp(y) or 1.0) for y in records) for at in (-1, -2)}
    if off[-1] <= SAME < off[-2]:
        return waves.span, "from the first sample to the last, which repeats it; --period gives another"
    return (
        waves.span + usual,
        f"{len(waves.t)} samples and the interval to the next beat; --period gives another",
    )


def _remarks(waves: Waveforms, model: CircuitModel) -> list[str]:
    """Return what is odd about a record."""
    outliers = find_outliers(waves, (*model.inputs, model.output))
    lines = [outlier.line() for outlier in outliers]
    if outliers:
        lines.append(f"{len(outliers)} outliers are left in the record; --repair outliers replaces them")
    for name in model.inputs:
        if name[0] == "q" and waves[name].mean() < 0:
            lines.append(
                f"the mean of {waves.heading(name)} is negative: it is taken as positive downstream; "
                f"--flip {name} turns it round"
            )
    return lines
