"""Closed forms of an immersed plate in plane strain: bent by a uniform load, and waving in a fluid of its density.

An incompressible plate of thickness t and shear modulus G has the bending stiffness D = G t^3 / 3. Held at both ends of
a span L and loaded by q, it yields in its middle by

    w = q L^4 / (384 D) + q L^2 / (8 k_s G t),    k_s = 5/6                          (Timoshenko and Gere 1972)

Its waves exp(i k x + s t) are those of potential theory, omega^2 = D k^4 / (rho (t + 2 / k)), as the waves are long
(k t << 1) and the fluid's Stokes layer sqrt(2 nu / omega) is thin. `immersed_wave` is exact for any of both: solid and
fluid obey the same linear equation

    rho s u = -grad p + eta lap u,  div u = 0,   eta = mu in the fluid, mu + G / s in the plate

whose solutions exp(+-k z), exp(+-l z), l^2 = k^2 + rho s / eta, are joined at the plate's surface. `kernel_wave` is the
same for two rows of points at z = +-t/2 on a grid, forces spread and velocities interpolated by a kernel: what that
adds to plate and fluid is known without a run. Nearly all of it is mass, see `slowing`.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from valvefsi.coupling.kernels import BSPLINE, KERNELS
from valvefsi.errors import ConvergenceError
from valvefsi.types import Array

SHEAR = 5.0 / 6.0
"""Shear correction factor k_s of a rectangular section."""
WAVES = 12
"""Waves of a spacing across the plate up to which a kernel's transform is summed."""


@dataclass(frozen=True, kw_only=True)
class ImmersedPlate:
    """A plate across the middle of a periodic box of fluid.

    Attributes:
        thickness: t [cm].
        length: Span L, or length of the wave [cm].
        height: Of the box, across the plate [cm].
        modulus: Shear modulus G [dyn/cm^2].
        rho: Density of plate and fluid [g/cm^3].
        mu: Viscosity of the fluid [dyn s/cm^2].
    """

    thickness: float
    length: float
    height: float
    modulus: float
    rho: float = 1.0
    mu: float = 0.0

    @property
    def stiffness(self) -> float:
        """Bending stiffness D per width [dyn cm]."""
        return self.modulus * self.thickness**3 / 3.0

    @property
    def wave_number(self) -> float:
        """Wave number k [1/cm]."""
        return 2.0 * math.pi / self.length

    def yielding(self) -> float:
        """Return the deflection of the middle of a span per load, w / q [cm^3/dyn]."""
        shear = 8.0 * SHEAR * self.modulus * self.thickness
        return self.length**4 / (384.0 * self.stiffness) + self.length**2 / shear

    def potential_frequency(self) -> float:
        """Return omega of potential theory [rad/s]."""
        k = self.wave_number
        return math.sqrt(self.stiffness * k**4 / (self.rho * (self.thickness + 2.0 / k)))


def immersed_wave(plate: ImmersedPlate) -> complex:
    """Return s of a wave of an incompressible elastic plate in a viscous fluid, exact in the linear theory [1/s].

    Above the plate u_z is A times a potential flow that is even about the middle between plate and image, and B times
    a Stokes layer; in the plate it is a and b times even functions. Both velocities and both tractions are continuous.
    """
    k, t, rho, mu = plate.wave_number, plate.thickness, plate.rho, plate.mu
    T = math.tanh(0.5 * k * (plate.height - t))
    inside = math.tanh(0.5 * k * t)

    def condition(s: complex) -> complex:
        eta = mu + plate.modulus / s
        fluid, solid = cmath.sqrt(k * k + rho * s / mu), cmath.sqrt(k * k + rho * s / eta)
        steep = cmath.tanh(0.5 * solid * t)
        a = (1.0, k * inside, rho * s / k * inside + 2.0 * eta * k * inside, 2.0 * eta * k * k)
        b = (1.0, solid * steep, 2.0 * eta * solid * steep, eta * (solid**2 + k * k))
        A = (-1.0, k * T, (rho * s / k + 2.0 * mu * k) * T, -2.0 * mu * k * k)
        B = (-1.0, fluid, 2.0 * mu * fluid, -mu * (fluid**2 + k * k))
        trivial = solid**2 - k * k  # a and b are one solution where it vanishes
        return complex(np.linalg.det(np.array([a, b, A, B]).T)) / trivial

    return _root(condition, plate.potential_frequency() * (-0.02 + 0.97j))


def kernel_wave(plate: ImmersedPlate, *, kernel: str, h: float, edge: float) -> complex:
    """Return s of a wave of a plate of two rows of points on a grid, in the mean over its places on the grid [1/s].

    With the grid's symbols k_x = 2 sin(k h / 2) / h and k_z, the flow of a force is (1 - k k / k^2) f / (rho (s + nu
    k^2)); spread and interpolated at the rows it is the mobility Y of w, the mean of u_z, and beta, the difference of
    u_x over t. The plate gives the forces back with D and the shear stiffness G t of its elements.

    Args:
        plate: The plate.
        kernel: Name of a B-spline or a composite one.
        h: Grid spacing [cm].
        edge: Length of the plate's elements [cm].

    Raises:
        ValueError: The kernel is none of B-splines.
    """
    _, own, across = _spline(kernel)
    k, t = plate.wave_number, plate.thickness
    m = _waves(plate.height, h)
    x, z = _hat(np.array(k), h), _hat(m, h)
    kx, kz = 2.0 / h * math.sin(0.5 * k * h), 2.0 / h * np.sin(0.5 * m * h)
    square = kx**2 + kz**2
    w = x**across * z**own * kx * np.cos(0.5 * m * t)
    beta = x**own * z**across * kz * np.sin(0.5 * m * t) * 2.0 / t
    stiffness = _element_stiffness(plate, edge)

    def condition(s: complex) -> complex:
        flow = 1.0 / (square * plate.height * (plate.rho * s + plate.mu * square))
        cross = 1j * np.sum(w * beta * flow)
        Y = np.array([[np.sum(w * w * flow), cross], [-cross, np.sum(beta * beta * flow)]])
        return complex(np.linalg.det(np.eye(2) * s + Y @ stiffness))

    return _root(condition, plate.potential_frequency() * (-0.02 + 0.95j))


@dataclass(frozen=True, kw_only=True)
class Slowing:
    """Factors that the mass of fluid which a kernel adds puts on the frequency of a wave.

    Attributes:
        across: The forces along the normal are smeared across the plate.
        along: They are smeared along it.
        turning: Its sections cannot slip in the fluid that their own kernels stir.
    """

    across: float
    along: float
    turning: float


def slowing(plate: ImmersedPlate, *, kernel: str, h: float) -> Slowing:
    """Return how the fluid that a kernel adds slows a wave, without viscosity, the grid's symbols and shear.

    A force at z moves a fluid without viscosity at z' by k exp(-k |z - z'|) / (2 rho): two rows at +-t/2 move as by a
    mass per area of

        m = 2 rho / (k <exp(-k |Z|)>) = rho (2/k + 2 <|Z|> + ...)

    Z the distance between two points, each in one of the rows at random: <|Z|> = t/2, and the mass is that of the
    plate and of the potential flow on both sides. With a kernel both points are drawn from it, too: <|Z|> grows, by
    0.57 h for `bspline3` and a plate without thickness, by half of that for a thick one. Along the plate the kernel
    divides the mass by its transform squared. The rows turn as the plate does, beta = -w', which stirs the fluid in
    reach of both: with Y_w = 1/m, Y_b and c the mobilities of w, of beta and between both,

        m = (Y_b - 2 k c + k^2 Y_w) / (Y_w Y_b - c^2).

    Args:
        plate: The plate, in its periodic box.
        kernel: Name of a B-spline or a composite one.
        h: Grid spacing [cm].

    Raises:
        ValueError: The kernel is none of B-splines.
    """
    _, own, beside = _spline(kernel)
    k, t, H = plate.wave_number, plate.thickness, plate.height
    m, x = _waves(H, h), float(_hat(np.array(k), h))
    rows = 0.5 + 0.5 * math.cosh(k * (0.5 * H - t)) / math.cosh(0.5 * k * H)
    sharp = 2.0 * math.tanh(0.5 * k * H) / (k * rows)
    flow = 1.0 / ((k * k + m * m) * H)
    w = x**beside * _hat(m, h) ** own * k * np.cos(0.5 * m * t)
    beta = x**own * _hat(m, h) ** beside * m * np.sin(0.5 * m * t) * 2.0 / t
    Y_w, Y_b, c = (float(np.sum(product * flow)) for product in (w * w, beta * beta, w * beta))
    turned = (Y_b - 2.0 * k * c + k * k * Y_w) / (Y_w * Y_b - c * c)
    across = math.sqrt(sharp * Y_w) / x**beside
    return Slowing(across=across, along=x**beside, turning=1.0 / math.sqrt(turned * Y_w))


def _spline(kernel: str) -> tuple[int, int, int]:
    """Return the family and the points of a B-spline along a component and across it."""
    if KERNELS[kernel][0] != BSPLINE:
        raise ValueError(f"the transform is that of B-splines, {kernel} is none")
    return KERNELS[kernel]


def _waves(height: float, h: float) -> Array:
    """Return the wave numbers across the plate [1/cm]."""
    count = math.ceil(WAVES * height / h)
    return 2.0 * math.pi / height * np.arange(-count, count + 1, dtype=np.float64)


def _hat(wave: Array, h: float) -> Array:
    """Transform of the B-spline of one point."""
    return np.sinc(0.5 * wave * h / math.pi).astype(np.float64)


def _element_stiffness(plate: ImmersedPlate, edge: float) -> Array:
    """Return the forces on w and beta per w and beta of linear elements with shear sampled in their middles."""
    k = plate.wave_number
    slope, mean = 2j * math.sin(0.5 * k * edge) / edge, math.cos(0.5 * k * edge)
    shear, bend = np.array([slope, mean]), np.array([0.0, slope])
    stiffness: Array = plate.modulus * plate.thickness * np.outer(shear.conj(), shear)
    return stiffness + plate.stiffness * np.outer(bend.conj(), bend)


def _root(function: Callable[[complex], complex], start: complex) -> complex:
    """Return a root near a start, by the secant method.

    Raises:
        ConvergenceError: There is none near.
    """
    a, b = start, start * (1.0 + 1e-3j)
    fa, fb = function(a), function(b)
    for _ in range(60):
        if fa == fb or abs(b - a) < 1e-7 * abs(b):
            return b
        a, b, fa = b, b - fb * (b - a) / (fb - fa), fb
        fb = function(b)
    raise ConvergenceError(f"plate: no wave near s = {start:.3g}/s")
