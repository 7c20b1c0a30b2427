"""What the columns of a biaxial test may be called, upper or lower case, with a unit at the end if there is one.

``P11_kPa``, ``S22 [MPa]``, ``tension1 (N/m)``, ``E11_percent``:

    deformation   stretch1 stretch2 (lambda1 ...) | E11 E22 [E12] (strain1 ..., Green) | F11 F12 F21 F22
                  | eng_strain1 eng_strain2 (nominal_strain1 ..., eps1 ...): stretch less 1
    stress        PK1_1 PK1_2 (P11 P22 [P12 P21], eng_stress1 ...) | PK2_1 PK2_2 (S11 S22 [S12])
                  | cauchy1 cauchy2 (sigma11 ...) | tension1 tension2: force per unloaded length, needs the thickness
                  | force1 force2 (load1 ...): needs the unloaded sections
    protocol      a name or number for each row; without it a file is one protocol
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

from valvefsi.errors import CaseError
from valvefsi.fitting.record_table import Table, is_statistic
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
FORCE_UNITS = {"n": 1.0, "mn": 1e-3, "kn": 1e3, "gf": 9.80665e-3, "dyn": 1e-5}
"""Units of force in N; mN, for no test of tissue takes a meganewton."""
PURE_UNITS = {"-": 1.0, "1": 1.0, "percent": 0.01, "%": 0.01}
KINDS = {
    "stretch": r"(?:stretch(?:_?ratio)?|lambda|lam)",
    "strain": r"(?:e|strain|green(?:_?lagrange)?(?:_?strain)?)",
    "engineering": r"(?:(?:engineering|nominal|eng)_?strain|eps|epsilon)",
    "gradient": r"(?:f|deformation_?gradient)",
    "pk1": r"(?:pk1|p|piola|first_?pk|(?:engineering|nominal|eng)_?stress)",
    "pk2": r"(?:pk2|s|second_?pk)",
    "cauchy": r"(?:cauchy|sigma|sig)",
    "tension": r"(?:tension|membrane_?tension|t)",
    "force": r"(?:force|load)",
}
DEFORMATIONS = ("gradient", "strain", "engineering", "stretch")
STRESSES = ("pk1", "pk2", "cauchy", "tension", "force")
INDEX = r"_?(11|22|12|21|1|2)"
EXAMPLES = "stretch1, eng_strain1, E11, F11, PK1_1, PK2_1, cauchy1, tension1, force1 or protocol"
NAMES = {
    "stretch": "stretch{0}",
    "strain": "E{0}{0}",
    "engineering": "eng_strain{0}",
    "gradient": "F{0}{0}",
    "pk1": "P{0}{0}",
    "pk2": "S{0}{0}",
}
NAMES |= {"cauchy": "cauchy{0}", "tension": "tension{0}", "force": "force{0}"}
"""A name of each quantity along an axis, for messages."""


@dataclass(frozen=True, kw_only=True)
class Column:
    """A column of a file: its header, what it is, its component, its unit (None if not said)."""

    header: str
    kind: str
    component: str
    unit: str | None


Columns = Mapping[tuple[str, str], Column]
"""Columns by kind and component."""


def recognise(table: Table, columns: Mapping[str, str]) -> Columns:
    """Return the columns by kind and component.

    Args:
        table: The text of the file.
        columns: Column of the file by the name it stands for.

    Raises:
        CaseError: A name stands for no quantity, a unit is not known, or two columns are the same.
    """
    recognised: dict[tuple[str, str], Column] = {}
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


def _meaning(header: str, name: str, table: Table) -> Column | None:
    """Return what a column is, None if it is nothing known.

    Raises:
        CaseError: It is a known quantity in an unknown unit.
    """
    text = name.strip().lower().replace(" ", "_")
    if text in ("protocol", "test", "set"):
        return Column(header=header, kind="protocol", component="", unit=None)
    for kind, pattern in KINDS.items():
        match = re.fullmatch(pattern + INDEX + r"(?:_*[\[(]([^\])]*)[\])]|_+(\S+))?", text)
        if match is None or is_statistic(text):
            continue
        unit = next((plain_unit(part) for part in match.groups()[1:] if part is not None), None)
        units = units_of(kind)
        if unit is not None and unit not in units:
            raise table.fault(f"unknown unit {unit}, expected one of {', '.join(units)}", header)
        component = match[1] if len(match[1]) == 2 else 2 * match[1]
        return Column(header=header, kind=kind, component=component, unit=unit)
    return None


def units_of(kind: str) -> Mapping[str, float]:
    """Return the units of a kind of column: kPa, N/m, N or none each."""
    if kind in ("tension", "force"):
        return TENSION_UNITS if kind == "tension" else FORCE_UNITS
    return STRESS_UNITS if kind in STRESSES else PURE_UNITS


def plain_unit(text: str) -> str:
    """Return a unit without blanks, powers and case: ``dyn_cm^2`` and ``dyn/cm2`` are the same."""
    return re.sub(r"[\s^*]", "", text.strip("_").lower()).replace("_per_", "/").replace("_", "/")


def kinds(table: Table, columns: Columns) -> tuple[str, str]:
    """Return how the deformation and the stress are given.

    Raises:
        CaseError: Columns are missing, all named at once, or there are several measures of stress.
    """
    deformation = next((kind for kind in DEFORMATIONS if {(kind, "11"), (kind, "22")} & columns.keys()), None)
    stresses = [kind for kind in STRESSES if any(key[0] == kind for key in columns)]
    if len(stresses) > 1 and "force" in stresses:
        stresses.remove("force")  # many machines write both
    if len(stresses) > 1:
        raise CaseError(f"expected one measure of stress, found {' and '.join(stresses)}", file=table.path)
    missing = []
    for kind in filter(None, (deformation, *stresses)):
        missing += [NAMES[kind].format(axis) for axis in (1, 2) if (kind, 2 * str(axis)) not in columns]
    if deformation is None:
        missing.append("the deformation (stretch1 and stretch2, E11 and E22, eng_strain1 ..., or F11 to F22)")
    if not stresses:
        missing.append("the stress (PK1_1 and PK1_2, PK2_1 ..., cauchy1 ..., tension1 ... or force1 ...)")
    if missing or deformation is None:
        message = f"columns missing: {' and '.join(missing)}"
        raise CaseError(message, file=table.path, key=f"columns {', '.join(table.header)}")
    return deformation, stresses[0]
