"""The tables of a case file that say what is read off on the way: flows, profiles, forces."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from valvefsi.case.quantities import Length
from valvefsi.case.table import Name, Table, problem


class Section(Table):
    """A plane across the box, or a disk in it, whose flow and mean pressure are in the history."""

    name: Name = Field(
        description="Name, in the column names flow_NAME_cm3_per_s and pressure_NAME_dyn_per_cm2"
    )
    axis: Literal["x", "y", "z"] = Field(description="Axis the plane is normal to; flow along it is positive")
    position: Length = Field(description="Where the plane cuts the axis")
    centre: tuple[Length, ...] = Field(
        (),
        description="Centre of the disk, one entry per dimension; left out for the whole plane",
        examples=[["1 cm", "2 cm", "2 cm"]],
    )
    radius: Length | None = Field(None, gt=0, description="Radius of the disk", examples=["1.25 cm"])

    @model_validator(mode="after")
    def _check(self) -> Self:
        if bool(self.centre) != (self.radius is not None):
            missing = "radius" if self.centre else "centre"
            raise problem("a disk needs a centre and a radius, a plane neither", missing, None)
        return self


class Line(Table):
    """A straight line along which velocity and pressure, and their averages, are written at the end."""

    name: Name = Field(description="Name of the table, profiles/NAME.csv")
    start: tuple[Length, ...] = Field(description="First point, one entry per dimension")
    end: tuple[Length, ...] = Field(description="Last point")
    points: int = Field(101, ge=2, le=100_000, description="Number of points")


class Force(Table):
    """The force of the fluid on bodies, such as drag and lift, in the history."""

    name: Name = Field(
        description="Name, in the column names force_x_NAME_dyn ... (dyn_per_cm in two dimensions)"
    )
    body: tuple[str, ...] = Field(
        description='Names of the solids, or "housing", whose forces are added up; flexible posts belong to the solid '
        "that is attached to them"
    )
    lower: tuple[Length, ...] = Field(
        (),
        description="Lower corner of a box around them whose balance of momentum checks the force, in columns "
        "force_balance_x_NAME_dyn ...; no check when left out",
    )
    upper: tuple[Length, ...] = Field((), description="Upper corner of that box")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if len(self.lower) != len(self.upper):
            raise problem(
                "a box needs a lower and an upper corner of as many entries", "upper", list(self.upper)
            )
        return self
