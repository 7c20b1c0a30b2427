"""The tables of a case file about a valve in a test section: the leaflets' mesh and the rigid housing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from valvefsi.case.quantities import Length
from valvefsi.case.table import Name, Table
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.geometry.leaflets import TYPES, ValveGeometry

VALVE_TAGS = ("leaflet_1", "leaflet_2", "leaflet_3", "inflow", "outflow", "attached", "free")


class ValveShape(Table):
    """Three leaflets in a stent, as `valvefsi mesh valve` makes them; z is along the flow."""

    type: Literal["pericardial", "porcine"] = Field("pericardial", description='"pericardial" or "porcine"')
    diameter: Length = Field(2.5, gt=0, description="Diameter of the stent")
    base: Length = Field(0.0, description="z of the lowest point of the leaflets' attachment")
    ratio: float = Field(0.75, ge=0.05, le=4, description="Element size over the grid's spacing h")
    layers: int = Field(1, ge=1, description="Elements through the thickness")

    def geometry(self) -> ValveGeometry:
        """Return the valve's shape."""
        return TYPES[self.type](diameter=self.diameter)


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
    stent: Name | None = Field(
        None, description="Solid with a valve whose stent belongs to it", examples=["leaflets"]
    )

    def section(self) -> AorticSection:
        """Return the housing's shape."""
        names = ("inlet_radius", "outlet_radius", "annulus", "sinus_height", "sinus_depth")
        return AorticSection(**{name: getattr(self, name) for name in names})
