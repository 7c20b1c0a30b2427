"""The tables of a case file as typed models; all quantities in them are CGS numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self, get_args

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator
from pydantic_core import PydanticCustomError

from valvefsi.case.circuit_tables import CircuitTable
from valvefsi.case.fluid_tables import MOST, SIDES, Fluid, Grid
from valvefsi.case.material_tables import Fibre, Material
from valvefsi.case.output_tables import Force, Line, Section
from valvefsi.case.quantities import (
    BodyDamping,
    Density,
    Length,
    Permeability,
    Quantity,
    StepPerSpacing,
    Stress,
    Time,
    Viscosity,
)
from valvefsi.case.table import Name, Table, problem
from valvefsi.case.target_tables import Target
from valvefsi.case.valve_tables import Housing, OwnLeaflets, ValveShape
from valvefsi.types import Unchecked

Axis = Literal["x", "y", "z"]
Kernel = Literal[
    "piecewise_linear",
    "bspline3",
    "bspline4",
    "bspline5",
    "bspline6",
    "ib3",
    "ib4",
    "ib5",
    "ib6",
    "composite_bspline32",
    "composite_bspline43",
    "composite_bspline54",
    "composite_bspline65",
]
SolidQuantity = Literal[
    "pk1", "pk2", "cauchy", "principal_stresses", "von_mises", "principal_stretches", "fibre_stretch", "J"
]
MOST_STEPS = 10**9
"""Time steps that a run may have."""
RECTANGLE = ("body", *SIDES[:4])
SHAPES = {
    "compressed_block": (2, ("block", "bottom", "sides", "top_loaded", "top_outer")),
    "rectangle": (2, RECTANGLE),
    "box": (3, ("body", *SIDES)),
}
"""Shapes that valvefsi meshes itself: dimension and tags."""


class TimeStepping(Table):
    """Steps and end of the run."""

    dt: Time | None = Field(None, gt=0, description="Time step; or give dt_per_h", examples=["1 ms"])
    dt_per_h: StepPerSpacing | None = Field(
        None, gt=0, description="Time step per grid spacing, dt = dt_per_h h", examples=["0.001 s/cm"]
    )
    t_end: Time = Field(gt=0, description="End of the run")
    control: Literal["fixed", "adaptive"] = Field(
        "fixed",
        description='"fixed": every step is dt; "adaptive": dt is the largest step, shorter for cfl or the solids',
    )
    cfl: float = Field(0.25, gt=0, le=1, description="CFL number |u| dt/h that adaptive steps aim at")
    cfl_max: float = Field(0.5, gt=0, le=1, description="Largest CFL number |u| dt/h that is accepted")
    max_recoveries: int = Field(
        5,
        ge=0,
        le=MOST,
        description="adaptive only: times the run may go back to its last good state and take shorter steps",
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.dt is None) == (self.dt_per_h is None):
            found = "neither is given" if self.dt is None else "both are given"
            raise problem(f"give dt or dt_per_h; {found}", "dt", self.dt)
        if self.control == "adaptive" and self.cfl > self.cfl_max:
            raise problem(f"expected at most cfl_max, {self.cfl_max:g}", "cfl", self.cfl)
        return self

    def step(self, h: float) -> float:
        """Return the time step on a grid of spacing h [s]."""
        return self.dt if self.dt is not None else (self.dt_per_h or 0.0) * h


class Mesh(Table):
    """Where the mesh of a solid comes from: a gmsh file, a shape that valvefsi meshes, or a valve."""

    file: str | None = Field(
        None,
        description="gmsh file (.msh, in cm), relative to the case file; or give shape",
        examples=["block.msh"],
    )
    shape: Literal["compressed_block", "rectangle", "box"] | None = Field(
        None,
        description='"compressed_block", "rectangle" or "box"; or give file. Tags of their facets: x_lower, x_upper, '
        "y_lower, y_upper (and z_lower, z_upper), of a compressed_block bottom, sides, top_loaded, top_outer; of all "
        "cells: body, of a compressed_block block",
    )
    lower: tuple[Length, ...] = Field((), description="Lower corner of the shape")
    size: tuple[Annotated[Length, Field(gt=0)], ...] = Field((), description="Edge lengths of the shape")
    elements: tuple[Annotated[int, Field(ge=1, le=MOST)], ...] = Field(
        (), description="Elements along each edge"
    )
    cell: Literal["quadrilateral", "triangle", "hexahedron", "tetrahedron"] | None = Field(
        None,
        description="Cells: quadrilateral (default) or triangle, in 3-D hexahedron (default) or tetrahedron",
    )
    load_width: Length | None = Field(
        None,
        gt=0,
        description="compressed_block only: width of the loaded part of the top",
        examples=["10 cm"],
    )

    valve: ValveShape | None = Field(None, description="Leaflets of a valve; or give file or shape")
    leaflets: OwnLeaflets | None = Field(None, description="What the tags of a file with leaflets are")

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = [key for key in ("file", "shape", "valve") if getattr(self, key) is not None]
        if len(given) != 1:
            found = (
                "neither is given" if not given else "both are given" if len(given) == 2 else "all are given"
            )
            raise problem(f"give file, shape or valve; {found}", "shape", self.shape)
        if self.leaflets is not None and self.file is None:
            raise problem("it says what the tags of a file are; leave it out", "leaflets")
        if self.shape is None:
            return self
        dim = self.shape_dim
        for key in ("lower", "size", "elements"):
            if len(getattr(self, key)) != dim:
                raise problem(f"a {self.shape} needs {dim} entries", key, list(getattr(self, key)))
        cells = ("quadrilateral", "triangle") if dim == 2 else ("hexahedron", "tetrahedron")
        if self.cell not in (None, *cells):
            raise problem(f"a {self.shape} has cells {cells[0]!r} or {cells[1]!r}", "cell", self.cell)
        if (self.load_width is not None) != (self.shape == "compressed_block"):
            found = "needs a" if self.load_width is None else "has no"
            raise problem(f"a {self.shape} {found} load_width", "load_width", self.load_width)
        return self

    @property
    def valve_diameter(self) -> float | None:
        """Diameter of the orifice of the valve that it holds [cm]; None without one."""
        valve = self.valve or self.leaflets
        return None if valve is None else valve.diameter

    @property
    def shape_dim(self) -> int:
        """Dimension of the shape."""
        return SHAPES[str(self.shape)][0]


class Tether(Table):
    """Springs and dampers that hold a solid where it was, kappa (X - chi) - eta U."""

    on: tuple[str, ...] = Field((), description="Tags of facets it holds; empty for the whole body")
    components: tuple[Axis, ...] = Field(
        (), description='Axes it acts along, of "x", "y", "z"; empty for all'
    )
    stiffness: float = Field(
        gt=0, description="Stiffness kappa [dyn/cm^3 on facets, dyn/cm^4 in the whole body]"
    )
    damping: float = Field(
        0.0, ge=0, description="Damping eta [dyn*s/cm^3 on facets, dyn*s/cm^4 in the whole body]"
    )

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Unchecked) -> Unchecked:
        if not isinstance(data, Mapping):
            return data
        read = dict(data)
        for key, unit in _tether_units(bool(data.get("on"))).items():
            if key in data:
                try:
                    read[key] = Quantity(unit).parse(data[key])
                except PydanticCustomError as error:
                    raise problem(error.message(), key, data[key]) from None
        return read

    def unit(self, key: str) -> str | None:
        """Return the unit of a key."""
        return _tether_units(bool(self.on)).get(key)


def _tether_units(on_facets: bool) -> dict[str, str]:
    power = 3 if on_facets else 4
    return {"stiffness": f"dyn/cm^{power}", "damping": f"dyn*s/cm^{power}"}


class Load(Table):
    """A traction per reference area that keeps its direction."""

    on: tuple[str, ...] = Field(min_length=1, description="Tags of the facets that carry it")
    traction: tuple[Stress, ...] = Field(description="Traction, one entry per dimension")
    ramp: Time = Field(0.0, ge=0, description="Time until the load is whole; 0 for at once")
    ramp_shape: Literal["linear", "smooth"] = Field(
        "linear", description='"linear" or "smooth" (3 s^2 - 2 s^3)'
    )


class Probe(Table):
    """A node of the solid whose displacement is in the history."""

    name: Name = Field(description="Name, ends the column names u_x_NAME_cm ...")
    at: tuple[Length, ...] = Field(description="Reference position; the nearest node is taken")


def _off(value: Unchecked) -> Unchecked:
    """Read "off" as None."""
    if value is None or value == "off":
        return None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise problem('expected a number above -1 and below 0.5, or "off"')
    if not -1 < value < 0.5:
        near = 0.49 if value > 0 else -0.99
        raise problem(f'expected a number above -1 and below 0.5, or "off"; a near one is {near}')
    return value


class Solid(Table):
    """A hyperelastic solid immersed in the fluid."""

    name: Name = Field(description="Name, used for files, in --set and in messages")
    element: Literal["lagrange", "solid_shell"] = Field(
        "lagrange",
        description='"lagrange", or "solid_shell" for leaflets and other thin incompressible bodies of hexahedra',
    )
    faces: tuple[str, ...] = Field(
        (),
        description="solid_shell only: tags of the two faces that the thickness lies between; found from the elements "
        "when left out, for leaflets of a file from inflow and outflow",
        examples=[["lower", "upper"]],
    )
    degree: Literal[1, 2] = Field(1, description="Polynomial degree of the elements, 1 or 2")
    quadrature_degree: int | None = Field(
        None,
        ge=1,
        le=20,
        description="Degree the quadrature is exact for; 2 degree + 1 when left out",
        examples=[3],
    )
    kernel: Kernel = Field("bspline3", description="Kernel of the coupling: " + ", ".join(get_args(Kernel)))
    coupling: Literal["nodal", "elemental"] = Field(
        "nodal",
        description='Coupling at the "nodal" points, or "elemental": at quadrature points that follow the elements',
    )
    point_gap: float = Field(
        0.75, gt=0, description="elemental only: largest gap between neighbouring points, in grid spacings"
    )
    mass: Literal["consistent", "lumped"] = Field(
        "consistent", description='elemental only: mass of the projections, "consistent" or "lumped" (faster)'
    )
    density: Density | None = Field(
        None,
        gt=0,
        description="Density, that of the fluid or larger; that of the fluid when left out",
        examples=["1.1 g/cm^3"],
    )
    damping: BodyDamping = Field(0.0, ge=0, description="Damping eta of the whole body, force density -eta U")
    viscosity: Viscosity = Field(
        0.0,
        ge=0,
        description="Viscosity of the solid on top of the fluid's (Kelvin-Voigt)",
        examples=["100 P"],
    )
    permeability: Permeability = Field(
        0.0,
        ge=0,
        description="Hydraulic permeability k: the solid slips with k f through the fluid under a force density f",
        examples=["1e-10 cm^4/(dyn*s)"],
    )
    seepage: Literal["porous", "unresolved"] = Field(
        "porous",
        description='What permeability acts on: all forces ("porous"), or what the grid does not resolve of them '
        '("unresolved", nodal coupling: no fluid passes under a smooth load)',
    )
    nu_stab: Annotated[float | None, BeforeValidator(_off)] = Field(
        0.4, description='Numerical Poisson ratio of the volumetric term, above -1 and below 0.5, or "off"'
    )
    mesh: Mesh = Field(description="Mesh")
    kappa: Stress | None = Field(
        None,
        ge=0,
        description="Numerical bulk modulus instead of the one from nu_stab",
        examples=["400 dyn/cm^2"],
    )
    volumetric: Literal["log", "quadratic", "simo_taylor"] = Field(
        "log",
        description='Volumetric term: "log" (kappa/2 (ln J)^2), "quadratic" (kappa/2 (J - 1)^2) or "simo_taylor"',
    )
    volumetric_degree: int | None = Field(
        None,
        ge=1,
        le=20,
        description="Quadrature degree of what kappa adds to the bulk modulus of nu_stab, that of the forces when "
        "left out; 1 frees linear quadrilaterals and hexahedra from volumetric locking, 3 quadratic ones",
        examples=[1],
    )
    material: Material = Field(description="Material")
    fibre: tuple[Fibre, ...] = Field((), description="Fibre fields")
    tether: tuple[Tether, ...] = Field((), description="Tethers")
    load: tuple[Load, ...] = Field((), description="Loads")
    probe: tuple[Probe, ...] = Field((), description="Probes")

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.seepage == "unresolved" and self.coupling != "nodal":
            raise problem('expected coupling = "nodal" with it', "seepage", self.seepage)
        if self.faces and (len(self.faces) != 2 or self.element != "solid_shell"):
            found = "expected two tags" if self.element == "solid_shell" else "solid_shell only; leave it out"
            raise problem(found, "faces", list(self.faces))
        return self

    @property
    def quadrature(self) -> int:
        """Quadrature degree in use."""
        return self.quadrature_degree if self.quadrature_degree is not None else 2 * self.degree + 1


class Output(Table):
    """What is written, and how often."""

    history_every: int = Field(100, ge=1, le=MOST_STEPS, description="Steps between two rows of history.csv")
    frames: int = Field(
        20, ge=0, le=MOST, description="Frames of the ParaView series over the run, 0 for none"
    )
    checkpoint_every: int = Field(
        0, ge=0, le=MOST_STEPS, description="Steps between two checkpoints, 0 for none by steps"
    )
    checkpoint_wall: Time = Field(
        600.0, ge=0, description="Wall-clock time between two checkpoints, 0 for none by the clock"
    )
    keep_checkpoints: int = Field(2, ge=1, le=MOST, description="Checkpoints that are kept")
    dissipation: bool = Field(
        False, description="Whether the history holds the viscous dissipation of the box"
    )
    energy: bool = Field(
        False, description="Whether the history holds the balance of energy, see `valvefsi.run.energy`"
    )
    stress: tuple[SolidQuantity, ...] = Field(
        (),
        description="Stresses and strains of the solids in ParaView files beside the frames: "
        + ", ".join(get_args(SolidQuantity)),
    )
    fluid_every: int = Field(
        1, ge=1, description="Cells along each axis of which the frames of the fluid hold one"
    )
    fluid_lower: tuple[Length, ...] = Field(
        (), description="Lower corner of the part of the box that the frames hold; all of it when left out"
    )
    fluid_upper: tuple[Length, ...] = Field((), description="Upper corner of that part")
    averages_from: Time | None = Field(
        None,
        ge=0,
        description="Time from which on velocity and pressure are averaged; not at all when left out",
        examples=["0.5 s"],
    )
    units: Literal["lab", "cgs"] = Field(
        "lab",
        description='Units of the numbers that a run ends with on the terminal: "lab" (mm, mmHg, ml/s, mJ) or "cgs"',
    )
    section: tuple[Section, ...] = Field((), description="Planes and disks whose flow the history holds")
    line: tuple[Line, ...] = Field((), description="Lines along which profiles are written at the end")
    force: tuple[Force, ...] = Field((), description="Forces of the fluid on bodies in the history")


class Start(Table):
    """What the run begins from; at rest without it."""

    run: str = Field(
        "",
        description="Folder of another run of the same bodies in the same box, on other grids and meshes, relative "
        "to the case file: its newest state, interpolated; empty for rest",
        examples=["results/coarse"],
    )


class Case(Table):
    """A case: fluid, solids, time and output."""

    title: str = Field("", description="What this case is")
    grid: Grid = Field(description="Grid")
    fluid: Fluid = Field(Fluid(), description="Fluid")
    time: TimeStepping = Field(description="Time")
    output: Output = Field(Output(), description="Output")
    circuit: tuple[CircuitTable, ...] = Field((), description="Circuits of the flow loop")
    solid: tuple[Solid, ...] = Field((), description="Solids")
    housing: Housing | None = Field(None, description="Rigid aortic test section")
    start: Start | None = Field(None, description="What the run begins from")
    target: Target | None = Field(
        None, description="Operating condition that pump and resistance are chosen for"
    )
    _file: Path | None = PrivateAttr(None)
    _trust: bool = PrivateAttr(False)
    _origins: dict[str, str] = PrivateAttr(default_factory=dict)
    _written: dict[str, object] = PrivateAttr(default_factory=dict)

    @property
    def trust(self) -> bool:
        """Whether Python files of materials may be run."""
        return self._trust

    @property
    def file(self) -> Path | None:
        """The file it was read from."""
        return self._file

    @property
    def origins(self) -> dict[str, str]:
        """Where the values that were given are from, by their paths, see `valvefsi.case.origins`."""
        return self._origins

    @property
    def written(self) -> dict[str, object]:
        """Values as they were written, by their paths, see `valvefsi.case.values`."""
        return self._written

    @property
    def dt(self) -> float:
        """Time step [s]."""
        return self.time.step(self.grid.spacing)
