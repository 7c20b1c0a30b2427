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

A run measures again and again, and what limits it moves slowly: it starts from the mode that it found before, with a
part of all others so that one that has grown is seen, and stops as soon as the residual is small, mostly after two
products. It measures anew when a solid's stored energy, which its stiffness follows, has changed by a part of itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.fsi import Model, State
from valvefsi.grid import Array

if TYPE_CHECKING:
    from valvefsi.bodies.body import SmallMotion

PRODUCTS = 24
"""Most products of the Lanczos method from a displacement in every mode: to far below a per cent."""
TRACKED_PRODUCTS = 8
"""Most products of a measurement during a run."""
RESIDUAL = 0.05
"""Residual of a mode, as a part of its eigenvalue, at which a measurement during a run stops."""
OTHERS = 0.3
"""Part of all modes that is added to the one found before, in the product of the stiffness."""
NUDGE = 1e-5
"""Size of the displacement that the stiffness is differenced with, in spacings."""
CHANGE = 0.2
"""Relative change of the energy stored in a solid after which the stable step is measured anew."""
FAINT = 1e-4
"""Energy stored in a solid that is no load on it, as a part of its shear modulus times its volume."""
NO_MODE: Array = np.zeros((0, 3))
"""Of a rigid body."""

Unit = tuple[Array, Array]
"""A displacement, and the stiffness times it."""
Operator = Callable[[Array], Array]
Products = Callable[[Array, Sequence[Array]], Array]
"""Sums over all ranks of the products of a displacement with each of some forces, ``(k,)``."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """The stable step where the bodies are.

    Attributes:
        limit: The largest stable step for all of them, infinite without any [s].
        modes: What limits each body, a displacement of its points ``(n, 3)``; empty for a rigid one.
        energies: Energy stored in each body there [erg].
    """

    limit: float
    modes: tuple[Array, ...]
    energies: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Mode:
    """The mode of a product M K with the largest eigenvalue.

    Attributes:
        value: The eigenvalue.
        vector: The mode, of length 1 in the product of K.
        residual: Length of M K v - value v, as a part of the value.
    """

    value: float
    vector: Array
    residual: float


def stable_step(model: Model, state: State, dt: float) -> Measurement:
    """Return the largest stable step for all bodies where they are now, from the modes that were last found.

    Args:
        model: The model.
        state: The state.
        dt: The step in question [s].

    Note:
        Collective. Costs two products as a rule, up to eight where the mode is new; each is a solve of the fluid and
        two evaluations of the force, as many as the measurement needs twice more to begin with.
    """
    limits, modes = [], []
    for k, body in enumerate(model.bodies):
        before = state.modes[k] if state.modes else np.zeros_like(body.X)
        limit, mode = _body_limit(model, dt, k, at=state, before=before)
        limits.append(limit)
        modes.append(NO_MODE if body.solid is None else before if mode is None else mode.vector)
    limit = min(limits, default=math.inf)
    return Measurement(limit=limit, modes=tuple(modes), energies=stored_energies(model, state))


def stored_energies(model: Model, state: State) -> tuple[float, ...]:
    """Return the energy stored in each deformable body, 0 for others [erg] (collective)."""
    return tuple(
        body.stored(q) if body.solid is not None else 0.0
        for body, q in zip(model.bodies, state.bodies, strict=True)
    )


def has_changed(model: Model, state: State, spare: float = 1.0) -> bool:
    """Return whether a body has stored or given off so much energy that the stable step is another (collective).

    Args:
        model: The model.
        state: The state.
        spare: Stable step when it was last measured, less its reserve, as a part of the longest that is taken. Above 1
            steps grow no longer with it, and a load matters once it takes the rest: stiffness and the stored energy
            are as the inverse square of the stable step.
    """
    faint = (
        0.0 if body.solid is None else FAINT * body.solid.material.shear_modulus * body.solid.reference_volume
        for body in model.bodies
    )
    for now, then, least in zip(stored_energies(model, state), state.energies, faint, strict=True):
        change = (now - then) / max(then, least, 1e-300)
        if change > CHANGE * max(1.0, spare) ** 2 or (spare <= 1.0 and change < -CHANGE):
            return True
    return False


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
    return _body_limit(model, dt, number, at=at, products=products)[0]


def _body_limit(
    model: Model,
    dt: float,
    number: int,
    *,
    at: State | None,
    before: Array | None = None,
    products: int = PRODUCTS,
) -> tuple[float, Mode | None]:
    """Return the largest stable step for a body [s] and what limits it; track the mode found before, where given."""
    grid = model.grid
    nudge = NUDGE * float(min(grid.spacing[: grid.dim]))
    q, t = (None, 0.0) if at is None else (at.bodies[number], at.t)
    body = model.bodies[number].small_motion(q, t, dt, nudge)
    if body is None:
        return math.inf, None

    def inner(a: Array, others: Sequence[Array]) -> Array:
        sums: Array = grid.comm.allreduce(np.array([np.vdot(a, b) for b in others]))
        return sums

    K, M = body.stiffness, _mobility(model, body, dt)
    start = _unit(body.start, K, inner)
    if start is None:
        return math.inf, None
    if before is None:
        mode = _largest_mode(K, M, inner, start, products)
    else:
        start = _with_others(_unit(before, K, inner), start, inner)
        mode = _largest_mode(K, M, inner, start, TRACKED_PRODUCTS, RESIDUAL)
    return 2.0 * math.sqrt(body.reserve / mode.value) if mode.value > 0.0 else math.inf, mode


def _mobility(model: Model, body: SmallMotion, dt: float) -> Operator:
    """Return the product M F: acceleration of the points by the fluid, and slip, under forces F."""
    grid, boundary = model.grid, model.fluid.boundary
    calm = {place.name: 0.0 for place in boundary.places if place.is_open}
    rest, none = model.fluid.fill(grid.zero_faces(), 0.0), grid.zero_faces()

    def velocity(F: Array | None) -> Array:
        f = grid.zero_faces()
        if F is not None:
            body.transfer.spread(F, out=f)
        u, _ = model.fluid.step(rest, grid.zeros(), (none, none, 1.0), f, 0.0, dt, calm)
        return body.transfer.interpolate(u)

    base = velocity(None) if boundary.walls_move else 0.0

    def mobility(F: Array) -> Array:
        return (velocity(F) - base) / dt + body.slip(F)

    return mobility


def _with_others(known: Unit | None, others: Unit, inner: Products) -> Unit:
    """Return the displacement to begin with: a mode that is known and a part of all others, which may have grown.

    Where a solid that is compressed gives way, their sum can have no stiffness: then the others alone.
    """
    if known is None:
        return others
    v, Kv = (a + OTHERS * b for a, b in zip(known, others, strict=True))
    (square,) = inner(v, [Kv])
    return (v / math.sqrt(square), Kv / math.sqrt(square)) if square > 0.0 else others


def _unit(v: Array, K: Operator, inner: Products) -> Unit | None:
    """Return a displacement of length 1 in the product of K, and K times it; None for one without stiffness."""
    Kv = K(v)
    (square,) = inner(v, [Kv])
    if not square > 0.0:
        return None
    return v / math.sqrt(square), Kv / math.sqrt(square)


def _largest_mode(
    K: Operator,
    M: Operator,
    inner: Products,
    start: Unit,
    products: int = PRODUCTS,
    residual: float = 0.0,
) -> Mode:
    """Return the mode of the largest eigenvalue of M K for symmetric K and M that are not negative.

    By Lanczos in the product of K, orthogonal to all vectors before. A first product is never enough: a mode that has
    grown shows in the second.

    Args:
        K: Stiffness.
        M: Mobility.
        inner: Products of vectors.
        start: Displacement to begin with, and K times it.
        products: Most products of M.
        residual: Residual at which it stops.
    """
    V, KV = [start[0]], [start[1]]
    T, value, shares, rest = np.zeros((products, products)), 0.0, np.ones(1), math.inf
    for n in range(1, products + 1):
        w = M(KV[-1])
        parts = inner(w, KV)
        T[n - 1, :n] = T[:n, n - 1] = parts
        values, vectors = np.linalg.eigh(T[:n, :n])
        value, shares = float(values[-1]), vectors[:, -1]
        if n == products:
            break
        for _ in range(2):  # the second time takes what round-off of the first has left
            w = w - sum(part * v for part, v in zip(parts, V, strict=True))
            parts = inner(w, KV)
        Kw = K(w)
        (square,) = inner(w, [Kw])
        if not square > 1e-20 * value**2:
            rest = 0.0
            break
        rest = math.sqrt(square) * abs(shares[-1]) / value
        if n > 1 and rest < residual:
            break
        V.append(w / math.sqrt(square))
        KV.append(Kw / math.sqrt(square))
    vector: Array = np.tensordot(shares, np.array(V), axes=1)
    return Mode(value=value, vector=vector, residual=rest)
