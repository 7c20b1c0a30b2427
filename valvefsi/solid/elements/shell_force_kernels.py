"""Elastic forces of incompressible solid-shell elements: the kinematics by hand, the energies called point by point.

What is derived of an energy is compiled by FFCx for one point, ``f(out, inputs, constants)``, and comes here as the
address of that function. The sums of `valvefsi.solid.elements.shell_kinematics` are written out here, because DOLFINx
would work out the rate of each strain by each of an element's 21 unknowns anew.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

Array = np.ndarray
kernel = numba.njit(cache=True, fastmath={"contract", "nsz"}, error_model="numpy")
inlined = numba.njit(cache=True, forceinline=True, fastmath={"contract", "nsz"}, error_model="numpy")

SIDE = 1.0 / np.sqrt(3.0)
"""Place of the columns of points, +- SIDE along both edges, the second edge fastest."""

ZERO = (0.0, 0.0, 0.0)
Vector = tuple[float, float, float]
Monomials = tuple[Vector, Vector, Vector, Vector, Vector, Vector, Vector]

POINTER = types.CPointer(types.float64)


@intrinsic
def place(typing: Any, array: Any, offset: Any) -> tuple[Any, Any]:
    """Pointer to an entry of a flat array."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        made = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.gep(made.data, [arguments[1]])

    return POINTER(array, types.intp), code


@intrinsic
def call(typing: Any, address: Any, out: Any, inputs: Any, constants: Any) -> tuple[Any, Any]:
    """Call a function that FFCx has compiled; of a single point it reads neither coordinates nor numbers of a cell."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        real, byte, number = (t.as_pointer() for t in (ir.DoubleType(), ir.IntType(8), ir.IntType(32)))
        kinds = (real, real, real, real, number, byte, byte)
        function = ir.FunctionType(ir.VoidType(), kinds).as_pointer()
        nothing = [ir.Constant(kind, None) for kind in kinds[3:]]
        builder.call(builder.inttoptr(arguments[0], function), [*arguments[1:], *nothing])
        return context.get_dummy_value()

    return types.void(types.uint64, POINTER, POINTER, POINTER), code


# Vectors are tuples of three numbers, which stay in registers: with arrays the loop takes a seventh longer.
@inlined
def vector(m: Array, c: int, i: int) -> Vector:
    """One of the vectors of a cell."""
    return m[c, i, 0], m[c, i, 1], m[c, i, 2]


@inlined
def vectors(m: Array, c: int) -> Monomials:
    """The vectors x_1, x_2, x_3, x_12, x_13, x_23 and x_123 of a cell."""
    first = vector(m, c, 0), vector(m, c, 1), vector(m, c, 2), vector(m, c, 3)
    return (*first, vector(m, c, 4), vector(m, c, 5), vector(m, c, 6))


@inlined
def plus(a: Vector, k: float, b: Vector) -> Vector:
    """Return a + k b."""
    return a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]


@inlined
def both(k: float, a: Vector, s: float, b: Vector) -> Vector:
    """Return k a + s b."""
    return k * a[0] + s * b[0], k * a[1] + s * b[1], k * a[2] + s * b[2]


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def subtract(r: Array, c: int, i: int, a: Vector) -> None:
    """Subtract a vector from one of a cell."""
    r[c, i, 0] -= a[0]
    r[c, i, 1] -= a[1]
    r[c, i, 2] -= a[2]


# g_1 = x_1 + eta x_12 + zeta h_1,  h_1 = x_13 + eta x_123,  g_2 = x_2 + xi x_12 + zeta h_2,  h_2 = x_23 + xi x_123,
# g_3 = x_3 + xi x_13 + eta h_2
@inlined
def middle_vectors(x: Monomials, xi: float, eta: float) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Vectors g_1, g_2, g_3 of the middle of a column, h_1 and h_2."""
    x1, x2, x3, x12, x13, x23, x123 = x
    h1, h2 = plus(x13, eta, x123), plus(x23, xi, x123)
    return plus(x1, eta, x12), plus(x2, xi, x12), plus(plus(x3, xi, x13), eta, h2), h1, h2


@inlined
def volume_density(x: Monomials, xi: float, eta: float) -> float:
    """Return g_1 x g_2 . g_3 in the middle of a column."""
    g1, g2, g3, _, _ = middle_vectors(x, xi, eta)
    return dot(cross(g1, g2), g3)


# c_33 = (V^2 + c_11 c_23^2 - 2 c_12 c_13 c_23 + c_22 c_13^2) / A,  A = c_11 c_22 - c_12^2,
# A dc_33 = (c_23^2 - c_33 c_22) dc_11 + (c_13^2 - c_33 c_11) dc_22 + 2 (c_33 c_12 - c_13 c_23) dc_12
#           + 2 (c_22 c_13 - c_12 c_23) dc_13 + 2 (c_11 c_23 - c_12 c_13) dc_23
@inlined
def layer_forces(
    g1: Vector,
    g2: Vector,
    c13: float,
    c23: float,
    squared: float,
    w: float,
    inputs: Array,
    k: int,
    start: int,
    energy: int,
    constants: Array,
    S: Array,
) -> tuple[Vector, Vector, float, float]:
    """Work on g_1 and g_2 at a point, and the stresses that work on c_13 and c_23."""
    c11, c22, c12 = dot(g1, g1), dot(g2, g2), dot(g1, g2)
    inverse = 1.0 / (c11 * c22 - c12 * c12)
    c33 = inverse * (squared + c11 * c23 * c23 - 2.0 * c12 * c13 * c23 + c22 * c13 * c13)
    inputs[k], inputs[k + 1], inputs[k + 2] = c11, c22, c33
    inputs[k + 3], inputs[k + 4], inputs[k + 5] = c12, c13, c23
    S[:] = 0.0
    call(energy, place(S, 0), place(inputs, k + start), place(constants, 0))
    s33 = w * inverse * S[2]
    s11 = 2.0 * (w * S[0] + s33 * (c23 * c23 - c33 * c22))
    s22 = 2.0 * (w * S[1] + s33 * (c13 * c13 - c33 * c11))
    s12 = w * S[3] + 2.0 * s33 * (c33 * c12 - c13 * c23)
    s13 = w * S[4] + 2.0 * s33 * (c22 * c13 - c12 * c23)
    s23 = w * S[5] + 2.0 * s33 * (c11 * c23 - c12 * c13)
    return both(s11, g1, s12, g2), both(s22, g2, s12, g1), s13, s23


# c_13 = x_1 . x_3 + x_12 . x_23 + eta (x_1 . x_23 + x_12 . x_3),
# c_23 = x_2 . x_3 + x_12 . x_13 + xi (x_2 . x_13 + x_12 . x_3)
@inlined
def assumed_shear(x: Monomials, xi: float, eta: float) -> tuple[float, float]:
    """Return c_13 and c_23."""
    x1, x2, x3, x12, x13, x23, _ = x
    twist = dot(x12, x3)
    c13 = dot(x1, x3) + dot(x12, x23) + eta * (dot(x1, x23) + twist)
    return c13, dot(x2, x3) + dot(x12, x13) + xi * (dot(x2, x13) + twist)


@inlined
def subtract_shear(r: Array, c: int, x: Monomials, s13: float, s23: float, xi: float, eta: float) -> None:
    """Subtract what the stresses do on the monomials in c_13 and c_23."""
    x1, x2, x3, x12, x13, x23, _ = x
    subtract(r, c, 0, both(s13, x3, s13 * eta, x23))
    subtract(r, c, 1, both(s23, x3, s23 * xi, x13))
    subtract(r, c, 2, plus(both(s13, x1, s23, x2), s13 * eta + s23 * xi, x12))
    subtract(r, c, 3, plus(both(s13, x23, s23, x13), s13 * eta + s23 * xi, x3))
    subtract(r, c, 4, both(s23, x12, s23 * xi, x2))
    subtract(r, c, 5, both(s13, x12, s13 * eta, x1))


@inlined
def subtract_work(
    r: Array, c: int, f: tuple[Vector, Vector, Vector, Vector, Vector], xi: float, eta: float
) -> None:
    """Subtract what f on g_1, g_2, g_3, h_1 and h_2 does on the monomials."""
    f1, f2, f3, k1, k2 = f
    subtract(r, c, 0, f1)
    subtract(r, c, 1, f2)
    subtract(r, c, 2, f3)
    subtract(r, c, 3, both(eta, f1, xi, f2))
    subtract(r, c, 4, plus(k1, xi, f3))
    subtract(r, c, 5, plus(k2, eta, f3))
    subtract(r, c, 6, plus(both(eta, k1, xi, k2), xi * eta, f3))


@inlined
def pressure(function: int, constants: Array, J: float, scratch: Array) -> float:
    """Derivative of a volumetric energy at J; 0 without one."""
    if function == 0:
        return 0.0
    scratch[0], scratch[1] = J, 0.0
    call(function, place(scratch, 1), place(scratch, 0), place(constants, 0))
    return scratch[1]


# r = -dE/dm,  E = sum_points w |V| W(c) + sum_columns 2 |V| U_1(v / V) + |sum 2 V| U_2(sum v / sum V)
@kernel
def forces(
    out: Array,
    m: Array,
    inputs: Array,
    start: int,
    of_rest: Array,
    volumes: Array,
    places: Array,
    functions: tuple[int, int, int],
    constants: tuple[Array, Array, Array],
    factor: float,
) -> None:
    """Forces on the monomials, ``out (num_cells, 7, 3)``, of ``m`` of the same shape.

    A point's ``inputs``, flat, begin with the metric, which is set here: 11, 22, 33, 12, 13, 23; its function reads
    from entry ``start`` on. ``of_rest (num_cells, 4, points, 4)`` is V^2, w |V| and what c_13 and c_23 are short of,
    ``volumes (num_cells, 4)`` V in the middles of the columns and ``places`` zeta. The functions are those of W, U_1
    and U_2; ``factor`` multiplies the last.
    """
    S, v, scratch = np.empty(6), np.empty(4), np.empty(2)
    energy, column, mean = functions
    of_material, of_columns, of_mean = constants
    width = inputs.size // (4 * places.size * m.shape[0])
    for c in range(m.shape[0]):
        x = vectors(m, c)
        out[c] = 0.0
        volume, rest = 0.0, 0.0
        for q in range(4):
            v[q] = volume_density(x, SIDE if q > 1 else -SIDE, SIDE if q & 1 else -SIDE)
            volume += v[q]
            rest += volumes[c, q]
        p2 = factor * pressure(mean, of_mean, volume / rest, scratch)
        for q in range(4):
            xi, eta = (SIDE if q > 1 else -SIDE), (SIDE if q & 1 else -SIDE)
            g1, g2, g3, h1, h2 = middle_vectors(x, xi, eta)
            p = p2 + pressure(column, of_columns, v[q] / volumes[c, q], scratch)
            p = 2.0 * p if rest > 0.0 else -2.0 * p
            f1, f2, f3 = (
                plus(ZERO, p, cross(g2, g3)),
                plus(ZERO, p, cross(g3, g1)),
                plus(ZERO, p, cross(g1, g2)),
            )
            k1, k2, s13, s23 = ZERO, ZERO, 0.0, 0.0
            c13, c23 = assumed_shear(x, xi, eta)
            for z in range(places.size):
                zeta = places[z]
                n = ((4 * c + q) * places.size + z) * width
                a, b, t13, t23 = layer_forces(
                    plus(g1, zeta, h1),
                    plus(g2, zeta, h2),
                    c13 + of_rest[c, q, z, 2],
                    c23 + of_rest[c, q, z, 3],
                    of_rest[c, q, z, 0],
                    of_rest[c, q, z, 1],
                    inputs,
                    n,
                    start,
                    energy,
                    of_material,
                    S,
                )
                f1, f2, k1, k2 = plus(f1, 1.0, a), plus(f2, 1.0, b), plus(k1, zeta, a), plus(k2, zeta, b)
                s13, s23 = s13 + t13, s23 + t23
            subtract_work(out, c, (f1, f2, f3, k1, k2), xi, eta)
            subtract_shear(out, c, x, s13, s23, xi, eta)
