"""Materials of a case: names, presets, parameters and units, as the solid declares them."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any

from pydantic_core import PydanticCustomError

from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import Quantity
from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.case.material_tables import Material
    from valvefsi.solid.materials.parameters import Direction

ANGLE = re.compile(r"\s*[+-]?[\d.]+([eE][+-]?\d+)?\s*(deg|degree|degrees|rad|radian|radians)\s*")
RELATIVE = re.compile(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?) deg from circumferential\s*")
"""A direction relative to a leaflet's own, towards the radial one."""
RESERVED = ("model", "preset")


def _problem(message: str, key: str, value: Unchecked = None) -> PydanticCustomError:
    return PydanticCustomError("case", "{message}", {"message": message, "key": key, "value": value})


def material_kind(model: Unchecked) -> type:
    """Return the class of a material: a name, or "FILE:CLASS" of one that was loaded.

    Raises:
        PydanticCustomError: There is no such material.
    """
    from valvefsi.solid.materials import MATERIALS, find_material

    if not isinstance(model, str) or not (model in MATERIALS or ":" in model):
        hint = (
            '; one of your own is "FILE.py:CLASS"' if "." in str(model) else nearest(model, list(MATERIALS))
        )
        raise _problem(f"unknown material{hint}", "model", model)
    try:
        return find_material(model)
    except CaseError as error:
        raise _problem(error.reason, "model", model) from None


def material_units(model: str) -> dict[str, str | None]:
    """Return the parameters of a material with their units, None for directions and tables."""
    return {field.name: _unit(field) for field in fields(material_kind(model))}


def parameter_unit(model: str, key: str, value: Unchecked) -> str | None:
    """Return the unit that a parameter is written with, "deg" for a direction that is an angle."""
    known = {field.name: field for field in fields(material_kind(model))}
    if key not in known:
        return None
    angle = known[key].metadata.get("kind") == "direction" and isinstance(value, float)
    return "deg" if angle else _unit(known[key])


def _unit(field: Field[Any]) -> str | None:
    return None if "kind" in field.metadata else field.metadata.get("unit", "dyn/cm^2")


def read_material(data: Mapping[str, object]) -> dict[str, object]:
    """Return model, preset and parameters of a material, quantities in CGS.

    Args:
        data: The table of a case file: ``model``, ``preset`` or both, and parameters, which go before those of the
            preset.

    Raises:
        PydanticCustomError: The material, the preset or a parameter is not known, missing or out of range.
    """
    model, preset, given = data.get("model"), data.get("preset"), dict(data)
    if preset is not None:
        from valvefsi.solid.materials.presets import PRESETS

        if preset not in PRESETS:
            raise _problem(f"unknown preset{nearest(preset, list(PRESETS))}", "preset", preset)
        found = PRESETS[preset]
        if model not in (None, found.model):
            raise _problem(f'the preset "{preset}" is of the model "{found.model}"', "model", model)
        model, given = found.model, {**found.parameters, **data}
    kind = material_kind(model)
    parameters = _read_fields(kind, {k: v for k, v in given.items() if k not in RESERVED}, str(model), "")
    try:
        make_material(str(model), parameters)
    except CaseError as error:
        key = error.key or "model"
        raise _problem(error.reason, key, data.get(key)) from None
    return {"model": model, "preset": preset, **parameters}


def make_material(model: str, parameters: Mapping[str, Any]) -> Any:
    """Make the material of parameters that `read_material` gave.

    Raises:
        CaseError: A parameter is out of range.
    """
    kind = material_kind(model)
    values = dict(parameters)
    for field in fields(kind):
        if field.metadata.get("kind") == "table" and field.name in values:
            values[field.name] = tuple(field.metadata["item"](**entry) for entry in values[field.name])
    return kind(**values)


def say_provenance(material: Material, key: str, comm: MPI.Comm) -> None:
    """Warn on rank 0 of a preset that nobody has checked.

    Args:
        material: Table of the material.
        key: Place of the solid in the case.
        comm: Communicator of the run.
    """
    from valvefsi.solid.materials.presets import PRESETS

    preset = PRESETS.get(material.preset or "")
    if preset is not None and not preset.verified and comm.rank == 0:
        text = f'{key}.material: the preset "{material.preset}" is {preset.provenance}'
        warnings.warn(text, stacklevel=2)


def _read_fields(kind: type, data: Mapping[str, object], name: str, path: str) -> dict[str, Any]:
    """Return the parameters of a dataclass in CGS, those with a default filled in."""
    known, found = {field.name: field for field in fields(kind) if field.init}, {}
    for key, value in data.items():
        if key not in known:
            raise _problem(f"unknown parameter of {name}{nearest(key, list(known))}", path + key, value)
        found[key] = _read_value(known[key], value, name, path + key)
    for key, field in known.items():
        if key in found:
            continue
        if field.default is MISSING and field.default_factory is MISSING:
            unit = _unit(field)
            what = f", a quantity in {unit}" if unit else ""
            raise _problem(f"this parameter of {name} is required{what}", path + key)
        made = field.default_factory
        found[key] = made() if made is not MISSING else field.default
    return found


def _read_value(field: Field[Any], value: Unchecked, name: str, path: str) -> object:
    """Return one parameter in CGS."""
    kind = field.metadata.get("kind", "number")
    if kind == "table":
        return _read_table(field.metadata["item"], value, name, path)
    if kind == "direction":
        return _read_direction(value, path)
    if field.type in ("str", str):
        return value
    try:
        return Quantity(_unit(field) or "1").parse(value)
    except PydanticCustomError as error:
        raise _problem(error.message(), path, value) from None


def _read_table(item: type, value: Unchecked, name: str, path: str) -> tuple[dict[str, object], ...]:
    """Return a list of tables, each checked as the dataclass ``item``."""
    if not isinstance(value, list | tuple) or not all(isinstance(entry, Mapping) for entry in value):
        raise _problem("expected a list of tables", path, value)
    entries = []
    for number, entry in enumerate(value):
        place = f"{path}.{number}."
        read = _read_fields(item, entry, f"{name}.{path.rpartition('.')[2]}", place)
        try:
            item(**read)
        except CaseError as error:
            raise _problem(error.reason, place + str(error.key), entry.get(error.key)) from None
        entries.append(read)
    return tuple(entries)


def _read_direction(value: Unchecked, path: str) -> object:
    """Return a direction: the name of a fibre field, an angle in degrees, or a vector."""
    from valvefsi.solid.materials.parameters import checked_direction

    if isinstance(value, str) and ANGLE.fullmatch(value):
        return Quantity("deg").parse(value)
    relative = RELATIVE.fullmatch(value) if isinstance(value, str) else None
    if relative:
        return f"{Quantity('deg').parse(relative[1] + ' deg')!r} deg from circumferential"
    if isinstance(value, str) and not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", value):
        message = 'expected the name of a fibre field, "45 deg", "45 deg from circumferential", or a vector'
        raise _problem(message, path, value)
    try:
        return checked_direction(value, path)
    except CaseError as error:
        raise _problem(error.reason, path, value) from None


def directions_of(kind: type, values: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Direction]]:
    """Give place and value of every direction among the parameters of a material, those of its tables too."""
    for field in fields(kind):
        what, value = field.metadata.get("kind"), values.get(field.name)
        if what == "direction" and value is not None:
            yield f"{path}{field.name}", value
        elif what == "table":
            for number, entry in enumerate(value or ()):
                yield from directions_of(field.metadata["item"], entry, f"{path}{field.name}.{number}.")


def material_schemas() -> list[dict[str, object]]:
    """Return the JSON schema of each material of `MATERIALS`; one of your own has a file."""
    from valvefsi.solid.materials import MATERIALS
    from valvefsi.solid.materials.presets import PRESETS

    schemas = []
    for model, kind in MATERIALS.items():
        properties, required = _schema_of(kind)
        sets = {name: preset.provenance for name, preset in PRESETS.items() if preset.model == model}
        about = "; ".join(f"{name}: {provenance}" for name, provenance in sets.items())
        named = {
            "model": {"const": model},
            "preset": {"enum": list(sets), "description": about},
            **properties,
        }
        schema = {"type": "object", "properties": named, "additionalProperties": False}
        schemas.append({**schema, "anyOf": [{"required": ["model", *required]}, {"required": ["preset"]}]})
    own = {"type": "string", "pattern": ":", "description": "FILE.py:CLASS, a material of your own"}
    return [*schemas, {"type": "object", "properties": {"model": own}, "required": ["model"]}]


def _schema_of(kind: type) -> tuple[dict[str, object], list[str]]:
    """Return the properties of a dataclass of parameters, and the names of those without a default."""
    properties: dict[str, object] = {}
    for field in fields(kind):
        about = field.metadata.get("about", "")
        what = field.metadata.get("kind", "number")
        if what == "table":
            inner, needed = _schema_of(field.metadata["item"])
            item = {"type": "object", "properties": inner, "required": needed, "additionalProperties": False}
            properties[field.name] = {"type": "array", "items": item, "description": about}
        elif what == "direction":
            text = f"{about}: name of a fibre field, angle to the x axis [deg], angle from circumferential, or vector"
            properties[field.name] = {"type": ["string", "number", "array"], "description": text}
        else:
            text = f"{about} [{_unit(field)}]" if about else str(_unit(field))
            properties[field.name] = {"type": ["number", "string"], "description": text}
    return properties, [f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING]
