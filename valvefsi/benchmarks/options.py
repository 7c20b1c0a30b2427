"""What a user may choose: the options of a benchmark, fields of a dataclass, and its parameters in physical units."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from valvefsi.case.overrides import nearest, split_override
from valvefsi.case.quantities import Quantity
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Values = dict[str, Any]
"""Parameters by name: numbers in CGS, or words."""

Parameters = Mapping[str, tuple[float, str] | tuple[str, Sequence[str]]]
"""By name: a number and its unit ("1" for a pure number; `UNSET` where the benchmark finds it unless it is set), or a
word and the words that may stand in its place."""

UNSET = math.nan
"""Stands for the default of a parameter that is left out of the values unless it is set."""


@dataclass(frozen=True, kw_only=True)
class Option:
    """What is known of an option beside its type and default.

    Attributes:
        help: What it is, in a line.
        flag: Its name on the command line; None for that of the field.
        least: Smallest number.
        most: Largest number.
        between: Numbers that it must lie between, both excluded.
        choices: The words, or numbers, that it may be.
        everything: Whether "all" stands for all choices.
        metavar: What stands for its value in the help.
    """

    help: str
    flag: str | None = None
    least: float | None = None
    most: float | None = None
    between: tuple[float, float] | None = None
    choices: Collection[str | int] | None = None
    everything: bool = False
    metavar: str | None = None


def option(default: Any, help: str, **more: Any) -> Any:
    """Return a field of a benchmark that is an option of its command; ``more`` as of `Option`."""
    return field(default=default, metadata={"option": Option(help=help, **more)})


def options_of(kind: type) -> dict[str, tuple[Field[Any], Option]]:
    """Return the options of a benchmark by name of the field."""
    return {item.name: (item, item.metadata["option"]) for item in fields(kind) if "option" in item.metadata}


def flag_of(name: str, about: Option) -> str:
    """Return the name of an option on the command line."""
    return about.flag or "--" + name.replace("_", "-")


def check_options(holder: DataclassInstance) -> None:
    """Refuse numbers out of their range and words that are no choice, wherever the options came from.

    Raises:
        CaseError: An option cannot be used.
    """
    for name, (_, about) in options_of(type(holder)).items():
        value, flag = getattr(holder, name), flag_of(name, about)
        many = list(value) if isinstance(value, list | tuple) else [value]
        if about.choices is not None:
            _check_words(many, [str(choice) for choice in about.choices], flag)
        for number in many:
            if isinstance(number, int | float) and not isinstance(number, bool):
                _check_number(number, about, flag)


def _check_number(number: float, about: Option, flag: str) -> None:
    low, high = about.least, about.most
    if about.between is not None:
        inside = about.between[0] < number < about.between[1]
        ends = "above {:g} and below {:g}".format(*about.between)
    else:
        inside = (low is None or number >= low) and (high is None or number <= high)
        ends = f"of at least {low:g}" if high is None and low is not None else f"from {low} to {high}"
    if not (inside and math.isfinite(number)):
        raise CaseError(f"expected a number {ends}", key=flag, value=number)


def _check_words(words: Sequence[str | int], choices: Sequence[str], flag: str) -> None:
    if not words:
        raise CaseError(f"expected some of {', '.join(choices)}", key=flag)
    for word in words:
        if str(word) not in choices:
            near = nearest(word, choices) if isinstance(word, str) else ""
            near = near if near.startswith("; did") else ""
            raise CaseError(f"expected one of {', '.join(choices)}{near}", key=flag, value=word)


def quantities(text: str, **more: tuple[float, str] | tuple[str, Sequence[str]]) -> Parameters:
    """Return parameters from a text such as ``t_end = 2 s, nu = 1/3``, pure numbers without a unit; then ``more``."""
    pairs = (part.split("=") for part in text.split(",") if part.strip())
    texts = {key.strip(): value.strip().partition(" ") for key, value in pairs}
    return {key: (float(Fraction(number)), unit or "1") for key, (number, _, unit) in texts.items()} | more


def defaults(parameters: Parameters) -> Values:
    """Return the values that nobody changed, numbers in CGS, without those that are unset."""
    return {
        key: default
        for key, (default, _) in parameters.items()
        if isinstance(default, str) or not math.isnan(default)
    }


def changed(parameters: Parameters, **values: float | str) -> Parameters:
    """Return parameters with other defaults."""
    other = {key: (values.get(key, default), kind) for key, (default, kind) in parameters.items()}
    return other  # type: ignore[return-value]


def read_parameters(parameters: Parameters, overrides: Sequence[str]) -> Values:
    """Return the parameters in CGS, with overrides; numbers must be positive.

    Args:
        parameters: Default and unit, or default and choices, of each.
        overrides: Texts ``key=value``; the last one counts.

    Raises:
        CaseError: An override names no parameter, its value has another dimension or is not positive, or a word is
            not one of the choices.
    """
    values = read_quantities(parameters, overrides)
    for key, text in map(split_override, overrides):
        if not isinstance(values[key], str) and not values[key] > 0:
            raise CaseError("expected a positive value", file="--set", key=key, value=text)
    return values


def read_quantities(parameters: Parameters, overrides: Sequence[str]) -> Values:
    """As `read_parameters`, for numbers of any sign."""
    from pydantic_core import PydanticCustomError

    values = defaults(parameters)
    for key, text in map(split_override, overrides):
        if key == "t_end" and key not in parameters:
            raise CaseError("this benchmark does not march in time", file="--set", key=key, value=text)
        if key not in parameters:
            near = nearest(key, list(parameters))
            raise CaseError(f"unknown parameter{near}", file="--set", key=key, value=text)
        if isinstance(expected := parameters[key][1], str):
            try:
                values[key] = Quantity(expected).parse(text)
            except PydanticCustomError as error:
                raise CaseError(error.message(), file="--set", key=key, value=text) from None
        elif text in expected:
            values[key] = str(text)
        else:
            raise CaseError(f"expected one of {', '.join(expected)}", file="--set", key=key, value=text)
    return values


def texts(values: Values, *keys: str) -> list[str]:
    """Return the overrides that give these values, or some of them."""
    return [f"{key}={values[key]!r}" for key in keys or values]


def require_steps(values: Values, dt: float, least: int, why: str) -> None:
    """Refuse an end ``t_end`` that comes before the least number of steps.

    Raises:
        CaseError: It does, with the shortest run that there can be.
    """
    shortest = least * dt
    digit = 10.0 ** (math.floor(math.log10(shortest)) - 2)
    message = (
        f"expected at least {math.ceil(shortest / digit * (1.0 - 1e-9)) * digit:.4g} s, {least} steps: {why}"
    )
    require(values["t_end"] >= shortest * (1.0 - 1e-9), message, values, "t_end")


def require(holds: bool, message: str, values: Values, key: str) -> None:
    """Refuse a parameter unless something holds.

    Raises:
        CaseError: It does not hold; the message says what was expected.
    """
    if not holds:
        raise CaseError(message, file="--set", key=key, value=values[key])
