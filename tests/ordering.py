"""Shared check of observed orders of accuracy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence


def assert_order(run: Callable[[int], float], sizes: Sequence[int], *, order: float, below: float) -> None:
    """Assert the observed order on the finest pair and a ceiling on the finest error; show the table on failure."""
    errors = [run(n) for n in sizes]
    rates = [
        math.log(errors[k] / errors[k + 1]) / math.log(sizes[k + 1] / sizes[k]) for k in range(len(sizes) - 1)
    ]
    rows = [
        f"{n:6d}  {e:.4e}  {r}"
        for n, e, r in zip(sizes, errors, ["", *(f"{r:.2f}" for r in rates)], strict=True)
    ]
    table = "\n".join(["  size  error  rate", *rows])
    assert rates[-1] >= order, f"order {rates[-1]:.3f} is below {order}\n{table}"
    assert errors[-1] <= below, f"error {errors[-1]:.3e} is above {below}\n{table}"
