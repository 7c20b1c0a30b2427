"""Parameters of materials: unit, range and kind of each, checked when a material is made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, field, fields
from typing import TYPE_CHECKING, Any

from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

Direction = str | float | tuple[float, ...]
"""A direction in the reference state: the name of a fibre field of the mesh (or, in a case, "45 deg from
circumferential", from a leaflet's circumferential towards its radial direction), an angle to the x axis in the x-y
plane [deg], or a vector of any length."""

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

STRESS = "dyn/cm^2"
"""Unit of a parameter that says nothing else."""


def parameter(
    unit: str = STRESS,
    *,
    minimum: float = 0.0,
    maximum: float = math.inf,
    above: float = -math.inf,
    default: Any = MISSING,
    about: str = "",
) -> Any:
    """Declare a number of a material, see `check_parameters`.

    Args:
        unit: Unit in CGS that the case file reads and writes it in; "1" for none.
        minimum: Smallest value allowed.
        maximum: Largest value allowed.
        above: A value that it must exceed.
        default: Value where none is given; left out, one must be given.
        about: What it is.
    """
    limits = {"minimum": minimum, "maximum": maximum, "above": above}
    return field(default=default, metadata={"unit": unit, "about": about, **limits})


def direction(*, default: Any = MISSING, about: str = "") -> Any:
    """Declare a direction of a material: name of a fibre field, angle [deg] or vector."""
    return field(default=default, metadata={"kind": "direction", "about": about})


def table(item: type, *, about: str = "") -> Any:
    """Declare a list of tables, each of the dataclass ``item``; none by default."""
    return field(default=(), metadata={"kind": "table", "item": item, "about": about})


def check_parameters(material: DataclassInstance) -> None:
    """Refuse a parameter that is not finite, outside its range or of the wrong kind; call it at birth.

    Raises:
        CaseError: With the name of the parameter, its value and what was expected.
    """
    for item in fields(material):
        value, kind = getattr(material, item.name), item.metadata.get("kind", "number")
        if kind == "direction":
            object.__setattr__(material, item.name, checked_direction(value, item.name))
        elif kind == "table":
            _check_table(material, item.name, value, item.metadata["item"])
        else:
            check_number(item.name, value, item.metadata)


def check_number(name: str, value: Unchecked, about: Mapping[str, Any] | None = None) -> None:
    """Refuse what is not a finite number in the range that ``about`` tells, not negative without one."""
    about = about or {}
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CaseError("expected a finite number", key=name, value=value)
    minimum, maximum = about.get("minimum", 0.0), about.get("maximum", math.inf)
    above = about.get("above", -math.inf)
    if not value > above:
        raise CaseError(f"expected a number above {above:g}", key=name, value=value)
    if not minimum <= value <= maximum:
        upper = "" if maximum == math.inf else f" and at most {maximum:g}"
        raise CaseError(f"expected a number of at least {minimum:g}{upper}", key=name, value=value)


def _check_table(material: DataclassInstance, name: str, value: Unchecked, item: type) -> None:
    """Store a list of ``item`` as a tuple; refuse anything else."""
    if not isinstance(value, list | tuple) or not all(isinstance(entry, item) for entry in value):
        raise CaseError(f"expected a list of {item.__name__}", key=name, value=value)
    object.__setattr__(material, name, tuple(value))


def checked_direction(value: Unchecked, name: str) -> Direction:
    """Return a direction with a vector made unit; refuse one that is none.

    Raises:
        CaseError: It is neither a name, nor a finite angle, nor a finite vector that is not zero.
    """
    if isinstance(value, str) and value:
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    if isinstance(value, list | tuple) and len(value) in (2, 3):
        try:
            length = math.hypot(*value)
        except TypeError:
            length = math.nan
        if 0 < length < math.inf:
            return tuple(float(part) / length for part in value)
    message = "expected the name of a fibre field, an angle in degrees, or a vector that is not zero"
    raise CaseError(message, key=name, value=value)
