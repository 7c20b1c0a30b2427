"""What a plan says of an elastic body: points, warnings, bounds of the step, static displacements."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.bodies.body import Entry
from valvefsi.coupling.kernel_properties import largest_square_sum

if TYPE_CHECKING:
    from valvefsi.bodies.elastic import Elastic
    from valvefsi.grid import MacGrid
    from valvefsi.solid.structure import Structure

LONGEST_GAP = 1.25
"""Largest distance of neighbouring nodes over h that is held to be tight.

At 1, 1.2, 1.5 and 2.4 h a plug two cells thick in a channel passes 0.20, 0.72, 2.6 and 15 times what slots of width h
would (piecewise_linear; bspline3: 0.10, 0.68, 1.6, 9.8; ib4: 0.27, 0.31, 0.52, 2.8). Quadratic elements leak as linear
ones with nodes at the same places, within some per cent. The leak follows the pressure difference: a body that is
merely carried along keeps its volume with nodes further apart, as a soft disk in a cavity does.
"""
SOUND_BARE, SOUND_ELEMENTAL = 0.85, 1.0
"""Distance of nodes over h up to which nodal coupling without volumetric energy was sound (0.5 in all, 0.75 in some
of the kernel study), and from which elemental coupling is 5 % off or more."""
WIDE = ("ib4", "ib5", "ib6", "bspline6")
"""Kernels that were 3 to 6 % off on Cook's membrane with nodal coupling and elements of 0.5 to 1 h, stabilised."""

UPRIGHT = 10.0
"""Angle between thickness and normal of a solid shell that is let be [deg]."""
THINNEST, THIN = 0.25, 2.0
"""Thickness over h of the thinnest plate whose bending was measured (`bench plate`), and that below which a plate drags
more fluid than it should: waves 16 h long are 7 to 11 % slow."""
STIFF = ("piecewise_linear", "composite_bspline32")
"""Kernels linear along or across a component: velocities that they interpolate cannot bend a thin body without
shearing it."""


def size(body: Elastic, grid: MacGrid) -> list[Entry]:
    """Return the number of points, their distances, and what to make of them (collective)."""
    solid, h = body.solid, float(grid.spacing[0])
    ratio, longest = solid.stiffness().smallest_edge / h, solid.longest_edge() / h
    entry = Entry(
        quantity=f"points of {body.name}",
        value=body.num_points,
        note=f"smallest edge / h = {ratio:.2f}, longest {longest:.2f}",
    )
    thickness = solid.thickness() / h
    texts = _warnings(body, body.gap({"chi": body.X}) / h, solid.longest_gap(body.X) / h)
    texts += _thin_warnings(body.coupling.name, thickness)
    return [entry, *(Entry(quantity=f"warning, {body.name}", value="", note=text) for text in texts)]


def _warnings(body: Elastic, gap: float, nodes: float) -> list[str]:
    """Warn where a solid leaves the range in which the kernel study found errors of at most 3 % and no leak.

    Args:
        body: The body.
        gap: Largest distance of neighbouring points, over h.
        nodes: Largest distance of neighbouring nodes, over h.
    """
    texts, nodal, stabilised = [], body.coupling.nodal, body.solid.kappa > 0.0
    if gap > LONGEST_GAP:
        texts.append(
            f"fluid leaks between points: neighbours are {gap:.2f} h apart, at most {LONGEST_GAP:g} is safe; "
            f"{body.remedy}"
        )
    if not stabilised:
        texts.append("no volumetric energy (nu_stab, kappa): J goes far from 1 under large compression")
        if nodal and SOUND_BARE < nodes <= LONGEST_GAP:
            texts.append(
                f"without volumetric energy nodes {nodes:.2f} h apart may leak where it stretches; 0.5 h was sound"
            )
    slant = getattr(body.solid.elasticity, "slant", 0.0)
    if slant > UPRIGHT:
        texts.append(
            f"edges through the thickness slant by up to {slant:.0f} degrees from the normal; 14 degrees stiffened a "
            "strip by 11 %, 27 by 33 %"
        )
    if not nodal and nodes > SOUND_ELEMENTAL:
        texts.append(
            f"elemental coupling was 5 % and more off with nodes {SOUND_ELEMENTAL:g} h apart, here they are "
            f"{nodes:.2f} h; refine the mesh"
        )
    if nodal and stabilised and body.coupling.name in WIDE:
        texts.append(f"{body.coupling.name} was 3 to 6 % off on Cook's membrane, bspline3 at most 1 %")
    return texts


def _thin_warnings(kernel: str, thickness: float) -> list[str]:
    """Warn where a thin body leaves the range in which a plate at rest yields as it should (`bench plate`).

    Args:
        kernel: Name of the kernel.
        thickness: Of the body, over h.
    """
    texts = []
    if thickness < THINNEST:
        texts.append(
            f"it is {thickness:.2f} h thick; bending was measured down to {THINNEST:g} h, where a load bends a plate "
            "within 1 % of what it should and waves 16 h long are 11 % slow; refine the grid"
        )
    if thickness < THIN and kernel in STIFF:
        texts.append(
            f"{kernel} stiffens thin bodies: a plate 0.5 h thick yields 23 to 47 % too little; bspline3 is within 1 %"
        )
    return texts


def step_limits(body: Elastic, h: float, rho: float) -> dict[str, float]:
    """Return bounds of a stable step by cause [s] (collective).

    Args:
        body: The body.
        h: Smallest spacing [cm].
        rho: Density of the fluid [g/cm^3].
    """
    solid, dim = body.solid, body.coupling.grid.dim
    stiff, c, reserve = solid.stiffness(), largest_square_sum(body.coupling.name), body.reserve
    fibres = getattr(solid.material, "fibre_modulus", 0.0)
    modulus = stiff.kappa + 4.0 / 3.0 * stiff.shear_modulus + fibres
    fill = min(1.0, c * solid.thickness() / h)
    mass = rho / fill
    edge = stiff.smallest_edge
    limits = {f"elastic, {body.name}": edge * math.sqrt(reserve * mass / modulus / dim)}
    if solid.viscosity:
        limits[f"viscosity, {body.name}"] = reserve * mass * edge**2 / (4.0 * solid.viscosity.eta * dim)
    if body.slip is not None:
        limits[f"Darcy slip, {body.name}"] = edge**2 / (2.0 * body.slip.largest(fill) * modulus * dim)
    springs: dict[str, float] = {}
    for tether in solid.tethers:
        mass = rho if tether.on is None else rho * h / c
        for axis in set("xyz"[:dim]) & set(tether.components):
            springs[axis] = springs.get(axis, 0.0) + tether.stiffness / mass
    if springs:
        limits[f"tether, {body.name}"] = 2.0 * math.sqrt(reserve / max(springs.values()))
    damping = solid.damping / rho + sum(
        t.damping / (rho if t.on is None else rho * h / c) for t in solid.tethers
    )
    if damping > 0.0:
        limits[f"damping, {body.name}"] = 2.0 * reserve / damping
    return limits


def static_displacements(solid: Structure) -> list[Entry]:
    """Return how far each tether yields under the mean of the loads it carries: mean traction / stiffness."""
    entries, total = [], np.zeros(3)
    for load in solid.load_report():
        traction = np.atleast_1d(load.value)
        total[: len(traction)] += traction * load.measure
    for tether in solid.tether_report():
        force = max((abs(total["xyz".index(axis)]) for axis in tether.components), default=0.0)
        stiffness = float(np.max(tether.value))
        where = "body" if tether.on is None else ", ".join(tether.on)
        entries.append(
            Entry(
                quantity=f"static displacement of the tether on {where} ({''.join(tether.components)})",
                value=force / (tether.measure * stiffness) if stiffness else math.inf,
                unit="cm",
                note="mean traction / stiffness",
            )
        )
    return entries
