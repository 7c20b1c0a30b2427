"""The tables of a case file about a valve in a test section: the leaflets, meshed or of one's own, and the housing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from valvefsi.case.quantities import Length, Mass, Spring
from valvefsi.case.table import Name, Table, problem
from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import AorticSection
from valvefsi.geometry.leaflets import TYPES, ValveGeometry

VALVE_TAGS = ("leaflet_1", "leaflet_2", "leaflet_3", "inflow", "outflow", "attached", "free")

SURFACES = ("attached", "free", "inflow", "outflow")
"""What the facets of leaflets are."""

SECTION = ("inlet_radius", "outlet_radius", "sinus_height", "sinus_depth")
"""Lengths of the parametric test section."""

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


class OwnLeaflets(Table):
    """What the tags of a mesh file are that holds leaflets; z is along the flow, and the axis of the valve."""

    diameter: Length = Field(
        2.5, gt=0, description="Diameter of the orifice, where the leaflets are attached"
    )
    attached: tuple[str, ...] = Field(
        ("attached",), min_length=1, description="Tags of the facets at which the leaflets are attached"
    )
    free: tuple[str, ...] = Field(("free",), min_length=1, description="Tags of the facets of the free edges")
    inflow: tuple[str, ...] = Field(
        ("inflow",), min_length=1, description="Tags of the leaflets' faces towards the inflow"
    )
    outflow: tuple[str, ...] = Field(
        ("outflow",), min_length=1, description="Tags of the leaflets' faces towards the outflow"
    )
    directions: Literal["tags", "data"] = Field(
        "tags",
        description='Where the leaflets\' own directions are from: "tags" (radial from the attached to the free '
        'edge, circumferential along them) or "data" (the unit vectors in the file\'s cell data)',
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        seen: dict[str, str] = {}
        for name, tags in self.tags.items():
            for tag in tags:
                if tag in seen:
                    raise problem(f"this tag is one of {seen[tag]}, too", name, tag)
                seen[tag] = name
        return self

    @property
    def tags(self) -> dict[str, tuple[str, ...]]:
        """Tags of facets by what they are."""
        return {name: getattr(self, name) for name in SURFACES}


class FlexiblePosts(Table):
    """Posts of a stent that bend towards the axis; without this table they are rigid."""

    stiffness: Spring | None = Field(
        None,
        gt=0,
        description="Force towards the axis at the tip of a post over the tip's displacement, as makers measure it; "
        "3 E I / L^3 of a uniform bar",
        examples=["2000 N/m"],
    )
    mass: Mass = Field(
        0.02,
        gt=0,
        description="Mass that the tip moves: 33/140 of that of a uniform post; the fluid's comes in by itself",
    )
    damping: float = Field(0.05, ge=0, le=10, description="Damping of a post, as a part of the critical one")
    length: Length | None = Field(
        None,
        gt=0,
        description="Length from the tip down to where a post is clamped; where the attached edge begins to rise "
        "steeply when left out",
        examples=["8 mm"],
    )


class Housing(Table):
    """A rigid aortic test section about the z axis, from one z side of the box to the other."""

    file: str | None = Field(
        None,
        description="STL file, or mesh whose facets are the wall, relative to the case file; about the z axis, "
        "in place of the test section of the lengths below",
        examples=["housing.stl"],
    )
    file_unit: Length | None = Field(
        None, gt=0, description="file only: length of its unit; 1 cm when left out", examples=["1 mm"]
    )
    tags: tuple[str, ...] = Field(
        (), description="file only: tags of the facets that are the wall; empty for all"
    )
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
        description="Whether the fluid outside is held still beside the stent, so that nothing flows round the valve",
    )
    stent: Name | None = Field(
        None,
        description="Solid with a valve whose stent belongs to it: a wall from annulus to the attached edge",
        examples=["leaflets"],
    )
    posts: FlexiblePosts | None = Field(None, description="Flexible posts of the stent; rigid when left out")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.posts is not None and self.stent is None:
            raise problem("posts are those of a stent; name its solid in stent", "posts")
        if self.posts is not None and self.posts.stiffness is None:
            raise problem("flexible posts need a stiffness", "posts.stiffness")
        own = ("file_unit", "tags") if self.file is None else SECTION
        for key in own:
            if getattr(self, key) != type(self).model_fields[key].default:
                found = "needs a file" if self.file is None else "is that of the file; leave it out"
                raise problem(f"the wall {found}", key, getattr(self, key))
        return self

    def section(self) -> AorticSection:
        """Return the housing's shape."""
        return AorticSection(annulus=self.annulus, **{name: getattr(self, name) for name in SECTION})
