"""The names that all parts share: arrays, and what the parts ask of one another.

Nothing is imported from the package here. The parts that never import one another (`valvefsi.fluid`,
`valvefsi.solid`, `valvefsi.coupling`, `valvefsi.circulation`) are handed objects that follow these protocols; whoever
supplies an own solid, coupling, body or circulation writes a class with these attributes and methods.

Shapes: ``n`` is the number of nodes or points of this rank; positions, velocities and forces are ``(n, 3)`` in two
dimensions as well, where the third column is not used and forces are per cm of depth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from dolfinx import fem
    from dolfinx.mesh import Mesh as Cells
    from dolfinx.mesh import MeshTags
    from mpi4py import MPI

Array = NDArray[np.float64]
"""Real numbers; the docstring gives shape and unit."""

Indices = NDArray[np.int64]
"""Numbers of nodes, points, cells or samples."""

Mask = NDArray[np.bool_]
"""Which entries are meant."""

Slices = tuple[slice, slice, slice]
"""A part of a local array."""

Faces = tuple[Array, ...]
"""A field on the faces of the staggered grid: one local array with ghost layers per axis, ``(nx, ny, nz)`` each."""

Table = dict[str, Array]
"""The state of a body by name: ``chi``, with excess mass also ``Y`` and ``V``; ``d`` of rigid surfaces; ``posts``."""

Waveform = Callable[[float], float]
"""A quantity as a function of time [s]."""

Scalar = str | bool | int | float | None
"""A single value of a result, or the cell of a table."""

Unchecked = object
"""What a file or a user gives, before it is read: anything."""

Progress = Callable[[int, float, float, dict[str, float]], None]
"""Called after a step with its number, the time, the end [s], and the newest row of the history."""


Gmsh = Any
"""The gmsh module, or its ``model``: a library without annotations."""


class Grid(Protocol):
    """What is asked of the staggered grid; `valvefsi.grid.MacGrid` is the one there is."""

    @property
    def comm(self) -> MPI.Comm:
        """Communicator that the grid is divided among."""
        ...

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        ...

    @property
    def cells(self) -> tuple[int, ...]:
        """Number of cells along each of three axes."""
        ...

    @property
    def spacing(self) -> Array:
        """Smallest width of a cell along each axis, ``(3,)`` [cm]."""
        ...

    @property
    def lower(self) -> Array:
        """Lower corner of the box, ``(3,)`` [cm]."""
        ...

    @property
    def upper(self) -> Array:
        """Upper corner of the box, ``(3,)`` [cm]."""
        ...

    def zeros(self) -> Array:
        """Return zeros in the cells, a local array with ghosts, ``(nx, ny, nz)``."""
        ...

    def zero_faces(self) -> Faces:
        """Return zeros on the faces, local arrays with ghosts."""
        ...


class Mesh(Protocol):
    """What is asked of the mesh of a solid; `valvefsi.geometry.mesh.SolidMesh` is the one there is."""

    @property
    def mesh(self) -> Cells:
        """DOLFINx mesh of one cell type, coordinates in cm."""
        ...

    @property
    def cell_tags(self) -> MeshTags | None:
        """Tags of the cells, None where there are none."""
        ...

    @property
    def facet_tags(self) -> MeshTags | None:
        """Tags of the facets, None where there are none."""
        ...

    @property
    def names(self) -> Mapping[str, tuple[int, int]]:
        """``{name: (dimension, tag)}`` of the tags."""
        ...

    @property
    def source(self) -> str:
        """Where the mesh comes from, for messages."""
        ...

    @property
    def fibres(self) -> Mapping[str, fem.Function]:
        """Unit vector fields of the reference state by name, functions of ``dim`` components."""
        ...

    @property
    def dim(self) -> int:
        """Number of dimensions, 2 or 3."""
        ...

    def tag(self, name: str) -> tuple[int, int]:
        """Return dimension and number of the tag called ``name``; CaseError where there is none."""
        ...


class Solid(Protocol):
    """What an elastic body asks of a solid; `valvefsi.solid.structure.Structure` is the one there is."""

    @property
    def name(self) -> str:
        """Name in files and messages."""
        ...

    @property
    def X(self) -> Array:
        """Reference positions of this rank's nodes, ``(n, 3)`` [cm]."""
        ...

    @property
    def ids(self) -> Indices:
        """Numbers of this rank's nodes among those of all ranks, ``(n,)``."""
        ...

    @property
    def num_nodes(self) -> int:
        """Number of nodes on all ranks."""
        ...

    @property
    def weights(self) -> Array:
        """Reference volume of this rank's nodes, ``(n,)`` [cm^3]."""
        ...

    @property
    def reference_volume(self) -> float:
        """Reference volume on all ranks [cm^3]."""
        ...

    def force(self, chi: Array, U: Array, t: float) -> Array:
        """Return the forces on the nodes. Collective.

        Args:
            chi: Positions, ``(n, 3)`` [cm].
            U: Velocities, ``(n, 3)`` [cm/s].
            t: Time [s].

        Returns:
            Forces, ``(n, 3)`` [dyn], a new array; NaN where an element is inverted.
        """
        ...


class Transfer(Protocol):
    """Spreading and interpolation for one position of the nodes, each the adjoint of the other."""

    def spread(self, F: Array, out: Faces | None = None) -> Faces:
        """Return the force density on the faces of nodal forces. Collective.

        Args:
            F: Forces of this rank's nodes, ``(n, 3)`` [dyn].
            out: Faces to add to; new ones by default [dyn/cm^3].
        """
        ...

    def interpolate(self, u: Faces) -> Array:
        """Return the velocity of this rank's nodes, ``(n, 3)``, of a velocity on the faces [cm/s]. Collective."""
        ...

    def smooth(self, F: Array) -> Array:
        """Return the force density ``(n, 3)`` [dyn/cm^3] that the nodes feel of their own forces [dyn]. Collective."""
        ...


class Coupling(Protocol):
    """How a solid and the grid see each other: at the nodes, or at quadrature points of the elements."""

    @property
    def grid(self) -> Grid:
        """The grid."""
        ...

    @property
    def name(self) -> str:
        """Name of the kernel."""
        ...

    @property
    def nodal(self) -> bool:
        """Whether the nodes themselves are the points."""
        ...

    @property
    def reach(self) -> float:
        """Half the width of the kernel, in grid spacings."""
        ...

    def at(self, chi: Array) -> Transfer:
        """Prepare the transfer for nodes at chi ``(n, 3)`` [cm]. Collective.

        Raises:
            StabilityError: A node has left the box, or is within the kernel's reach of a side that cannot mirror it.
        """
        ...


class Keeping(Protocol):
    """How points that stay where they are and the grid see each other."""

    @property
    def grid(self) -> Grid:
        """The grid."""
        ...

    def own(self, points: Array) -> Indices:
        """Return the numbers of the points ``(n, 3)`` [cm], the same on all ranks, that this rank keeps."""
        ...

    def stay(self, X: Array) -> Transfer:
        """Prepare the transfer for this rank's points at X ``(n, 3)`` [cm].

        Raises:
            StabilityError: A point lies too near to a side, on the rank of the point.
        """
        ...


class HalfStep(Protocol):
    """A body halfway through a step."""

    @property
    def force(self) -> Array:
        """Forces of the body on the fluid, at its nodes or points, ``(n, 3)`` [dyn]."""
        ...

    def spread(self, f: Faces) -> None:
        """Add these forces to the force density f on the faces [dyn/cm^3]. Collective."""
        ...

    def velocity(self, u_half: Faces) -> Array:
        """Return the velocity of the fluid at its nodes or points, ``(n, 3)`` [cm/s]. Collective.

        Args:
            u_half: Velocity at the middle of the step, the mean of both ends, ghosts filled [cm/s].
        """
        ...

    def whole(self, U: Array) -> Table:
        """Return the body's state after the whole step, carried by that velocity U ``(n, 3)`` [cm/s]."""
        ...


class Body(Protocol):
    """What the coupled step moves and spreads: an elastic body, one with excess mass, a rigid surface."""

    @property
    def name(self) -> str:
        """Name in files and messages."""
        ...

    def start(self, u: Faces) -> Table:
        """Return the state at t = 0 in a fluid with velocity u on the faces, ghosts filled [cm/s]. Collective."""
        ...

    def half(self, q: Table, u: Faces, t: float, dt_old: float, dt: float) -> HalfStep:
        """Move half a step with the velocity that the body feels now, and find its force there.

        Args:
            q: State at t.
            u: Velocity on the faces at t, ghosts filled [cm/s].
            t: Time [s].
            dt_old: Length of the step that ended at t [s].
            dt: Length of this step [s].

        Raises:
            StabilityError: A node has left the box, or is within its kernel's reach of an open side.

        Note:
            Collective.
        """
        ...


class Circulation(Protocol):
    """What the coupled step asks of the circuits that drive and load the fluid."""

    @property
    def sides(self) -> Sequence[str]:
        """Names of the sides of the box whose pressure it gives; none for no circulation."""
        ...

    @property
    def start(self) -> Array:
        """Its state at t = 0, the same on all ranks, ``(num_states,)``."""
        ...

    def pressures(self, y: Array, t: float) -> Mapping[str, float]:
        """Return the pressure on each of its sides for state y ``(num_states,)`` at time t [dyn/cm^2]."""
        ...

    def step(self, y: Array, outflow: Mapping[str, float], t: float, dt: float) -> Array:
        """Return the state at t + dt, ``(num_states,)``.

        Args:
            y: State at t, ``(num_states,)``.
            outflow: Mean flow out of the box through each of its sides [cm^3/s].
            t: Time [s].
            dt: Length of the step [s].
        """
        ...
