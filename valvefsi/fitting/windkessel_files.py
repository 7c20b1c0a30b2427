"""``circuit.toml``: a fitted circuit that a simulation reads; and the pictures of a fit."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.circulation.linear import Circuit
from valvefsi.errors import CaseError
from valvefsi.fitting.fit_pictures import draw_profiles
from valvefsi.fitting.uncertainty import band
from valvefsi.fitting.windkessel_models import CIRCUITS, SIZES, state_unit
from valvefsi.units import KILOPASCAL, LITRE_PER_MINUTE, MMHG, PASCAL

if TYPE_CHECKING:
    from valvefsi.fitting.windkessel import CircuitReport
    from valvefsi.fitting.windkessel_pump import PumpReport

READABLE = {
    **SIZES,
    "dyn*s/cm^5": 1.0,
    "cm^5/dyn": 1.0,
    "dyn*s^2/cm^5": 1.0,
    "Pa*s/m^3": 1e-5,
    "m^3/Pa": 1e5,
    "dyn/cm^2": 1.0,
    "Pa": PASCAL,
    "kPa": KILOPASCAL,
    "cm^3/s": 1.0,
    "L/min": LITRE_PER_MINUTE,
}
"""Units that ``circuit.toml`` may use, and their size in CGS."""
ALIKE = (
    ("mmHg*s/ml", "dyn*s/cm^5", "Pa*s/m^3"),
    ("ml/mmHg", "cm^5/dyn", "m^3/Pa"),
    ("mmHg*s^2/ml", "dyn*s^2/cm^5"),
    ("mmHg", "dyn/cm^2", "Pa", "kPa"),
    ("ml/s", "cm^3/s", "L/min"),
)


@dataclass(frozen=True, kw_only=True)
class StoredCircuit:
    """What ``circuit.toml`` holds.

    Attributes:
        name: Name of the circuit in `CIRCUITS`.
        circuit: The circuit, CGS.
        start: Initial states by name, CGS.
        pump: The pump's record, None without one.
        provenance: Where it is from.
    """

    name: str
    circuit: Circuit
    start: Mapping[str, float]
    pump: Path | None
    provenance: Mapping[str, object]


def circuit_text(
    name: str, values: Mapping[str, float], start: Mapping[str, float], provenance: Mapping[str, object]
) -> str:
    """Return the text of ``circuit.toml``; values and initial states in mmHg, ml and s."""
    parameters = CIRCUITS[name].parameters
    lines = [f"# {CIRCUITS[name].about}", "[circuit]", f'model = "{name}"']
    lines += [f'{key} = "{float(values[key])!r} {unit}"' for key, (unit, _) in parameters.items()]
    if start:
        lines += ["", "[circuit.start]"]
        lines += [f'{key} = "{float(value)!r} {state_unit(key)}"' for key, value in start.items()]
    lines += ["", "[circuit.provenance]", *(f"{key} = {_toml(value)}" for key, value in provenance.items())]
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


def read_circuit(path: str | Path) -> StoredCircuit:
    """Read ``circuit.toml``.

    Raises:
        CaseError: A key is missing, not known or holds what cannot be used.
    """
    path = Path(path)
    name, table = _circuit_table(path)
    parameters = CIRCUITS[name].parameters
    for key in table:
        if key not in (*parameters, "model", "start", "provenance", "pump"):
            raise CaseError(f"unknown key, expected {', '.join(parameters)}", file=path, key=f"circuit.{key}")
    values = {
        key: _quantity(path, f"circuit.{key}", table.get(key), unit) for key, (unit, _) in parameters.items()
    }
    try:
        circuit = CIRCUITS[name].kind(**values)
    except ValueError as error:
        raise CaseError(str(error), file=path, key="circuit") from None
    states, given = circuit.system().states, table.get("start", {})
    for key in given:
        if key not in states:
            raise CaseError(
                f"no such state, expected {', '.join(states)}", file=path, key=f"circuit.start.{key}"
            )
    start = {
        key: _quantity(path, f"circuit.start.{key}", text, state_unit(key)) for key, text in given.items()
    }
    pump = table.get("pump", {}).get("file")
    if not isinstance(pump, str | None):
        raise CaseError("expected the name of a file", file=path, key="circuit.pump.file", value=pump)
    return StoredCircuit(
        name=name,
        circuit=circuit,
        start=start,
        pump=None if pump is None else path.parent / pump,
        provenance=table.get("provenance", {}),
    )


def draw_fit(report: CircuitReport, out: Path) -> list[Path]:
    """Draw ``fit.png`` and, where there are profiles, ``profiles.png``."""
    from valvefsi.io import waveform_plots as plots

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
    from valvefsi.io import waveform_plots as plots

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


def _circuit_table(path: Path) -> tuple[str, dict[str, object]]:
    """Return the name of the circuit and its table, whose own tables are tables."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8")).get("circuit")
    except OSError as error:
        raise CaseError(f"cannot be read ({error.strerror})", file=path) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CaseError(str(error), file=path) from None
    if not isinstance(table, dict):
        raise CaseError("no table [circuit]", file=path)
    name = table.get("model")
    if name not in CIRCUITS:
        raise CaseError(f"expected one of {', '.join(CIRCUITS)}", file=path, key="circuit.model", value=name)
    for key in ("start", "pump", "provenance"):
        if not isinstance(table.get(key, {}), dict):
            raise CaseError("expected a table", file=path, key=f"circuit.{key}", value=table[key])
    return name, table


def _quantity(path: Path, key: str, text: object, unit: str) -> float:
    """Return a number with a unit, such as "1.085 mmHg*s/ml", in CGS."""
    choice = next(units for units in ALIKE if unit in units)
    if isinstance(text, int | float) and not isinstance(text, bool):
        return float(text)
    match = re.fullmatch(r"\s*([-+.\deE]+)\s+(\S+)\s*", text) if isinstance(text, str) else None
    if match is None or match[2] not in choice:
        wanted = f'expected a number and one of {", ".join(choice)}, such as "1.0 {unit}"'
        raise CaseError(wanted, file=path, key=key, value=text)
    try:
        return float(match[1]) * READABLE[match[2]]
    except ValueError:
        raise CaseError("expected a number", file=path, key=key, value=text) from None
