"""The tables of a case file that say what a solid is made of: its material and its fibres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, Self

from pydantic import ConfigDict, Field, model_validator

from valvefsi.case.quantities import Angle, Length
from valvefsi.case.table import Name, Table, problem
from valvefsi.types import Unchecked


class Material(Table):
    """The material; its parameters stand beside its name."""

    model_config = ConfigDict(extra="allow", frozen=True)
    model: str = Field(
        description="Name of the material, or FILE.py:CLASS of one of your own (needs --trust); its parameters follow"
    )
    preset: str | None = Field(
        None,
        description="A named parameter set; parameters beside it go before its own",
        examples=["bovine_pericardium_hgo"],
    )

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Unchecked) -> Unchecked:
        if not isinstance(data, Mapping) or not {"model", "preset"} & set(data):
            return data
        from valvefsi.case.materials import read_material

        return read_material(data)

    @property
    def parameters(self) -> dict[str, object]:
        """Parameters by name, in CGS."""
        return dict(self.model_extra or {})

    def unit(self, key: str) -> str | None:
        """Return the unit of a parameter."""
        from valvefsi.case.materials import parameter_unit

        return parameter_unit(self.model, key, self.parameters.get(key))


class Fibre(Table):
    """A fibre field of a solid: unit vectors in the reference state, by a rule or from data."""

    name: Name = Field(description="Name that the material's directions use")
    rule: Literal["constant", "circumferential", "blend", "data"] = Field(
        description='"constant", "circumferential" (about an axis), "blend" (angles at two surfaces) or "data"'
    )
    direction: tuple[float, ...] = Field((), description="constant: the direction, of any length")
    axis: tuple[float, float, float] = Field(
        (0.0, 0.0, 1.0), description="circumferential, blend: direction of the axis; in 2-D it is z"
    )
    through: tuple[Length, ...] = Field(
        (), description="circumferential: a point on the axis; the origin when empty"
    )
    angle: Angle = Field(0.0, description="circumferential: angle out of the circle")
    angles: dict[str, Angle] = Field(
        {}, description="blend: angle out of the circle at each of two facet tags, {tag = angle, tag = angle}"
    )
    file: str | None = Field(
        None, description="data: file that meshio reads, relative to the case file", examples=["fibres.vtu"]
    )
    data: str = Field("fibre", description="data: name of the cell or point data in the file")

    @model_validator(mode="after")
    def _check(self) -> Self:
        own = {
            "constant": {"direction"},
            "circumferential": {"axis", "through", "angle"},
            "blend": {"axis", "angles"},
        }
        used = own.get(self.rule, {"file", "data"})
        for key in sorted(self.model_fields_set - {"name", "rule"} - used):
            if getattr(self, key) != type(self).model_fields[key].default:
                listed = ", ".join(sorted(used))
                raise problem(f'a "{self.rule}" fibre field has {listed}', key, getattr(self, key))
        needed = {"constant": "direction", "blend": "angles", "data": "file"}.get(self.rule)
        if needed and not getattr(self, needed):
            raise problem(f'a "{self.rule}" fibre field needs this key', needed)
        if self.rule == "blend" and len(self.angles) != 2:
            raise problem("expected two facet tags with an angle each", "angles", self.angles)
        if not any(self.axis) or not all(map(math.isfinite, (*self.axis, *self.direction))):
            raise problem("expected finite components, not all zero", "axis", list(self.axis))
        return self
