"""Parameters of a benchmark: default and unit of each by name, and ``key=value`` texts that change them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from valvefsi.case.overrides import nearest, split_override
from valvefsi.case.quantities import Quantity
from valvefsi.errors import CaseError

Parameters = Mapping[str, tuple[float, str] | tuple[str, Sequence[str]]]
"""By name: a number and its unit ("1" for a pure number), or a word and the words that may stand in its place."""


def defaults(parameters: Parameters) -> dict[str, float | str]:
    """Return the values that nobody changed, numbers in CGS."""
    return {key: default for key, (default, _) in parameters.items()}


def read_parameters(parameters: Parameters, overrides: Sequence[str]) -> dict[str, float | str]:
    """Return the parameters in CGS, with overrides; numbers must be positive.

    Args:
        parameters: Default and unit, or default and choices, of each.
        overrides: Texts ``key=value``; the last one counts.

    Raises:
        CaseError: An override names no parameter, its value has another dimension or is not positive, or a word is
            not one of the choices.
    """
    values = read_quantities(parameters, overrides)
    for key, given in map(split_override, overrides):
        if not isinstance(values[key], str) and not values[key] > 0:
            raise CaseError("expected a positive value", file="--set", key=key, value=given)
    return values


def read_quantities(parameters: Parameters, overrides: Sequence[str]) -> dict[str, float | str]:
    """As `read_parameters`, for numbers of any sign."""
    values = defaults(parameters)
    for key, given in map(split_override, overrides):
        if key not in parameters:
            near = nearest(key, list(parameters))
            raise CaseError(f"unknown parameter{near}", file="--set", key=key, value=given)
        values[key] = _parse(key, given, parameters[key][1])
    return values


def _parse(key: str, given: object, expected: str | Sequence[str]) -> float | str:
    from pydantic_core import PydanticCustomError

    if not isinstance(expected, str):
        if given not in expected:
            raise CaseError(f"expected one of {', '.join(expected)}", file="--set", key=key, value=given)
        return str(given)
    try:
        return Quantity(expected).parse(given)
    except PydanticCustomError as error:
        raise CaseError(error.message(), file="--set", key=key, value=given) from None
