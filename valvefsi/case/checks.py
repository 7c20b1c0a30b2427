"""Checks of a case that look at more than one table."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

from valvefsi.case.fluid_tables import Grid, Side, Sides
from valvefsi.case.models import MOST_STEPS, SHAPES, Case, Solid
from valvefsi.case.overrides import nearest
from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

REACH = {
    "piecewise_linear": 1.0,
    "bspline3": 1.5,
    "bspline4": 2.0,
    "bspline5": 2.5,
    "bspline6": 3.0,
    "ib3": 1.5,
    "ib4": 2.0,
    "ib5": 2.5,
    "ib6": 3.0,
    "composite_bspline32": 1.5,
    "composite_bspline43": 2.0,
    "composite_bspline54": 2.5,
    "composite_bspline65": 3.0,
}
"""How far each kernel reaches from a point, in grid spacings."""


def check_case(case: Case) -> None:
    """Check what holds between the tables of a case.

    Raises:
        CaseError: Something does not fit; its key is a path with numbers for the items of lists.
    """
    _check_sides(case.grid, case.fluid.sides)
    circuits = [circuit.name for circuit in case.circuit]
    for number, name in enumerate(circuits):
        if name in circuits[:number]:
            raise CaseError("two circuits have this name", key=f"circuit.{number}.name", value=name)
    names: list[str] = []
    for number, solid in enumerate(case.solid):
        key = f"solid.{number}"
        if solid.name in names:
            raise CaseError(
                "two solids have this name; give each its own", key=f"{key}.name", value=solid.name
            )
        names.append(solid.name)
        _check_solid(case, solid, key)
    _check_housing(case)
    _check_output(case)
    if case.dt > case.time.t_end * (1 + 1e-9):
        raise CaseError(
            f"expected at least one time step, {case.dt:g} s", key="time.t_end", value=case.time.t_end
        )
    if case.time.t_end > MOST_STEPS * case.dt:
        message = f"expected at most {MOST_STEPS:g} time steps of {case.dt:g} s"
        raise CaseError(message, key="time.t_end", value=case.time.t_end)


def check_against_mesh(
    case: Case, number: int, *, tags: Collection[str], lower: Sequence[float], upper: Sequence[float]
) -> None:
    """Check a solid against its mesh.

    Args:
        case: The case.
        number: Which solid.
        tags: Names of the mesh's facet and cell tags.
        lower: Lower corner of the mesh's bounding box [cm].
        upper: Upper corner of it [cm].

    Raises:
        CaseError: A tag is not in the mesh, the solid is not inside the box or a probe not inside the solid.
    """
    solid, file = case.solid[number], case.file
    key = f"solid.{solid.name}"
    try:
        _check_tags(solid, key, tags)
        mesh_key = f"{key}.mesh.lower" if solid.mesh.shape else f"{key}.mesh.file"
        value = [float(x) for x in lower[: case.grid.dim]] if solid.mesh.shape else solid.mesh.file
        if solid.mesh.valve is not None:
            mesh_key, value = f"{key}.mesh.valve", solid.mesh.valve.type
        _check_place(case, solid, (lower, upper), mesh_key, value)
        _check_probes(solid, key, lower, upper)
    except CaseError as error:
        raise CaseError(error.reason, file=file, key=error.key, value=error.value) from None


def _check_sides(grid: Grid, sides: Sides) -> None:
    """Velocities have one entry per dimension and let no net flow in; two dimensions have no z sides."""
    flow, scale, expressions = 0.0, 0.0, False
    lengths = [b - a for a, b in grid.bounds]
    for number, name in enumerate(type(sides).model_fields):
        side, (axis, upper) = getattr(sides, name), divmod(number, 2)
        key = f"fluid.sides.{name}"
        if axis >= grid.dim:
            if side != type(side)():
                raise CaseError("a case in two dimensions has no such side; leave it out", key=key)
            continue
        _check_entries(side, grid.dim, key)
        expressions |= bool(side.velocity_expression)  # their flow is checked where they are made functions
        if side.velocity:
            rate = side.velocity[axis] * math.prod(lengths) / lengths[axis]
            flow += -rate if upper else rate
            scale += abs(rate)
    if abs(flow) > 1e-12 * scale and not sides.opens and not expressions:
        raise CaseError(
            f"the walls' velocities let {flow:g} cm^{grid.dim}/s into the box; in and out must balance, or a side be "
            "open",
            key="fluid.sides",
        )


def _check_entries(side: Side, dim: int, key: str) -> None:
    for name in ("velocity", "velocity_expression", "centre"):
        value = getattr(side, name)
        if value and len(value) != dim:
            hint = ", or none for a wall at rest" if name == "velocity" else ""
            raise CaseError(f"expected {dim} entries{hint}", key=f"{key}.{name}", value=list(value))


def _check_solid(case: Case, solid: Solid, key: str) -> None:
    dim = case.grid.dim
    if solid.density is not None and solid.density < case.fluid.density:
        raise CaseError(
            f"expected the fluid's density, {case.fluid.density:g} g/cm^3, or more; a solid lighter than the fluid "
            "is not supported",
            key=f"{key}.density",
            value=solid.density,
        )
    for number, load in enumerate(solid.load):
        _check_length(load.traction, dim, f"{key}.load.{number}.traction")
    for number, tether in enumerate(solid.tether):
        if dim == 2 and "z" in tether.components:
            place = f"{key}.tether.{number}.components"
            raise CaseError("in two dimensions there are 'x', 'y'", key=place, value=list(tether.components))
    probes: list[str] = []
    for number, probe in enumerate(solid.probe):
        _check_length(probe.at, dim, f"{key}.probe.{number}.at")
        if probe.name in probes:
            raise CaseError("two probes have this name", key=f"{key}.probe.{number}.name", value=probe.name)
        probes.append(probe.name)
    mesh = solid.mesh
    if mesh.valve is not None:
        from valvefsi.case.valve_tables import VALVE_TAGS

        _check_tags(solid, key, VALVE_TAGS)
    if mesh.valve_diameter is not None:
        if dim != 3:
            place = "valve" if mesh.valve is not None else "leaflets"
            raise CaseError("a valve needs three dimensions", key=f"{key}.mesh.{place}")
        _check_directions(solid, key)
    if mesh.shape is not None:
        if mesh.shape_dim != dim:
            fits = "'box'" if dim == 3 else "'rectangle' or 'compressed_block'"
            raise CaseError(
                f"the grid has {dim} dimensions; expected {fits}", key=f"{key}.mesh.shape", value=mesh.shape
            )
        upper = [a + b for a, b in zip(mesh.lower, mesh.size, strict=True)]
        _check_tags(solid, key, SHAPES[mesh.shape][1])
        _check_place(case, solid, (mesh.lower, upper), f"{key}.mesh.lower", list(mesh.lower))
        _check_probes(solid, key, mesh.lower, upper)


def _check_directions(solid: Solid, key: str) -> None:
    """Three leaflets lie at 120 degrees to one another: one direction in space is not the tissue's in all of them."""
    from valvefsi.case.materials import directions_of, material_kind

    fixed = {fibre.name for fibre in solid.fibre if fibre.rule == "constant"}
    for place, value in directions_of(material_kind(solid.material.model), solid.material.parameters):
        if not isinstance(value, str) or value in fixed:
            degrees = f"{value:g}" if isinstance(value, float) else "45"
            raise CaseError(
                "one direction in space is not that of the tissue in three leaflets; give it relative to each leaflet, "
                f'"{degrees} deg from circumferential", or name a field of the mesh, "fibre_1"',
                key=f"{key}.material.{place}",
                value=value,
            )


def _check_output(case: Case) -> None:
    """Corners and lines have one entry per dimension and lie in the box."""
    dim, output = case.grid.dim, case.output
    if bool(output.fluid_lower) != bool(output.fluid_upper):
        missing = "fluid_lower" if output.fluid_upper else "fluid_upper"
        raise CaseError("a part of the box needs two corners", key=f"output.{missing}")
    points = {f"output.{key}": getattr(output, key) for key in ("fluid_lower", "fluid_upper")}
    for number, line in enumerate(output.line):
        if line.name in [other.name for other in output.line[:number]]:
            raise CaseError("two lines have this name", key=f"output.line.{number}.name", value=line.name)
        points |= {f"output.line.{number}.{key}": getattr(line, key) for key in ("start", "end")}
    for key, point in points.items():
        if not point:
            continue
        _check_length(point, dim, key)
        if not all(a <= x <= b for x, (a, b) in zip(point, case.grid.bounds, strict=True)):
            raise CaseError("this point is outside the box", key=key, value=list(point))
    if output.fluid_lower:
        for axis, (a, b) in enumerate(zip(output.fluid_lower, output.fluid_upper, strict=True)):
            if b - a < output.fluid_every * case.grid.spacing:
                raise CaseError(
                    f"no cell between this and fluid_upper along {'xyz'[axis]}",
                    key="output.fluid_lower",
                    value=list(output.fluid_lower),
                )


def _check_housing(case: Case) -> None:
    """A housing is in space, and its stent is that of a solid with a valve."""
    housing = case.housing
    if housing is None:
        return
    if case.grid.dim != 3:
        raise CaseError("a housing needs three dimensions", key="housing")
    valves = {s.name: s.mesh.valve for s in case.solid if s.mesh.valve_diameter is not None}
    if housing.stent is None:
        return
    if housing.stent not in valves:
        raise CaseError(
            f"no solid with a valve has this name{nearest(housing.stent, sorted(valves))}",
            key="housing.stent",
            value=housing.stent,
        )
    valve = valves[housing.stent]
    if valve is not None and valve.base < housing.annulus:
        raise CaseError(
            "the leaflets' attachment begins below the housing's annulus",
            key="housing.annulus",
            value=housing.annulus,
        )
    leaflets = next(s for s in case.solid if s.name == housing.stent)
    attached = set(leaflets.mesh.leaflets.attached if leaflets.mesh.leaflets is not None else ("attached",))
    if housing.posts is not None and not any(t.on and set(t.on) <= attached for t in leaflets.tether):
        raise CaseError(
            f"no tether of {housing.stent} holds the attached edge alone: nothing would hang on the posts",
            key="housing.posts",
        )


def _check_length(value: Sequence[float], dim: int, key: str) -> None:
    if len(value) != dim:
        raise CaseError(f"expected {dim} entries, as many as grid.lower", key=key, value=list(value))


def _check_tags(solid: Solid, key: str, tags: Collection[str]) -> None:
    for tag in solid.faces:
        if tag not in tags:
            raise CaseError(
                f"the mesh has no such tag{nearest(tag, sorted(tags))}", key=f"{key}.faces", value=tag
            )
    for kind in ("tether", "load"):
        for number, item in enumerate(getattr(solid, kind)):
            for tag in item.on:
                if tag not in tags:
                    place = f"{key}.{kind}.{number}.on"
                    raise CaseError(
                        f"the mesh has no such tag{nearest(tag, sorted(tags))}", key=place, value=tag
                    )


def _check_place(
    case: Case, solid: Solid, box: tuple[Sequence[float], Sequence[float]], key: str, value: Unchecked
) -> None:
    """Keep a solid inside the box, and as far from open sides and from graded cells as the kernel reaches."""
    grid, reach = case.grid, REACH[solid.kernel] * case.grid.spacing
    for axis in range(grid.dim):
        bounds, fine = grid.bounds[axis], grid.fine[axis]
        if case.fluid.sides.periodic(axis) and fine == bounds:
            continue
        # Walls reflect the kernel; fluid that passes a side does not.
        free = [fine[end] != bounds[end] or _opens(case, axis, end) for end in (0, 1)]
        low, high = fine[0] + reach * free[0], fine[1] - reach * free[1]
        first, last = box[0][axis], box[1][axis]
        slack = 1e-12 * (high - low)
        if first < low - slack or last > high + slack:
            name = "xyz"[axis]
            if first < bounds[0] or last > bounds[1]:
                what = "outside the box"
            else:
                sides = [bounds[0] if first < low else None, bounds[1] if last > high else None]
                opens = any(side in (fine[0], fine[1]) for side in sides)
                edge = "an open side" if opens else "cells that are not of the smallest width"
                what = f"within the reach of {solid.kernel} from {edge}"
            raise CaseError(
                f"the solid is {what}: it spans {name} = {first:g} ... {last:g} cm, "
                f"allowed is {low:g} ... {high:g} cm",
                key=key,
                value=value,
            )


def _opens(case: Case, axis: int, end: int) -> bool:
    side = getattr(case.fluid.sides, f"{'xyz'[axis]}_{('lower', 'upper')[end]}")
    return side.type not in ("wall", "free_slip")


def _check_probes(solid: Solid, key: str, lower: Sequence[float], upper: Sequence[float]) -> None:
    for number, probe in enumerate(solid.probe):
        for x, a, b in zip(probe.at, lower, upper, strict=False):
            if not a - 1e-9 * (b - a) <= x <= b + 1e-9 * (b - a):
                clipped = (min(max(x, a), b) for x, a, b in zip(probe.at, lower, upper, strict=False))
                near = ", ".join(f"{v:g}" for v in clipped)
                message = f"the probe is outside the solid; the nearest position is {near} cm"
                raise CaseError(message, key=f"{key}.probe.{number}.at", value=list(probe.at))
