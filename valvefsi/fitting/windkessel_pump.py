"""The pump's pressure from measured Q_LV and P_LV (Lee2020, S4-S5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.circulation.pump import PumpPressure, UpstreamPorcine, pump_pressure
from valvefsi.errors import CaseError
from valvefsi.fitting.report import measures, number, provenance, write_json
from valvefsi.fitting.waveform_repair import smooth
from valvefsi.fitting.waveforms import Waveforms, write_waveforms
from valvefsi.fitting.windkessel import circuit_text
from valvefsi.fitting.windkessel_models import SIZES, find_circuit
from valvefsi.fitting.windkessel_pictures import draw_pump
from valvefsi.io.folder import write_text
from valvefsi.types import Array
from valvefsi.units import MMHG

CIRCUIT = "upstream-porcine"
JAGGED = 0.05
"""Share of a curve's swing that may lie between neighbouring samples before smoothing is advised."""


@dataclass(frozen=True, kw_only=True)
class PumpReport:
    """The pump's pressure, and how well the circuit driven by it gives the record back.

    Attributes:
        circuit: The circuit, CGS.
        parameters: Its values [mmHg, ml, s].
        measured: The record as measured.
        used: The record the pump's pressure was derived from, smoothed where asked for.
        pump: The pump's pressure.
        back: P_LV of the forward run, ``(n,)`` [dyn/cm^2].
        notes: Things to say first.
    """

    circuit: UpstreamPorcine
    parameters: Mapping[str, float]
    measured: Waveforms
    used: Waveforms
    pump: PumpPressure
    back: Array
    notes: tuple[str, ...]

    @property
    def roundtrip(self) -> float:
        """Largest difference of the forward run from the record used [mmHg]."""
        return float(np.abs(self.back - self.used["p_lv"]).max() / MMHG)

    @property
    def misfit(self) -> dict[str, float]:
        """Normalised norms of the forward run against the measured record (S24)."""
        return measures(self.measured["p_lv"], self.back, self.measured.t)

    def summary(self) -> str:
        """Return what was found as text."""
        p, size = self.pump.p_pump / MMHG, self.misfit
        values = ", ".join(f"{name} {number(value)}" for name, value in self.parameters.items())
        return "\n".join(
            [
                f"pressure of the pump from q_lv and p_lv, {CIRCUIT} (S4-S5): {values} (mmHg, ml, s)",
                *self.notes,
                f"P_pump {number(p.min())} ... {number(p.max())} mmHg, mean {number(_mean(self.pump.t, p))} mmHg",
                f"forward run: P_LV back to {self.roundtrip:.2g} mmHg; against the measured record "
                f"relative L2 {100 * size['relative_l2']:.3g} %, Linf {100 * size['relative_linf']:.3g} %",
            ]
        )

    def as_dict(self) -> dict[str, Any]:
        """Return what ``fit.json`` holds."""
        units, file = find_circuit(CIRCUIT).parameters, self.measured.file
        entry = {"std": None, "ci95": None, "verdict": "held"}
        return {
            "kind": "windkessel",
            "model": CIRCUIT,
            "derived": "p_pump",
            "parameters": {
                name: {"value": v, "unit": units[name], **entry} for name, v in self.parameters.items()
            },
            "roundtrip_mmHg": self.roundtrip,
            "norms_over_time": self.misfit,
            "n_points": len(self.pump.t),
            "notes": self.notes,
            **provenance([file] if file else []),
        }

    def write(self, out: Path) -> Path:
        """Write ``fit.json``, ``pump.csv``, ``circuit.toml`` and ``fit.png``; return the path of the first."""
        out = Path(out)
        out.mkdir(parents=True, exist_ok=True)
        record = Waveforms(t=self.pump.t, values={"p_pump": self.pump.p_pump, "q_lv": self.used["q_lv"]})
        header = ["pressure of the pump, derived from q_lv (positive downstream) and p_lv", *self.notes]
        write_waveforms(record, out / "pump.csv", header)
        start = {"p_via": float(self.pump.p_via[0] / MMHG)} if self.circuit.C_VIA else {}
        about = {"derived": "p_pump, see pump.csv", "roundtrip_mmHg": self.roundtrip}
        text = circuit_text(CIRCUIT, self.parameters, start, {**self.measured.origin, **about})
        write_text(out / "circuit.toml", text + '\n[pump]\nfile = "pump.csv"\n')
        draw_pump(self, out)
        return write_json(out / "fit.json", self.as_dict())


def derive_pump(waves: Waveforms, values: Mapping[str, float], *, cutoff: float = 0.0) -> PumpReport:
    """Derive the pump's pressure, and run the circuit forward with it.

    Args:
        waves: The record; q_lv positive downstream.
        values: R_1, R_2 and C_VIA [mmHg, ml, s].
        cutoff: Period that the smoothing of q_lv and p_lv halves [s]; 0 for none.

    Raises:
        CaseError: A value or a column is missing.
    """
    waves.require(["q_lv", "p_lv"], f"circuit {CIRCUIT} without p_pump")
    model = find_circuit(CIRCUIT)
    for name in values:
        if name not in model.starts:
            raise CaseError(f"no such parameter, expected {', '.join(model.starts)}", key="fix", value=name)
    missing = [name for name in model.parameters if name not in values]
    if missing:
        raise CaseError(
            f"without a column p_pump the pump's pressure is derived from q_lv and p_lv, and nothing is fitted: "
            f"give {', '.join(f'--fix {name}=...' for name in missing)} (mmHg, ml, s)",
            file=waves.file,
        )
    try:
        circuit = UpstreamPorcine(
            **{name: values[name] * SIZES[unit] for name, unit in model.parameters.items()}
        )
    except ValueError as error:
        raise CaseError(str(error), key="fix") from None
    used = smooth(waves, ("q_lv", "p_lv"), cutoff)
    pump = pump_pressure(circuit, used.t, used["q_lv"], used["p_lv"])
    system, u = circuit.system(), np.stack([pump.p_pump, used["q_lv"]], axis=1)
    states = system.simulate(pump.t, u, pump.p_via[: len(system.states)])
    notes = [*used.notes, "" if cutoff else "q_lv and p_lv are not smoothed", _roughness(pump.p_pump, cutoff)]
    return PumpReport(
        circuit=circuit,
        parameters=dict(values),
        measured=waves,
        used=used,
        pump=pump,
        back=system.outputs(states, u),
        notes=tuple(note for note in notes if note),
    )


def _roughness(p: Array, cutoff: float) -> str:
    """Return a warning where the curve is mostly noise."""
    swing = np.ptp(p)
    jag = float(np.sqrt(np.mean(np.diff(p, 2) ** 2)) / swing) if swing > 0 else 0.0
    if jag < JAGGED:
        return ""
    more = "a longer" if cutoff else "such as 0.03 for a"
    return f"P_pump is jagged (second differences {100 * jag:.0f} % of its swing): try --smooth SECONDS, {more} cut-off"


def _mean(t: Array, y: Array) -> float:
    return float(np.trapezoid(y, t) / (t[-1] - t[0]))
