"""Materials of a case: names, parameters and units, as the solid declares them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields

from pydantic_core import PydanticCustomError

from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import Quantity


def _problem(message: str, key: str, value: object = None) -> PydanticCustomError:
    return PydanticCustomError("case", "{message}", {"message": message, "key": key, "value": value})


def material_units(model: str) -> dict[str, str]:
    """Return the parameters of a material with their units."""
    from valvefsi.solid.materials import MATERIALS

    return {field.name: field.metadata.get("unit", "dyn/cm^2") for field in fields(MATERIALS[model])}


def read_material(model: object, data: Mapping[str, object]) -> dict[str, float]:
    """Return the parameters of a material in CGS.

    Raises:
        PydanticCustomError: The material or a parameter is not known, missing or out of range.
    """
    from valvefsi.solid.materials import MATERIALS

    if model not in MATERIALS:
        raise _problem(f"unknown material{nearest(model, list(MATERIALS))}", "model", model)
    units, found = material_units(model), {}
    for key, value in data.items():
        if key == "model":
            continue
        if key not in units:
            raise _problem(f"unknown parameter of {model}{nearest(key, list(units))}", key, value)
        try:
            found[key] = Quantity(units[key]).parse(value)
        except PydanticCustomError as error:
            raise _problem(error.message(), key, value) from None
    for field in fields(MATERIALS[model]):
        if field.name not in found:
            if field.default is MISSING:
                raise _problem(
                    f"this parameter of {model} is required, a quantity in {units[field.name]}", field.name
                )
            found[field.name] = field.default
    try:
        MATERIALS[model](**found)
    except ValueError as error:
        key = getattr(error, "key", None) or "model"
        raise _problem(getattr(error, "reason", str(error)), key, data.get(key)) from None
    return found


def material_schemas() -> list[dict[str, object]]:
    """Return the JSON schema of each material."""
    from valvefsi.solid.materials import MATERIALS

    schemas = []
    for model, kind in MATERIALS.items():
        quantity = {
            name: {"type": ["number", "string"], "description": unit}
            for name, unit in material_units(model).items()
        }
        required = [field.name for field in fields(kind) if field.default is MISSING]
        schema = {"type": "object", "properties": {"model": {"const": model}, **quantity}}
        schemas.append({**schema, "required": ["model", *required], "additionalProperties": False})
    return schemas
