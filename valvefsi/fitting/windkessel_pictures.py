"""Pictures of fitted circuits and of a derived pump."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.fitting.uncertainty import band
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from valvefsi.fitting.windkessel import CircuitReport
    from valvefsi.fitting.windkessel_pump import PumpReport


def draw_fit(report: CircuitReport, out: Path) -> Path:
    """Draw ``fit.png``."""
    from valvefsi.post.plots import waveform as plots

    fit, waves, model = report.fit, report.waves, report.simulator.model
    kept, alike, norms = report.simulator.kept, report.assessment.alike, report.extra["norms_over_time"]
    inputs = {_symbol(q): waves[q][kept] / (MMHG if q[0] == "p" else 1.0) for q in model.inputs}
    picture = plots.CircuitPicture(
        t=waves.t[kept],
        data=fit.problem.data,
        curve=fit.curve,
        band=band(fit, report.assessment.linear) * np.sqrt(alike),
        output=f"{_symbol(model.output)} [mmHg]",
        inputs=inputs,
        title=f"{report.model}: relative L2 {100 * norms['relative_l2']:.2f} %, "
        f"Linf {100 * norms['relative_linf']:.2f} %",
        caption=", ".join(f"{name} {fit.named[name]:.4g}" for name in model.starts)
        + f" (mmHg, ml, s); 95 % band{f', residuals alike over {alike:.0f} samples' if alike > 2 else ''}",
    )
    return plots.circuit_fit(out / "fit.png", picture)


def draw_pump(report: PumpReport, out: Path) -> Path:
    """Draw the derived pressure of the pump, and P_LV of the forward run over the measured one."""
    from valvefsi.post.plots import waveform as plots

    measured = report.measured
    picture = plots.CircuitPicture(
        t=measured.t,
        data=measured["p_lv"] / MMHG,
        curve=report.back / MMHG,
        output=f"{_symbol('p_lv')} [mmHg]",
        inputs={_symbol("p_pump"): report.pump.p_pump / MMHG, _symbol("q_lv"): report.used["q_lv"]},
        title="pump pressure from measured flow and pressure",
        caption="; ".join(report.notes),
    )
    return plots.circuit_fit(out / "fit.png", picture)


def _symbol(quantity: str) -> str:
    """Return a quantity as a symbol: p_ao is P_Ao."""
    places = {"ao": "Ao", "lv": "LV", "la": "LA", "pump": "pump"}
    kind, _, place = quantity.partition("_")
    return f"${kind.upper()}_\\mathrm{{{places.get(place, place)}}}$"
