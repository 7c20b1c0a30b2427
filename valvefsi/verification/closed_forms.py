"""Closed forms, and ordinary differential equations, that runs are compared with: flows, thick shells, a beam."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import jn_zeros

Array = NDArray[np.float64]
FINAL = 5.783185962946785
"""Square of the first zero of J_0: R^2 / (FINAL nu) is the time in which the flow in a tube settles."""
TIMES = 60
"""Terms of the series."""


def poiseuille(y: Array, mu: float) -> Array:
    """Return the velocity at heights y in a plane channel of height 1, density and gradient of the pressure 1.

        u = y (1 - y) / (2 mu)

    Args:
        y: Heights, of any shape.
        mu: Viscosity.
    """
    return y * (1.0 - y) / (2.0 * mu)


def womersley(y: Array, t: float, number: float, mu: float) -> Array:
    """Return the velocity at heights y in that channel, the gradient of the pressure cos(w t) (Womersley 1955).

        u = Re{1 / (i w) [1 - cosh(k (y - 1/2)) / cosh(k / 2)] exp(i w t)},  k^2 = i w / mu

    Args:
        y: Heights, of any shape.
        t: Time.
        number: 1/2 sqrt(w / mu), half a height over the layer.
        mu: Viscosity.
    """
    w = mu * (2.0 * number) ** 2
    k = np.sqrt(1j * w / mu)
    profile = (1.0 - np.cosh(k * (y - 0.5)) / np.cosh(0.5 * k)) / (1j * w)
    return np.real(profile * np.exp(1j * w * t))


def start_up(t: Array, relaxation: float) -> Array:
    """Return the flow in a tube over the final one at times after a constant force begins (Szymanski 1932).

        Q(t) / Q_final = 1 - sum_k 32 / z_k^4 exp(-z_k^2 nu t / R^2),  z_k the zeros of J_0

    Args:
        t: Times, of any shape [s].
        relaxation: R^2 / (5.78 nu) [s].
    """
    z = _zeros()
    decay = np.exp(-np.multiply.outer(np.asarray(t, dtype=float), z**2) / (FINAL * relaxation))
    return 1.0 - decay @ (32.0 / z**4)


@functools.cache
def _zeros() -> Array:
    """Return the zeros of J_0, which take longer than the series."""
    zeros: Array = jn_zeros(0, TIMES)
    return zeros


def cylinder_pressure(growth: float, A: float, B: float) -> float:
    """Return p/c1 of an incompressible neo-Hookean cylinder of shear modulus c1 whose inner radius grows.

        p/c1 = ln(a B / (A b)) + c/2 (1/a^2 - 1/b^2),  r^2 = R^2 + c    (Green and Zerna, Theoretical Elasticity)

    Args:
        growth: By how much, a - A [cm].
        A: Inner radius at rest [cm].
        B: Outer radius at rest [cm].
    """
    a = A + growth
    c = a * a - A * A
    b = math.sqrt(B * B + c)
    return math.log(a * B / (A * b)) + c / 2 * (1 / a**2 - 1 / b**2)


def sphere_pressure(growth: float, A: float, B: float) -> float:
    """Return the same of a sphere, p/c1 = 2/l_b + 1/(2 l_b^4) - 2/l_a - 1/(2 l_a^4), l = r/R, r^3 = R^3 + c."""
    a = A + growth
    b = (B**3 + a**3 - A**3) ** (1 / 3)
    inner, outer = a / A, b / B
    return 2 / outer + 0.5 / outer**4 - 2 / inner - 0.5 / inner**4


def elastica(force: float, length: float, stiffness: float) -> tuple[float, float]:
    """Return how far the end of a clamped beam comes back and sinks under a dead force across it.

        B theta' = M,  M' = -P cos theta,  x' = cos theta,  z' = sin theta

    Args:
        force: Force P [dyn].
        length: Length [cm].
        stiffness: Bending stiffness B [dyn cm^2].
    """

    def end(moment: float) -> Array:
        def rates(_: float, y: Array) -> list[float]:
            return [y[1] / stiffness, -force * math.cos(y[0]), math.cos(y[0]), math.sin(y[0])]

        return np.asarray(solve_ivp(rates, (0, length), [0, moment, 0, 0], rtol=1e-11, atol=1e-12).y[:, -1])

    moment = brentq(lambda M: end(M)[1], 0.0, force * length, xtol=1e-12)
    _, _, x, z = end(moment)
    return length - float(x), float(z)
