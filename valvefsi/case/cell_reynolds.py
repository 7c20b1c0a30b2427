"""What a plan says of the cell Reynolds number |u| h rho / mu: the speed it is for, and layers that a grid cannot show.

A layer that grows along a wall of length L is about 5 sqrt(mu L / (rho |u|)) thick (Blasius; Schlichting and Gersten
2017). One along the whole box is the thickest that there can be.
"""

from __future__ import annotations

import math

from valvefsi.bodies.body import Entry
from valvefsi.case.models import Case
from valvefsi.case.sides import largest_given_speed
from valvefsi.case.target import orifice_of_case
from valvefsi.units import MMHG

CENTRED_MOST = 2.0
"""Cell Reynolds number above which centred differences of steady advection and diffusion oscillate between cells."""
BLASIUS = 5.0
"""Thickness of a plate's layer, to 99 % of the stream, over sqrt(mu L / (rho |u|))."""
LAYER_CELLS = 4.0
"""Cells through the thickest layer below which a plan warns."""
EJECTION = 1.0 / 3.0
"""Part of a beat in which a valve lets its flow through, about."""
JET_PRESSURE = 10.0 * MMHG
"""A pressure difference over an open valve, for an example of a speed [dyn/cm^2]."""


def cell_reynolds_number(case: Case) -> list[Entry]:
    """Return the lines of a plan about |u| h rho / mu, with a warning where the grid is too coarse for its scheme.

    The speed is the largest at a side, or that of a target's flow through its orifice; without one of them the lines
    say at which speed the number is 1.
    """
    fluid, (speed, source) = case.fluid, _speed(case)
    one = fluid.viscosity / (fluid.density * case.grid.spacing)
    if speed == 0.0:
        note = "|u| = mu / (rho h)"
        if case.fluid.sides.opens:
            jet = math.sqrt(2.0 * JET_PRESSURE / fluid.density)
            note += (
                f"; pressures drive the flow, its speed is not known yet: {JET_PRESSURE / MMHG:g} mmHg make a jet of "
                f"{jet:.3g} cm/s, at which it is {jet / one:.3g}"
            )
        return [Entry(quantity="cell Reynolds number is 1 at", value=one, unit="cm/s", note=note)]
    note = f"|u| h rho / mu at {speed:.4g} cm/s, {source}"
    entry = Entry(quantity="cell Reynolds number", value=speed / one, note=note)
    warning = _centred(speed / one) if fluid.advection == "centred" else _thin_layers(case, speed)
    return [entry, *(Entry(quantity="warning, fluid", value="", note=text) for text in warning)]


def _speed(case: Case) -> tuple[float, str]:
    """Return the largest speed that is known before a run [cm/s], 0 without one, and what it is."""
    speed, source = largest_given_speed(case), "the largest speed given at a side"
    if case.target is None:
        return speed, source
    mean = case.target.cardiac_output / EJECTION / orifice_of_case(case).area
    text = f"about the target's flow in {EJECTION:.2g} of a beat through the orifice's area; peaks are higher"
    return (mean, text) if mean > speed else (speed, source)


def _centred(number: float) -> list[str]:
    text = f'centred advection gives stripes far above {CENTRED_MOST:g}: take advection = "xsppm7", or a finer grid'
    return [text] if number > CENTRED_MOST else []


def _thin_layers(case: Case, speed: float) -> list[str]:
    """Return a warning where even a layer along the whole box has few cells through it."""
    longest = max(upper - lower for lower, upper in case.grid.bounds)
    layer = BLASIUS * math.sqrt(case.fluid.viscosity * longest / (case.fluid.density * speed))
    cells = layer / case.grid.spacing
    if cells >= LAYER_CELLS:
        return []
    return [
        f"{case.fluid.advection} stays stable, but layers at walls are not resolved: one as long as the box is "
        f"{10 * layer:.2g} mm thick, {cells:.2g} cells; "
        f"{LAYER_CELLS:g} need a spacing of {10 * layer / LAYER_CELLS:.2g} mm"
    ]
