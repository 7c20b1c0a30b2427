"""A state of one run as the beginning of another, on another grid and other meshes of the same bodies."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from valvefsi.errors import CaseError
from valvefsi.fsi import Model, State
from valvefsi.grid import MacGrid
from valvefsi.types import Array


def regridded(coarse: Model, state: State, fine: Model, dt: float) -> State:
    """Return a state of another model of the same bodies and circuits.

    Velocity and pressure are interpolated linearly, the velocity is made solenoidal again; elastic bodies take over
    their displacements, rigid ones begin unloaded; the history of the advection term begins anew.

    Args:
        coarse: The model that the state is of, whole on this rank.
        state: Its state.
        fine: The model to go on with.
        dt: Length of the next step [s].

    Returns:
        The state at the same time, its steps counted from 0.

    Raises:
        CaseError: Boxes, bodies or circuits differ.

    Note:
        Collective over the ranks of ``fine``.
    """
    _check(coarse, fine)
    u = fine.grid.zero_faces()
    for d, component in enumerate(u):
        component[fine.grid.owned_faces(d)] = _interpolated(coarse.grid, state.u[d], fine.grid, d)
    u = fine.fluid.project(u, state.t)
    p = fine.grid.zeros()
    p[fine.grid.owned] = _interpolated(coarse.grid, state.p, fine.grid, None)
    fine.grid.exchange((p,), width=1)
    pairs = zip(fine.bodies, coarse.bodies, state.bodies, strict=True)
    return State(
        t=state.t,
        step=0,
        dt=dt,
        u=u,
        p=p,
        N=fine.fluid.advection(u),
        bodies=tuple(body.continued(other, q, u) for body, other, q in pairs),
        circuits=state.circuits.copy(),
        given=np.zeros((len(fine.bodies), 4)),
    )


def _check(coarse: Model, fine: Model) -> None:
    """Refuse what is not the same bodies in the same box with the same circuits."""
    names = [[body.name for body in model.bodies] for model in (coarse, fine)]
    if names[0] != names[1]:
        message = f"that run has the bodies {', '.join(names[0])}, this one {', '.join(names[1])}"
        raise CaseError(message, key="start.run")
    if len(coarse.circulation.start) != len(fine.circulation.start):
        raise CaseError("that run has other circuits", key="start.run")
    a, b = coarse.grid, fine.grid
    if not (np.allclose(a.lower, b.lower) and np.allclose(a.upper, b.upper) and a.periodic == b.periodic):
        raise CaseError(
            f"that run has another box, {a.lower} to {a.upper} cm against {b.lower} to {b.upper} cm",
            key="start.run",
        )


def _interpolated(old: MacGrid, values: Array, new: MacGrid, d: int | None) -> Array:
    """Return values of the cells, or of the faces of component d, at the owned ones of another grid."""
    there, here = ((g.owned if d is None else g.owned_faces(d)) for g in (old, new))
    axes, places = [], []
    for axis in range(3):
        axes.append(old.coordinates(axis, on_faces=axis == d)[there[axis]])
        places.append(new.coordinates(axis, on_faces=axis == d)[here[axis]])
    flat = [axis for axis in range(3) if len(axes[axis]) == 1]
    data = values[there].squeeze(tuple(flat))
    bent = [axis for axis in range(3) if axis not in flat]
    field = RegularGridInterpolator([axes[axis] for axis in bent], data, bounds_error=False, fill_value=None)
    found = field(tuple(np.meshgrid(*(places[axis] for axis in bent), indexing="ij")))
    return np.expand_dims(found, tuple(flat))
