"""Biaxial tests of a known leaflet: makes the records of the leaflet studies.

Under load control the loads of each protocol grow in a fixed ratio, and the strains at which the material (S1-S3)
carries them are solved for. Under control of the deformation the specimen is stretched, and sheared, along a path
until its largest stress is reached. Everything is rounded as a data logger does.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import optimize

from valvefsi.fitting.biaxial import BiaxialFit
from valvefsi.fitting.planar import PlanarState
from valvefsi.fitting.planar_hgo import HGO

RATIOS = ((1.0, 1.0), (1.0, 0.75), (0.75, 1.0), (1.0, 0.5), (0.5, 1.0))
POINTS = 25


def strains_under(material: HGO, values: Sequence[float], loads: np.ndarray) -> np.ndarray:
    """Return E11, E22, E12 that carry second Piola-Kirchhoff stresses S11, S22 with S12 = 0.

    Args:
        material: The material.
        values: Its constants, stresses in kPa.
        loads: S11 and S22 along a path that starts at rest, ``(n, 2)`` [kPa].
    """
    v, guess, found = np.array(values, float), np.zeros(3), []

    def out_of_balance(E: np.ndarray, target: np.ndarray) -> np.ndarray:
        state = PlanarState(
            C11=np.array([1 + 2 * E[0]]), C22=np.array([1 + 2 * E[1]]), C12=np.array([2 * E[2]])
        )
        return (material.stress(v, state)[:, 0] - target) / np.abs(loads).max()

    for load in loads:
        target = np.array([*load, 0.0])
        tried = (
            optimize.root(out_of_balance, guess, args=(target,), method=m, tol=1e-13) for m in ("hybr", "lm")
        )
        done = next((answer for answer in tried if np.abs(answer.fun).max() < 1e-9), None)
        if done is None:
            raise RuntimeError(f"no strain carries {load} kPa")
        guess = done.x
        found.append(guess)
    return np.array(found)


def make_tests(
    material: HGO, values: Sequence[float], largest: float
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return number, strains and stresses S11, S22 of each protocol up to the ``largest`` stress [kPa]."""
    found = []
    for number, ratio in enumerate(RATIOS, 1):
        loads = largest * np.outer(np.linspace(0, 1, POINTS) ** 1.5, ratio)
        fine = np.concatenate([np.linspace(a, b, 8)[:-1] for a, b in itertools.pairwise(loads)])
        strains = strains_under(material, values, np.vstack([fine, loads[-1:]]))[::7]
        found.append((number, strains, loads))
    return found


def stretch_tests(
    material: HGO, values: Sequence[float], paths: Sequence[np.ndarray], largest: float
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """Return number, F and P11, P22, P12 of each protocol, up to the ``largest`` stress [kPa].

    Args:
        material: The material.
        values: Its constants, stresses in kPa.
        paths: Direction in which F leaves the identity in each protocol, ``(2, 2)``.
        largest: Largest component of P.
    """

    def stress(F: np.ndarray) -> np.ndarray:
        S = material.stress(np.array(values, float), PlanarState.of(F))
        P = F @ np.array([[S[0], S[2]], [S[2], S[1]]]).transpose(2, 0, 1)
        return np.array([P[:, 0, 0], P[:, 1, 1], P[:, 0, 1]]).T

    found = []
    for number, path in enumerate(paths, 1):
        reach = optimize.brentq(
            lambda s, path=path: stress(np.eye(2)[None] + s * path).max() - largest, 0, 0.5
        )
        F = np.eye(2) + reach * np.linspace(0, 1, POINTS)[:, None, None] * path
        found.append((number, F, stress(F)))
    return found


def write_record(path: Path, header: list[str], columns: list[str], rows: list[list[float]]) -> Path:
    """Write a record with where it is from."""
    lines = [f"# {line}" for line in header]
    lines += [",".join(columns), *(",".join(f"{value:.7g}" for value in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def against_truth(found: BiaxialFit, truth: dict[str, float]) -> dict[str, object]:
    """Return value, interval and verdict of each parameter next to the value the record was made with."""
    rows = {}
    for name, entry in found.report.parameters().items():
        ends = entry["ci95"]
        inside = None if ends is None else bool(ends[0] <= truth[name] <= ends[1])
        rows[name] = {
            "value": entry["value"],
            "truth": truth[name],
            "unit": entry["unit"],
            "ci95": ends,
            "inside": inside,
            "verdict": entry["verdict"],
        }
    written = found.report.as_dict()
    kept = ("half_sum_of_squares", "r_squared", "relative_l2", "relative_linf", "residual_std")
    starts = {
        "converged": found.fit.converged,
        "reached_best": found.fit.reached,
        "count": len(found.fit.starts),
    }
    return {"parameters": rows, **{key: written[key] for key in kept}, "starts": starts}
