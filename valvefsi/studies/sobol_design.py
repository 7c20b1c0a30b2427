"""Saltelli's design and the Sobol indices of its outputs, by SALib."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvefsi.errors import SurroundingsError
from valvefsi.runtime.installing import how_to_add
from valvefsi.types import Array

LEVEL = 0.95
RESAMPLES = 200
"""Resamples of the rows of a design for the intervals of its indices."""


@dataclass(frozen=True, kw_only=True)
class Indices:
    """Sobol indices of the groups of inputs for one output.

    Attributes:
        groups: Names of the groups.
        first: First-order indices, ``(num_groups,)``: the part of the variance that goes with a group alone.
        total: Total indices, ``(num_groups,)``: the part that stays when all other groups are known.
        first_interval: Ends of their 95 % intervals, ``(num_groups, 2)``.
        total_interval: The same of the total ones.
    """

    groups: tuple[str, ...]
    first: Array
    total: Array
    first_interval: Array
    total_interval: Array


def saltelli_design(of_variates: Sequence[str], size: int, seed: int) -> Array:
    """Return the points of Saltelli's design: blocks of A, A with one group from B each, and B.

    Args:
        of_variates: Name of the group of each variate.
        size: Number of blocks, a power of two.
        seed: Seed of the scrambling.

    Returns:
        ``(size (num_groups + 2), num_variates)``, in the unit cube.

    Raises:
        SurroundingsError: SALib is missing.
    """
    try:
        from SALib.sample import sobol
    except ImportError as error:
        message = f"the design 'sobol' needs SALib: {how_to_add('uncertainty')}; 'latin-hypercube' needs nothing more"
        raise SurroundingsError(message) from error
    problem = _problem(of_variates)
    points = sobol.sample(problem, size, calc_second_order=False, scramble=True, seed=seed)
    return np.asarray(points, dtype=float)


def sobol_indices(of_variates: Sequence[str], outputs: Array, seed: int) -> Indices:
    """Return the indices of an output over the points of `saltelli_design`.

    Args:
        of_variates: Name of the group of each variate.
        outputs: The output at each point, whole blocks only, ``(num_points,)``; it varies.
        seed: Seed of the resampling.
    """
    from SALib.analyze import sobol

    problem = _problem(of_variates)
    found = sobol.analyze(
        problem,
        np.asarray(outputs, dtype=float),
        calc_second_order=False,
        num_resamples=RESAMPLES,
        conf_level=LEVEL,
        print_to_console=False,
        seed=seed,
    )
    first, total, about_first, about_total = (
        np.asarray(found[name], dtype=float) for name in ("S1", "ST", "S1_conf", "ST_conf")
    )
    return Indices(
        groups=tuple(dict.fromkeys(of_variates)),
        first=first,
        total=total,
        first_interval=np.stack([first - about_first, first + about_first], axis=1),
        total_interval=np.stack([total - about_total, total + about_total], axis=1),
    )


def whole_blocks(of_variates: Sequence[str], done: Array) -> Array:
    """Return which points belong to blocks of which every point is done, ``(num_points,)``."""
    blocks = done.reshape(-1, len(set(of_variates)) + 2)
    return np.repeat(blocks.all(axis=1), blocks.shape[1])


def independent_points(of_variates: Sequence[str], count: int) -> Array:
    """Return which of ``count`` points are of A and B: the sample that a distribution of outputs is taken from."""
    block = len(set(of_variates)) + 2
    place = np.arange(count) % block
    return (place == 0) | (place == block - 1)


def _problem(of_variates: Sequence[str]) -> dict[str, Any]:
    """Return what SALib calls a problem, over the unit cube; groups only where one has several variates."""
    count = len(of_variates)
    problem: dict[str, Any] = {
        "num_vars": count,
        "names": [f"u{k}" for k in range(count)],
        "bounds": [[0.0, 1.0]] * count,
    }
    if len(set(of_variates)) < count:
        problem["groups"] = list(of_variates)
    return problem
