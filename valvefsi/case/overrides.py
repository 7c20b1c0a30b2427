"""Overrides ``a.b=value``: a path of keys through the tables of a case, items of a list by name or number."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any

from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

Override = str | tuple[str, object]
"""Text ``a.b=value`` as on the command line, or a path of keys and its value."""
ALTERNATIVES = {"time.dt": "dt_per_h", "time.dt_per_h": "dt", "grid.h": "cells", "grid.cells": "h"}
"""Setting the one takes the other away."""


def nearest(name: Unchecked, known: Sequence[str]) -> str:
    """Return ``; did you mean 'x'?`` or, where nothing is near, the list of what there is."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; there {'is' if len(known) == 1 else 'are'} {', '.join(map(repr, known))}" if known else ""


def split_override(text: str) -> tuple[str, object]:
    """Split ``key=value``; the value is TOML, or a plain string where it is not.

    Raises:
        CaseError: There is no key or no equals sign.
    """
    key, sign, value = (part.strip() for part in text.partition("="))
    if not sign or not all(part.strip() for part in key.split(".")):
        raise CaseError(
            "expected key=value, such as time.t_end=2 or fluid.viscosity='1 cP'", file="--set", key=text
        )
    try:
        return key, tomllib.loads(f"value = {value}")["value"]
    except (ValueError, RecursionError, KeyError):
        return key, value


def apply_overrides(
    raw: dict[str, object], overrides: Sequence[Override], aliases: Mapping[str, str] | None = None
) -> list[str]:
    """Put values into a raw case, in place.

    Args:
        raw: The case as TOML gives it.
        overrides: Texts ``a.b=value``, or pairs of a path and a value.
        aliases: Short names of keys, such as ``{"c1": "solid.block.material.c1"}``.

    Returns:
        The keys that were set, as paths from the root with numbers for the items of lists.

    Raises:
        CaseError: A path leads nowhere.
    """
    done = []
    for override in overrides:
        key, value = split_override(override) if isinstance(override, str) else override
        path = (aliases or {}).get(key, key)
        if aliases and path == key and "." not in key and key not in raw:
            raise CaseError(
                f"unknown parameter{nearest(key, [*aliases, *raw])}", file="--set", key=key, value=value
            )
        done.append(_set(raw, path.split("."), value))
    return done


def _set(raw: dict[str, object], path: list[str], value: Unchecked) -> str:
    place: Any = raw
    found: list[str] = []
    for depth, name in enumerate(path):
        shown = ".".join(path[: depth + 1])
        last = depth == len(path) - 1
        part: str | int = name
        if isinstance(place, list):
            part = _item(place, name, shown)
        elif not isinstance(place, dict):
            raise CaseError(
                f"{'.'.join(path[:depth])} is a value, it has no keys", file="--set", key=".".join(path)
            )
        found.append(str(part))
        if last:
            place[part] = value
            other = ALTERNATIVES.get(".".join(found))
            if other:
                place.pop(other, None)
        else:
            place = place.setdefault(part, {}) if isinstance(place, dict) else place[part]
    return ".".join(found)


def _item(items: list[object], part: str, shown: str) -> int:
    """Return the number of the item that is called ``part`` or has that number."""
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    if part in names:
        return names.index(part)
    if part.isdigit() and int(part) < len(items):
        return int(part)
    known = [name for name in names if name] or [str(k) for k in range(len(items))]
    raise CaseError(f"no such item{nearest(part, known)}", file="--set", key=shown)
