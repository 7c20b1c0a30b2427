"""Numbers with units at the border: "200 dyn/cm^2" or "15 mmHg" come in, CGS numbers stay."""

from __future__ import annotations

import difflib
import math
import re
from functools import cache
from typing import TYPE_CHECKING, Annotated, get_args

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from valvefsi.types import Unchecked
from valvefsi.units import MMHG

if TYPE_CHECKING:
    import pint
    from pydantic.fields import FieldInfo

COMMON_UNITS = (
    "cm",
    "mm",
    "m",
    "um",
    "g",
    "kg",
    "s",
    "ms",
    "min",
    "dyn",
    "N",
    "mN",
    "Pa",
    "kPa",
    "MPa",
    "mmHg",
    "P",
    "cP",
)
USUAL_UNITS = {
    "cm^3/s": ("l/min",),
    "dyn/cm^2": ("mmHg", "kPa"),
    "dyn*s/cm^5": ("mmHg*s/ml",),
    "dyn*s^2/cm^5": ("mmHg*s^2/ml",),
    "cm^5/dyn": ("ml/mmHg",),
}
"""What people measure in, where it is not what is kept."""
DIGITS = 6
"""Digits of a short number."""
UNIT = re.compile(r"(?>[^\W\d]\w*+(?:\s*(?:\^|\*\*)\s*-?\d)?+|1(?=\s*/)|[\s()/%-]|\*(?!\*))++")
"""Names with one exponent of one digit each, times, over and parentheses: what a library may evaluate."""
LONGEST = 60
FLOAT_MAX = 2**1023
NUMBER = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


@cache
def unit_registry() -> pint.UnitRegistry:
    """Return the one registry of units."""
    import pint

    registry = pint.UnitRegistry(on_redefinition="ignore")
    registry.define(f"millimeter_Hg = {MMHG!r} dyn / cm^2 = mmHg")  # the torr, as everywhere here
    return registry


class Quantity:
    """Marks a field as a number in a CGS unit that may be given with any unit of its dimension.

    Args:
        unit: The unit the number is kept in, "1" for a pure number.
    """

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def parse(self, value: Unchecked) -> float:
        """Return the number in ``unit``.

        Raises:
            PydanticCustomError: It is not a finite number, its unit is not known or has another dimension.
        """
        if isinstance(value, str):
            number, unit = self._split(value)
            if unit.replace(" ", "") != self.unit.replace(" ", ""):
                number = self._convert(number, unit)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            number = float(value) if abs(value) < FLOAT_MAX else math.inf
        else:
            raise self._expected()
        if not math.isfinite(number):
            raise PydanticCustomError("quantity", "expected a finite number")
        return number

    def text(self, value: float) -> str:
        """Return the number with its unit, so that it reads back exactly.

        A number that is long in ``unit`` is written in a unit that people use, where it is a short one there.
        """
        short = f"{value:g}"
        if float(short) == value:
            return f"{short} {self.unit}"
        for unit in USUAL_UNITS.get(self.unit, ()):
            text = f"{value / self._convert(1.0, unit):.{DIGITS}g} {unit}"
            if self.parse(text) == value:
                return text
        return f"{value!r} {self.unit}"

    def text_in(self, value: float, like: object, digits: int) -> str:
        """Return a number of ``unit`` to some digits, in the unit of a text such as ``like`` where it has one."""
        match = NUMBER.fullmatch(like) if isinstance(like, str) else None
        unit = match[2] if match and match[2] else self.unit
        if unit != self.unit:
            registry = unit_registry()
            value = float(registry.Quantity(value, self.unit).to(registry.parse_units(unit)).magnitude)
        return f"{value:.{digits}g} {unit}"

    def _split(self, text: str) -> tuple[float, str]:
        match = NUMBER.fullmatch(text)
        if match is None:
            raise self._expected(": this text begins with no number")
        if not match[2]:
            raise self._expected(f": write {match[1]} without quotes, or a unit after it")
        return float(match[1]), match[2]

    def _convert(self, number: float, unit: str) -> float:
        import pint

        if len(unit) > LONGEST or not UNIT.fullmatch(unit):
            raise self._expected(": what follows the number is no unit")
        registry = unit_registry()
        try:
            return float(registry.Quantity(number, registry.parse_units(unit)).to(self.unit).magnitude)
        except pint.DimensionalityError:
            raise self._expected(f", {unit} measures something else") from None
        except pint.UndefinedUnitError as error:
            names = error.unit_names if isinstance(error.unit_names, str) else next(iter(error.unit_names))
            near = difflib.get_close_matches(names, COMMON_UNITS, n=1, cutoff=0.4)
            hint = f', did you mean "{near[0]}"?' if near else ""
            raise PydanticCustomError(
                "quantity",
                'unknown unit "{name}"{hint} (expected a quantity in {unit})',
                {"name": names, "hint": hint, "unit": self.unit},
            ) from None
        except Exception:  # pint's parser raises whatever Python's does
            raise self._expected(": what follows the number is no unit") from None

    def _expected(self, why: str = "") -> PydanticCustomError:
        values = {"unit": self.unit, "why": why}
        return PydanticCustomError("quantity", "expected a quantity in {unit}{why}", values)

    def __get_pydantic_core_schema__(
        self, source: type, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Parse before pydantic sees the number."""
        return core_schema.no_info_before_validator_function(self.parse, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, object]:
        """Describe a number, or a string with a unit."""
        text = {"type": "string", "description": f'a number and a unit, such as "1 {self.unit}"'}
        return {"anyOf": [{**handler(schema), "description": self.unit}, text]}


Length = Annotated[float, Quantity("cm")]
Time = Annotated[float, Quantity("s")]
Velocity = Annotated[float, Quantity("cm/s")]
Density = Annotated[float, Quantity("g/cm^3")]
Viscosity = Annotated[float, Quantity("dyn*s/cm^2")]
Stress = Annotated[float, Quantity("dyn/cm^2")]
BodyDamping = Annotated[float, Quantity("dyn*s/cm^4")]
Permeability = Annotated[float, Quantity("cm^4/(dyn*s)")]
Angle = Annotated[float, Quantity("deg")]
Mass = Annotated[float, Quantity("g")]
Spring = Annotated[float, Quantity("dyn/cm")]
StepPerSpacing = Annotated[float, Quantity("s/cm")]


def unit_of(field: FieldInfo | type) -> str | None:
    """Return the unit that a pydantic field, or an annotation anywhere inside it, is marked with."""
    for mark in (*getattr(field, "metadata", ()), *getattr(field, "__metadata__", ())):
        if isinstance(mark, Quantity):
            return mark.unit
    inside = [field.annotation] if hasattr(field, "annotation") else get_args(field)
    return next((unit for unit in map(unit_of, inside) if unit), None)
