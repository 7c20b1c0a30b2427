"""The largest stable step of the explicit coupling, measured on the coupled operator itself.

A small displacement d of a solid's nodes at rest, moving with U, makes the force -K d - C U, which the fluid turns into
an acceleration of the nodes: M times it, spread, projected and interpolated. For one mode, M K = omega^2 and M C = c,
the scheme of `valvefsi.fsi` has the trace 2 - c dt - omega^2 dt^2 and the determinant 1 - c dt; it is stable while

    dt^2 omega^2 + 2 dt c < 4,    that is    dt < 2 / sqrt(largest eigenvalue of M (K + 2 C / dt)),

which the method of Lanczos finds in a few products: M K is self-adjoint in the product x . K y. Nodes that slip through
the fluid with m times their force, m symmetric, add 2 dt s with s = m K to the left side, which is M + 2 m / dt instead
of M; dampers count there too, on the safe side by 4 m C. What a bound for each cause cannot know is in it: the
projection takes away most of what the bulk modulus does, and thin bodies and points much closer than a spacing move
the mass of fluid in their kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from valvefsi.fsi import Model, State
from valvefsi.grid import Array

PRODUCTS = 24
"""Products of the Lanczos method: within a few per cent of the largest eigenvalue."""
NUDGE = 1e-5
"""Size of the displacement that the stiffness is differenced with, in spacings."""


def stable_step(model: Model, state: State, dt: float, products: int = PRODUCTS) -> float:
    """Return the largest stable step for all bodies where they are now, infinite without any [s].

    Args:
        model: The model.
        state: The state.
        dt: The step in question [s].
        products: Products of the Lanczos method.

    Note:
        Collective.
    """
    limits = [measured_limit(model, dt, k, at=state, products=products) for k in range(len(model.bodies))]
    return min(limits, default=math.inf)


def measured_limit(
    model: Model, dt: float, number: int, *, at: State | None = None, products: int = PRODUCTS
) -> float:
    """Return the largest stable step for elastic forces, springs, dampers, slip and excess mass of a body [s].

    Args:
        model: The model.
        dt: The step in question, at which dampers, slip and the fluid's viscosity are taken [s].
        number: Which body.
        at: State in which the body is; at rest without one.
        products: Products of the Lanczos method.

    Returns:
        The limit, above dt where dt is stable and below it where it is not; infinite for a body without
        stiffness and for a rigid one.

    Note:
        Collective. Costs a fluid step and two evaluations of the force a product. A solid that is compressed or
        stretched is stiffer than at rest.
    """
    grid = model.grid
    nudge = NUDGE * float(min(grid.spacing[: grid.dim]))
    q, t = (None, 0.0) if at is None else (at.bodies[number], at.t)
    body = model.bodies[number].small_motion(q, t, dt, nudge)
    if body is None:
        return math.inf
    pressures = model.circulation.pressures(model.circulation.start, 0.0)
    rest, none = model.fluid.fill(grid.zero_faces(), 0.0), grid.zero_faces()

    def velocity(F: Array | None) -> Array:
        f = grid.zero_faces()
        if F is not None:
            body.transfer.spread(F, out=f)
        u, _ = model.fluid.step(rest, grid.zeros(), (none, none, 1.0), f, 0.0, dt, pressures)
        return body.transfer.interpolate(u)

    base = velocity(None)

    def mobility(F: Array) -> Array:
        return (velocity(F) - base) / dt + body.slip(F)

    def dot(a: Array, b: Array) -> float:
        return grid.comm.allreduce(float(np.vdot(a, b)))

    largest = _largest_eigenvalue(body.stiffness, mobility, dot, body.start, products)
    return 2.0 * math.sqrt(body.reserve / largest) if largest > 0.0 else math.inf


def _largest_eigenvalue(
    K: Callable[[Array], Array],
    M: Callable[[Array], Array],
    dot: Callable[[Array, Array], float],
    start: Array,
    products: int = PRODUCTS,
) -> float:
    """Largest eigenvalue of M K for symmetric K and M that are not negative, by Lanczos in the product of K."""
    v = start
    Kv = K(v)
    size = dot(v, Kv)
    if not size > 0.0:
        return 0.0
    v, Kv = v / math.sqrt(size), Kv / math.sqrt(size)
    before = np.zeros_like(v)
    diagonal: list[float] = []
    beside: list[float] = []
    for _ in range(products):
        w = M(Kv)
        diagonal.append(dot(w, Kv))
        if len(diagonal) == products:
            break
        w = w - diagonal[-1] * v - (beside[-1] if beside else 0.0) * before
        Kw = K(w)
        size = dot(w, Kw)
        if not size > 1e-20 * diagonal[-1] ** 2:
            break
        beside.append(math.sqrt(size))
        before, v, Kv = v, w / beside[-1], Kw / beside[-1]
    n = len(diagonal)
    T = np.diag(diagonal) + np.diag(beside[: n - 1], 1) + np.diag(beside[: n - 1], -1)
    return float(np.linalg.eigvalsh(T)[-1])
