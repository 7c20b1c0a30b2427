"""Records of planar biaxial tests: CSV files to deformation gradients and stresses, with every doubt named.

What columns may be called is in `biaxial_columns`; other columns are passed over with a note, and so are those of a
standard deviation (``P11_sd``).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.biaxial_columns import NAMES, STRESSES, Columns, kinds, plain_unit, recognise, units_of
from valvefsi.fitting.record_table import Table, read_table
from valvefsi.types import Array, Indices

LARGEST = 1e6
"""Largest stress that a record may hold [kPa]."""
FIXED = 1e-9
"""Change of F below which nothing was deformed."""
FALL, SLACK = 0.1, 0.05
"""Fall of the stress, and stress in a slack specimen, that are refused, as parts of the protocol's largest."""
FRACTIONS = {"strain": 1.0, "engineering": 1.0, "stretch": 3.0}
"""Largest strains and stretches that are taken as fractions where no unit is said; tissue reaches none of them."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How records are to be read where their header does not say.

    Args:
        columns: Column of the file by the name it stands for, such as ``{"stretch1": "lx"}``.
        unit: Unit of the stresses (tensions, forces).
        thickness: Thickness of the unloaded specimen, for tensions [cm].
        areas: Sections of the unloaded specimen across axes 1 and 2, for forces [cm^2].
        decimal: The decimal mark, a point or a comma.
        accept_suspect: Only note what looks wrong (stress falling with stretch, tension while slack).
    """

    columns: Mapping[str, str] | None = None
    unit: str | None = None
    thickness: float | None = None
    areas: tuple[float, float] | None = None
    decimal: str = "."
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
    table = read_table(path, decimal=reading.decimal)
    columns = recognise(table, reading.columns or {})
    deformation, measure = kinds(table, columns)
    used = (deformation, measure, "protocol")
    columns = {key: column for key, column in columns.items() if column.kind in used}
    notes = list(table.unused(column.header for column in columns.values()))
    F = _deformation(table, columns, deformation, notes)
    components, stress = _stress(table, columns, measure, reading, notes)
    protocol, names = _protocols(table, columns, path.stem if many else None)
    data = BiaxialData(
        F=F,
        measure="pk1" if measure in ("tension", "force") else measure,
        components=components,
        stress=stress,
        protocol=protocol,
        names=names,
        files=(path,),
    )
    notes += _suspects(table, data, columns, accept=reading.accept_suspect)
    return replace(data, notes=tuple(notes))


def _deformation(table: Table, columns: Columns, kind: str, notes: list[str]) -> Array:
    """Return F from the stretches, strains or F itself, ``(rows, 2, 2)``."""
    values = {}
    for component in ("11", "22", "12", "21"):
        column = columns.get((kind, component))
        if column is not None:
            values[component] = table.numbers(column.header) * units_of(kind)[column.unit or "-"]
    _check_fractions(table, columns, kind, values)
    _check_positive(table, columns, kind, values)
    F = np.zeros((len(table.rows), 2, 2))
    if kind == "strain":
        F = _stretch_of(table, values, notes)
        if not columns[(kind, "11")].header.lower().startswith(("e", "green")):
            notes.append(
                f"{table.path.name}: strain is taken as Green strain; stretch less 1 is eng_strain1, eng_strain2"
            )
    elif kind == "engineering":
        F[:, 0, 0], F[:, 1, 1] = 1 + values["11"], 1 + values["22"]
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


def _check_fractions(table: Table, columns: Columns, kind: str, values: Mapping[str, Array]) -> None:
    """Refuse strains and stretches that look like percent where their heading has no unit."""
    for component, numbers in values.items():
        column, worst = columns[(kind, component)], int(np.argmax(np.abs(numbers)))
        most, value = FRACTIONS.get(kind, np.inf), float(numbers[worst])
        if column.unit is None and abs(value) > most:
            name = NAMES[kind].format(component[0]) if component[0] == component[1] else f"E{component}"
            message = (
                f"this is the largest value, and no fraction that tissue reaches (at most {most:g}); is it in percent? "
                f"Head the column {name} [%], or {name} [1] where it is a fraction; "
                f"an option does the same: --column '{name}_percent={column.header}'"
            )
            raise table.fault(message, column.header, table.lines[worst], value)


def _check_positive(table: Table, columns: Columns, kind: str, values: Mapping[str, Array]) -> None:
    """Refuse stretches (strains) that are not positive (above -1/2), and those that no unit explains."""
    least, most, small = {
        "strain": (-0.5, 100, "a Green strain must exceed -1/2"),
        "engineering": (-1, 9, "an engineering strain must exceed -1"),
    }.get(kind, (0, 10, "a stretch must be positive"))
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
    units, largest = units_of(kind), float(np.abs(raw).max())
    unit = None if reading.unit is None else plain_unit(reading.unit)
    if unit is not None and unit not in units:
        raise CaseError(f"unknown unit, expected one of {', '.join(units)}", key="unit", value=reading.unit)
    said = all(columns[(kind, c)].unit for c in components)
    if unit is None and kind == "force" and not said:
        raise CaseError("forces need a unit, such as force1_N", file=table.path, key="unit")
    if unit is None:
        unit = "n/m" if kind == "tension" else "pa" if largest > 5e3 else "kpa" if largest > 2 else "mpa"
        if not said:
            known = {"n/m": "N/m", "pa": "Pa", "kpa": "kPa", "mpa": "MPa"}[unit]
            notes.append(
                f"{table.path.name}: no unit given for the stress, {known} inferred from its size "
                f"(largest {largest:.5g})"
            )
    stress = raw * np.array([units[columns[(kind, c)].unit or unit] for c in components])
    stress = _per_area(table, kind, components, stress, reading, notes)
    beyond = np.argwhere(np.abs(stress) > LARGEST)
    if len(beyond):
        row, at = beyond[0]
        message = f"no tissue bears this, at most {LARGEST:g} kPa is plausible"
        raise table.fault(
            message, columns[(kind, components[at])].header, table.lines[row], float(raw[row, at])
        )
    return components, stress


def _per_area(
    table: Table,
    kind: str,
    components: tuple[str, ...],
    loads: Array,
    reading: Reading,
    notes: list[str],
) -> Array:
    """Return first Piola-Kirchhoff stress from tensions [N/m] or forces [N], ``(rows, components)`` [kPa]."""
    if kind == "tension":
        if reading.thickness is None or not reading.thickness > 0:
            raise CaseError("tensions need the thickness of the specimen", file=table.path, key="thickness")
        millimetres = 10 * reading.thickness
        notes.append(f"{table.path.name}: first Piola-Kirchhoff stress is tension over {millimetres:g} mm")
        return loads / millimetres
    if kind == "force":
        if reading.areas is None or not min(reading.areas) > 0:
            message = "forces need the unloaded sections that they act on"
            raise CaseError(message, file=table.path, key="area")
        across = [100 * reading.areas[int(component[1]) - 1] for component in components]
        sizes = " and ".join(f"{area:g}" for area in dict.fromkeys(across))
        notes.append(f"{table.path.name}: first Piola-Kirchhoff stress is force over {sizes} mm^2")
        return 1e3 * loads / np.array(across)
    return loads


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
