"""The table of a case file that says which operating condition pump and peripheral resistance are chosen for."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from valvefsi.case.quantities import Quantity, Stress
from valvefsi.case.table import Table
from valvefsi.units import LITRE_PER_MINUTE, MMHG

Flow = Annotated[float, Quantity("cm^3/s")]
Area = Annotated[float, Quantity("cm^2")]
Inertance = Annotated[float, Quantity("g/cm^4")]


class Target(Table):
    """Operating condition: the loop with an orifice chooses pump, peripheral resistance and start for it."""

    beats_per_minute: float = Field(
        70.0, gt=0, le=600, description="Beats a minute; the pump's record is stretched to it"
    )
    cardiac_output: Flow = Field(
        5.0 * LITRE_PER_MINUTE,
        gt=0,
        description="Net flow through the valve, the mean of a beat; 5 l/min when left out",
    )
    mean_aortic_pressure: Stress = Field(
        100.0 * MMHG,
        gt=0,
        description="Mean pressure downstream of the valve over a beat; 100 mmHg when left out",
    )
    beats: int = Field(
        1, ge=1, le=1000, description="Beats that the run lasts, or longer where time.t_end says so"
    )
    orifice_area: Area | None = Field(
        None,
        gt=0,
        description="Effective area of the orifice that stands for the valve; 0.6 of the area of the valve's diameter "
        "when left out",
        examples=["2.9 cm^2"],
    )
    inertance: Inertance | None = Field(
        None,
        gt=0,
        description="Inertance of the fluid around it; of a column of the valve's diameter as long as the box "
        "when left out",
        examples=["1.6 g/cm^4"],
    )
    response: float = Field(
        1.0,
        gt=0,
        le=10,
        description="Flow through the valve over that through the orifice, which `valvefsi target` finds in a beat",
    )
