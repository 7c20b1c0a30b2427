"""The tables of a case file about the fluid: the grid, the sides of the box, the fluid."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from valvefsi.case.expressions import Expression
from valvefsi.case.quantities import Density, Length, Stress, Velocity, Viscosity
from valvefsi.case.table import Table, problem
from valvefsi.grid.grading import core_edges, graded_edges, nearest_spacing

SIDES = ("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper")
MOST = 100_000
"""Cells that an axis may have."""
Spacings = tuple[tuple[Length, Annotated[Length, Field(gt=0)]], ...]


class Grid(Table):
    """The box of fluid and its cells: equal ones, or graded by wanted spacings along each axis."""

    lower: tuple[Length, ...] = Field(
        (), description="Lower corner of the box, 2 entries or 3; or give x, y (and z)"
    )
    upper: tuple[Length, ...] = Field((), description="Upper corner of the box")
    cells: tuple[Annotated[int, Field(ge=4, le=MOST)], ...] = Field(
        (), description="Cells along each axis, at least 4; the spacing must be the same on all axes"
    )
    h: Length | None = Field(
        None,
        gt=0,
        description="Spacing in the core of the box, instead of cells; outside the core cells grow",
        examples=["1 mm"],
    )
    adjust: bool = Field(
        False,
        description="h only: take the nearest spacing of which an axis without a core is a whole number",
    )
    core_lower: tuple[Length, ...] = Field(
        (), description="h only: lower corner of the core, the box's when left out"
    )
    core_upper: tuple[Length, ...] = Field((), description="h only: upper corner of the core")
    x: Spacings = Field(
        (),
        description="Positions along x with the spacings wanted there, instead of lower, upper and cells; the "
        "smallest spacing must be the same on all axes",
        examples=[[["-5 cm", "4 mm"], ["-2 cm", "1 mm"], ["2 cm", "1 mm"], ["5 cm", "4 mm"]]],
    )
    y: Spacings = Field((), description="The same along y")
    z: Spacings = Field((), description="The same along z, in three dimensions")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if any((self.x, self.y, self.z)):
            return self._check_graded()
        if self.h is not None:
            return self._check_core()
        if len(self.lower) not in (2, 3):
            raise problem("expected 2 or 3 entries", "lower", list(self.lower))
        for key in ("upper", "cells"):
            if len(getattr(self, key)) != self.dim:
                raise problem(f"expected {self.dim} entries as in lower", key, list(getattr(self, key)))
        if not all(a < b for a, b in zip(self.lower, self.upper, strict=True)):
            raise problem(
                f"expected each entry above that of lower, {list(self.lower)}", "upper", list(self.upper)
            )
        spacing = [(b - a) / n for a, b, n in zip(self.lower, self.upper, self.cells, strict=True)]
        if max(spacing) - min(spacing) > 1e-12 * max(spacing):
            near = nearest_spacing([b - a for a, b in zip(self.lower, self.upper, strict=True)], spacing[0])
            fit = [round((b - a) / near) for a, b in zip(self.lower, self.upper, strict=True)] if near else []
            hint = f"; {fit} would do" if near else ""
            shown = ", ".join(f"{h:.6g}" for h in spacing)
            raise problem(
                f"the spacing must be the same on all axes, it is {shown} cm{hint}", "cells", list(self.cells)
            )
        return self

    def _check_graded(self) -> Self:
        for key in ("lower", "upper", "cells", "core_lower", "core_upper"):
            if getattr(self, key):
                raise problem("give x, y, z or lower, upper, cells, not both", key, list(getattr(self, key)))
        if self.h is not None:
            raise problem("give x, y, z or h, not both", "h", self.h)
        for key, value in (("x", self.x), ("y", self.y)):
            if not value:
                raise problem(
                    "a graded grid needs x and y (and z), each with positions and spacings", key, []
                )
        smallest = []
        for axis, points in zip("xyz", (self.x, self.y, self.z), strict=True):
            if points:
                span, least = points[-1][0] - points[0][0], min(spacing for _, spacing in points)
                if span > MOST * least:
                    raise problem(
                        f"expected at most {MOST} cells along an axis", axis, [list(p) for p in points]
                    )
                try:
                    smallest.append(np.diff(graded_edges(points)).min())
                except ValueError as error:
                    raise problem(str(error), axis, [list(pair) for pair in points]) from None
        if max(smallest) - min(smallest) > 1e-6 * max(smallest):
            shown = ", ".join(f"{h:.6g}" for h in smallest)
            raise problem(
                f"the smallest spacing must be the same on all axes, it is {shown} cm",
                "x",
                [list(p) for p in self.x],
            )
        return self

    def _check_core(self) -> Self:
        if len(self.lower) not in (2, 3):
            raise problem("expected 2 or 3 entries", "lower", list(self.lower))
        if self.cells:
            raise problem("give h or cells, not both", "cells", list(self.cells))
        for key in ("upper", "core_lower", "core_upper"):
            value = getattr(self, key)
            if (value or key == "upper") and len(value) != self.dim:
                raise problem(f"expected {self.dim} entries as in lower", key, list(value))
        corners = (self.lower, *self._core, self.upper)
        for a, b, key in zip(corners, corners[1:], ("core_lower", "core_upper", "upper"), strict=False):
            if not all(x <= y for x, y in zip(a, b, strict=True)):
                raise problem("expected lower <= core_lower < core_upper <= upper", key, list(b))
        longest = max(b - a for a, b in zip(self.lower, self.upper, strict=True))
        if longest > MOST * self.spacing:
            raise problem(f"expected at most {MOST} cells along an axis of {longest:g} cm", "h", self.h)
        if any(abs(length / self.spacing - round(length / self.spacing)) > 1e-6 for length in self._whole):
            near = (
                f"; {self._nearest:.9g} cm is, adjust = true takes it"
                if self._nearest
                else ", nor of a near one"
            )
            raise problem(f"an axis is not a whole number of cells of this spacing{near}", "h", self.h)
        try:
            edges = self.edges
        except ValueError as error:
            raise problem(str(error), "h", self.h) from None
        if min(len(e) for e in edges) < 5:
            raise problem("expected at least 4 cells along each axis", "h", self.h)
        return self

    @property
    def _core(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        return self.core_lower or self.lower, self.core_upper or self.upper

    @property
    def _whole(self) -> list[float]:
        """Lengths of the axes that are all core [cm]."""
        ends = zip(self.lower, *self._core, self.upper, strict=True)
        return [b - a for a, first, last, b in ends if a == first and last == b]

    @cached_property
    def _nearest(self) -> float | None:
        """Spacing nearest to h that fits these axes [cm]."""
        return nearest_spacing(self._whole, self.h) if self._whole and self.h is not None else None

    @property
    def graded(self) -> bool:
        """Whether the grid is given by spacings."""
        return bool(self.x) or any(
            np.ptp(np.diff(e)) > 1e-9 * np.diff(e).min() for e in (self.edges if self.h is not None else ())
        )

    @cached_property
    def edges(self) -> list[np.ndarray]:
        """Edges of the cells along each axis [cm]."""
        if self.h is not None:
            return [
                core_edges(*ends, self.spacing)
                for ends in zip(self.lower, *self._core, self.upper, strict=True)
            ]
        if self.x:
            return [graded_edges(points) for points in (self.x, self.y, self.z) if points]
        return [np.linspace(a, b, n + 1) for a, b, n in zip(self.lower, self.upper, self.cells, strict=True)]

    @property
    def dim(self) -> int:
        """Number of dimensions."""
        return len(self.edges) if self.x else len(self.lower)

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Lower and upper end of the box along each axis [cm]."""
        return [(float(e[0]), float(e[-1])) for e in self.edges]

    @property
    def fine(self) -> list[tuple[float, float]]:
        """Along each axis the region where cells have the smallest width, where solids must stay [cm]."""
        if not self.graded:
            return self.bounds
        fine = []
        for e in self.edges:
            small = np.flatnonzero(np.diff(e) < np.diff(e).min() * (1 + 1e-6))
            fine.append((float(e[small[0]]), float(e[small[-1] + 1])))
        return fine

    @property
    def spacing(self) -> float:
        """Grid spacing, the smallest on a graded grid [cm]."""
        if self.h is not None:
            return (self._nearest if self.adjust else None) or self.h
        if self.graded:
            return float(min(np.diff(e).min() for e in self.edges))
        return (self.upper[0] - self.lower[0]) / self.cells[0]


class Side(Table):
    """One side of the box."""

    type: Literal["wall", "periodic", "free_slip", "open", "mixed"] = Field(
        "wall",
        description='"wall", "periodic", "free_slip", "open" (normal traction given, no velocity along the side) or '
        '"mixed" (open on a disk, wall at rest elsewhere)',
    )
    velocity: tuple[Velocity, ...] = Field(
        (), description="Velocity of the fluid on a wall, one entry per dimension; empty for a wall at rest"
    )
    velocity_expression: tuple[str, ...] = Field(
        (),
        description="The same as expressions in x, y, z [cm], t [s] and the columns of table, in cm/s",
        examples=[["6 * y * (1 - y)", "0"]],
    )
    pressure: Stress = Field(0.0, description="Pressure outside an open side or disk")
    pressure_expression: str = Field(
        "", description="The same as an expression, in dyn/cm^2", examples=["1e5 * sin(2 * pi * t)"]
    )
    circuit: str = Field(
        "", description="Name of the circuit that gives the pressure of an open side", examples=["outlet"]
    )
    table: str = Field(
        "",
        description="CSV file with a column t_s, whose other columns expressions may use by their names; relative to "
        "the case file",
        examples=["inflow.csv"],
    )
    backflow: float = Field(
        1.0,
        ge=0,
        le=1,
        description="Part of the dynamic pressure that fluid coming in through an open side loses; 1 is stable, 0 "
        "keeps the pressure on the side itself",
    )
    mean_pressure: bool = Field(
        False,
        description="Whether the pressure of an open side is the mean over it: what fluid coming in loses is given "
        "back evenly",
    )
    centre: tuple[Length, ...] = Field(
        (), description="mixed only: centre of the open disk, one entry per dimension"
    )
    radius: Length | None = Field(
        None, gt=0, description="mixed only: radius of the open disk", examples=["1.25 cm"]
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.type == "periodic" and any(self.velocity):
            raise problem("a periodic side has no velocity; leave it out", "velocity", list(self.velocity))
        allowed = {
            "wall": {"velocity", "velocity_expression", "table"},
            "free_slip": set(),
            "periodic": {"velocity"},
        }
        opened = {"pressure", "pressure_expression", "backflow", "mean_pressure", "table", "circuit"}
        allowed |= {"open": opened, "mixed": opened | {"centre", "radius"}}
        for key in self.model_fields_set - {"type"} - allowed[self.type]:
            if getattr(self, key) != type(self).model_fields[key].default:
                raise problem(
                    f"a side of type {self.type!r} has no such key; leave it out", key, getattr(self, key)
                )
        for key, other in (("velocity", "velocity_expression"), ("pressure", "pressure_expression")):
            if getattr(self, key) and getattr(self, other):
                raise problem(f"give {key} or {other}, not both", other, getattr(self, other))
        if self.circuit and (self.pressure or self.pressure_expression):
            raise problem("give a pressure or the circuit that gives it, not both", "circuit", self.circuit)
        if self.mean_pressure and self.backflow == 0.0:
            raise problem("nothing is lost to give back; give a backflow above 0", "mean_pressure", True)
        if self.type == "mixed" and (not self.centre or self.radius is None):
            raise problem("a mixed side needs centre and radius", "centre", list(self.centre))
        self._check_expressions()
        return self

    def _check_expressions(self) -> None:
        """Check them here as far as this can be done without the table."""
        if self.table:
            return
        for key in ("velocity_expression", "pressure_expression"):
            given = getattr(self, key)
            for text in (given,) if isinstance(given, str) else given:
                if text:
                    try:
                        Expression(text)
                    except ValueError as error:
                        raise problem(str(error), key, text) from None


class Sides(Table):
    """The sides of the box, walls at rest where nothing is said; in 3-D also z_lower and z_upper."""

    x_lower: Side = Field(Side(), description="Side at the lower end of x")
    x_upper: Side = Field(Side(), description="Side at the upper end of x")
    y_lower: Side = Field(Side(), description="Side at the lower end of y")
    y_upper: Side = Field(Side(), description="Side at the upper end of y")
    z_lower: Side = Field(Side(), description="Side at the lower end of z, in three dimensions")
    z_upper: Side = Field(Side(), description="Side at the upper end of z, in three dimensions")

    @model_validator(mode="after")
    def _check(self) -> Self:
        for axis in "xyz":
            types = {end: getattr(self, f"{axis}_{end}").type for end in ("lower", "upper")}
            if list(types.values()).count("periodic") == 1:
                other = next(end for end, kind in types.items() if kind != "periodic")
                message = "the opposite side is periodic; both must be or neither"
                raise problem(message, f"{axis}_{other}.type", types[other])
        return self

    @property
    def opens(self) -> bool:
        """Whether fluid may leave the box somewhere."""
        return any(getattr(self, name).type in ("open", "mixed") for name in SIDES)

    def periodic(self, axis: int) -> bool:
        """Whether the box is periodic along an axis."""
        return getattr(self, SIDES[2 * axis]).type == "periodic"


class Fluid(Table):
    """The fluid; an immersed solid has its viscosity too, and its density unless it is given a larger one."""

    density: Density = Field(1.0, gt=0, description="Density rho")
    viscosity: Viscosity = Field(0.01, gt=0, description="Dynamic viscosity mu")
    advection: Literal["centred", "xsppm7"] = Field(
        "xsppm7",
        description='Advection scheme, "xsppm7" (upwind; keep |u| dt/h below 0.3) or "centred" (no dissipation of its '
        "own, but stripes where the cell Reynolds number |u| h rho / mu is far above 2)",
    )
    viscous: Literal["auto", "implicit", "explicit", "coupled"] = Field(
        "auto",
        description='Viscous term: "implicit" (Crank-Nicolson), "explicit" (three solves fewer, with a limit of the '
        'step), "auto" (explicit where the step is at most half of that limit, else implicit) or "coupled" (implicit, '
        "with velocity and pressure solved for together by FGMRES: ten times the time, no splitting error)",
    )
    sides: Sides = Field(Sides(), description="Sides of the box")
