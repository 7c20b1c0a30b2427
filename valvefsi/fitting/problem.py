"""Named parameters with bounds and scales, and a model with data: what is fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.types import Array, Indices

LOSSES = ("linear", "soft_l1", "huber", "cauchy", "arctan")
HUGE = 1e120
"""Residuals are cut here, so that their squares stay finite and the solver can turn back."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number to be fitted, or held.

    Args:
        name: Its name.
        unit: Its unit.
        lower: Lower bound.
        upper: Upper bound.
        start: Range that starts are drawn from; the bounds if not given.
        log: Fit the logarithm (for a positive number whose size is not known).
        value: The value it is held at; None where it is fitted.
        linear: The model is linear in it, so that starts need not guess it.
        period: Length after which the model repeats, None where it does not (an angle).
        even: The model is even about every multiple of it (an angle, without shear in the data); None where it is not.
    """

    name: str
    unit: str = "-"
    lower: float
    upper: float
    start: tuple[float, float] | None = None
    log: bool = False
    value: float | None = None
    linear: bool = False
    period: float | None = None
    even: float | None = None

    def __post_init__(self) -> None:
        if self.value is not None:
            if not np.isfinite(self.value):
                raise CaseError("expected a finite number", key=self.name, value=self.value)
            return
        if not (np.isfinite(self.lower) and np.isfinite(self.upper) and self.lower < self.upper):
            raise CaseError("expected a lower and a larger upper bound", key=self.name, value=self.bounds)
        if self.log and self.lower <= 0:
            raise CaseError("expected positive bounds", key=self.name, value=self.bounds)

    @property
    def bounds(self) -> tuple[float, float]:
        """Lower and upper bound."""
        return (self.lower, self.upper)

    @property
    def range(self) -> tuple[float, float]:
        """Range of starts, inside the bounds."""
        low, high = np.clip(self.start or self.bounds, self.lower, self.upper)
        return (float(low), float(high)) if low < high else self.bounds

    @property
    def width(self) -> float:
        """Size by which a parameter that is not logarithmic is divided."""
        return self.range[1] - self.range[0]

    def scaled(self, value: float) -> float:
        """Return the number the solver sees."""
        return float(np.log(value)) if self.log else value / self.width

    def natural(self, scaled: float) -> float:
        """Return the value that belongs to a number of the solver."""
        if self.log:  # before the exponential, which may overflow
            scaled = np.clip(scaled, self.scaled(self.lower), self.scaled(self.upper))
        value = np.exp(scaled) if self.log else scaled * self.width
        return float(np.clip(value, self.lower, self.upper))

    def slope(self, value: float) -> float:
        """Return d value / d scaled."""
        return value if self.log else self.width


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Data and a model with parameters.

    Args:
        parameters: All parameters, those held included, in the order of the model's argument.
        data: Observations, ``(m,)``.
        model: The model, values of all parameters ``(n,)`` to ``(m,)``.
        jacobian: Its derivative, ``(n,)`` to ``(m, n)``; central differences if not given.
        weights: Factor of each residual, ``(m,)``; 1 if not given.
        blocks: Number of the block (protocol, cycle) of each observation, ``(m,)``; one block if not given.
        series: Number of the series of neighbouring observations that each belongs to, ``(m,)``; one if not given.
        block_names: Name of each block by its number.
        unit: Unit of the observations.
        loss: Loss of `scipy.optimize.least_squares`; all but ``linear`` count outliers less.
        loss_scale: Residual at which the loss turns from squares, in the unit of the observations.
    """

    parameters: tuple[Parameter, ...]
    data: Array
    model: Callable[[Array], Array]
    jacobian: Callable[[Array], Array] | None = None
    weights: Array | None = None
    blocks: Indices | None = None
    series: Indices | None = None
    block_names: Mapping[int, str] = field(default_factory=dict)
    unit: str = "-"
    loss: str = "linear"
    loss_scale: float = 1.0

    def __post_init__(self) -> None:
        if self.loss not in LOSSES:
            message = f"unknown loss, expected one of {', '.join(LOSSES)}"
            raise CaseError(message, key="loss", value=self.loss)

    @cached_property
    def free(self) -> tuple[int, ...]:
        """Positions of the parameters that are fitted."""
        return tuple(i for i, p in enumerate(self.parameters) if p.value is None)

    @cached_property
    def free_parameters(self) -> tuple[Parameter, ...]:
        """The parameters that are fitted."""
        return tuple(self.parameters[i] for i in self.free)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def w(self) -> Array:
        """Factor of each residual, ``(m,)``."""
        return np.ones(len(self.data)) if self.weights is None else np.asarray(self.weights, float)

    @cached_property
    def block_of(self) -> Indices:
        """Block of each observation, ``(m,)``."""
        return np.zeros(len(self.data), int) if self.blocks is None else np.asarray(self.blocks, int)

    @cached_property
    def bounds(self) -> Array:
        """Bounds of the scaled free parameters, ``(2, free)``."""
        ends = [[p.scaled(p.lower), p.scaled(p.upper)] for p in self.free_parameters]
        return np.array(ends).reshape(-1, 2).T

    def values(self, scaled: Array) -> Array:
        """Return the values of all parameters, ``(n,)``, from the scaled free ones, ``(free,)``."""
        values = np.array([np.nan if p.value is None else p.value for p in self.parameters])
        for i, p, x in zip(self.free, self.free_parameters, scaled, strict=True):
            values[i] = p.natural(x)
        return values

    def scaled(self, values: Array) -> Array:
        """Return the scaled free parameters, ``(free,)``, from the values of all, ``(n,)``."""
        return np.array([p.scaled(values[i]) for i, p in zip(self.free, self.free_parameters, strict=True)])

    def slopes(self, values: Array) -> Array:
        """Return d value / d scaled of each free parameter, ``(free,)``, at the values of all, ``(n,)``."""
        return np.array([p.slope(values[i]) for i, p in zip(self.free, self.free_parameters, strict=True)])

    def residual(self, scaled: Array) -> Array:
        """Return weight (model - data), ``(m,)``, at scaled free parameters, ``(free,)``."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            return np.clip(self.w * (self.model(self.values(scaled)) - self.data), -HUGE, HUGE)

    def sensitivity(self, values: Array) -> Array:
        """Return d model / d free parameter in its own unit, ``(m, free)``, at the values of all, ``(n,)``."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            if self.jacobian is not None:
                return np.asarray(self.jacobian(values))[:, list(self.free)]
            return self._differences(values)

    def scaled_sensitivity(self, values: Array) -> Array:
        """Return d (weight model) / d scaled free parameter, ``(m, free)``, at the values of all, ``(n,)``."""
        with np.errstate(over="ignore", invalid="ignore"):
            return np.clip(self.w[:, None] * self.sensitivity(values) * self.slopes(values), -HUGE, HUGE)

    def _differences(self, values: Array) -> Array:
        columns = []
        for i, p in zip(self.free, self.free_parameters, strict=True):
            step = 6e-6 * abs(p.slope(values[i]))
            low, high = values.copy(), values.copy()
            low[i], high[i] = max(values[i] - step, p.lower), min(values[i] + step, p.upper)
            columns.append((self.model(high) - self.model(low)) / (high[i] - low[i]))
        return np.array(columns).reshape(len(columns), len(self.data)).T

    def with_constant(self, name: str, value: float) -> Problem:
        """Return the same problem with one parameter held."""
        parameters = [replace(p, value=value) if p.name == name else p for p in self.parameters]
        return replace(self, parameters=tuple(parameters))

    def weighted(self, weights: Array) -> Problem:
        """Return the same problem with further factors on the residuals, ``(m,)``."""
        return replace(self, weights=self.w * weights)
