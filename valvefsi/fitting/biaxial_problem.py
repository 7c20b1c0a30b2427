"""A biaxial test as a least-squares problem: measured stress as a function of a material's parameters."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from valvefsi.errors import CaseError
from valvefsi.fitting.biaxial_records import BiaxialData
from valvefsi.fitting.least_squares import Fit, Parameter, Problem
from valvefsi.fitting.planar import Extent, PlanarMaterial, PlanarState
from valvefsi.fitting.planar_hgo import KINDS
from valvefsi.fitting.problem import LOSSES
from valvefsi.types import Array

OFFSET = 0.05
"""Largest offset of a stretch."""
CHOICES = {
    "families": KINDS,
    "weights": ("unit", "balanced"),
    "loss": LOSSES,
    "axis1": ("circumferential", "radial", "x"),
}


@dataclass(frozen=True, kw_only=True)
class BiaxialOptions:
    """What is fitted, and how.

    Args:
        families: Families of fibres of ``hgo``: ``1``, ``2``, ``2-kappas`` or ``symmetric``, see `HGO`.
        fibre_angle: Angle of the fibres to axis 1 [deg]; None to fit it.
        axis1: Direction of the leaflet that axis 1 of the test lay along: ``circumferential``, ``radial`` (axis 2 is
            then circumferential), or ``x`` for a flat sheet; ``material.toml`` gives directions relative to it.
        fix: Values of parameters that are held, in their unit.
        bounds: Bounds of parameters, in their unit.
        protocols: Names of the protocols that are fitted, the others are predicted; None for all.
        weights: ``unit``, or ``balanced``: each protocol and component weighs the same.
        loss: Loss of `scipy.optimize.least_squares`; all but ``linear`` count outliers less.
        loss_scale: Residual at which the loss turns from squares [kPa].
        offsets: Fit an offset of the stretch for each protocol and axis (preconditioning).
        starts: Number of starts.
        seed: Seed of the starts and of the bootstrap.
        draws: Draws of the bootstrap over protocols, 0 for none.
        profiles: Compute profile likelihoods.
        compare: Other materials to compare with.
    """

    families: str = "1"
    fibre_angle: float | None = None
    axis1: str = "circumferential"
    fix: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    protocols: Sequence[str] | None = None
    weights: str = "unit"
    loss: str = "linear"
    loss_scale: float = 1.0
    offsets: bool = False
    starts: int = 32
    seed: int = 0
    draws: int = 50
    profiles: bool = True
    compare: Sequence[str] = ()

    def __post_init__(self) -> None:
        for key, choices in CHOICES.items():
            if str(getattr(self, key)) not in choices:
                raise CaseError(f"expected one of {', '.join(choices)}", key=key, value=getattr(self, key))
        object.__setattr__(self, "families", str(self.families))
        if self.starts < 1:
            raise CaseError("expected at least one start", key="starts", value=self.starts)
        if not self.loss_scale > 0:
            raise CaseError("expected a positive number", key="loss_scale", value=self.loss_scale)
        if self.fibre_angle is not None and not np.isfinite(self.fibre_angle):
            raise CaseError("expected a finite angle, or free", key="fibre_angle", value=self.fibre_angle)


@dataclass(frozen=True, kw_only=True)
class Biaxial:
    """A material, records, and the least-squares problem they make.

    Attributes:
        data: The records.
        material: The material.
        options: What is held, bounded and weighted; whether the stretches have offsets.

    Raises:
        CaseError: A parameter is fixed or bounded that the material does not have, or to no value it can take.
    """

    data: BiaxialData
    material: PlanarMaterial
    options: BiaxialOptions

    def __post_init__(self) -> None:
        names = [p.name for p in self.own]
        for key in (*self.options.fix, *self.options.bounds):
            if key not in names:
                near = difflib.get_close_matches(key, names, n=1)
                hint = f", did you mean {near[0]}?" if near else f", expected one of {', '.join(names)}"
                raise CaseError(f"no such parameter of {self.material.model}{hint}", key=key)

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The material's own parameters."""
        extent = Extent.of(self._state, float(np.abs(self.data.stress).max()))
        own = tuple(_with_options(p, self.options) for p in self.material.parameters(extent))
        even = 90.0 if self.mirrored else None
        return tuple(replace(p, even=even) if p.name == "angle" else p for p in own)

    @property
    def mirrored(self) -> bool:
        """Whether +angle and -angle are the same."""
        return not self.data.shear or getattr(self.material, "families", "") == "symmetric"

    @property
    def count(self) -> int:
        """Number of the material's own parameters."""
        return len(self.own)

    @cached_property
    def problem(self) -> Problem:
        """The problem; its data are the components one after the other, offsets follow the material's parameters."""
        data, options = self.data, self.options
        offsets = [
            Parameter(name=f"offset{axis}_{name}", lower=-OFFSET, upper=OFFSET, start=(-1e-3, 1e-3))
            for name in data.names
            for axis in (1, 2)
        ]
        several = len(data.components)
        return Problem(
            parameters=(*self.own, *(offsets if options.offsets else ())),
            data=data.stress.T.ravel(),
            model=self._curve,
            jacobian=self._jacobian,
            weights=_balanced(data) if options.weights == "balanced" else None,
            blocks=np.tile(data.protocol, several),
            series=np.concatenate([data.protocol + k * len(data.names) for k in range(several)]),
            block_names=dict(enumerate(data.names)),
            unit="kPa",
            loss=options.loss,
            loss_scale=options.loss_scale,
        )

    def predict(self, values: Array, data: BiaxialData) -> Array:
        """Return the stress at the deformations of other records, ``(n, components)`` [kPa].

        Args:
            values: Values of all parameters, ``(parameters,)``.
            data: The records.
        """
        S = self.material.stress(values[: self.count], PlanarState.of(data.F))
        return np.einsum("knj,jn->nk", measured_from_pk2(data, data.F), S)

    def canonical(self, fit: Fit) -> Fit:
        """Return the same fit with the fibre angle in its first period, by the symmetries there are.

        Without shear in the data +angle and -angle are the same, and the angle is put from 0 to 90 degrees; so
        is the larger family first. An angle that all but lies on an axis is put on it.
        """
        names = list(self.problem.names)
        at = names.index("angle") if "angle" in names else -1
        if at < 0 or self.own[at].period is None or self.own[at].value is not None:
            return fit
        values = fit.values.copy()
        angle = values[at] % 180.0
        if "k1_2" in names and 45 < angle <= 135:
            angle -= 90
            for one in ("k1_1", "k2_1", "kappa_1"):
                if one in names:
                    pair = [names.index(one), names.index(one[:-1] + "2")]
                    values[pair] = values[pair[::-1]]
        elif angle > 90:
            angle -= 180
        angle = abs(angle) if self.mirrored else angle
        size = np.abs(self.problem.w * self.problem.data).max()
        for value in (round(angle / 90) * 90.0, angle):
            values[at] = value
            change = np.abs(self.problem.w * (self.problem.model(values) - fit.curve)).max()
            if change <= 1e-7 * size:
                return replace(fit, values=values, problem=self._folded(fit.problem, at))
        return fit  # a bound or a held parameter breaks the symmetry

    def _folded(self, problem: Problem, at: int) -> Problem:
        """Return the problem with the angle from 0 to 90 degrees where that is all there is."""
        if not self.mirrored:
            return problem
        parameters = list(problem.parameters)
        parameters[at] = replace(parameters[at], lower=0.0, upper=90.0, start=(0.0, 90.0))
        return replace(problem, parameters=tuple(parameters))

    @cached_property
    def _state(self) -> PlanarState:
        return PlanarState.of(self.data.F)

    @cached_property
    def _maps(self) -> Array:
        return measured_from_pk2(self.data, self.data.F)

    def _curve(self, v: Array) -> Array:
        """Return the components one after the other, ``(components n,)``."""
        state, maps = self._placed(v)
        return np.einsum("knj,jn->kn", maps, self.material.stress(v[: self.count], state)).ravel()

    def _jacobian(self, v: Array) -> Array:
        """Return its derivative, ``(components n, parameters)``; by offsets with a complex step."""
        state, maps = self._placed(v)
        gradient = self.material.gradient(v[: self.count], state)
        own = np.einsum("knj,pjn->knp", maps, gradient).reshape(-1, self.count)
        if not self.options.offsets:
            return own
        columns = []
        for step in ([1e-30j, 0.0], [0.0, 1e-30j]):
            state, maps = self._placed(v, np.array(step))
            S = self.material.stress(v[: self.count].astype(complex), state)
            columns.append(np.einsum("knj,jn->kn", maps, S).imag.ravel() / 1e-30)
        blocks = np.tile(self.data.protocol, len(self.data.components))
        offsets = [column * (blocks == k) for k in range(len(self.data.names)) for column in columns]
        return np.column_stack([own, *offsets])

    def _placed(self, v: Array, step: Array | float = 0.0) -> tuple[PlanarState, Array]:
        """Return state and maps with the offsets added to the stretches."""
        if not self.options.offsets:
            return self._state, self._maps
        shift = np.asarray(v[self.count :]).reshape(-1, 2)[self.data.protocol] + step
        F = self.data.F.astype(shift.dtype)
        F[:, 0, 0] += shift[:, 0]
        F[:, 1, 1] += shift[:, 1]
        return PlanarState.of(F), measured_from_pk2(self.data, F)


def measured_from_pk2(data: BiaxialData, F: Array) -> Array:
    """Return what turns S (11, 22, 12) into the measured components, ``(components, n, 3)``.

    P = F S,  sigma = F S F^T with det F = 1 in three dimensions

    Args:
        data: Records that say what was measured.
        F: Deformation gradients in the plane, ``(n, 2, 2)`` [-].
    """
    zero, one = np.zeros_like(F[:, 0, 0]), np.ones_like(F[:, 0, 0])
    rows = []
    for component in data.components:
        i, j = int(component[0]) - 1, int(component[1]) - 1
        if data.measure == "pk2":
            rows.append(
                [one if component == name else zero for name in ("11", "22")] + [one if i != j else zero]
            )
        elif data.measure == "pk1":
            rows.append([F[:, i, 0], zero, F[:, i, 1]] if j == 0 else [zero, F[:, i, 1], F[:, i, 0]])
        else:
            shear = F[:, i, 0] * F[:, j, 1] + F[:, i, 1] * F[:, j, 0]
            rows.append([F[:, i, 0] * F[:, j, 0], F[:, i, 1] * F[:, j, 1], shear])
    return np.array(rows).transpose(0, 2, 1)


def _with_options(parameter: Parameter, options: BiaxialOptions) -> Parameter:
    """Return a parameter with what was fixed or bounded."""
    name, dispersion = parameter.name, parameter.name.startswith("kappa")
    if name in options.fix:
        value = float(options.fix[name])
        if parameter.period is None and parameter.unit == "kPa" and value < 0:
            raise CaseError("expected a number that is not negative", key=f"fix {name}", value=value)
        if dispersion and not 0 <= value <= 1 / 3:
            raise CaseError("expected a number from 0 to 1/3", key="fix kappa", value=value)
        return replace(parameter, value=value)
    if name in options.bounds:
        low, high = options.bounds[name]
        if parameter.log and low <= 0:
            low = min(parameter.lower, high * 1e-6) if high > 0 else low
        if dispersion and not 0 <= low < high <= 1 / 3 + 1e-12:
            raise CaseError("expected bounds from 0 to 1/3", key="bounds kappa", value=(low, high))
        return replace(parameter, lower=float(low), upper=float(high), value=None, period=None)
    return parameter


def _balanced(data: BiaxialData) -> Array:
    """Return weights that give each protocol and component the same sum of squares, ``(components n,)``."""
    weights = np.ones_like(data.stress)
    total = np.sqrt(np.mean(data.stress**2))
    for k in range(len(data.names)):
        rows = data.protocol == k
        size = np.sqrt(np.mean(data.stress[rows] ** 2, axis=0))
        weights[rows] = total / np.maximum(size, 1e-3 * total)
    return weights.T.ravel()
