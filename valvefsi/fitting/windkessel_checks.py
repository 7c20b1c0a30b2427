"""Two faults of a record that a fit hides: pressure and flow that are not of one time, and coarse sampling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from valvefsi.fitting import uncertainty
from valvefsi.fitting.least_squares import Fit, Problem, solve
from valvefsi.fitting.windkessel_models import LAG, Simulator
from valvefsi.types import Array

SURE, SHORTEST = 4.0, 0.5
"""A lag is said that is this many standard deviations (for residuals that are alike) and at least this long [ms]."""
COARSE = 0.02
"""Part of a parameter that may be due to the sampling before it is said."""
FEWEST = 40
"""Samples that the check of the sampling needs."""


@dataclass(frozen=True, kw_only=True)
class Lag:
    """A time by which the fitted pressure follows what drives the circuit.

    Attributes:
        value: The lag [ms].
        std: Its standard deviation, for residuals alike over as many samples as they are [ms].
        changes: Relative change of each parameter when the lag is fitted.
    """

    value: float
    std: float
    changes: Mapping[str, float]

    def line(self) -> str:
        """Return it in words."""
        changes = ", ".join(f"{name} {100 * change:+.1f} %" for name, change in self.changes.items())
        who = "follows" if self.value > 0 else "leads"
        return (
            f"warning: the pressure {who} the inputs by {abs(self.value):.2f} ms (std {self.std:.2g} ms), from "
            f"delays of the sensors or the way between them; with the lag fitted: {changes}; fit it with --lag fit, or "
            "correct the record"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return what ``fit.json`` holds."""
        return {"value_ms": self.value, "std_ms": self.std, "relative_changes": dict(self.changes)}


def lag_of(best: Fit, simulator: Simulator, problem: Problem) -> Lag | None:
    """Return the lag of a record, None where none is sure.

    Args:
        best: The fit without a lag.
        simulator: The circuit with a lag.
        problem: The problem with the lag as its last parameter.
    """
    if simulator.names[-1] != LAG or problem.parameters[-1].value is not None or not best.problem.free:
        return None
    if len(problem.data) <= len(problem.free):
        return None
    answer = solve(problem, problem.scaled(np.append(best.values, 0.0)), tolerance=1e-9)
    if not np.isfinite(answer.cost):
        return None
    lagged = replace(best, problem=problem, values=answer.values, cost=answer.cost, starts=(answer,))
    std = uncertainty.linearised(lagged).std[-1] * np.sqrt(uncertainty.correlation_length(lagged.residual))
    if not abs(answer.values[-1]) > max(SURE * std, SHORTEST):
        return None
    return Lag(value=float(answer.values[-1]), std=float(std), changes=_changes(best, answer.values))


def coarseness(best: Fit, simulator: Simulator) -> str:
    """Return a warning where the sampling is coarse for the flow, nothing where it is not.

    Inputs linear between samples err as the square of the interval: what a parameter moves by when every second
    sample is left out is three times what it is off by already.

    Args:
        best: The fit.
        simulator: The circuit driven by the record.
    """
    count = len(simulator.t)
    half = np.unique(np.append(np.arange(0, count, 2), count - 1))  # the last closes a cycle
    if len(half) < FEWEST or LAG in simulator.names or not best.problem.free:
        return ""
    thin = replace(simulator, t=simulator.t[half], u=simulator.u[half], kept=np.arange(len(half)), _last={})
    problem = replace(
        best.problem,
        data=best.problem.data[half],
        model=thin.curve,
        jacobian=thin.jacobian,
        blocks=None,
        weights=None,
    )
    answer = solve(problem, problem.scaled(best.values), tolerance=1e-9)
    linear = uncertainty.linearised(best)
    std = dict(zip(linear.names, linear.std, strict=True))
    off = {
        name: change / 3
        for name, change in _changes(best, answer.values).items()
        if abs(change) / 3 > max(COARSE, std[name] / abs(best.named[name]))
    }
    if not off or not np.isfinite(answer.cost):
        return ""
    parts = ", ".join(f"{name} by about {100 * abs(part):.0f} %" for name, part in off.items())
    step = 1e3 * float(np.median(np.diff(simulator.t)))
    return (
        f"warning: samples every {step:.3g} ms are coarse for these waveforms: judged by leaving out every second one, "
        f"the straight lines between them put {parts} off"
    )


def _changes(best: Fit, values: Array) -> dict[str, float]:
    """Return the relative change of the circuit's free parameters to other values, ``(parameters,)``."""
    problem = best.problem
    return {
        p.name: float(values[i] / best.values[i] - 1)
        for i, p in zip(problem.free, problem.free_parameters, strict=True)
        if p.log and best.values[i] != 0
    }
