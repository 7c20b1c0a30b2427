"""Energies whose numbers are constants of a compiled form, so that one compilation serves all their values."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

from valvefsi.runtime import dolfinx_compat as compat  # noqa: F401  (before dolfinx)

# isort: split
import ufl
from dolfinx import fem

if TYPE_CHECKING:
    from ufl.core.expr import Expr

T = TypeVar("T")


def adjustable(energy: T) -> T:
    """Return an energy, a material or a volumetric one, whose parameters do not stand in the code of its forms.

    A parameter that is 0 stands there, as one does that the energy decides by: another form is compiled where it
    changes. All else is as it was.
    """
    return cast("T", _Adjustable(energy))


class _Adjustable:
    def __init__(self, original: Any) -> None:
        self._original = original

    def __getattr__(self, name: str) -> Any:
        return getattr(self._original, name)

    def energy(self, kinematics: Any) -> Expr:
        """Return the energy of the kinematics."""
        known = kinematics.I1_bar if hasattr(kinematics, "I1_bar") else kinematics.J
        domain = ufl.domain.extract_unique_domain(known)
        try:
            return _with_constants(self._original, domain).energy(kinematics)
        except (TypeError, ValueError):  # it decides by a parameter, or computes with it as a number
            return self._original.energy(kinematics)


def _with_constants(original: Any, domain: ufl.Mesh) -> Any:
    """Return a copy of a dataclass with constants for its numbers, and for those of its tables."""
    if not is_dataclass(original):
        return original
    made = copy.copy(original)
    for item in fields(original):
        value, kind = getattr(original, item.name), item.metadata.get("kind", "number")
        if kind == "table":
            constant: Any = tuple(_with_constants(entry, domain) for entry in value)
        elif kind == "number" and isinstance(value, float) and value != 0.0:
            constant = fem.Constant(domain, value)
        else:
            continue
        object.__setattr__(made, item.name, constant)
    return made
