"""Is a fitted material safe to run: convexity and ellipticity over the range of the data and beyond."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from valvefsi.fitting.planar import PlanarMaterial, PlanarState
from valvefsi.types import Array

Marks = NDArray[np.bool_]

BEYOND = 0.2
"""How far beyond the data it is checked, as a part of their range."""
GRID = 13
DIRECTIONS = 24


@dataclass(frozen=True, kw_only=True)
class Stability:
    """Least eigenvalues over states of strain inside the data's range, and inside a range 20 % wider.

    Attributes:
        convex: Share of states where W is convex in the Green strain of the plane, inside and wider.
        elliptic: Share of the states in tension where the acoustic tensor of the sheet is positive.
        worst: First Green strain (11, 22, 12) found where ellipticity is lost, None if nowhere.
    """

    convex: tuple[float, float]
    elliptic: tuple[float, float]
    worst: tuple[float, ...] | None

    def as_dict(self) -> dict[str, object]:
        """Return what ``fit.json`` holds."""
        ends = ("data_range", "beyond_20_percent")
        return {
            "convex_share": dict(zip(ends, self.convex, strict=True)),
            "elliptic_share": dict(zip(ends, self.elliptic, strict=True)),
            "lost_at_strain": None if self.worst is None else list(self.worst),
        }

    def lines(self) -> list[str]:
        """Return it in words."""
        lines = []
        for name, shares in (("convex in E", self.convex), ("elliptic (states in tension)", self.elliptic)):
            yes = [
                "everywhere" if share == 1 else f"at {100 * share:.1f} % of the states" for share in shares
            ]
            lines.append(f"{name}: {yes[0]} in the data's range, {yes[1]} up to 20 % beyond")
        return lines


def stability(material: PlanarMaterial, values: Array, F: Array) -> Stability:
    """Check a material over a box of strains that holds the data, and over one 20 % wider.

    Args:
        material: The material.
        values: Its parameters.
        F: Deformations of the data, ``(n, 2, 2)``.
    """
    convex: list[float] = []
    elliptic: list[float] = []
    worst = None
    for beyond in (0.0, BEYOND):
        state = _states(F, beyond)
        tangent, S = _tangent(material, values, state)
        scale = np.abs(tangent).max(axis=(1, 2))
        convex.append(_share(np.linalg.eigvalsh(tangent)[:, 0] >= -1e-9 * scale))
        tense = _in_tension(S)
        least = _least_acoustic(tangent, S, state)
        good = least >= -1e-9 * scale
        elliptic.append(_share(good[tense]))
        failures = np.flatnonzero(tense & ~good)
        if worst is None and len(failures):
            k = failures[0]
            worst = tuple(
                float(x) for x in ((state.C11[k] - 1) / 2, (state.C22[k] - 1) / 2, state.C12[k] / 2)
            )
    return Stability(convex=(convex[0], convex[1]), elliptic=(elliptic[0], elliptic[1]), worst=worst)


def _share(good: Marks) -> float:
    return float(np.mean(good)) if len(good) else 1.0


def _states(F: Array, beyond: float) -> PlanarState:
    """Return a grid over the box of Green strains that holds the data, widened."""
    state = PlanarState.of(F)
    axes = []
    for C, identity in ((state.C11, 1.0), (state.C22, 1.0), (state.C12, 0.0)):
        low, high = min(float(C.min()), identity), max(float(C.max()), identity)
        wider = beyond * (high - low)
        count = GRID if high - low > 1e-6 else 1
        axes.append(
            np.linspace(low, high + wider, count)
            if identity
            else np.linspace(low - wider, high + wider, count)
        )
    C11, C22, C12 = (part.ravel() for part in np.meshgrid(*axes, indexing="ij"))
    real = C11 * C22 - C12**2 > 1e-3
    return PlanarState(C11=C11[real], C22=C22[real], C12=C12[real])


def _tangent(material: PlanarMaterial, values: Array, state: PlanarState) -> tuple[Array, Array]:
    """Return dS/dE with engineering shear, ``(n, 3, 3)``, by a complex step, and S, ``(3, n)``."""
    columns = []
    parts = {"C11": state.C11, "C22": state.C22, "C12": state.C12}
    for name, slope in (("C11", 2.0), ("C22", 2.0), ("C12", 1.0)):
        step = {key: part.astype(complex) for key, part in parts.items()}
        step[name] += 1e-30j
        columns.append(slope * material.stress(values.astype(complex), PlanarState(**step)).imag / 1e-30)
    tangent = np.array(columns).transpose(2, 1, 0)
    return (tangent + tangent.transpose(0, 2, 1)) / 2, np.real(material.stress(values, state))


def _in_tension(S: Array) -> Marks:
    """Return where both principal stresses of the plane are not negative."""
    size = np.abs(S).max(axis=0) + 1e-300
    return (S[0] + S[1] >= -1e-9 * size) & (S[0] * S[1] - S[2] ** 2 >= -1e-9 * size**2)


def _least_acoustic(tangent: Array, S: Array, state: PlanarState) -> Array:
    """Return the least eigenvalue of the sheet's acoustic tensor over directions N in its plane.

    Q_ik = F_iA (D_ABCD N_B N_D) F_kC + delta_ik N.S N; its congruent C^(1/2) form has the same sign, so U = F.
    """
    U = _root(state)
    least = np.full(S.shape[1], np.inf)
    for angle in np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        n1, n2 = np.cos(angle), np.sin(angle)
        B = np.array([[n1, 0.0, n2], [0.0, n2, n1]])  # strain of a (x) N, in Voigt's order 11, 22, 2*12
        inner = np.einsum("ai,nij,bj->nab", B, tangent, B)
        Q = np.einsum("nai,nij,nbj->nab", U, inner, U)
        Q += (n1 * n1 * S[0] + n2 * n2 * S[1] + 2 * n1 * n2 * S[2])[:, None, None] * np.eye(2)
        least = np.minimum(least, np.linalg.eigvalsh((Q + Q.transpose(0, 2, 1)) / 2)[:, 0])
    return least


def _root(state: PlanarState) -> Array:
    """Return U = sqrt(C), ``(n, 2, 2)``."""
    C = np.array([[state.C11, state.C12], [state.C12, state.C22]]).transpose(2, 0, 1)
    squares, axes = np.linalg.eigh(C)
    return np.einsum("nik,nk,njk->nij", axes, np.sqrt(squares), axes)
