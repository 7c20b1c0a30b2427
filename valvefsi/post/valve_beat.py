"""One cycle of a valve's waveforms, of a run or the mean of a record, as a periodic function of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from valvefsi.post.valve_numbers import CycleNumbers, cycle_numbers
from valvefsi.post.valve_record import ValveRecord, ValveTest, first_closed
from valvefsi.types import Array

QUANTITIES = ("p_lv", "p_ao", "q_ao", "pdva")
"""What is compared: pressures before and after the valve, flow through it, its projected open area."""
UNKNOWN = ValveTest(rho=1.0, mu=0.01, diameter=2.5)
"""Stands in for the fluid and the valve of a record: saline; viscosity and diameter are in no number compared."""
FEWEST_CYCLES = 3
"""Cycles of which a standard deviation is taken."""


@dataclass(frozen=True, kw_only=True)
class Beat:
    """One cycle, repeated for ever, linear between its samples.

    Attributes:
        name: What it is called.
        t: Times from the start of the cycle, ascending in [0, T), ``(n,)`` [s].
        period: Length of the cycle, T [s].
        values: Waveforms by quantity, each ``(n,)`` [dyn/cm^2, cm^3/s, cm^2].
        deviations: Standard deviations over the cycles of a record, by quantity, each ``(n,)``.
        measured: Whether it is of a record: its flow may have the offset of a probe.
        start: Where the cycle starts in the run or the record [s].
        cycles: Number of cycles that it is the mean of.
        test: Fluid and valve, where they are known.
        notes: What a reader should know of it.
    """

    name: str
    t: Array
    period: float
    values: Mapping[str, Array]
    deviations: Mapping[str, Array] = field(default_factory=dict)
    measured: bool = False
    start: float = 0.0
    cycles: int = 1
    test: ValveTest | None = None
    notes: tuple[str, ...] = ()

    @property
    def spacing(self) -> float:
        """Usual time between two samples [s]."""
        return float(np.median(np.diff(self.t)))

    def at(self, quantity: str, t: Array) -> Array:
        """Return a waveform at any times, ``(k,)``."""
        return np.interp(t, self.t, self.values[quantity], period=self.period)

    def deviation_at(self, quantity: str, t: Array) -> Array:
        """Return a standard deviation at any times, ``(k,)``."""
        return np.interp(t, self.t, self.deviations[quantity], period=self.period)

    @property
    def grid(self) -> Array:
        """Even times from 0 to T, both included, as far apart as the samples usually are [s]."""
        return np.linspace(0.0, self.period, max(round(self.period / self.spacing), 8) + 1)

    def diastolic_offset(self) -> float | None:
        """Return the mean flow while the valve is shut, outside forward flow and closing backflow [cm^3/s].

        None without a flow, or where the valve is never shut.
        """
        record = self._from_shut() if "q_ao" in self.values else None
        leakage = None if record is None else cycle_numbers(record, self.test or UNKNOWN, 0).leakage_flow
        return None if leakage is None else -leakage

    def numbers(self, rho: float = 1.0) -> tuple[CycleNumbers | None, str]:
        """Return what a laboratory reports of the cycle, taken from where the valve is shut, or why there is nothing.

        Args:
            rho: Density where the fluid is not known [g/cm^3]; only the effective orifice area depends on it.
        """
        missing = [name for name in QUANTITIES[:3] if name not in self.values]
        if missing:
            return None, f"{self.name} has no {' and no '.join(missing)}"
        record = self._from_shut()
        if record is None:
            return None, f"the valve of {self.name} is never shut"
        return cycle_numbers(record, self.test or replace(UNKNOWN, rho=rho), 0), ""

    def _from_shut(self) -> ValveRecord | None:
        """Return the cycle twice, to be cut where the valve is shut; a pressure that is missing is zero."""
        t = np.concatenate([self.t, self.t + self.period, [2 * self.period + self.t[0]]])
        nothing = np.zeros(len(t))
        p_lv, p_ao, q = (self.at(name, t) if name in self.values else nothing for name in QUANTITIES[:3])
        pdva = self.at("pdva", t) if "pdva" in self.values else None
        twice = ValveRecord(t=t, p_lv=p_lv, p_ao=p_ao, q=q, pdva=pdva, period=self.period)
        start = first_closed(twice)
        return None if start is None else replace(twice, start=start)


def mean_beat(
    t: Array, waves: Mapping[str, Array], period: float
) -> tuple[Array, dict[str, dict[str, Array]], int]:
    """Return the mean of a record's whole cycles.

    Args:
        t: Times, ascending, ``(n,)`` [s].
        waves: Waveforms by quantity, each ``(n,)``.
        period: Length of a cycle, T [s].

    Returns:
        Times from the start of the cycle, ``(k,)`` [s]; by ``values`` and ``deviations`` (of three cycles or more,
        sample standard deviations), each by quantity, ``(k,)``; the number of cycles, 0 where none is whole.
    """
    step = float(np.median(np.diff(t)))
    count = int(np.floor((t[-1] - t[0] + 1.5 * step) / period))
    since = t - t[0]
    if count <= 1:
        inside = since < period * (1.0 - 1e-9)
        return since[inside], {"values": {q: y[inside] for q, y in waves.items()}, "deviations": {}}, count
    number = round(period / step)
    phases = np.linspace(0.0, period, number, endpoint=False)
    places = phases + period * np.arange(count)[:, None]
    cycles = {q: np.interp(places, since, y) for q, y in waves.items()}
    found = {"values": {q: y.mean(axis=0) for q, y in cycles.items()}, "deviations": dict[str, Array]()}
    if count >= FEWEST_CYCLES:
        found["deviations"] = {q: y.std(axis=0, ddof=1) for q, y in cycles.items()}
    return phases, found, count
