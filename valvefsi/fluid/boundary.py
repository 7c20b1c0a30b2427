"""What the sides of the box do to the fluid: ghost values and boundary faces.

A prescribed velocity normal to a side is set on its faces; everything beyond by reflection about the side,
u_ghost = 2 u_side - u where the value is given and u_ghost = u where its normal derivative is zero, which keeps
second order. On open sides the pressure is given, p_ghost = 2 p_side - p, and the velocity on the faces is an
unknown of the momentum equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from valvefsi.fluid.sides import Disk, FreeSlip, Mixed, Open, Side, Wall
from valvefsi.grid import MacGrid
from valvefsi.types import Array, Faces, Mask, Slices

__all__ = ["SIDES", "Boundary", "Disk", "FreeSlip", "Mixed", "Open", "Side", "Wall"]

SIDES = ("x_lower", "x_upper", "y_lower", "y_upper", "z_lower", "z_upper")


@dataclass(frozen=True, kw_only=True)
class Place:
    """A side of the box and where its entries are in local arrays."""

    name: str
    axis: int
    upper: bool
    side: Side
    here: bool  # whether this rank touches it
    face: int  # index of its faces along the axis
    open: Mask | bool  # which of its faces are open, (.., 1, ..) of local entries
    opened: Mask | None = None  # the same of a mixed side for all ranks, (n, n) along the other two axes

    def at(self, index: int) -> tuple[slice, ...]:
        """Place of a plane of entries along the axis, which is kept."""
        return (slice(None),) * self.axis + (slice(index, index + 1),)

    @property
    def inside(self) -> int:
        """Index of the cells that touch the side."""
        return self.face - 1 if self.upper else self.face

    @property
    def outside(self) -> int:
        """Index of the cells beyond the side."""
        return self.face if self.upper else self.face - 1

    @property
    def mask(self) -> Mask:
        """Which faces of a mixed side are open, the same on all ranks, ``(n, n)`` along the other two axes."""
        assert self.opened is not None, f"side {self.name} is not mixed"
        return self.opened

    @property
    def is_open(self) -> bool:
        """Whether any of its faces is open, on any rank."""
        return isinstance(self.side, Open | Mixed)

    @property
    def opening(self) -> Open:
        """What holds on its open part."""
        side = self.side.open if isinstance(self.side, Mixed) else self.side
        assert isinstance(side, Open), f"side {self.name} is not open"
        return side

    def loss(self, u: Faces, rho: float) -> Array | float:
        """What the pressure on its faces loses where fluid comes in, ``(.., 1, ..)`` [dyn/cm^2]."""
        if not self.opening.backflow > 0.0:
            return 0.0
        outward = u[self.axis][self.at(self.face)] * (1.0 if self.upper else -1.0)
        return 0.5 * self.opening.backflow * rho * np.square(np.minimum(outward, 0.0))


class Boundary:
    """Sets boundary faces and ghost values of velocity and pressure.

    Args:
        grid: The grid.
        sides: What each side that is not periodic is, keyed ``x_lower`` ... ``z_upper``; walls at rest when left out.

    Raises:
        ValueError: Something is said of a periodic side, or a side is not known, or mixed sides do not face each
            other.
    """

    def __init__(self, grid: MacGrid, sides: Mapping[str, Side] | None = None) -> None:
        self.grid = grid
        sides = dict(sides or {})
        self.places: list[Place] = []
        for number, name in enumerate(SIDES[: 2 * grid.dim]):
            axis, upper = divmod(number, 2)
            side = sides.pop(name, None)
            if grid.periodic[axis]:
                if side is not None:
                    kind = type(side).__name__.lower()
                    raise ValueError(f"side {name} is periodic, it cannot be a {kind}")
                continue
            self.places.append(self._place(name, axis, bool(upper), side or Wall()))
        if sides:
            raise ValueError(f"unknown side {next(iter(sides))!r}, a side is one of {', '.join(SIDES)}")
        if len({place.axis for place in self.mixed}) > 1:
            raise ValueError(
                "mixed sides must face each other, along one axis; those given are "
                + ", ".join(place.name for place in self.mixed)
            )
        self.changes_in_time = any(
            isinstance(p.side, Wall) and callable(p.side.velocity) for p in self.places
        )

    def _place(self, name: str, axis: int, upper: bool, side: Side) -> Place:
        grid = self.grid
        face = grid.ghosts[axis] + (grid.size[axis] if upper else 0)
        here = grid.is_last[axis] if upper else grid.is_first[axis]
        place = partial(Place, name=name, axis=axis, upper=upper, side=side, here=here, face=face)
        if not isinstance(side, Mixed):
            return place(open=isinstance(side, Open))
        mask = self._mask(axis, upper, side)
        if not mask.any():
            raise ValueError(f"no face of side {name} is open")
        others = [a for a in range(3) if a != axis]
        padded = mask
        for number, a in enumerate(others):
            pad = [(0, 0), (0, 0)]
            pad[number] = (grid.ghosts[a], grid.ghosts[a])
            padded = np.pad(padded, pad, mode="wrap" if grid.periodic[a] else "edge")
        local = padded[tuple(slice(grid.start[a], grid.start[a] + grid.shape[a]) for a in others)]
        return place(open=np.expand_dims(local, axis), opened=mask)

    def _mask(self, axis: int, upper: bool, side: Mixed) -> Mask:
        """Open faces of a side, the same on all ranks: one on the rim must not be open here and wall there."""
        ends = self.grid.upper if upper else self.grid.lower
        points = np.meshgrid(
            *[ends[a : a + 1] if a == axis else self.grid.centres(a) for a in range(3)],
            indexing="ij",
            sparse=True,
        )
        shape = [1 if a == axis else n for a, n in enumerate(self.grid.cells)]
        return np.broadcast_to(np.asarray(side.where(*points), dtype=bool), shape).squeeze(axis).copy()

    def _points(self, axis: int, upper: bool) -> tuple[Array, Array, Array]:
        """Open-mesh coordinates of the face centres on a side, ghosts included."""
        points = list(self.grid.points(axis))
        points[axis] = np.full((1, 1, 1), (self.grid.upper if upper else self.grid.lower)[axis])
        x, y, z = points
        return x, y, z

    @property
    def mixed(self) -> list[Place]:
        """The sides that are open on a part."""
        return [place for place in self.places if isinstance(place.side, Mixed)]

    def place(self, name: str) -> Place:
        """Return a side by its name.

        Raises:
            ValueError: There is none, or it is periodic.
        """
        for place in self.places:
            if place.name == name:
                return place
        raise ValueError(f"no side {name!r} that is not periodic")

    def kinds(self, d: int | None = None) -> tuple[str, str, str]:
        """Return the kinds of axes of the pressure (None) or of velocity component d, see `valvefsi.fluid.axes`."""
        kinds = ["periodic"] * 3
        for axis in range(self.grid.dim):
            ends = "".join(self._end(place, d) for place in self.places if place.axis == axis)
            if ends:
                kinds[axis] = f"{'faces' if d == axis else 'cells'} {ends}"
        return kinds[0], kinds[1], kinds[2]

    @staticmethod
    def _end(place: Place, d: int | None) -> str:
        """Whether the value (D) or the normal derivative (N) is given; on a mixed side that of the wall."""
        fully_open = isinstance(place.side, Open)
        if d is None:
            return "D" if fully_open else "N"
        if d == place.axis:
            return "N" if fully_open else "D"
        return "N" if isinstance(place.side, FreeSlip) else "D"

    @property
    def signs(self) -> dict[tuple[int, bool], tuple[float, ...]]:
        """Sign with which each velocity component is reflected about a side at rest, by axis and whether it is upper.

        Sides that are open, or open on a part, have none.
        """
        return {
            (place.axis, place.upper): tuple(
                1.0 if self._end(place, d) == "N" else -1.0 for d in range(self.grid.dim)
            )
            for place in self.places
            if not place.is_open
        }

    def unknown_faces(self, d: int) -> Slices:
        """Slices of the owned faces of component d that the direct solver solves for."""
        first, last = self.grid.owned[d].start, self.grid.owned[d].stop
        for place in self.places:
            if place.axis == d and place.here:
                solved = isinstance(place.side, Open)
                if place.upper:
                    last += int(solved)
                else:
                    first += int(not solved)
        x, y, z = (slice(first, last) if a == d else s for a, s in enumerate(self.grid.owned))
        return x, y, z

    def opens_upward(self, d: int) -> bool:
        """Whether this rank holds faces of the upper side along axis d that are unknowns."""
        return any(p.axis == d and p.upper and p.here and p.is_open for p in self.places)

    # Velocity ---------------------------------------------------------------------------------------------------

    @property
    def walls_move(self) -> bool:
        """Whether a velocity other than zero is given on any side."""
        walls = (place.side.velocity for place in self.places if isinstance(place.side, Wall))
        return any(callable(velocity) or any(velocity) for velocity in walls)

    def fill(self, u: Faces, *times: float) -> None:
        """Set the boundary faces that are given and the ghost layers beyond each side, in place.

        Args:
            u: Velocity on the faces whose ghost layers from other ranks are filled.
            times: Times of the wall velocities; their mean is used where several are given [s].
        """
        for place in self.places:
            if place.here:
                for d, component in enumerate(u):
                    self._reflect(component, place, d, times)

    def set_faces(self, u: Faces, t: float) -> None:
        """Set the boundary faces alone, which a rank nearby may hold as ghosts: before the ghosts are exchanged."""
        for place in self.places:
            if place.here and not isinstance(place.side, Open):
                self._set_normal(u[place.axis], place, self._velocity(place, place.axis, (t,)))

    def _velocity(self, place: Place, d: int, times: tuple[float, ...]) -> Array | float:
        """Given velocity component on a side, a number or ``(.., 1, ..)`` of local entries [cm/s]."""
        if not isinstance(place.side, Wall):
            return 0.0
        velocity = place.side.velocity
        if not callable(velocity):
            return velocity[d]
        points = list(self.grid.points(d))
        points[place.axis] = self._points(place.axis, place.upper)[place.axis]
        x, y, z = points
        values = [np.asarray(velocity(x, y, z, t)[d], dtype=float) for t in times]
        return sum(values) / len(values)

    def _set_normal(self, q: Array, place: Place, value: Array | float) -> None:
        faces = q[place.at(place.face)]
        np.copyto(faces, np.where(place.open, faces, value))

    def _reflect(self, q: Array, place: Place, d: int, times: tuple[float, ...]) -> None:
        normal = d == place.axis
        value = self._velocity(place, d, times)
        if normal:
            self._set_normal(q, place, value)
            even = place.open
        else:
            even = isinstance(place.side, FreeSlip)
        # First place beyond the side and its mirror image: a face away from the side, or half a cell.
        beyond = 1 if place.upper else -1
        if normal:
            outside, inside = place.face + beyond, place.face - beyond
        else:
            outside, inside = place.outside, place.inside
        while 0 <= outside < q.shape[place.axis]:
            image = q[place.at(inside)]
            if even is True:
                q[place.at(outside)] = image
            elif even is False:
                q[place.at(outside)] = 2.0 * value - image
            else:
                q[place.at(outside)] = np.where(even, image, -image)
            outside, inside = outside + beyond, inside - beyond

    # Pressure ---------------------------------------------------------------------------------------------------

    def fill_pressure(
        self, p: Array, u: Faces, rho: float, t: float, pressures: Mapping[str, float] | None = None
    ) -> None:
        """Set the layer of the pressure beyond each open side, in place.

        Args:
            p: Pressure [dyn/cm^2].
            u: Velocity, for what flows in [cm/s].
            rho: Density [g/cm^3].
            t: Time of the given pressures [s].
            pressures: Pressure by name of the side, in place of its own [dyn/cm^2].

        Note:
            Collective.
        """
        for place, value in self._side_pressures(u, rho, t, pressures):
            p[place.at(place.outside)] = 2.0 * value - p[place.at(place.inside)]

    def _side_pressures(
        self, u: Faces, rho: float, t: float, pressures: Mapping[str, float] | None
    ) -> list[tuple[Place, Array | float]]:
        """Each open side of this rank and its pressure, a number or ``(.., 1, ..)`` [dyn/cm^2]. Collective."""
        given_back, found = self._mean_losses(u, rho), []
        for place in self.places:
            if place.is_open and place.here:
                given = (pressures or {}).get(place.name, place.opening.pressure)
                value = given(*self._points(place.axis, place.upper), t) if callable(given) else given
                found.append((place, value - place.loss(u, rho) + given_back.get(place.name, 0.0)))
        return found

    def _mean_losses(self, u: Faces, rho: float) -> dict[str, float]:
        """Mean over the open part of what is lost, for sides whose pressure is a mean [dyn/cm^2]. Collective."""
        places = [p for p in self.places if p.is_open and p.opening.mean_pressure]
        if not places:
            return {}
        sums = [
            (self._integral(place, place.loss(u, rho)), self._integral(place, np.multiply(1.0, place.open)))
            for place in places
        ]
        lost, area = self.grid.comm.allreduce(np.array(sums)).T
        return dict(zip((place.name for place in places), (lost / area).tolist(), strict=True))

    def extend_pressure(
        self, p: Array, u: Faces, rho: float, t: float, pressures: Mapping[str, float] | None = None
    ) -> list[tuple[Place, Array]]:
        """Extend the pressure linearly beyond each open side, in place, and return what is missing to the given one.

        The projection adds what is missing. Were it put into the old pressure, a layer of its own would jump at the
        side, and viscosity would spread the jump.

        Args:
            p: Pressure of the step before [dyn/cm^2].
            u: Velocity, for what flows in [cm/s].
            rho: Density [g/cm^3].
            t: Time of the given pressures [s].
            pressures: Pressure by name of the side, in place of its own [dyn/cm^2].

        Returns:
            Each open side that this rank touches, with the given pressure less the extended one, zero on walls.

        Note:
            Collective.
        """
        missing = []
        for place, value in self._side_pressures(u, rho, t, pressures):
            inward = -1 if place.upper else 1
            widths, gaps = self.grid.widths[place.axis], self.grid.gaps[place.axis]
            first, second = p[place.at(place.inside)], p[place.at(place.inside + inward)]
            gap = gaps[place.inside + (1 if inward > 0 else 0)]
            side = first + (first - second) * (0.5 * widths[place.inside] / gap)
            p[place.at(place.outside)] = 2.0 * side - first
            missing.append((place, np.where(place.open, value - side, 0.0)))
        return missing

    def subtract_given(self, r: Array, missing: list[tuple[Place, Array]]) -> None:
        """Subtract from the right-hand side on owned cells what given values on open sides add to lap phi, in place."""
        for place, value in missing:
            cells = [slice(None)] * 3
            cells[place.axis] = slice(-1, None) if place.upper else slice(0, 1)
            owned = [slice(0, 1) if a == place.axis else s for a, s in enumerate(self.grid.owned)]
            width = self.grid.widths[place.axis][place.inside]
            r[tuple(cells)] -= 2.0 / width**2 * value[tuple(owned)]

    def fill_correction(self, phi: Array, missing: list[tuple[Place, Array]] | None = None) -> None:
        """Set the layer of a correction of the pressure beyond each open side, given there or zero.

        Args:
            phi: Correction of the pressure; changed in place [dyn/cm^2].
            missing: Its values on open sides, from `extend_pressure` [dyn/cm^2].
        """
        values = {place.name: value for place, value in missing or ()}
        for place in self.places:
            if place.is_open and place.here:
                phi[place.at(place.outside)] = 2.0 * values.get(place.name, 0.0) - phi[place.at(place.inside)]

    def clear_open_faces(self, N: Faces) -> None:
        """Set the advection term on open faces to zero, in place.

        There u_n has no normal derivative and the velocity along the side is zero, so that div(u u) has no
        normal part.
        """
        for place in self.places:
            if place.is_open and place.here:
                N[place.axis][place.at(place.face)] = 0.0

    def outflow(self, u: Faces, name: str) -> float:
        """Return the flow out of the box through a side, integral of u_n dA [cm^3/s] (collective)."""
        place = self.place(name)
        local = self._integral(place, u[place.axis][place.at(place.face)]) * (1.0 if place.upper else -1.0)
        return self.grid.comm.allreduce(local)

    def power(
        self, u: Faces, p: Array, rho: float, t: float, pressures: Mapping[str, float] | None = None
    ) -> dict[str, tuple[float, float]]:
        """Return what comes in through each side where fluid passes: power of the pressure, and kinetic energy [erg/s].

        Args:
            u: Velocity with filled ghosts [cm/s].
            p: Pressure with filled ghosts, for sides with a given velocity [dyn/cm^2].
            rho: Density [g/cm^3].
            t: Time of the given pressures [s].
            pressures: Pressure by name of the side, in place of its own [dyn/cm^2].

        Note:
            Collective. On an open side the velocity along it is zero.
        """
        local = {place.name: np.zeros(2) for place in self.places if not isinstance(place.side, FreeSlip)}
        on_sides = {place.name: value for place, value in self._side_pressures(u, rho, t, pressures)}
        for place in self.places:
            if place.name in local and place.here:
                inward = u[place.axis][place.at(place.face)] * (-1.0 if place.upper else 1.0)
                side = on_sides.get(place.name, p[place.at(place.inside)])
                energy = 0.5 * rho * inward**2
                local[place.name] += [self._integral(place, e * inward) for e in (side, energy)]
        return {name: tuple(self.grid.comm.allreduce(values)) for name, values in local.items()}

    def _integral(self, place: Place, values: ArrayLike) -> float:
        """Integral over this rank's part of a side of ``(.., 1, ..)`` local entries."""
        if not place.here:
            return 0.0
        grid = self.grid
        shape = [1 if a == place.axis else grid.shape[a] for a in range(3)]
        owned = tuple(slice(0, 1) if a == place.axis else grid.owned[a] for a in range(3))
        return float((np.broadcast_to(values, shape)[owned] * self._areas[place.axis]).sum())

    @cached_property
    def _areas(self) -> list[Array]:
        """Areas of this rank's faces normal to each axis on a side [cm^2]."""
        x, y, z = (w[own] for w, own in zip(self.grid.widths, self.grid.owned, strict=True))
        widths = x[:, None, None], y[None, :, None], z[None, None, :]
        return [widths[(a + 1) % 3] * widths[(a + 2) % 3] for a in range(3)]
