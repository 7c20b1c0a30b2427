"""Clocks around the parts of a model, so that the step itself needs none."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any


class Timed:
    """Stands for an object and adds the wall-clock time of some of its methods to a table [s].

    Args:
        inner: The object.
        table: Time by phase, added to.
        methods: Phase of each method that is timed.
    """

    def __init__(self, inner: Any, table: dict[str, float], methods: Mapping[str, str]) -> None:
        self._inner = inner
        for method, phase in methods.items():
            setattr(self, method, timed_call(getattr(inner, method), table, phase))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


class TimedCoupling(Timed):
    """Stands for a coupling; the transfers it makes are timed too."""

    def __init__(self, inner: Any, table: dict[str, float]) -> None:
        super().__init__(inner, table, {})
        prepare = timed_call(inner.at, table, "kernel weights")
        methods = {"spread": "spread", "interpolate": "interpolate"}
        self.at = lambda chi: Timed(prepare(chi), table, methods)


def seconds(call: Callable[[], Any]) -> float:
    """Return the wall-clock time of a call [s]."""
    started = time.perf_counter()
    call()
    return time.perf_counter() - started


def timed_call(function: Callable[..., Any], table: dict[str, float], phase: str) -> Callable[..., Any]:
    """Return the function with a clock around it."""

    def timed(*args: Any, **options: Any) -> Any:
        started = time.perf_counter()
        result = function(*args, **options)
        table[phase] += time.perf_counter() - started
        return result

    return timed
