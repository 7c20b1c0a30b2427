"""The tables of a case file about a valve in a test section: the leaflets' mesh and the rigid housing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from valvefsi.case.quantities import Length
from valvefsi.case.table import Name, Table, problem
from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.geometry.leaflets import TYPES, ValveGeometry

VALVE_TAGS = ("leaflet_1", "leaflet_2", "leaflet_3", "inflow", "outflow", "attached", "free")

LENGTHS = ("height", "commissure", "thickness", "belly_thickness", "gap", "nose", "drop")
"""Lengths of the leaflets that a case may set in place of the type's own."""


def _own(description: str, example: str) -> Any:
    return Field(None, gt=0, description=f"{description}; the type's own when left out", examples=[example])


class ValveShape(Table):
    """Three leaflets in a stent, as `valvefsi mesh valve` makes them; z is along the flow."""

    type: Literal["pericardial", "porcine"] = Field("pericardial", description='"pericardial" or "porcine"')
    diameter: Length = Field(2.5, gt=0, description="Diameter of the stent")
    base: Length = Field(0.0, description="z of the lowest point of the leaflets' attachment")
    ratio: float = Field(0.75, ge=0.05, le=4, description="Element size over the grid's spacing h")
    layers: int = Field(1, ge=1, le=100, description="Elements through the thickness")
    height: Length | None = _own(
        "Height of the commissures above the lowest point of the attachment", "1.75 cm"
    )
    commissure: Length | None = _own("Straight upper part of the attachment at each post", "8 mm")
    thickness: Length | None = _own("Thickness of the leaflets at their edges", "0.4 mm")
    belly_thickness: Length | None = _own("Thickness in the middle of the leaflets", "0.3 mm")
    gap: Length | None = _own("Least distance between the surfaces of two unloaded leaflets", "0.4 mm")
    nose: Length | None = _own("Rounding of the unloaded free edge at the axis", "0.5 mm")
    drop: Length | None = _own("How far the middle of the free edge lies below the commissures", "3 mm")

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            self.geometry()
        except CaseError as error:
            raise problem(error.reason, str(error.key).split(",")[0], error.value) from None
        return self

    def geometry(self) -> ValveGeometry:
        """Return the valve's shape."""
        given = {name: getattr(self, name) for name in LENGTHS if getattr(self, name) is not None}
        return replace(TYPES[self.type](diameter=self.diameter), **given)


class Housing(Table):
    """A rigid aortic test section about the z axis, from one z side of the box to the other."""

    inlet_radius: Length = Field(1.25, gt=0, description="Radius of the inflow tract")
    outlet_radius: Length = Field(1.4, gt=0, description="Radius of the outflow tract")
    annulus: Length = Field(0.0, description="z at which the sinuses begin, and the stent")
    sinus_height: Length = Field(2.2, gt=0, description="Length of the sinuses along the flow")
    sinus_depth: Length = Field(0.5, ge=0, description="How far the sinuses go out at their deepest")
    hold: float = Field(
        0.25,
        gt=0,
        le=0.5,
        description="Springs and dampers that hold it, as a part of what the time step allows",
    )
    fill: bool = Field(
        True,
        description="Whether the fluid outside is held still, so that nothing flows round the valve there",
    )
    stent: Name | None = Field(
        None, description="Solid with a valve whose stent belongs to it", examples=["leaflets"]
    )

    def section(self) -> AorticSection:
        """Return the housing's shape."""
        names = ("inlet_radius", "outlet_radius", "annulus", "sinus_height", "sinus_depth")
        return AorticSection(**{name: getattr(self, name) for name in names})
