"""Bending, stretching and twisting of a leaflet's strip: solid-shell elements against incompressible ones.

A strip of 10 x 5 mm, clamped at one end, flat or curved along its length:

    stiffness_ratio         pressure on one face, small: deflection of the end, incompressible over solid shell
    stiffness_ratio_90      pressure that follows the face, sides held across: pressures at which the end has turned by
                            90 degrees, solid shell over incompressible
    membrane_ratio          the end pulled by 0.1 %: energies, solid shell over incompressible
    membrane_free_ratio     the same with ends that are free to thin
    twist_ratio             the end turned about the strip's axis by 0.05: energies, solid shell over incompressible

The last three are of flat strips. The incompressible answers are those of Taylor-Hood elements (Q2-Q1), two layers,
finer towards clamps and corners, where they are singular.

A clamp that holds the thickness stiffens a pulled strip within about a thickness of it. Elements longer than that
spread this over their first row, whatever they are made of; ends that are free to thin show the element alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mpi4py import MPI
from scipy.interpolate import PchipInterpolator

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import row
from valvefsi.case.materials import make_material
from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.geometry.shapes import box
from valvefsi.post.plots.bending import edge_series
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.presets import PRESETS
from valvefsi.solid.statics import Fixed, SolidShell, TaylorHood, rotation
from valvefsi.solid.structure import Discretisation, Structure

if TYPE_CHECKING:
    from valvefsi.geometry.mesh import SolidMesh
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics.formulations import Formulation
    from valvefsi.types import Array

LENGTH, WIDTH = 1.0, 0.5
"""Of the strip [cm]."""
STOPS = tuple(1.5**k for k in range(-14, 1))
"""Parts of the largest pressure at which the rotation is looked at."""
LARGEST = 80.0
"""Largest pressure that is tried, in those which bend a strip of the matrix by a right angle in linear theory."""
QUADRATURE = 7

Motion = Callable[["Array", float], "Array"]
Answer = Callable[..., float]
"""What is measured: of a strip, elements along, across and through it, their kind, a communicator."""


class Counts(NamedTuple):
    """Elements along, across and through a strip; by how much each is longer than its neighbour nearer to the rim."""

    along: int
    across: int
    through: int
    growth: tuple[float, float] = (1.0, 1.0)


REFERENCE = Counts(20, 8, 2, growth=(1.25, 1.6))
"""Taylor-Hood elements of the references, 0.4 % too stiff at 0.2 mm; as many of one size are by 1.5 %."""
TURNED = Counts(16, 2, 3, growth=(1.3, 1.0))
"""The same where the end turns by 90 degrees and the sides, held across, have no corners to resolve."""


@dataclass(frozen=True, kw_only=True)
class Strip:
    """What is bent.

    Attributes:
        thickness: Thickness [cm].
        edge: Edges of the elements along the strip and across it [cm].
        layers: Elements through the thickness.
        material: Name of a preset.
        radius: Radius of the inner surface's middle at rest, None for a flat strip [cm].
        angle: Of the fibres to the strip's length [deg].
        kappa: Numerical bulk modulus [dyn/cm^2].
    """

    thickness: float = 0.04
    edge: float = 0.1
    layers: int = 1
    material: str = "bovine_pericardium_lee_sacks"
    radius: float | None = None
    angle: float = 0.0
    kappa: float = 1e8

    def __post_init__(self) -> None:
        for key in ("thickness", "edge"):
            if not 0 < getattr(self, key) <= WIDTH:
                raise CaseError("expected a length of at most 5 mm", key=key, value=getattr(self, key))
        if self.radius is not None and not self.radius > 2 * self.thickness:
            raise CaseError("expected at least two thicknesses", key="radius", value=self.radius)
        if self.material not in PRESETS:
            listed = ", ".join(PRESETS)
            raise CaseError(f"expected one of {listed}", key="material", value=self.material)

    @property
    def counts(self) -> Counts:
        """Elements along, across and through the strip; an even number across, so that nodes lie in the middle."""
        return Counts(round(LENGTH / self.edge), 2 * math.ceil(WIDTH / self.edge / 2 - 1e-9), self.layers)


def answers(strip: Strip) -> dict[str, Answer]:
    """Return what is measured of a strip by name of its ratio; each takes elements of one kind (collective)."""
    measures: dict[str, Answer] = {"stiffness_ratio": deflection, "stiffness_ratio_90": right_angle}
    if strip.radius is None:
        measures["membrane_ratio"] = partial(energy_of, fixed=clamped(pull))
        measures["membrane_free_ratio"] = partial(energy_of, fixed=free_to_thin(pull))
        measures["twist_ratio"] = partial(energy_of, fixed=clamped(rotation(0.05, **AXIS)))
    return measures


def reference_counts(name: str) -> Counts:
    """Return the Taylor-Hood elements that a ratio's reference is computed with."""
    return TURNED if name == "stiffness_ratio_90" else REFERENCE


def ratio_of(name: str, own: float, reference: float) -> float:
    """Return the ratio of stiffness, solid shell over incompressible; a deflection is the other way round."""
    return reference / own if name == "stiffness_ratio" else own / reference


def ratios(strip: Strip, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, float]:
    """Return the ratios of stiffness, 1 for an element that neither locks nor is too soft (collective)."""
    numbers = {}
    for name, answer in answers(strip).items():
        reference = answer(strip, reference_counts(name), TaylorHood(), comm)
        numbers[name] = ratio_of(
            name, answer(strip, strip.counts, SolidShell(kappa=strip.kappa), comm), reference
        )
    return numbers


def series(strip: Strip, comm: MPI.Comm = MPI.COMM_WORLD) -> dict[str, list[float]]:
    """Return the edges 2 E, E, E/2 and the ratio of bending stiffness with one and with two layers (collective)."""
    expected = deflection(strip, REFERENCE, TaylorHood(), comm)
    numbers: dict[str, list[float]] = {"edge_cm": [2 * strip.edge, strip.edge, strip.edge / 2]}
    for layers in (1, 2):
        finer = [replace(strip, edge=edge, layers=layers) for edge in numbers["edge_cm"]]
        shell = SolidShell(kappa=strip.kappa)
        numbers[f"layers_{layers}"] = [expected / deflection(s, s.counts, shell, comm) for s in finer]
    linear = statics.NearlyIncompressible(degree=1, kappa=strip.kappa)
    numbers["linear_hexahedra"] = [
        expected / deflection(s, s.counts, linear, comm)
        for s in (replace(strip, edge=edge) for edge in numbers["edge_cm"])
    ]
    return numbers


AXIS = {"axis": (1.0, 0.0, 0.0), "through": (0.0, WIDTH / 2, 0.0)}


def pull(X: Array, s: float) -> Array:
    """Return the displacement of an end that is pulled by 0.1 % of the length."""
    return np.outer(np.full(len(X), 1e-3 * LENGTH * s), (1.0, 0.0, 0.0))


def clamped(motion: Motion) -> list[Fixed]:
    """Return the supports of both ends, one of them moved."""
    return [Fixed(on=("x_lower",)), Fixed(on=("x_upper",), value=motion)]


def free_to_thin(motion: Motion) -> list[Fixed]:
    """Return supports that hold both ends along and across the strip only; the strip lies on a plane."""
    ends = [replace(end, components=("x", "y")) for end in clamped(motion)]
    return [*ends, Fixed(on=("z_lower",), components=("z",))]


def material_of(strip: Strip) -> Material:
    """Return the material; dispersed fibres with the transition that Newton's method can rest on."""
    preset = PRESETS[strip.material]
    material = make_material(preset.model, preset.parameters)
    if any(family.kappa > 0 for family in getattr(material, "families", ())):
        return replace(material, width=0.01)
    return material


def mesh_of(strip: Strip, counts: Counts, comm: MPI.Comm) -> SolidMesh:
    """Return the strip's mesh with its fibres (collective)."""
    thickness, radius = strip.thickness, strip.radius
    size = LENGTH, WIDTH, thickness
    mesh = box(comm, lower=(0.0, 0.0, -thickness / 2), size=size, elements=tuple(counts[:3]))
    X = mesh.mesh.geometry.x
    for axis, count in enumerate((counts.along, counts.across)):
        X[:, axis] = _graded(X[:, axis] / size[axis], count, counts.growth[axis]) * size[axis]
    if radius is not None:
        turn, r = X[:, 0] / radius, radius + X[:, 2]
        X[:, 0], X[:, 2] = r * np.sin(turn), r * np.cos(turn) - radius
    along, across = math.cos(math.radians(strip.angle)), math.sin(math.radians(strip.angle))

    def direction(x: Array) -> Array:
        turn = np.zeros(len(x)) if radius is None else np.arctan2(x[:, 0], x[:, 2] + radius)
        return np.stack([along * np.cos(turn), across + 0 * turn, -along * np.sin(turn)], axis=1)

    return mesh.with_fibres(fibre=fibres.from_function(mesh, direction))


def _graded(x: Array, count: int, growth: float) -> Array:
    """Return where points between 0 and 1 of even elements are, once the elements grow from both ends to the middle."""
    lengths = growth ** np.minimum(np.arange(count), np.arange(count)[::-1])
    ends = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
    graded: Array = np.interp(x, np.linspace(0.0, 1.0, count + 1), ends)
    return graded


def _unit_pressure(strip: Strip) -> float:
    """Return the pressure that turns the end of a flat strip of the matrix by 1 in linear theory [dyn/cm^2]."""
    return 6 * 4 * material_of(strip).shear_modulus * strip.thickness**3 / 12 / LENGTH**3


def _end(strip: Strip, height: float) -> tuple[float, float, float]:
    """Return a point in the middle of the strip's end, at a height over its middle surface."""
    if strip.radius is None:
        return LENGTH, WIDTH / 2, height
    turn, r = LENGTH / strip.radius, strip.radius + height
    return r * math.sin(turn) - 1e-9, WIDTH / 2, r * math.cos(turn) - strip.radius


def deflection(strip: Strip, counts: Counts, formulation: Formulation | SolidShell, comm: MPI.Comm) -> float:
    """Return the deflection of the end under a pressure that turns it by about a degree (collective)."""
    solution = statics.solve(
        mesh_of(strip, counts, comm),
        material_of(strip),
        fixed=[Fixed(on=("x_lower",))],
        loads=[Pressure(on=("z_lower",), value=0.02 * _unit_pressure(strip))],
        formulation=formulation,
        options=statics.SolverOptions(quadrature_degree=QUADRATURE, first_increment=1.0),
    )
    return float(np.linalg.norm(solution.displacement_at(_end(strip, 0.0))))


class _Reached(Exception):
    """The end has turned far enough."""


def right_angle(strip: Strip, counts: Counts, formulation: Formulation | SolidShell, comm: MPI.Comm) -> float:
    """Return the pressure at which the end has turned by 90 degrees [dyn/cm^2] (collective)."""
    largest = LARGEST * 0.5 * math.pi * _unit_pressure(strip)
    reach = 0.498 * strip.thickness
    ends = np.array([_end(strip, -reach), _end(strip, reach)])
    turns, pressures = [0.0], [0.0]

    def look(s: float, solution: statics.StaticSolution) -> None:
        normal, before = np.diff(ends + solution.displacement_at(ends), axis=0)[0], np.diff(ends, axis=0)[0]
        turned = math.atan2(before[0], before[2]) - math.atan2(normal[0], normal[2])
        turns.append(turned % (2 * math.pi))
        pressures.append(s * largest)
        if turns[-1] > 0.5 * math.pi:
            raise _Reached

    supports = [Fixed(on=("x_lower",)), Fixed(on=("y_lower", "y_upper"), components=("y",))]
    options = statics.SolverOptions(
        quadrature_degree=QUADRATURE, first_increment=STOPS[0], smallest_increment=1e-6, stops=STOPS
    )
    try:
        statics.solve(
            mesh_of(strip, counts, comm),
            material_of(strip),
            fixed=supports,
            loads=[Pressure(on=("z_lower",), value=largest)],
            formulation=formulation,
            options=options,
            on_stop=look,
        )
    except _Reached:
        return float(PchipInterpolator(turns, pressures)(0.5 * math.pi))
    raise ConvergenceError(
        f"bending: the end of the strip turned by {math.degrees(turns[-1]):.3g} degrees only"
    )


def energy_of(
    strip: Strip,
    counts: Counts,
    formulation: Formulation | SolidShell,
    comm: MPI.Comm,
    *,
    fixed: Sequence[Fixed],
) -> float:
    """Return the strain energy of a strip on its supports [erg] (collective)."""
    mesh, material = mesh_of(strip, counts, comm), material_of(strip)
    solution = statics.solve(
        mesh,
        material,
        fixed=fixed,
        formulation=formulation,
        options=statics.SolverOptions(quadrature_degree=QUADRATURE, first_increment=1.0),
    )
    if isinstance(formulation, SolidShell):
        solid = Structure(
            mesh, material, discretisation=Discretisation(element="solid_shell", kappa=strip.kappa)
        )
    else:
        quadratic = Discretisation(degree=2, quadrature_degree=QUADRATURE)
        solid = Structure(mesh, material, nu_stab=None, discretisation=quadratic)
    position = solid.elasticity.position
    position.interpolate(solution.displacement)  # statics may number its nodes in another order
    return solid.energy(solid.X + position.x.array.reshape(-1, 3)[: len(solid.X)])


@dataclass(frozen=True, kw_only=True)
class Bending(Benchmark[Strip, None]):
    """Solid-shell elements against incompressible ones."""

    name = "bending"
    keeps = True

    thickness: float = option(0.4, "Thickness of the strip [mm].")
    edge: float = option(1.0, "Edge of the elements [mm].")
    layers: int = option(1, "Elements through the thickness.", least=1, most=4)
    material: str = option("bovine_pericardium_lee_sacks", "Name of a preset.")
    radius: str = option("flat", "Radius at rest [mm], or flat.", metavar="MM|flat")
    angle: float = option(0.0, "Angle of the fibres to the strip's length [deg].")
    kappa: float = option(1e8, "Numerical bulk modulus [dyn/cm^2].")

    def check(self, values: Values) -> None:
        self.runs()

    def runs(self) -> list[Strip]:
        try:
            radius = None if self.radius == "flat" else 0.1 * float(self.radius)
        except ValueError:
            raise CaseError("expected a number, or flat", key="--radius", value=self.radius) from None
        strip = Strip(
            thickness=0.1 * self.thickness,
            edge=0.1 * self.edge,
            layers=self.layers,
            material=self.material,
            radius=radius,
            angle=self.angle,
            kappa=self.kappa,
        )
        return [strip]

    def one(self, run: Strip, job: Job) -> Record:
        return {"ratios": ratios(run, job.comm), "series": series(run, job.comm)}

    def report(self, records: Sequence[Record], reference: None) -> Report:
        (r,) = records
        source = "mixed Q2-Q1 elements, {} x {} x {}, graded".format(*REFERENCE)
        return Report(
            parameters=asdict(self.runs()[0]),
            quantities=r["ratios"],
            reference=dict.fromkeys(r["ratios"], 1.0),
            more={"series": r["series"]},
            table=[row(name, value, 1.0, source) for name, value in r["ratios"].items()],
        )

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        title = f"Bending stiffness of a strip, {self.material}"
        edge_series(out / "bending.png", records[0]["series"], title=title)
