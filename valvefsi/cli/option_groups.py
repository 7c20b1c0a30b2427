"""Options of a command as the fields of a dataclass, where there are too many for an argument list."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

import typer

T = TypeVar("T")


def options_of(kind: type[T]) -> Callable[[Callable[[T], Any]], Callable[..., Any]]:
    """Turn a function of one dataclass into a command whose options are the dataclass' fields.

    Each field is annotated as typer wants it, ``Annotated[type, typer.Option(...)]``; one without a default
    is required. The function's docstring is the command's help.
    """
    if not is_dataclass(kind):
        raise TypeError(f"{kind.__name__} is no dataclass")
    hints = get_type_hints(kind, include_extras=True)

    def decorate(function: Callable[[T], Any]) -> Callable[..., Any]:
        def command(**given: Any) -> Any:
            return function(kind(**given))

        empty = inspect.Parameter.empty
        given = [
            inspect.Parameter(
                item.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=empty if item.default is MISSING else item.default,
                annotation=hints[item.name],
            )
            for item in fields(kind)
        ]
        command.__name__, command.__doc__ = function.__name__, function.__doc__
        vars(command)["__signature__"] = inspect.Signature(given)
        command.__annotations__ = {item.name: hints[item.name] for item in fields(kind)}
        return command

    return decorate


def pairs(texts: list[str] | None, option: str) -> dict[str, str]:
    """Return ``KEY=VALUE`` texts as a dictionary.

    Raises:
        typer.BadParameter: One has no ``=`` or no name.
    """
    found = {}
    for text in texts or []:
        key, mark, value = text.partition("=")
        if not (mark and key.strip() and value.strip()):
            raise typer.BadParameter(f"expected KEY=VALUE, found {text!r}", param_hint=f"--{option}")
        found[key.strip()] = value.strip()
    return found


def as_number(text: str, option: str) -> float:
    """Return a finite number.

    Raises:
        typer.BadParameter: It is none.
    """
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not abs(value) < float("inf"):
        raise typer.BadParameter(f"expected a number, found {text!r}", param_hint=f"--{option}")
    return value
