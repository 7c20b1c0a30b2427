"""A plate thinner than the kernel: how far it yields to a load, and its bending waves, against closed forms.

    static    held at both ends of a span of L spacings, under a pressure difference between open sides (at an angle to
              the grid: under a dead load), until it rests; against an incompressible plate and statics on its own mesh
    wave      released from one wave of L spacings; frequency and damping against the exact wave of an immersed elastic
              plate, and against what the kernel makes of it, see `plate_theory`

The box is as many cells wide as the solver needs and periodic: plane strain. The plate goes through the whole box, and
beyond both ends it goes on as its image, so that its ends are clamped by symmetry and only held in place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

from valvefsi import fsi
from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.immersed.plate_model import (
    NU,
    WIDTH,
    Discrete,
    Loading,
    Place,
    incompressible_deflection,
    model_of,
    own_deflection,
    place_of,
)
from valvefsi.benchmarks.immersed.plate_theory import ImmersedPlate, immersed_wave, kernel_wave, slowing
from valvefsi.benchmarks.options import UNSET, Values, option, quantities, require
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.running import Columns, History, completed, fixed_steps
from valvefsi.coupling.kernels import BSPLINE, KERNELS
from valvefsi.post.plots.plate import thin_plate
from valvefsi.run.stable_step import measured_limit
from valvefsi.solid.loads import Ramp
from valvefsi.solid.structure import Structure
from valvefsi.types import Array

PARAMETERS = quantities(
    """
    h = 0.1 cm, modulus = 1e6 dyn/cm^2, rho = 1 g/cm^3, stokes = 0.25, shift = 0.1, step = 0.7,
    periods = 2, deflection = 0.02
    """,
    t_end=(UNSET, "s"),
)
"""``t_end`` stands in place of ``periods`` where it is set; a plate's period is that of its thickness."""
KINDS = ("static", "wave")
CLAMPED = 22.3733
"""omega L^2 sqrt(m / D) of the first mode of a span with clamped ends (Timoshenko and Gere 1972)."""
LEAST_PERIODS = 0.5
"""Periods of a run at least: a wave is fitted from a quarter of its period on."""
SMOOTH = 100
"""Steps of a period at least."""
CRITICAL = 1.4
"""Body damping of the static run, over the plate's frequency and the mass that moves: near the critical 2."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run.

    Attributes:
        kind: "static" or "wave".
        thickness: Of the plate, over h.
    """

    kind: str
    thickness: float

    def __str__(self) -> str:
        return f"{self.kind}, {self.thickness:g} h"


def amplitude(solid: Structure, weights: Array, normal: Array) -> Columns:
    """Return what follows a weighted mean of the displacement along the plate's normal [cm]."""

    def mean(state: fsi.State) -> list[float]:
        return [solid.comm.allreduce(weights @ ((state.bodies[0]["chi"] - solid.X) @ normal))]

    return Columns(("amplitude_cm",), mean)


@dataclass(frozen=True, kw_only=True)
class Plate(Benchmark[Case, None]):
    """Plates of several thicknesses, at rest under a load and waving."""

    name = "plate"
    parameters = PARAMETERS
    keeps = True

    thickness: tuple[float, ...] = option(
        (0.25, 0.5, 1.0, 2.0), "Thicknesses over the spacing.", metavar="T,T", least=0.1, most=4.0
    )
    length: int = option(16, "Span and wavelength in spacings.", least=8, most=64)
    element: str = option("solid_shell", "solid_shell, quadratic or linear.", choices=tuple(NU))
    kernel: str = option("bspline3", "Kernel of the coupling.", choices=tuple(KERNELS))
    ratio: float = option(0.5, "Distance of the nodes over the spacing.", least=0.2, most=2.0)
    layers: int = option(1, "Elements through the thickness.", least=1, most=4)
    angle: int = option(0, "Angle of the plate at rest to the grid [degrees].", choices=(0, 45))
    kinds: tuple[str, ...] = option(KINDS, "static, wave or both.", choices=KINDS)

    def check(self, values: Values) -> None:
        key = "t_end" if "t_end" in values else "periods"
        for run in self.runs():
            period = self._period(run)
            least = f"{LEAST_PERIODS:g} periods" + (f", {LEAST_PERIODS * period:.3g} s" * (key == "t_end"))
            message = f"expected at least {least} of {run}"
            require(self._periods(period) >= LEAST_PERIODS * (1.0 - 1e-9), message, values, key)

    def runs(self) -> list[Case]:
        """Return every thickness at rest and waving, the thickest, which is fastest, first."""
        every = sorted(self.thickness, reverse=True)
        return [Case(kind=kind, thickness=t) for kind in self.kinds for t in every]

    def place(self, run: Case, out: Path) -> Path:
        return out / f"{run.kind}-{run.thickness:g}"

    def values_of(self, run: Case) -> Values:
        options = (self.length, self.element, self.kernel, self.ratio, self.layers, self.angle)
        return {**self.values, "chosen": repr(options)}

    @property
    def discrete(self) -> Discrete:
        """How the plates are discretised."""
        return Discrete(
            element=self.element,
            kernel=self.kernel,
            ratio=self.ratio,
            layers=self.layers,
            h=self.values["h"],
            shift=self.values["shift"],
        )

    def where(self, run: Case) -> Place:
        """Return the place of a plate; a wave and what it moves need a box as high as long."""
        if run.kind == "wave":
            return place_of(self.length, self.length, 0)
        return place_of(self.length, max(2 * WIDTH, self.length // 2), self.angle)

    def theory(self, run: Case) -> ImmersedPlate:
        """Return the plate of a run; its fluid has a Stokes layer of the wave of ``stokes`` spacings."""
        v, where = self.values, self.where(run)
        plate = ImmersedPlate(
            thickness=run.thickness * v["h"],
            length=where.length * v["h"],
            height=where.height * v["h"],
            modulus=v["modulus"],
            rho=v["rho"],
        )
        layer = v["stokes"] * v["h"]
        return replace(plate, mu=0.5 * v["rho"] * plate.potential_frequency() * layer**2)

    def _period(self, run: Case) -> float:
        """Return the period of a wave, or of the first mode of a plate with the fluid of its box [s]."""
        plate = self.theory(run)
        if run.kind == "wave":
            return 2.0 * math.pi / immersed_wave(plate).imag
        return 2.0 * math.pi / _frequency_at_rest(plate)

    def _periods(self, period: float) -> float:
        """Return how many periods a run lasts."""
        v = self.values
        return float(v["t_end"] / period if "t_end" in v else v["periods"])

    def one(self, run: Case, job: Job) -> Record:
        measure = (self._static if run.kind == "static" else self._wave)(run, job)
        return {"kind": run.kind, "thickness": run.thickness, **measure}

    def _static(self, run: Case, job: Job) -> Record:
        """Return how far a plate yields, over what incompressible elements and its own say."""
        plate, where, discrete = self.theory(run), self.where(run), self.discrete
        load = self.values["deflection"] * plate.thickness / plate.yielding()
        mass = plate.rho * (plate.thickness + plate.height)
        omega = _frequency_at_rest(plate)
        loading = Loading(
            load=load,
            ramp=Ramp(duration=2.0 / omega, shape="smooth"),
            damping=CRITICAL * omega * mass / plate.thickness,
        )
        model, solid = model_of(plate, where, discrete, job.comm, loading)
        along = np.abs((solid.X - discrete.middle(where)) @ where.along)
        middle = _mean_where(solid, along < 1e-6 * plate.length)
        ends = _mean_where(solid, along > (0.5 - 1e-6) * plate.length)
        follower = amplitude(solid, middle - ends, where.normal)
        h, steps = self._march(run, job, model, follower, 2.0 * math.pi / omega)
        t, w = h["t_s"], h["amplitude_cm"]
        exact = incompressible_deflection(plate, load, job.comm)
        return {
            "over_incompressible": float(w[-1] / exact),
            "over_own": float(w[-1] / own_deflection(plate, discrete, load, job.comm)),
            "closed_form": plate.yielding() * load / exact,
            "settling": float(w[-1] / np.interp(0.8 * t[-1], t, w) - 1.0),
            "steps": steps,
            "history": {"t": (t / t[-1]).tolist(), "w": (w / exact).tolist()},
        }

    def _wave(self, run: Case, job: Job) -> Record:
        """Return frequency and damping of a wave, and those of the theories."""
        plate, discrete = self.theory(run), self.discrete
        exact = immersed_wave(plate)
        model, solid = model_of(plate, self.where(run), discrete, job.comm)
        chi, follower = self._released(run, solid)
        h, steps = self._march(run, job, model, follower, 2.0 * math.pi / exact.imag, chi)
        fit = decay(h, exact)
        ratio = fit.s.imag / exact.imag
        record = {
            "frequency_ratio": ratio,
            "damping": -fit.s.real / fit.s.imag,
            "exact_damping": -exact.real / exact.imag,
            "potential_ratio": exact.imag / plate.potential_frequency(),
            "rest": fit.rest,
            "misfit": fit.misfit,
            "dragged": (plate.thickness + 2.0 / plate.wave_number) * (ratio**-2 - 1.0) / discrete.h,
            "steps": steps,
        }
        if KERNELS[self.kernel][0] == BSPLINE:
            edge = plate.length / discrete.elements(plate)
            s = kernel_wave(plate, kernel=self.kernel, h=discrete.h, edge=edge)
            record |= {"kernel_ratio": s.imag / exact.imag, "kernel_damping": -s.real / s.imag}
            parts = slowing(plate, kernel=self.kernel, h=discrete.h)
            record |= {f"slowing_{name}": factor for name, factor in asdict(parts).items()}
        return record

    def _released(self, run: Case, solid: Structure) -> tuple[Array, Columns]:
        """Return the nodes of a plate bent to a wave without shear [cm], and what follows the wave (collective)."""
        plate, where, h = self.theory(run), self.where(run), self.values["h"]
        k, X = plate.wave_number, solid.X - self.discrete.middle(where)
        shape = np.cos(k * X[:, 0])
        bend = np.stack([k * np.sin(k * X[:, 0]) * X[:, 2], 0.0 * shape, shape], axis=1)
        weights = solid.weights * shape
        weights /= solid.comm.allreduce(weights @ shape)
        chi = solid.X + self.values["deflection"] * h * bend
        return chi, amplitude(solid, weights, where.normal)

    def _march(
        self,
        run: Case,
        job: Job,
        model: fsi.Model,
        follower: Columns,
        period: float,
        chi: Array | None = None,
    ) -> tuple[History, int]:
        """Run some periods from rest, the nodes at chi, in steps that are a part of the largest stable one.

        Returns:
            The history and the number of steps (collective).
        """
        v = self.values
        limit = measured_limit(model, v["h"] * math.sqrt(v["rho"] / v["modulus"]), 0)
        periods = self._periods(period)
        steps = math.ceil(periods * max(period / (v["step"] * limit), SMOOTH))
        dt = periods * period / steps
        state = None if chi is None else replace(fsi.initial_state(model, dt), bodies=({"chi": chi},))
        more: dict[str, Any] = {"observers": (follower,), "provenance": self.values_of(run)}
        return completed(
            fixed_steps(model, job.folder, dt, steps, rows=500, initial=state, **more), job
        ), steps

    def report(self, records: Sequence[Record], reference: None) -> Report:
        options = ("length", "element", "kernel", "ratio", "layers", "angle")
        table = [line for record in records for line in _lines(record)]
        return Report(
            parameters={**self.values, **{key: getattr(self, key) for key in options}},
            quantities={
                f"{r['kind']}, {r['thickness']:g} h": {
                    key: value for key, value in r.items() if isinstance(value, float) and key != "thickness"
                }
                for r in records
            },
            reference={"static": 1.0, "frequency_ratio": 1.0},
            table=table,
        )

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        title = f"Plate held across {self.length} spacings, and its waves"
        thin_plate(
            out / "plate.png",
            records,
            title=title,
            caption=f"{self.element}, {self.kernel}, nodes {self.ratio:g} h apart",
        )


def _frequency_at_rest(plate: ImmersedPlate) -> float:
    """Return the frequency of the first mode of a clamped plate with the fluid of its box [1/s]."""
    mass = plate.rho * (plate.thickness + plate.height)
    return CLAMPED * math.sqrt(plate.stiffness / mass) / plate.length**2


def _mean_where(solid: Structure, where: NDArray[np.bool_]) -> Array:
    """Return the weights of the mean over some nodes (collective)."""
    part = solid.weights * where
    return part / solid.comm.allreduce(part.sum())


def _lines(r: Record) -> list[Row]:
    """Return the lines of the table of one run."""
    t = f"{r['thickness']:g} h"
    if r["kind"] == "static":
        moving = f"{100.0 * r['settling']:+.2f} % over the last fifth of the run"
        return [
            row(f"deflection, thickness {t}", r["over_incompressible"], 1.0, "incompressible elements"),
            row("  over its own elements without a fluid", r["over_own"], 1.0, moving),
        ]
    theory = r.get("kernel_ratio")
    source = f"exact wave; the kernel's theory: {theory:.3f}" if theory else "exact wave"
    damping = f"; the kernel's theory: {r['kernel_damping']:.4f}" if theory else ""
    return [
        row(f"frequency, thickness {t}", r["frequency_ratio"], 1.0, source),
        row("  the exact wave's frequency over potential theory's", r["potential_ratio"]),
        row("  damping ratio", r["damping"], r["exact_damping"], f"exact wave{damping}"),
        row("  fluid dragged, as thickness", r["dragged"], unit="h"),
        row("  it swings about, over the first bend", r["rest"], 0.0, "flat", relative=False),
    ]


@dataclass(frozen=True, kw_only=True)
class Decay:
    """A decaying oscillation, c + a exp(s t), as its real part.

    Attributes:
        s: Complex rate [1/s].
        rest: Position c that it swings about, over its first value.
        misfit: Largest distance of the history from it, over the first value.
    """

    s: complex
    rest: float
    misfit: float


def decay(history: History, near: complex) -> Decay:
    """Return the oscillation that fits a history from a quarter of its period on.

    Args:
        history: Columns ``t_s`` and ``amplitude_cm``.
        near: A value near s [1/s].
    """
    t, a = history["t_s"], history["amplitude_cm"] / history["amplitude_cm"][0]
    late = t > 0.5 * math.pi / near.imag

    def shape(t: Array, rest: float, c: float, d: float, damping: float, omega: float) -> Array:
        wave: Array = rest + np.exp(-damping * t) * (c * np.cos(omega * t) + d * np.sin(omega * t))
        return wave

    swings = np.abs(np.fft.rfft(a - a.mean()))
    omega = near.imag if swings.argmax() < 2 else 2.0 * math.pi * swings.argmax() / t[-1]
    starts = [
        [0.0, 1.0, 0.0, -near.real, near.imag],
        [float(a.mean()), float(1.0 - a.mean()), 0.0, 0.0, omega],
    ]
    fits = [curve_fit(shape, t[late], a[late], p0=start, maxfev=5000)[0] for start in starts]
    misfits = [float(np.abs(shape(t[late], *fit) - a[late]).max()) for fit in fits]
    fit = fits[int(np.argmin(misfits))]
    return Decay(s=complex(-fit[3], abs(fit[4])), rest=float(fit[0]), misfit=min(misfits))
