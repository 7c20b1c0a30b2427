"""The table of a study about a solid in static equilibrium: which one, what holds it, what loads it."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from valvefsi.case.quantities import Length, Stress
from valvefsi.case.table import Name, Table, problem


class HeldFacets(Table):
    """Facets of a solid that do not move."""

    on: tuple[str, ...] = Field(min_length=1, description="Tags of the facets")
    components: tuple[Literal["x", "y", "z"], ...] = Field(
        (), description="Axes along which they do not move; all when left out"
    )


class StaticsModel(Table):
    """A solid of the case in static equilibrium under a pressure, without fluid; of a valve one leaflet."""

    solid: Name = Field("leaflets", description="The solid")
    pressure: Stress = Field(
        description="Pressure from outside, that turns with the facets", examples=["80 mmHg"]
    )
    on: tuple[str, ...] = Field(("outflow",), min_length=1, description="Tags of the facets it pushes on")
    held: tuple[HeldFacets, ...] = Field(
        (HeldFacets(on=("attached",)),), description="What does not move; the attached edge when left out"
    )
    contact: tuple[str, ...] = Field(
        (),
        description="Valves only: tags of the facets that meet the neighbouring leaflets, such as inflow: planes "
        "between the sectors, which three leaflets that close alike have",
    )
    contact_depth: Length = Field(
        0.01,
        gt=0,
        description="How far a surface passes such a plane where it bears the whole pressure there",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.contact and not self.pressure > 0.0:
            raise problem("expected a pressure above 0 where leaflets meet", "pressure", self.pressure)
        return self
