"""From records to a case: the leaflets' material, the circuits on both sides of the valve, and the case of them all."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case import Case, load_case, parse_case, to_toml
from valvefsi.case.circulation import connected
from valvefsi.case.includes import read_toml
from valvefsi.case.study_tables import ValidationStudy
from valvefsi.case.table import Table
from valvefsi.case.valve_report import ENDS
from valvefsi.circulation.pump import PumpPressure
from valvefsi.errors import CaseError
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.fitting.biaxial import fit_biaxial
from valvefsi.fitting.waveforms import Waveforms
from valvefsi.fitting.windkessel import Settings, fit_windkessel
from valvefsi.fitting.windkessel_models import SIZES, find_circuit
from valvefsi.fitting.windkessel_pump import PumpReport, derive_pump
from valvefsi.io.folder import write_text
from valvefsi.post.valve_beat import Beat
from valvefsi.studies.bench_start import from_sample, repeated, start_sample
from valvefsi.units import MMHG

UPSTREAM, DOWNSTREAM = "upstream-porcine", "downstream"
AROUND = 3
"""Cycles that the pump's pressure is derived over; the one in the middle is kept."""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """The measured beat of a study.

    Attributes:
        beat: The beat, from the record's first sample on.
        first: Sample at which a run begins.
        waves: The beat from that sample on, its flow without the probe's offset where the study says so.
    """

    beat: Beat
    first: int
    waves: Waveforms

    @property
    def start(self) -> float:
        """Time in the beat at which a run begins [s]."""
        return float(self.beat.t[self.first])


def read_measured(study: ValidationStudy) -> Measured:
    """Return the measured beat of a study, and where a run begins in it."""
    file = Path(study.record.file)
    beat = read_bench_beat(file, period=study.record.period)
    first = start_sample(beat, file, study.record.start)
    offset = (beat.diastolic_offset() or 0.0) if study.record.without_offset else 0.0
    return Measured(beat=beat, first=first, waves=from_sample(beat, first, file, offset))


def case_of(study: ValidationStudy, trust: bool) -> tuple[Case, dict[str, str]]:
    """Return the case that a study begins with, and its circuits' names by their model.

    Raises:
        CaseError: It is no valve between the two circuits, or has a target.
    """
    case = load_case(study.case, study.changes, trust=trust)
    if case.target is not None:
        reason = "a study takes pump and resistance from its record; leave the table out"
        raise CaseError(reason, file=case.file, key="target")
    sides, names = connected(case), dict[str, str]()
    for side, model in zip(ENDS, (UPSTREAM, DOWNSTREAM), strict=True):
        there = next((c for c in case.circuit if c.name == sides.get(side)), None)
        if there is None or there.model != model:
            key, value = (
                (f"fluid.sides.{side}.circuit", None)
                if there is None
                else (f"circuit.{there.name}.model", there.model)
            )
            raise CaseError(f"expected a circuit {model} at {side}", file=case.file, key=key, value=value)
        names[model] = there.name
    return case, names


def make_leaflet(study: ValidationStudy, folder: Path) -> dict[str, Any]:
    """Fit the leaflets' material to biaxial tests; ``material.toml``."""
    table = study.leaflet
    if table is None:
        return {}
    names = ("families", "axis1", "fibre_angle", "starts")
    options: dict[str, Any] = {name: getattr(table, name) for name in names}
    found = fit_biaxial(table.file, table.model, **options)
    found.write(folder)
    return {"model": table.model, "parameters": found.parameters, **_quality(found.report.as_dict())}


def make_downstream(study: ValidationStudy, folder: Path) -> dict[str, Any]:
    """Fit the circuit downstream to the record's flow and pressure, periodic; ``circuit.toml``."""
    measured, table = read_measured(study), study.downstream
    settings = Settings(
        fixed=_in_lab_units(table, DOWNSTREAM),
        periodic=True,
        period=measured.beat.period,
        profiles=table.profiles,
        draws=table.draws,
    )
    report = fit_windkessel(measured.waves, DOWNSTREAM, settings)
    report.write(folder)
    return {"parameters_mmHg_ml_s": report.fit.named, **_quality(report.extra["norms_over_time"])}


def make_upstream(study: ValidationStudy, folder: Path, trust: bool) -> dict[str, Any]:
    """Derive the pump's pressure from the record's flow and pressure; ``circuit.toml`` and ``pump.csv``."""
    measured = read_measured(study)
    values = upstream_values(study, trust)
    waves = repeated(measured.waves, measured.beat.period, AROUND)
    report = _middle(derive_pump(waves, values, cutoff=study.upstream.smooth), len(measured.waves.t))
    report.write(folder)
    pump = report.pump.p_pump / MMHG
    return {
        "parameters_mmHg_ml_s": values,
        "p_pump_mmHg": [float(pump.min()), float(pump.max())],
        "roundtrip_mmHg": report.roundtrip,
        **_quality(report.misfit),
    }


def upstream_values(study: ValidationStudy, trust: bool) -> dict[str, float]:
    """Return R_1, R_2 and C_VIA [mmHg, ml, s]: those of the study, and of its case where it has none."""
    case, names = case_of(study, trust)
    own: Mapping[str, Any] = next(c.parameters for c in case.circuit if c.name == names[UPSTREAM])
    units = find_circuit(UPSTREAM).parameters
    return {name: own[name] / SIZES[unit] for name, unit in units.items()} | _in_lab_units(
        study.upstream, UPSTREAM
    )


def make_case(study: ValidationStudy, folder: Path, trust: bool) -> dict[str, Any]:
    """Write the case with the material and the circuits that were found; ``case.toml``.

    The start values of the circuits are those of the record at the sample where a run begins.
    """
    measured, (case, names) = read_measured(study), case_of(study, trust)
    raw = tomllib.loads(to_toml(case))
    period, waves = measured.beat.period, measured.waves
    upstream, downstream = (
        read_toml(folder.parent / name / "circuit.toml") for name in ("upstream", "downstream")
    )
    upstream["pump"] = {
        "file": str((folder.parent / "upstream" / "pump.csv").resolve()),
        "period": f"{period!r} s",
        "cycles_from": "0 s",
    }
    p_wk = (waves["p_ao"][0] - _of(downstream, "R_c") * waves["q_ao"][0]) / MMHG
    downstream["start"] = {"p_wk": f"{float(p_wk)!r} mmHg"}
    downstream["target_pressure"] = f"{_mean(measured.beat, 'p_ao') / MMHG!r} mmHg"
    found = {names[UPSTREAM]: upstream, names[DOWNSTREAM]: downstream}
    raw["circuit"] = [{"name": c["name"], **found.get(c["name"], c)} for c in raw["circuit"]]
    if study.leaflet is not None:
        solid = _solid(raw, study.leaflet.solid, study)
        solid["material"] = read_toml(folder.parent / "leaflet" / "material.toml")
    raw["time"]["t_end"] = f"{period!r} s"
    raw["title"] = study.title or case.title
    written = parse_case(raw, file=Path(study.case), trust=trust)
    write_text(folder / "case.toml", to_toml(written))
    return {
        "start_in_record_s": measured.start,
        "period_s": period,
        "p_wk_mmHg": float(p_wk),
        "p_via_mmHg": next(c.start["p_via"] for c in written.circuit if c.name == names[UPSTREAM]) / MMHG,
    }


def _solid(raw: dict[str, Any], name: str, study: ValidationStudy) -> dict[str, Any]:
    """Return the table of a solid by its name."""
    solids: list[dict[str, Any]] = raw.get("solid", [])
    found = next((solid for solid in solids if solid["name"] == name), None)
    if found is None:
        names = ", ".join(solid["name"] for solid in solids) or "none"
        raise CaseError(
            f"the case has no such solid, it has {names}", file=study.file, key="leaflet.solid", value=name
        )
    return found


def _of(circuit: dict[str, Any], name: str) -> float:
    """Return a parameter of ``circuit.toml`` in CGS."""
    number, _, unit = str(circuit[name]).partition(" ")
    return float(number) * SIZES[unit]


def _mean(beat: Beat, name: str) -> float:
    return float(np.trapezoid(beat.at(name, beat.grid), beat.grid) / beat.period)


def _in_lab_units(table: Table, circuit: str) -> dict[str, float]:
    """Return the parameters of a circuit that a table gives, in mmHg, ml and s."""
    units = find_circuit(circuit).parameters
    values = {name: getattr(table, name) for name in units}
    return {name: value / SIZES[units[name]] for name, value in values.items() if value is not None}


def _middle(report: PumpReport, n: int) -> PumpReport:
    """Return the derivation of one cycle of ``n`` samples, with what is smoothed and derived at its ends."""
    kept = np.arange(n, 2 * n + 1)
    t = report.pump.t[kept] - report.pump.t[n]
    pump = PumpPressure(t=t, p_pump=report.pump.p_pump[kept], p_via=report.pump.p_via[kept])
    measured, used = (Waveforms(**{**vars(w.picked(kept)), "t": t}) for w in (report.measured, report.used))
    return replace(report, measured=measured, used=used, pump=pump, back=report.back[kept])


def _quality(numbers: Mapping[str, Any]) -> dict[str, float]:
    """Return how well a fit follows its record, in per cent."""
    known = {"relative_l2": "l2_percent", "relative_linf": "linf_percent"}
    return {name: 100.0 * numbers[key] for key, name in known.items() if numbers.get(key) is not None}
