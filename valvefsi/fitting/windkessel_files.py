"""``circuit.toml``: a fitted circuit that a simulation reads; and the pictures of a fit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.fitting.fit_pictures import draw_profiles
from valvefsi.fitting.uncertainty import band
from valvefsi.fitting.windkessel_models import CIRCUITS, state_unit
from valvefsi.units import MMHG

if TYPE_CHECKING:
    from valvefsi.fitting.windkessel import CircuitReport
    from valvefsi.fitting.windkessel_pump import PumpReport


def circuit_text(
    name: str, values: Mapping[str, float], start: Mapping[str, float], provenance: Mapping[str, object]
) -> str:
    """Return the text of ``circuit.toml``; values and initial states in mmHg, ml and s."""
    parameters = CIRCUITS[name].parameters
    about = f"# {CIRCUITS[name].about}"
    use = '# in a case file: [[circuit]], then name = "outlet" and include = "circuit.toml"'
    lines = [about, use, f'model = "{name}"']
    lines += [f'{key} = "{float(values[key])!r} {unit}"' for key, (unit, _) in parameters.items()]
    if start:
        lines += ["", "[start]"]
        lines += [f'{key} = "{float(value)!r} {state_unit(key)}"' for key, value in start.items()]
    lines += ["", "[provenance]", *(f"{key} = {_toml(value)}" for key, value in provenance.items())]
    return "\n".join(lines) + "\n"


def write_circuit(report: CircuitReport, path: Path) -> Path:
    """Write a fitted circuit."""
    norms = report.extra["norms_over_time"]
    about = {"relative_l2": norms["relative_l2"], "relative_linf": norms["relative_linf"]}
    about |= {f"verdict_{name}": entry["verdict"] for name, entry in report.parameters().items()}
    waves = report.waves
    origin = {"data": waves.file.name, "sha256": waves.sha256} if waves.file else {}
    text = circuit_text(report.model, report.fit.named, report.start, {**origin, **about})
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    return path


def draw_fit(report: CircuitReport, out: Path) -> list[Path]:
    """Draw ``fit.png`` and, where there are profiles, ``profiles.png``."""
    from valvefsi.post.plots import waveform as plots

    fit, waves, model = report.fit, report.waves, report.simulator.model
    wide = np.sqrt(report.extra["residual_correlation_samples"])
    reach = band(fit, report.assessment.linear) * wide
    norms = report.extra["norms_over_time"]
    picture = plots.CircuitPicture(
        t=waves.t,
        data=fit.problem.data,
        curve=fit.curve,
        band=reach,
        output=f"{_symbol(model.output)} [mmHg]",
        inputs={_symbol(q): waves[q] / (MMHG if q[0] == "p" else 1.0) for q in model.inputs},
        title=f"{report.model}: relative L2 {100 * norms['relative_l2']:.2f} %, "
        f"Linf {100 * norms['relative_linf']:.2f} %",
        caption=", ".join(f"{name} {report.fit.named[name]:.4g}" for name in model.parameters)
        + f" (mmHg, ml, s); 95 % band{f', residuals alike over {wide**2:.0f} samples' if wide**2 > 2 else ''}",
    )
    drawn = [plots.circuit_fit(out / "fit.png", picture)]
    if report.assessment.profiles:
        drawn.append(draw_profiles(out / "profiles.png", report))
    return drawn


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


def _toml(value: object) -> str:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(float(value)) if isinstance(value, float) else repr(value)
    return '"' + str(value).replace("\\", "\\\\").replace('"', '\\"') + '"'
