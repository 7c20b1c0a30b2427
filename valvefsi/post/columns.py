"""What the columns of a history are called and measured in, read off their names."""

from __future__ import annotations

from valvefsi.units import MMHG

COLUMNS = {
    "dyn_per_cm2": ("dyn/cm^2", 1.0 / MMHG, "mmHg"),
    "cm3_per_s": ("cm^3/s", 1.0, "ml/s"),
    "erg_per_s": ("erg/s", 1e-4, "mW"),
    "dyn_per_cm": ("dyn/cm", 1.0, "mN/m"),
    "cm_per_s": ("cm/s", 1.0, "cm/s"),
    "ml_s": ("ml/s", 1.0, "ml/s"),
    "percent": ("%", 1.0, "%"),
    "mmHg": ("mmHg", 1.0, "mmHg"),
    "cm2": ("cm^2", 1.0, "cm^2"),
    "cm3": ("cm^3", 1.0, "ml"),
    "dyn": ("dyn", 1e-2, "mN"),
    "erg": ("erg", 1e-4, "mJ"),
    "mm": ("mm", 1.0, "mm"),
    "cm": ("cm", 10.0, "mm"),
    "mm": ("mm", 1.0, "mm"),
    "kPa": ("kPa", 1.0, "kPa"),
    "Hz": ("Hz", 1.0, "Hz"),
    "ms": ("ms", 1.0, "ms"),
    "s": ("s", 1.0, "s"),
}
"""How the name of a column of a history ends: its unit, and factor and unit that a lab uses."""


def ending(name: str) -> str | None:
    """Return the end of a column's name that says its unit, a key of `COLUMNS`; None of a pure number."""
    return next((end for end in COLUMNS if name.endswith(f"_{end}")), None)


def column_label(name: str, units: str = "lab") -> tuple[str, str, float]:
    """Return a column's name in words, its unit, and the factor from its values to that unit.

    Args:
        name: The column, whose end names its unit.
        units: "lab" or "cgs".
    """
    end = ending(name)
    unit, factor, lab = COLUMNS[end] if end else ("", 1.0, "")
    words = (name.removesuffix(f"_{end}") if end else name).replace("_", " ")
    return (words, lab, factor) if units == "lab" else (words, unit, 1.0)
