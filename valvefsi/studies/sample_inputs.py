"""Uncertain inputs as functions of independent variates: distributions, and what a fit says of its parameters.

A design lives in the unit cube, one axis for each variate. A group is a set of variates whose inputs depend on one
another; between groups all is independent, so that variances, and Sobol indices of groups, add up.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import ndtr, ndtri

from valvefsi.case.sample_tables import FittedInputs, SampleStudy, UncertainInput
from valvefsi.errors import CaseError
from valvefsi.studies.members import read_json
from valvefsi.types import Array

EDGE = 1e-12
"""How near to 0 and 1 a variate may come."""
REACH = float(ndtri(0.975))
"""Standard deviations from the median to the end of a 95 % interval."""
ALONE = 0.3
"""Largest correlation that may be left out."""
Germ = Literal["normal", "uniform", "none"]
"""What the polynomials of a variate are orthogonal to; none where no polynomial follows it."""


@dataclass(frozen=True, kw_only=True)
class Group:
    """Inputs that are drawn together.

    Attributes:
        name: Name of the group.
        names: Names of its inputs.
        keys: Their keys of the case.
        units: Their units, "" for a pure number.
        germ: Kind of its variates.
        num_variates: Their number.
        values: Function of variates in the unit cube, ``(n, num_variates)``, to inputs, ``(n, num_inputs)``.
        notes: What a reader must know.
    """

    name: str
    names: tuple[str, ...]
    keys: tuple[str, ...]
    units: tuple[str, ...]
    germ: Germ
    num_variates: int
    values: Callable[[Array], Array]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inputs:
    """All uncertain inputs of a study.

    Attributes:
        groups: The groups.
    """

    groups: tuple[Group, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs."""
        return tuple(name for group in self.groups for name in group.names)

    @property
    def keys(self) -> tuple[str, ...]:
        """Their keys."""
        return tuple(key for group in self.groups for key in group.keys)

    @property
    def units(self) -> tuple[str, ...]:
        """Their units."""
        return tuple(unit for group in self.groups for unit in group.units)

    @property
    def of_variates(self) -> tuple[str, ...]:
        """Name of the group of each variate."""
        return tuple(group.name for group in self.groups for _ in range(group.num_variates))

    @property
    def germs(self) -> tuple[Germ, ...]:
        """Kind of each variate."""
        return tuple(group.germ for group in self.groups for _ in range(group.num_variates))

    def values(self, u: Array) -> Array:
        """Return the inputs at points of the unit cube.

        Args:
            u: Points, ``(n, num_variates)``.

        Returns:
            ``(n, num_inputs)``, in the order of `names`.
        """
        ends = np.cumsum([group.num_variates for group in self.groups])[:-1]
        parts = np.split(np.clip(u, EDGE, 1.0 - EDGE), ends, axis=1)
        return np.concatenate([g.values(part) for g, part in zip(self.groups, parts, strict=True)], axis=1)


def inputs_of(study: SampleStudy) -> Inputs:
    """Return the inputs of a study.

    Raises:
        CaseError: What a fit left cannot be used: says file and parameter.
    """
    groups = [_distributed(one) for one in study.input]
    for fit in study.fit:
        groups += _samples(fit) if fit.take == "samples" else _fitted(fit)
    return Inputs(tuple(groups))


def _distributed(one: UncertainInput) -> Group:
    """Return an input of its own distribution."""
    first, second, unit = one.numbers()

    def values(u: Array) -> Array:
        if one.distribution == "uniform":
            return first + (second - first) * u
        if one.distribution == "normal":
            return first + second * ndtri(u)
        spread = np.sqrt(np.log1p((second / first) ** 2))
        return np.exp(np.log(first) - 0.5 * spread**2 + spread * ndtri(u))

    return Group(
        name=one.name,
        names=(one.name,),
        keys=(one.key,),
        units=(unit,),
        germ="uniform" if one.distribution == "uniform" else "normal",
        num_variates=1,
        values=values,
    )


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A parameter of a fit, as a function of a standard normal variate.

        x = x_0 + (x_+ - x_0) z / 1.96 for z > 0, x_0 - (x_0 - x_-) |z| / 1.96 for z < 0,   x the value or its logarithm

    so that its median and the ends of its 95 % interval are those of the fit.

    Attributes:
        value: Its value x_0.
        low: Lower end of its 95 % interval.
        high: Upper end.
        log: Whether it is the logarithm.
        at_bound: At which bound the value lies: -1 lower, 1 upper, 0 at none; it is then on one side only.
    """

    value: float
    low: float
    high: float
    log: bool
    at_bound: int = 0

    def __call__(self, z: Array) -> Array:
        """Return the values of variates."""
        x, low, high = (
            np.log([self.value, self.low, self.high]) if self.log else (self.value, self.low, self.high)
        )
        if self.at_bound:  # half of a normal distribution, its mode at the bound
            z = -self.at_bound * ndtri(0.5 * (1.0 + ndtr(z if self.at_bound < 0 else -z)))
        y = x + np.where(z > 0.0, high - x, x - low) * z / REACH
        return np.exp(y) if self.log else y


def _fitted(fit: FittedInputs) -> list[Group]:
    """Return the parameters of a fit as one group, or each as its own."""
    data = read_json(Path(fit.file))
    known: Mapping[str, Any] = data.get("parameters", {})
    names = list(fit.keys)
    for name in names:
        if name not in known:
            raise CaseError(f"the fit has {', '.join(known) or 'no parameters'}", file=fit.file, key=name)
    laws = [_law(fit, name, known[name]) for name in names]
    units = ["" if known[name]["unit"] == "-" else str(known[name]["unit"]) for name in names]
    correlation = _correlation(data, names)
    notes = tuple(
        f"{fit.name}.{name}: the fit calls it {known[name]['verdict']}"
        for name in names
        if known[name]["verdict"] != "identified"
    )
    largest = float(np.abs(correlation - np.eye(len(names))).max())
    if fit.joint and len(names) > 1:
        said = f"{fit.name}: correlated by up to {largest:.2g}; its indices are those of all together"
        return [_together(fit, laws, units, correlation, (*notes, said))]
    if largest > ALONE:
        message = (
            f"parameters are correlated by {largest:.2g}, more than {ALONE:g}: they cannot be taken alone"
        )
        raise CaseError(message, file=fit.file, key=f"fit.{fit.name}.joint", value=False)
    if len(names) > 1:
        notes = (*notes, f"{fit.name}: correlations of up to {largest:.2g} are left out")
    return [
        Group(
            name=f"{fit.name}.{name}",
            names=(f"{fit.name}.{name}",),
            keys=(fit.keys[name],),
            units=(units[k],),
            germ="normal",
            num_variates=1,
            values=_alone(laws[k]),
            notes=notes if k == 0 else (),
        )
        for k, name in enumerate(names)
    ]


def _together(
    fit: FittedInputs,
    laws: Sequence[Fitted],
    units: Sequence[str],
    correlation: Array,
    notes: tuple[str, ...],
) -> Group:
    """Return the parameters of a fit as one group, correlated as the fit says."""
    root = np.linalg.cholesky(correlation)

    def values(u: Array) -> Array:
        z = ndtri(u) @ root.T
        return np.stack([law(z[:, k]) for k, law in enumerate(laws)], axis=1)

    return Group(
        name=fit.name,
        names=tuple(f"{fit.name}.{name}" for name in fit.keys),
        keys=tuple(fit.keys.values()),
        units=tuple(units),
        germ="normal",
        num_variates=len(laws),
        values=values,
        notes=notes,
    )


def _alone(law: Fitted) -> Callable[[Array], Array]:
    return lambda u: law(ndtri(u))


def _law(fit: FittedInputs, name: str, entry: Mapping[str, Any]) -> Fitted:
    """Return a parameter of ``fit.json``: positive ones are fitted by their logarithm, and are so here."""
    value, bounds = float(entry["value"]), entry.get("bounds")
    interval = entry.get("ci95" if fit.take == "profile" else "ci95_covariance")
    if bounds is None or interval is None or None in interval:
        message = f"the fit has no interval of it from its {fit.take} ({entry['verdict']})"
        raise CaseError(message, file=fit.file, key=name)
    at_bound = -1 if value <= bounds[0] else 1 if value >= bounds[1] else 0
    return Fitted(value=value, low=interval[0], high=interval[1], log=bounds[0] > 0.0, at_bound=at_bound)


def _correlation(data: Mapping[str, Any], names: Sequence[str]) -> Array:
    """Return the correlation of some parameters of ``fit.json``; those without one are independent."""
    table = data.get("correlation", {})
    order, rows = list(table.get("names", ())), table.get("matrix", ())
    found = np.eye(len(names))
    for i, a in enumerate(names):
        for j, b in enumerate(names):
            if i != j and a in order and b in order:
                found[i, j] = rows[order.index(a)][order.index(b)] or 0.0
    return found


def _samples(fit: FittedInputs) -> list[Group]:
    """Return the rows of a table, each as likely; of one column its quantiles."""
    rows = _read_rows(fit)
    ordered = np.sort(rows[:, 0])

    def by_row(u: Array) -> Array:
        return rows[np.minimum((u[:, 0] * len(rows)).astype(int), len(rows) - 1)]

    def by_quantile(u: Array) -> Array:
        return np.interp(u, (np.arange(len(ordered)) + 0.5) / len(ordered), ordered)

    single = rows.shape[1] == 1
    names = tuple(fit.name if single else f"{fit.name}.{name}" for name in fit.keys)
    return [
        Group(
            name=fit.name,
            names=names,
            keys=tuple(fit.keys.values()),
            units=tuple(fit.units.get(name, "") for name in fit.keys),
            germ="uniform" if single else "none",
            num_variates=1,
            values=by_quantile if single else by_row,
            notes=(f"{fit.name}: {len(rows)} samples of {Path(fit.file).name}",),
        )
    ]


def _read_rows(fit: FittedInputs) -> Array:
    """Return the columns of a table of samples, ``(num_rows, num_keys)``."""
    with Path(fit.file).open(encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(line for line in file if not line.startswith("#")))
    try:
        rows = np.array([[float(row[name]) for name in fit.keys] for row in table])
    except (KeyError, TypeError, ValueError) as error:
        raise CaseError(f"expected numbers under {', '.join(fit.keys)}: {error}", file=fit.file) from None
    if len(rows) < 2 or not np.isfinite(rows).all():
        raise CaseError("expected two finite samples or more", file=fit.file, value=len(rows))
    return rows
