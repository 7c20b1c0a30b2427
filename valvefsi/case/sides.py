"""From the tables of a case to the grid and the sides of its box."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from valvefsi.case.expressions import Expression, TimeTable, read_table
from valvefsi.case.fluid_tables import SIDES, Side
from valvefsi.case.models import Case
from valvefsi.case.sizes import check_size
from valvefsi.errors import CaseError
from valvefsi.fluid import boundary
from valvefsi.fluid.boundary import Boundary
from valvefsi.fluid.navier_stokes import ExplicitViscosity, NavierStokes, stable_fluid
from valvefsi.fluid.sides import Velocity
from valvefsi.grid import MacGrid
from valvefsi.types import Array

GOLDEN, TIMES = 0.6180339887498949, 64
"""Fractions k GOLDEN mod 1 fall evenly and never in step with a period: times at which walls are checked."""
UNBALANCED = 0.01
"""Net flow into a box that nothing leaves, as a part of what goes in and out, from which it is refused."""


def build_grid(case: Case, comm: MPI.Comm) -> MacGrid:
    """Build the grid of a case; one that the memory cannot hold is refused first."""
    check_size(case, comm)
    grid = case.grid
    periodic = [case.fluid.sides.periodic(axis) for axis in range(grid.dim)]
    try:
        if grid.graded:
            return MacGrid.graded([edges.tolist() for edges in grid.edges], periodic, comm)
        counts = [len(edges) - 1 for edges in grid.edges]
        return MacGrid(grid.lower, grid.upper, counts, periodic, comm)
    except ValueError as error:
        key = "grid.h" if grid.h is not None else "grid.x" if grid.x else "grid.cells"
        value = grid.h if grid.h is not None else list(grid.x or grid.cells)
        raise CaseError(str(error), file=case.file, key=key, value=value) from None


def build_fluid(case: Case, grid: MacGrid) -> NavierStokes:
    """Build the fluid of a case, with the viscous scheme that it asks for or that its step allows.

    Raises:
        CaseError: The viscous scheme is not stable with the step, or a side cannot be as it is given.
    """
    fluid = case.fluid
    physics: dict[str, Any] = {"rho": fluid.density, "mu": fluid.viscosity, "advection": fluid.advection}
    sides = build_boundary(case, grid)
    limit = ExplicitViscosity.limit(grid, rho=fluid.density, mu=fluid.viscosity)
    if fluid.viscous == "explicit" and case.dt > limit:
        raise CaseError(
            f"explicit viscosity is stable up to a step of {limit:.3g} s, the step is {case.dt:.3g} s",
            file=case.file,
            key="fluid.viscous",
            value=fluid.viscous,
        )
    if fluid.viscous == "coupled":
        from valvefsi.fluid.krylov import CoupledNavierStokes  # PETSc is needed for this one only

        return CoupledNavierStokes(grid, sides, **physics)
    if fluid.viscous == "auto":
        return stable_fluid(grid, sides, case.dt, **physics)
    return (ExplicitViscosity if fluid.viscous == "explicit" else NavierStokes)(grid, sides, **physics)


def build_boundary(case: Case, grid: MacGrid) -> Boundary:
    """Build the sides of the box of a case.

    Raises:
        CaseError: A table cannot be read, an expression cannot be used, or no face of a disk is open.
    """
    sides = {}
    for number, name in enumerate(SIDES[: 2 * grid.dim]):
        if not grid.periodic[number // 2]:
            key = f"fluid.sides.{name}"
            sides[name] = _side(getattr(case.fluid.sides, name), case, grid.dim, key)
    if not case.fluid.sides.opens:
        _check_balance(case, sides)
    try:
        return Boundary(grid, sides)
    except ValueError as error:
        raise CaseError(str(error), file=case.file, key="fluid.sides") from None


def _check_balance(case: Case, sides: Mapping[str, boundary.Side]) -> None:
    """Refuse walls whose velocities let a net flow into a box that nothing leaves.

    The flow through the faces of each wall is summed at times spread over the run; quadrature errs by the square of
    the cell's width, so that a small part is let through.

    Raises:
        CaseError: With the flow and the time.
    """
    moving = {name: side.velocity for name, side in sides.items() if isinstance(side, boundary.Wall)}
    if not any(callable(velocity) for velocity in moving.values()):
        return
    edges = [np.asarray(part, dtype=float) for part in case.grid.edges]
    flows = []
    times = case.time.t_end * (GOLDEN * np.arange(TIMES) % 1.0)
    for t in times:
        rates = [_inflow(name, velocity, edges, float(t)) for name, velocity in moving.items()]
        flows.append([sum(rates), sum(map(abs, rates))])
    net, gross = np.abs(flows).T
    worst = int(net.argmax())
    if net[worst] > UNBALANCED * gross.max():
        raise CaseError(
            f"the walls let {flows[worst][0]:.4g} cm^{case.grid.dim}/s into the box at t = {times[worst]:.4g} s, and "
            "nothing leaves it; in and out must balance, or a side be open",
            file=case.file,
            key="fluid.sides",
        )


def _inflow(name: str, velocity: tuple[float, ...] | Velocity, edges: list[Array], t: float) -> float:
    """Return the flow through a wall into the box [cm^3/s, or cm^2/s in two dimensions]."""
    axis, upper = "xyz".index(name[0]), name.endswith("upper")
    places, widths = _faces(name, edges), [np.diff(part) for part in edges]
    widths[axis] = np.ones(1)
    areas = np.prod(np.meshgrid(*widths, indexing="ij"), axis=0).reshape(places[0].shape)
    normal = (velocity(*places, t) if callable(velocity) else velocity)[axis]
    return float(np.sum(normal * areas)) * (-1.0 if upper else 1.0)


def _faces(name: str, edges: list[Array]) -> tuple[Array, Array, Array]:
    """Return the middles of the faces of a side, three arrays of one shape [cm]."""
    axis = "xyz".index(name[0])
    places = [0.5 * (part[1:] + part[:-1]) for part in edges]
    places[axis] = edges[axis][[-1 if name.endswith("upper") else 0]]
    x, y, z = np.meshgrid(*(places + [np.zeros(1)])[:3], indexing="ij")
    return x, y, z


def largest_given_speed(case: Case) -> float:
    """Return the largest speed that a case gives at its walls, at times spread over the run [cm/s].

    What pressures and circuits will drive is not known before the run.
    """
    edges = [np.asarray(part, dtype=float) for part in case.grid.edges]
    largest = 0.0
    for name in SIDES[: 2 * case.grid.dim]:
        given: Side = getattr(case.fluid.sides, name)
        if given.type != "wall" or not (given.velocity or given.velocity_expression):
            continue
        side = _side(given, case, case.grid.dim, f"fluid.sides.{name}")
        velocity = side.velocity if isinstance(side, boundary.Wall) else ()
        faces = _faces(name, edges)
        for t in case.time.t_end * (GOLDEN * np.arange(TIMES) % 1.0):
            parts = velocity(*faces, float(t)) if callable(velocity) else velocity
            squares = sum(np.square(np.asarray(part, dtype=float)) for part in parts)
            largest = max(largest, float(np.sqrt(np.max(squares, initial=0.0))))
    return largest


def _side(side: Side, case: Case, dim: int, key: str) -> boundary.Side:
    if side.type == "free_slip":
        return boundary.FreeSlip()
    table = read_table(_path(side.table, case.file)) if side.table else None
    if side.type == "wall":
        if not side.velocity_expression:
            return boundary.Wall(velocity=tuple(side.velocity) or (0.0,) * dim)
        parts = [
            _function(text, table, case, f"{key}.velocity_expression") for text in side.velocity_expression
        ]
        return boundary.Wall(velocity=lambda x, y, z, t: [part(x, y, z, t) for part in parts])
    pressure: Any = side.pressure
    if side.pressure_expression:
        pressure = _function(side.pressure_expression, table, case, f"{key}.pressure_expression")
    opened = boundary.Open(pressure=pressure, backflow=side.backflow, mean_pressure=side.mean_pressure)
    if side.type == "open":
        return opened
    x, y, z, *_ = (*side.centre, 0.0, 0.0)
    return boundary.Mixed(open=opened, where=boundary.Disk(centre=(x, y, z), radius=side.radius or 0.0))


def _path(name: str, file: Path | None) -> Path:
    return (file.parent if file is not None else Path()) / name


def _function(
    text: str, table: TimeTable | None, case: Case, key: str
) -> Callable[[Array, Array, Array, float], Array | float]:
    """A function of place and time from an expression, tried once at the origin at t = 0."""
    try:
        expression = Expression(text, tuple(table.columns) if table else ())
    except ValueError as error:
        raise CaseError(str(error), file=case.file, key=key, value=text) from None

    def function(x: Array, y: Array, z: Array, t: float) -> Array | float:
        values: dict[str, Array | float] = {"x": x, "y": y, "z": z, "t": t}
        return expression({**values, **(table.at(t) if table else {})})

    with np.errstate(all="ignore"):
        x, y, z, *_ = [np.array(0.5 * sum(b)) for b in case.grid.bounds] + [np.array(0.0)]
        value = function(x, y, z, 0.0)
    if not np.all(np.isfinite(value)):
        raise CaseError(
            "the value in the middle of the box at t = 0 is not finite", file=case.file, key=key, value=text
        )
    return function
