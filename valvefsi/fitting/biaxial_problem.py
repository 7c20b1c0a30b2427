"""A biaxial test as a least-squares problem: measured stress as a function of a material's parameters."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from valvefsi.errors import CaseError
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.least_squares import Fit, Parameter, Problem
from valvefsi.fitting.planar import Extent, PlanarMaterial, PlanarState

OFFSET = 0.05
"""Largest offset of a stretch."""


class Choices(Protocol):
    """What of the options matters here."""

    fix: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    weights: str
    offsets: bool


@dataclass(frozen=True, kw_only=True)
class Biaxial:
    """A material, records, and the problem they make.

    Attributes:
        data: The records.
        material: The material.
        problem: The problem; its data are the components one after the other.
    """

    data: BiaxialData
    material: PlanarMaterial
    problem: Problem

    @property
    def count(self) -> int:
        """Number of the material's own parameters."""
        return len(self.problem.parameters) - (2 * len(self.data.names) if self._offsets else 0)

    @property
    def _offsets(self) -> bool:
        return self.problem.parameters[-1].name.startswith("offset")

    def predict(self, values: NDArray, data: BiaxialData) -> NDArray:
        """Return the stress at the deformations of other records, ``(n, components)`` [kPa]."""
        S = self.material.stress(values[: self.count], PlanarState.of(data.F))
        return np.einsum("knj,jn->nk", measured_from_pk2(data, data.F), S)

    def canonical(self, found: Fit) -> Fit:
        """Return the same fit with the fibre angle in its first period, by the symmetries there are.

        Without shear in the data +angle and -angle are the same, and the angle is put from 0 to 90 degrees; so
        is the larger family first. An angle that all but lies on an axis is put on it.
        """
        names = [p.name for p in self.problem.parameters]
        at = names.index("angle") if "angle" in names else -1
        if (
            at < 0
            or self.problem.parameters[at].period is None
            or self.problem.parameters[at].value is not None
        ):
            return found
        values = found.values.copy()
        angle = values[at] % 180.0
        if "k1_2" in names and 45 < angle <= 135:
            angle -= 90
            one, other = names.index("k1_1"), names.index("k1_2")
            values[[one, one + 1, other, other + 1]] = values[[other, other + 1, one, one + 1]]
            if "kappa_2" in names:
                pair = [names.index("kappa_1"), names.index("kappa_2")]
                values[pair] = values[pair[::-1]]
        elif angle > 90:
            angle -= 180
        mirrored = not self.data.shear or getattr(self.material, "families", "") == "symmetric"
        angle = abs(angle) if mirrored else angle
        size = np.abs(self.problem.w * self.problem.data).max()
        for value in (round(angle / 90) * 90.0, angle):
            values[at] = value
            change = np.abs(self.problem.w * (self.problem.model(values) - found.curve)).max()
            if change <= 1e-7 * size:
                return replace(found, values=values, problem=self._folded(found.problem, at, mirrored))
        return found  # a bound or a held parameter breaks the symmetry

    def _folded(self, problem: Problem, at: int, mirrored: bool) -> Problem:
        """Return the problem with the angle from 0 to 90 degrees where that is all there is."""
        if not mirrored:
            return problem
        parameters = list(problem.parameters)
        parameters[at] = replace(parameters[at], lower=0.0, upper=90.0, start=(0.0, 90.0))
        return replace(problem, parameters=tuple(parameters))


def biaxial_problem(data: BiaxialData, material: PlanarMaterial, extent: Extent, choices: Choices) -> Biaxial:
    """Return the least-squares problem of a material and records.

    Raises:
        CaseError: A parameter is fixed or bounded that the material does not have, or to no value it can take.
    """
    parameters = list(material.parameters(extent))
    parameters = [_chosen(p, choices) for p in parameters]
    names = [p.name for p in parameters]
    for key in (*choices.fix, *choices.bounds):
        if key not in names:
            near = difflib.get_close_matches(key, names, n=1)
            hint = f", did you mean {near[0]}?" if near else f", expected one of {', '.join(names)}"
            raise CaseError(f"no such parameter of {material.model}{hint}", key=key)
    count = len(parameters)
    model = _Model(data=data, material=material, count=count, offsets=choices.offsets)
    if choices.offsets:
        parameters += [
            Parameter(name=f"offset{axis}_{name}", lower=-OFFSET, upper=OFFSET, start=(-1e-3, 1e-3))
            for name in data.names
            for axis in (1, 2)
        ]
    repeated = len(data.components)
    problem = Problem(
        parameters=tuple(parameters),
        data=data.stress.T.ravel(),
        model=model.values,
        jacobian=model.jacobian,
        weights=_balanced(data) if choices.weights == "balanced" else None,
        blocks=np.tile(data.protocol, repeated),
        block_names=dict(enumerate(data.names)),
        unit="kPa",
    )
    return Biaxial(data=data, material=material, problem=problem)


def measured_from_pk2(data: BiaxialData, F: NDArray) -> NDArray:
    """Return what turns S (11, 22, 12) into the measured components, ``(components, n, 3)``.

    P = F S,  sigma = F S F^T with det F = 1 in three dimensions
    """
    zero, one = np.zeros_like(F[:, 0, 0]), np.ones_like(F[:, 0, 0])
    found = []
    for component in data.components:
        i, j = int(component[0]) - 1, int(component[1]) - 1
        if data.measure == "pk2":
            parts = [one if component == name else zero for name in ("11", "22")]
            found.append([*parts, one if i != j else zero])
        elif data.measure == "pk1":
            parts = [F[:, i, 0], zero, F[:, i, 1]] if j == 0 else [zero, F[:, i, 1], F[:, i, 0]]
            found.append(parts)
        else:
            shear = F[:, i, 0] * F[:, j, 1] + F[:, i, 1] * F[:, j, 0]
            found.append([F[:, i, 0] * F[:, j, 0], F[:, i, 1] * F[:, j, 1], shear])
    return np.array(found).transpose(0, 2, 1)


@dataclass(frozen=True, kw_only=True)
class _Model:
    """Measured stress as a function of the parameters, offsets of the stretch after the material's own."""

    data: BiaxialData
    material: PlanarMaterial
    count: int
    offsets: bool

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", PlanarState.of(self.data.F))
        object.__setattr__(self, "maps", measured_from_pk2(self.data, self.data.F))

    def values(self, v: NDArray) -> NDArray:
        """Return the components one after the other, ``(components n,)``."""
        state, maps = self._placed(v)
        return np.einsum("knj,jn->kn", maps, self.material.stress(v[: self.count], state)).ravel()

    def jacobian(self, v: NDArray) -> NDArray:
        """Return its derivative, ``(components n, parameters)``; by offsets with a complex step."""
        state, maps = self._placed(v)
        gradient = self.material.gradient(v[: self.count], state)
        own = np.einsum("knj,pjn->knp", maps, gradient).reshape(-1, self.count)
        if not self.offsets:
            return own
        columns = []
        for axis in (0, 1):
            step = np.array([0.0, 0.0], complex)
            step[axis] = 1e-30j
            state, maps = self._placed(v, step)
            S = self.material.stress(v[: self.count].astype(complex), state)
            columns.append(np.einsum("knj,jn->kn", maps, S).imag.ravel() / 1e-30)
        blocks = np.tile(self.data.protocol, len(self.data.components))
        offsets = [columns[axis] * (blocks == k) for k in range(len(self.data.names)) for axis in (0, 1)]
        return np.column_stack([own, *offsets])

    def _placed(self, v: NDArray, step: NDArray | None = None) -> tuple[PlanarState, NDArray]:
        """Return state and maps with the offsets added to the stretches."""
        if not self.offsets:
            return self.state, self.maps
        shift = np.asarray(v[self.count :]).reshape(-1, 2)[self.data.protocol]
        if step is not None:
            shift = shift + step
        F = self.data.F.astype(shift.dtype)
        F[:, 0, 0] += shift[:, 0]
        F[:, 1, 1] += shift[:, 1]
        return PlanarState.of(F), measured_from_pk2(self.data, F)


def _chosen(parameter: Parameter, choices: Choices) -> Parameter:
    """Return a parameter with what was fixed or bounded."""
    if parameter.name in choices.fix:
        value = float(choices.fix[parameter.name])
        if parameter.period is None and parameter.unit == "kPa" and value < 0:
            raise CaseError(
                "expected a number that is not negative", key=f"fix {parameter.name}", value=value
            )
        if parameter.name.startswith("kappa") and not 0 <= value <= 1 / 3:
            raise CaseError("expected a number from 0 to 1/3", key="fix kappa", value=value)
        return replace(parameter, value=value)
    if parameter.name in choices.bounds:
        low, high = choices.bounds[parameter.name]
        if parameter.log and low <= 0:
            low = min(parameter.lower, high * 1e-6) if high > 0 else low
        if parameter.name.startswith("kappa") and not 0 <= low < high <= 1 / 3 + 1e-12:
            raise CaseError("expected bounds from 0 to 1/3", key="bounds kappa", value=(low, high))
        return replace(parameter, lower=float(low), upper=float(high), value=None, period=None)
    return parameter


def _balanced(data: BiaxialData) -> NDArray:
    """Return weights that give each protocol and component the same sum of squares."""
    weights = np.ones_like(data.stress)
    total = np.sqrt(np.mean(data.stress**2))
    for k in range(len(data.names)):
        rows = data.protocol == k
        size = np.sqrt(np.mean(data.stress[rows] ** 2, axis=0))
        weights[rows] = total / np.maximum(size, 1e-3 * total)
    return weights.T.ravel()
