"""Records of planar biaxial tests: CSV files to deformation gradients and stresses, with every doubt named.

Columns are known by their names, upper or lower case, with a unit at the end if there is one (``P11_kPa``,
``S22 [MPa]``, ``tension1 (N/m)``, ``E11_percent``):

    deformation   stretch1 stretch2 (lambda1 ...) | E11 E22 [E12] (strain1 ...) | F11 F12 F21 F22
    stress        PK1_1 PK1_2 (P11 P22 [P12 P21]) | PK2_1 PK2_2 (S11 S22 [S12]) | cauchy1 cauchy2 (sigma11 ...)
                  | tension1 tension2: force per reference length, needs the thickness
    protocol      a name or number for each row; without it a file is one protocol

Other columns are passed over with a note, and so are those of a standard deviation (``P11_sd``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.record_table import Table, is_statistic, read_table
from valvefsi.types import Array, Indices
from valvefsi.units import KILOPASCAL, MMHG

STRESS_UNITS = {
    "pa": 1e-3,
    "kpa": 1.0,
    "mpa": 1e3,
    "gpa": 1e6,
    "n/mm2": 1e3,
    "dyn/cm2": 1 / KILOPASCAL,
    "mmhg": MMHG / KILOPASCAL,
}
"""Units of stress in kPa."""
TENSION_UNITS = {"n/m": 1.0, "mn/mm": 1.0, "n/mm": 1e3, "n/cm": 1e2, "dyn/cm": 1e-3, "mn/m": 1e-3}
"""Units of membrane tension in N/m."""
PURE_UNITS = {"-": 1.0, "1": 1.0, "percent": 0.01, "%": 0.01}
KINDS = {
    "stretch": r"(?:stretch(?:_?ratio)?|lambda|lam)",
    "strain": r"(?:e|strain|green(?:_?lagrange)?(?:_?strain)?)",
    "gradient": r"(?:f|deformation_?gradient)",
    "pk1": r"(?:pk1|p|piola|first_?pk)",
    "pk2": r"(?:pk2|s|second_?pk)",
    "cauchy": r"(?:cauchy|sigma|sig)",
    "tension": r"(?:tension|membrane_?tension|t)",
}
DEFORMATIONS, STRESSES = ("gradient", "strain", "stretch"), ("pk1", "pk2", "cauchy", "tension")
INDEX = r"_?(11|22|12|21|1|2)"
EXAMPLES = "stretch1, E11, F11, PK1_1, PK2_1, cauchy1, tension1 or protocol"
NAMES = {
    "stretch": "stretch{0}",
    "strain": "E{0}{0}",
    "gradient": "F{0}{0}",
    "pk1": "P{0}{0}",
    "pk2": "S{0}{0}",
}
NAMES |= {"cauchy": "cauchy{0}", "tension": "tension{0}"}
"""A name of each quantity along an axis, for messages."""
LARGEST = 1e6
"""Largest stress that a record may hold [kPa]."""
FIXED = 1e-9
"""Change of F below which nothing was deformed."""
FALL, SLACK = 0.1, 0.05
"""Fall of the stress, and stress in a slack specimen, that are refused, as parts of the protocol's largest."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How records are to be read where their header does not say.

    Args:
        columns: Column of the file by the name it stands for, such as ``{"stretch1": "lx"}``.
        unit: Unit of the stresses (or tensions).
        thickness: Thickness of the unloaded specimen, for tensions [cm].
        accept_suspect: Only note what looks wrong (stress falling with stretch, tension while slack).
    """

    columns: Mapping[str, str] | None = None
    unit: str | None = None
    thickness: float | None = None
    accept_suspect: bool = False


@dataclass(frozen=True, kw_only=True)
class BiaxialData:
    """Records of biaxial tests.

    Attributes:
        F: Deformation gradient in the plane, ``(n, 2, 2)``.
        measure: ``pk1``, ``pk2`` or ``cauchy``.
        components: Components of the stress that were measured, such as ``("11", "22")``.
        stress: The stress, ``(n, components)`` [kPa].
        protocol: Number of the protocol of each point, from 0, ``(n,)``.
        names: Names of the protocols.
        files: Where they are from.
        notes: What was inferred.
    """

    F: Array
    measure: str
    components: tuple[str, ...]
    stress: Array
    protocol: Indices
    names: tuple[str, ...]
    files: tuple[Path, ...] = ()
    notes: tuple[str, ...] = ()

    def select(self, names: Sequence[str]) -> BiaxialData:
        """Return the protocols of these names.

        Raises:
            CaseError: There is none of a name, or no name at all.
        """
        selection = [str(name).strip() for name in names]
        for name in selection:
            if name not in self.names:
                message = f"no such protocol, there are {', '.join(self.names)}"
                raise CaseError(message, key="protocols", value=name)
        places = [k for k, name in enumerate(self.names) if name in selection]
        if not places:
            raise CaseError("name at least one protocol", key="protocols")
        rows = np.isin(self.protocol, places)
        return replace(
            self,
            F=self.F[rows],
            stress=self.stress[rows],
            protocol=np.searchsorted(places, self.protocol[rows]),
            names=tuple(self.names[k] for k in places),
        )

    @property
    def shear(self) -> bool:
        """Whether the specimen was sheared."""
        return bool(np.abs(np.einsum("nk,nk->n", self.F[:, :, 0], self.F[:, :, 1])).max() > 1e-6)


@dataclass(frozen=True, kw_only=True)
class _Column:
    """A column of a file: its header, what it is, its component, its unit (None if not said)."""

    header: str
    kind: str
    component: str
    unit: str | None


Columns = Mapping[tuple[str, str], _Column]
"""Columns by kind and component."""


def read_biaxial(paths: str | Path | Sequence[str | Path], reading: Reading | None = None) -> BiaxialData:
    """Read one or several CSV files of biaxial tests.

    Raises:
        CaseError: Something in a file cannot be used; the message names file, row and column.
    """
    several = [paths] if isinstance(paths, str | Path) else list(paths)
    if not several:
        raise CaseError("no file given", key="DATA")
    reading = reading or Reading()
    parts = [_read_file(Path(path), reading, many=len(several) > 1) for path in several]
    first = parts[0]
    for part in parts[1:]:
        if (part.measure, part.components) != (first.measure, first.components):
            message = f"this file has other stresses than {first.files[0].name}"
            raise CaseError(message, file=part.files[0])
    names = tuple(name for part in parts for name in part.names)
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled is not None:
        raise CaseError("two protocols have this name", key="protocol", value=doubled)
    shifts = np.cumsum([0, *(len(part.names) for part in parts[:-1])])
    return replace(
        first,
        F=np.concatenate([part.F for part in parts]),
        stress=np.concatenate([part.stress for part in parts]),
        protocol=np.concatenate([part.protocol + s for part, s in zip(parts, shifts, strict=True)]),
        names=names,
        files=tuple(part.files[0] for part in parts),
        notes=tuple(dict.fromkeys(note for part in parts for note in part.notes)),
    )


def _read_file(path: Path, reading: Reading, *, many: bool) -> BiaxialData:
    table = read_table(path)
    columns = _recognise(table, reading.columns or {})
    deformation, measure = _kinds(table, columns)
    notes = list(table.unused(column.header for column in columns.values()))
    F = _deformation(table, columns, deformation, notes)
    components, stress = _stress(table, columns, measure, reading, notes)
    protocol, names = _protocols(table, columns, path.stem if many else None)
    data = BiaxialData(
        F=F,
        measure="pk1" if measure == "tension" else measure,
        components=components,
        stress=stress,
        protocol=protocol,
        names=names,
        files=(path,),
    )
    notes += _suspects(table, data, columns, accept=reading.accept_suspect)
    return replace(data, notes=tuple(notes))


def _recognise(table: Table, columns: Mapping[str, str]) -> Columns:
    """Return the columns by kind and component."""
    recognised: dict[tuple[str, str], _Column] = {}
    for header, name in table.renamed(columns, "column").items():
        column = _meaning(header, name, table)
        if column is None:
            if name != header:
                message = f"not a quantity, expected {EXAMPLES}"
                raise CaseError(message, file=table.path, key="column", value=name)
            continue
        key = (column.kind, column.component)
        if key in recognised:
            raise table.fault(f"the same quantity as column {recognised[key].header}", header)
        recognised[key] = column
    return recognised


def _meaning(header: str, name: str, table: Table) -> _Column | None:
    """Return what a column is, None if it is nothing known.

    Raises:
        CaseError: It is a known quantity in an unknown unit.
    """
    text = name.strip().lower().replace(" ", "_")
    if text in ("protocol", "test", "set"):
        return _Column(header=header, kind="protocol", component="", unit=None)
    for kind, pattern in KINDS.items():
        match = re.fullmatch(pattern + INDEX + r"(?:_*[\[(]([^\])]*)[\])]|_+(\S+))?", text)
        if match is None or is_statistic(text):
            continue
        unit = next((_plain_unit(part) for part in match.groups()[1:] if part is not None), None)
        units = _units(kind)
        if unit is not None and unit not in units:
            raise table.fault(f"unknown unit {unit}, expected one of {', '.join(units)}", header)
        component = match[1] if len(match[1]) == 2 else 2 * match[1]
        return _Column(header=header, kind=kind, component=component, unit=unit)
    return None


def _units(kind: str) -> Mapping[str, float]:
    return TENSION_UNITS if kind == "tension" else STRESS_UNITS if kind in STRESSES else PURE_UNITS


def _plain_unit(text: str) -> str:
    """Return a unit without blanks, powers and case: ``dyn_cm^2`` and ``dyn/cm2`` are the same."""
    return re.sub(r"[\s^*]", "", text.strip("_").lower()).replace("_per_", "/").replace("_", "/")


def _kinds(table: Table, columns: Columns) -> tuple[str, str]:
    """Return how the deformation and the stress are given.

    Raises:
        CaseError: Columns are missing, all named at once, or there are several measures of stress.
    """
    deformation = next((kind for kind in DEFORMATIONS if {(kind, "11"), (kind, "22")} & columns.keys()), None)
    stresses = [kind for kind in STRESSES if any(key[0] == kind for key in columns)]
    if len(stresses) > 1:
        raise CaseError(f"expected one measure of stress, found {' and '.join(stresses)}", file=table.path)
    missing = []
    for kind in filter(None, (deformation, *stresses)):
        missing += [NAMES[kind].format(axis) for axis in (1, 2) if (kind, 2 * str(axis)) not in columns]
    if deformation is None:
        missing.append("the deformation (stretch1 and stretch2, E11 and E22, or F11 to F22)")
    if not stresses:
        missing.append("the stress (PK1_1 and PK1_2, PK2_1 ..., cauchy1 ..., or tension1 ...)")
    if missing or deformation is None:
        message = f"columns missing: {' and '.join(missing)}"
        raise CaseError(message, file=table.path, key=f"columns {', '.join(table.header)}")
    return deformation, stresses[0]


def _deformation(table: Table, columns: Columns, kind: str, notes: list[str]) -> Array:
    """Return F from the stretches, strains or F itself, ``(rows, 2, 2)``."""
    values = {}
    for component in ("11", "22", "12", "21"):
        column = columns.get((kind, component))
        if column is not None:
            values[component] = table.numbers(column.header) * PURE_UNITS[column.unit or "-"]
    _check_positive(table, columns, kind, values)
    F = np.zeros((len(table.rows), 2, 2))
    if kind == "strain":
        F = _stretch_of(table, values, notes)
    else:
        for component, numbers in values.items():
            F[:, int(component[0]) - 1, int(component[1]) - 1] = numbers
    if np.ptp(F, axis=0).max() < FIXED:
        raise CaseError("the deformation does not change: there is nothing to fit", file=table.path)
    for line, value in zip(table.lines, np.linalg.det(F), strict=True):
        if not 1e-6 < value < 1e6:
            message = "the deformation leaves no usable area"
            raise CaseError(message, file=table.path, key=f"row {line}, det F", value=float(value))
    if len(F) > 1 and np.ptp(F, axis=0).max() < 1e-9:
        raise CaseError("the deformation does not change: there is nothing to fit", file=table.path)
    return F


def _check_positive(table: Table, columns: Columns, kind: str, values: Mapping[str, Array]) -> None:
    """Refuse stretches (strains) that are not positive (above -1/2), and those that look like percent."""
    strain = kind == "strain"
    least, most = (-0.5, 100) if strain else (0, 10)
    small = "a Green strain must exceed -1/2" if strain else "a stretch must be positive"
    for component in ("11", "22"):
        header = columns[(kind, component)].header
        for line, value in zip(table.lines, values[component], strict=True):
            if value <= least:
                raise table.fault(small, header, line)
            if value > most:
                message = "this is too large for soft tissue; is it in percent?"
                raise table.fault(message, header, line, float(value))


def _stretch_of(table: Table, values: Mapping[str, Array], notes: list[str]) -> Array:
    """Return U, U^2 = C = 1 + 2 E, the deformation without rotation, ``(rows, 2, 2)``."""
    shear = values.get("12", values.get("21", np.zeros(len(table.rows))))
    E = np.array([[values["11"], shear], [shear, values["22"]]]).transpose(2, 0, 1)
    squares, axes = np.linalg.eigh(np.eye(2) + 2 * E)
    for line, least in zip(table.lines, squares[:, 0], strict=True):
        if least <= 0:
            raise CaseError("these strains leave no length", file=table.path, key=f"row {line}")
    if np.any(shear):
        notes.append(f"{table.path.name}: strains with shear, F taken as U = sqrt(1 + 2 E), without rotation")
    return np.einsum("nik,nk,njk->nij", axes, np.sqrt(squares), axes)


def _stress(
    table: Table, columns: Columns, kind: str, reading: Reading, notes: list[str]
) -> tuple[tuple[str, ...], Array]:
    """Return the components of the stress and their values, ``(rows, components)`` [kPa]."""
    components = tuple(c for c in ("11", "22", "12", "21") if (kind, c) in columns)
    raw = np.array([table.numbers(columns[(kind, c)].header) for c in components]).T
    if not np.any(raw):
        raise CaseError("the stress is zero throughout", file=table.path)
    units, largest = _units(kind), float(np.abs(raw).max())
    unit = None if reading.unit is None else _plain_unit(reading.unit)
    if unit is not None and unit not in units:
        raise CaseError(f"unknown unit, expected one of {', '.join(units)}", key="unit", value=reading.unit)
    if unit is None:
        unit = "n/m" if kind == "tension" else "pa" if largest > 5e3 else "kpa" if largest > 2 else "mpa"
        if any(columns[(kind, c)].unit is None for c in components):
            said = {"n/m": "N/m", "pa": "Pa", "kpa": "kPa", "mpa": "MPa"}[unit]
            notes.append(
                f"{table.path.name}: no unit given for the stress, {said} inferred from its size "
                f"(largest {largest:.5g})"
            )
    stress = raw * np.array([units[columns[(kind, c)].unit or unit] for c in components])
    if kind == "tension":
        if reading.thickness is None or not reading.thickness > 0:
            raise CaseError("tensions need the thickness of the specimen", file=table.path, key="thickness")
        millimetres = 10 * reading.thickness
        notes.append(f"{table.path.name}: first Piola-Kirchhoff stress is tension over {millimetres:g} mm")
        stress = stress / millimetres
    beyond = np.argwhere(np.abs(stress) > LARGEST)
    if len(beyond):
        row, at = beyond[0]
        message = f"no tissue bears this, at most {LARGEST:g} kPa is plausible"
        raise table.fault(
            message, columns[(kind, components[at])].header, table.lines[row], float(raw[row, at])
        )
    return components, stress


def _protocols(table: Table, columns: Columns, prefix: str | None) -> tuple[Indices, tuple[str, ...]]:
    """Return the number of each row's protocol and the names; with several files the file's name goes first."""
    column = columns.get(("protocol", ""))
    if column is None:
        texts = [prefix or "1"] * len(table.rows)
    else:
        at = table.header.index(column.header)
        texts = [re.sub(r"^(\d+)\.0*$", r"\1", row[at]) for row in table.rows]
        for line, text in zip(table.lines, texts, strict=True):
            if not text:
                raise table.fault("expected the name of a protocol", column.header, line)
        texts = [text if prefix is None else f"{prefix}:{text}" for text in texts]
    names = list(dict.fromkeys(texts))
    for name in names:
        if texts.count(name) < 2:
            line = table.lines[texts.index(name)]
            message = f"protocol {name} has one point, at least two are needed"
            raise CaseError(message, file=table.path, key=f"row {line}")
    return np.array([names.index(text) for text in texts]), tuple(names)


def _suspects(table: Table, data: BiaxialData, columns: Columns, *, accept: bool) -> list[str]:
    """Name tension in a slack specimen and stress that falls while it is stretched; refuse or note it."""
    lengths = np.linalg.norm(data.F, axis=1)
    notes = []
    for axis, component in enumerate(("11", "22")):
        at = data.components.index(component)
        header = next(columns[(kind, component)].header for kind in STRESSES if (kind, component) in columns)
        for number, name in enumerate(data.names):
            rows = np.flatnonzero(data.protocol == number)
            stress, peak = data.stress[rows, at], np.abs(data.stress[rows]).max()
            slack = np.all(lengths[rows] <= 1 + 1e-9, axis=1) & (stress > SLACK * peak)
            rising = np.all(np.diff(lengths[rows], axis=0) >= 0, axis=1) & (np.diff(lengths[rows, axis]) > 0)
            falls = np.concatenate([[False], rising & (np.diff(stress) < -FALL * peak)])
            for fault, text in ((slack, "tension while slack"), (falls, "stress falls while stretched")):
                if fault.any():
                    error = table.fault(f"{text}, protocol {name}", header, table.lines[rows[fault][0]])
                    if not accept:
                        raise error
                    notes.append(f"{error} ({int(fault.sum())} rows)")
    return notes
