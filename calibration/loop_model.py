"""A flow loop without space: upstream circuit, a valve, downstream circuit.

Makes the records of `porcine_loop.py`, `bovine_loop.py` and `valve_beat.py`. The circuits are the ones a
three-dimensional run is coupled to, stepped the same way: the flow of the valve goes into both, their pressures come
back. In mmHg, ml and s.

    L dq/dt = P_LV - P_Ao - B q |q|   (q positive downstream)

The valve lets flow through one way, q >= 0 with a constant B, or is an orifice whose area follows flow and pressure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from valvefsi.circulation.linear import Circuit
from valvefsi.fitting.waveforms import Waveforms, write_waveforms
from valvefsi.fitting.windkessel import CircuitReport
from valvefsi.units import MMHG

PERIOD, SYSTOLE = 60 / 70, 0.35
"""ISO 5840: 70 beats a minute, systole 35 % of a cycle [s]."""
INERTANCE, BERNOULLI = 0.004, 6e-5
"""Of the valve [mmHg s^2/ml, mmHg s^2/ml^2]: 10 mmHg at 400 ml/s."""
STEP, KEPT = 2.5e-4, 20
"""Time step [s], and every how many steps a sample is taken."""


class Valve(Protocol):
    """What stands between the circuits."""

    area: float
    """Its open area [cm^2]."""

    def flow(self, q: float, push: float, resistance: float, dt: float) -> float:
        """Return the flow a time step on, from the flow, the pressure difference and the resistance beside it."""


@dataclass
class OneWay:
    """A valve that is open to forward flow, and shut to backflow at once."""

    area: float = float("nan")

    def flow(self, q: float, push: float, resistance: float, dt: float) -> float:
        """Return the flow a time step on [ml/s]."""
        return max(0.0, (INERTANCE * q / dt + push) / (INERTANCE / dt + BERNOULLI * q + resistance))


@dataclass
class Orifice:
    """An orifice whose area goes to that of the open valve while it is driven forward, else to its leak.

    B = rho / (2 A^2); dA/dt = (A_open - A)/tau_opening, or (A_leak - A)/tau_closing once flow falls below a part of
    its largest value with the pressure against it.
    """

    open: float
    leak: float
    opening: float
    closing: float
    area: float = 0.02
    largest: float = 1.0

    def flow(self, q: float, push: float, resistance: float, dt: float) -> float:
        """Return the flow a time step on [ml/s]; the area moves with it."""
        self.largest = max(self.largest * (1.0 - dt / PERIOD), q)
        forward = push > 0.0 or q > 0.35 * self.largest
        target, tau = (self.open, self.opening) if forward else (self.leak, self.closing)
        self.area += (target - self.area) * dt / tau
        loss = 0.5 / self.area**2 / MMHG
        return (INERTANCE * q / dt + push) / (INERTANCE / dt + loss * abs(q) + resistance)


def run_loop(
    upstream: Circuit,
    downstream: Circuit,
    drive: Callable[[float], list[float]],
    cycles: int,
    before: int = 30,
    valve: Valve | None = None,
) -> dict[str, np.ndarray]:
    """Run the loop to its periodic state and on, and return samples every 5 ms.

    Args:
        upstream: Circuit with the input q_lv.
        downstream: Circuit with the input q_ao.
        drive: The other inputs of the upstream circuit over time, in their order.
        cycles: Cycles to return.
        before: Cycles to run first.
        valve: The valve; one that lets flow through one way unless given.
    """
    valve = valve or OneWay()
    inlet, outlet = upstream.system(), downstream.system()
    place = inlet.inputs.index("q_lv")
    before_valve, after_valve = -inlet.D[place], outlet.D[0]  # resistances next to the valve

    def inputs(t: float, q: float) -> list[float]:
        given = list(drive(t))
        return [*given[:place], q, *given[place:]]

    a = inlet.start(np.full(len(inlet.states), 20.0), inputs(0.0, 0.0))
    b = outlet.start(np.full(len(outlet.states), 100.0), [0.0])
    q, rows, steps = 0.0, [], round(PERIOD / STEP)
    dt = PERIOD / steps
    for n in range((before + cycles) * steps + 1):
        p_lv, p_ao = inlet.observe(a), outlet.observe(b)
        if n >= before * steps and (n - before * steps) % KEPT == 0:
            others = [u for i, u in enumerate(a.u) if i != place]
            rows.append([(n - before * steps) * dt, p_lv, p_ao, q, valve.area, *others])
        # the resistances next to the valve and its own loss are taken at the new flow
        push = (p_lv + before_valve * q) - (p_ao - after_valve * q)
        q = valve.flow(q, push, before_valve + after_valve, dt)
        a = inlet.advance(a, inputs((n + 1) * dt, q), dt)
        b = outlet.advance(b, [q], dt)
    names = ["t", "p_lv", "p_ao", "q", "pdva", *(name for name in inlet.inputs if name != "q_lv")]
    return dict(zip(names, np.array(rows).T, strict=True))


def noisy(found: dict[str, np.ndarray], quantities: dict[str, float], seed: int) -> Waveforms:
    """Return a record with normal noise on the named quantities [mmHg, ml/s]."""
    rng = np.random.default_rng(seed)
    source = {"q_lv": "q", "q_ao": "q"}
    values = {}
    for name, deviation in quantities.items():
        clean = found[source.get(name, name)]
        measured = clean + deviation * rng.standard_normal(len(clean))
        values[name] = measured * (MMHG if name.startswith("p") else 1.0)
    return Waveforms(t=found["t"], values=values)


def write_record(path: Path, waves: Waveforms, header: list[str]) -> Path:
    """Write a record with where it is from, rounded as a data logger does."""
    rounded = {name: np.round(y / (MMHG if name[0] == "p" else 1.0), 3) for name, y in waves.values.items()}
    kept = {name: y * (MMHG if name[0] == "p" else 1.0) for name, y in rounded.items()}
    return write_waveforms(Waveforms(t=np.round(waves.t, 7), values=kept), path, header)


def against_truth(report: CircuitReport, truth: dict[str, float]) -> dict[str, object]:
    """Return value, interval and verdict of each parameter next to the value the record was made with."""
    found = report.parameters()
    wide = report.extra["ci95_correlated_residuals"]
    rows = {
        name: {
            "value": found[name]["value"],
            "truth": value,
            "unit": found[name]["unit"],
            "ci95": found[name]["ci95"],
            "inside": bool(found[name]["ci95"][0] <= value <= found[name]["ci95"][1]),
            "inside_for_correlated_residuals": bool(wide[name][0] <= value <= wide[name][1]),
            "verdict": found[name]["verdict"],
        }
        for name, value in truth.items()
    }
    return {"parameters": rows, "norms_over_time": report.extra["norms_over_time"]}
