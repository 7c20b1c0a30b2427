"""The difference operators of a step on a uniform or a graded staggered grid, over its kernels.

Two classes with the same methods; `make_operators` picks the one for a grid.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from valvefsi.fluid import explicit_kernels, graded_kernels, stencils
from valvefsi.fluid.advection import SCHEMES
from valvefsi.fluid.boundary import Boundary
from valvefsi.grid import MacGrid
from valvefsi.runtime import threads
from valvefsi.types import Array, Faces


class UniformOperators:
    """Flat loops over cells; one number per axis says what the spacing is.

    Args:
        grid: The grid, uniform along every axis.
        boundary: The sides.
        advection: Name of the advection scheme.
    """

    def __init__(self, grid: MacGrid, boundary: Boundary, advection: str) -> None:
        dim, shape = grid.dim, grid.shape
        self.grid, self.scheme = grid, SCHEMES[advection]
        self.inv_h = tuple(float(1.0 / h) for h in grid.spacing[:dim])
        self.strides = (shape[1] * shape[2], shape[2], 1)[:dim]
        first = sum(g * s for g, s in zip(grid.ghosts, self.strides, strict=False))
        last = first + 1 + sum((n - 1) * s for n, s in zip(grid.size, self.strides, strict=False))
        self.cells = (first, last)
        # Entries of a plane of axis 0 from the first owned one to the last.
        self.own = 1 + sum((n - 1) * s for n, s in zip(grid.size[1:], self.strides[1:], strict=False))
        # Faces of an open upper side lie one further on.
        self.faces = [(first, last + s * boundary.opens_upward(d)) for d, s in enumerate(self.strides)]

    def _divide(self, loop: Callable[[int, int], None], bounds: tuple[int, int]) -> None:
        """Run a loop over entries in as many parts as there are threads, whole planes each."""
        threads.divide(loop, *bounds, step=self.strides[0])

    def _zeros_around(self, bounds: tuple[int, int]) -> Array:
        """Return a new array that is zero before and after the entries that a loop writes."""
        out, (first, last) = np.empty(self.grid.shape), bounds
        out.ravel()[:first] = 0.0
        out.ravel()[last:] = 0.0
        return out

    def advection(self, u: Faces) -> Faces:
        """Return div(u u) on the faces inside."""
        flat = tuple(c.ravel() for c in u)
        out = tuple(self._zeros_around(self.cells) for _ in u)
        for d, term in enumerate(c.ravel() for c in out):

            def loop(a: int, b: int, d: int = d, term: Array = term) -> None:
                self.scheme(term, flat[d], flat, d, self.inv_h, self.strides, (a, b, self.own))

            self._divide(loop, self.cells)
        return out

    def subtract_laplacian(self, out: Array, q: Array, d: int, nu: float) -> None:
        """Subtract nu times the second differences of component d."""
        rates = tuple(nu * k * k for k in self.inv_h)
        arrays = out.ravel(), q.ravel(), rates
        self._divide(
            lambda a, b: explicit_kernels.subtract_laplacian(*arrays, (a, b, self.strides)), self.faces[d]
        )

    def momentum(
        self, q: Array, p: Array, terms: Faces, weights: tuple[float, float, float], d: int
    ) -> Array:
        """Return f - grad p - a N - b N_old + mu lap q on the faces of component d; weights are a, b, mu."""
        a, b, mu = weights
        out = np.empty(self.grid.shape)
        arrays = out.ravel(), q.ravel(), p.ravel(), tuple(term.ravel() for term in terms)
        factors = (a, b, self.inv_h[d], tuple(mu * k * k for k in self.inv_h))
        strides = (self.strides[d], self.strides)
        self._divide(lambda i, j: stencils.momentum(*arrays, factors, (i, j, *strides)), self.faces[d])
        return out

    def advance(self, q: Array, p: Array, terms: Faces, weights: tuple[float, float, float], d: int) -> Array:
        """Return q + k (f - grad p) - a N - b N_old on the faces of component d; weights are k, a, b."""
        out = self._zeros_around(self.faces[d])
        arrays = out.ravel(), q.ravel(), p.ravel(), tuple(term.ravel() for term in terms)
        factors = (*weights, self.inv_h[d])
        self._divide(
            lambda i, j: explicit_kernels.advance(*arrays, factors, (i, j, self.strides[d])), self.faces[d]
        )
        return out

    def divergence(self, u: Faces) -> Array:
        """Return the divergence in the owned cells."""
        out = np.empty(self.grid.shape)
        arrays = out.ravel(), tuple(c.ravel() for c in u), self.inv_h, self.strides
        self._divide(lambda a, b: stencils.divergence(*arrays, (a, b)), self.cells)
        return out

    def subtract_gradient(self, u: Faces, phi: Array, factor: float) -> None:
        """Subtract a multiple of the gradient of phi from the faces, in place."""
        for d, q in enumerate(u):
            arrays, k, stride = (q.ravel(), phi.ravel()), factor * self.inv_h[d], self.strides[d]

            def loop(a: int, b: int, arrays: Faces = arrays, k: float = k, stride: int = stride) -> None:
                stencils.subtract_gradient(*arrays, k, (a, b, stride))

            self._divide(loop, self.faces[d])


class GradedOperators:
    """Loops over local entries with the widths of cells along each axis.

    Advection is the scheme of uniform grids in terms of flows through faces and control volumes: a second-order one
    on a smoothly graded grid, and conservative.

    Args:
        grid: The grid.
        boundary: The sides.
        advection: Name of the advection scheme.
    """

    def __init__(self, grid: MacGrid, boundary: Boundary, advection: str) -> None:
        self.grid, self.uniform = grid, UniformOperators(grid, boundary, advection)
        self.cells = np.array([[s.start, s.stop] for s in grid.owned])
        self.faces = []
        for d in range(grid.dim):
            box = self.cells.copy()
            box[d, 1] += int(boundary.opens_upward(d))
            self.faces.append(box)
        self.inverse_widths = tuple(1.0 / w for w in grid.widths)
        self.inverse_gaps = tuple(1.0 / g for g in grid.gaps)
        self.rates = [self._rates(d) for d in range(grid.dim)]

    def _rates(self, d: int) -> tuple[Array, ...]:
        """Factors of the differences above and below each entry of component d, along the three axes."""
        rates = []
        for e in range(3):
            w, g = self.inverse_widths[e], self.inverse_gaps[e]
            if e == d:
                rates += [w * g, np.roll(w, 1) * g]
            else:
                rates += [np.roll(g, -1) * w, g * w]
        return tuple(rates)

    def advection(self, u: Faces) -> Faces:
        """Return div(u u) on the faces inside."""
        grid, ops = self.grid, self.uniform
        flows = tuple(np.empty(grid.shape) for _ in u)
        for d, c in enumerate(u):
            area = [np.ones(n) if a == d else grid.widths[a] for a, n in enumerate(grid.shape)]
            graded_kernels.transports(flows[d], c, *area)
        flat, out, ones = tuple(c.ravel() for c in flows), grid.zero_faces(), (1.0,) * grid.dim
        for d, q in enumerate(u):
            ops.scheme(out[d].ravel(), q.ravel(), flat, d, ones, ops.strides, (*ops.cells, ops.own))
            volume = [grid.gaps[a] if a == d else grid.widths[a] for a in range(3)]
            graded_kernels.divide_by_volume(out[d], *volume, self.cells)
        return out

    def subtract_laplacian(self, out: Array, q: Array, d: int, nu: float) -> None:
        """Subtract nu times the second differences of component d."""
        graded_kernels.laplacian(out, q, self.rates[d], -nu, self.faces[d])

    def momentum(
        self, q: Array, p: Array, terms: Faces, weights: tuple[float, float, float], d: int
    ) -> Array:
        """Return f - grad p - a N - b N_old + mu lap q on the faces of component d; weights are a, b, mu."""
        a, b, mu = weights
        out = self.grid.zeros()
        graded_kernels.right_hand_side(out, p, terms, (a, b, d), self.inverse_gaps[d], self.faces[d])
        graded_kernels.laplacian(out, q, self.rates[d], mu, self.faces[d])
        return out

    def advance(self, q: Array, p: Array, terms: Faces, weights: tuple[float, float, float], d: int) -> Array:
        """Return q + k (f - grad p) - a N - b N_old on the faces of component d; weights are k, a, b."""
        out = self.grid.zeros()
        graded_kernels.advance(out, q, p, terms, weights, d, self.inverse_gaps[d], self.faces[d])
        return out

    def divergence(self, u: Faces) -> Array:
        """Return the divergence in the owned cells."""
        out = self.grid.zeros()
        graded_kernels.divergence(out, u, self.inverse_widths, self.cells)
        return out

    def subtract_gradient(self, u: Faces, phi: Array, factor: float) -> None:
        """Subtract a multiple of the gradient of phi from the faces, in place."""
        for d, q in enumerate(u):
            graded_kernels.subtract_gradient(q, phi, factor * self.inverse_gaps[d], d, self.faces[d])


def make_operators(grid: MacGrid, boundary: Boundary, advection: str) -> UniformOperators | GradedOperators:
    """Return the operators for a grid.

    Raises:
        ValueError: An unknown advection scheme.
    """
    if advection not in SCHEMES:
        raise ValueError(f"unknown advection scheme {advection!r}, one of {', '.join(SCHEMES)}")
    kind = UniformOperators if all(grid.uniform) else GradedOperators
    return kind(grid, boundary, advection)
