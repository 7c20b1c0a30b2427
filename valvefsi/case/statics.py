"""Static equilibrium of one solid of a case under a pressure: a leaflet without fluid, and what it bears."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI
from pydantic import ValidationError

from valvefsi.case.fibres import add_fibres
from valvefsi.case.materials import make_material
from valvefsi.case.meshes import leaflet_mesh, solid_mesh
from valvefsi.case.models import Case, Solid
from valvefsi.case.reading import one_line
from valvefsi.case.statics_tables import StaticsModel
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.solid import statics
from valvefsi.solid.loads import Pressure
from valvefsi.solid.peaks import percentile, together
from valvefsi.solid.stress import Stress
from valvefsi.solid.structure_stress import stress_of_equilibrium

SECTOR = math.pi / 3
"""Half of the angle that a leaflet has for itself [rad]."""
OPTIONS = statics.SolverOptions(first_increment=0.02, smallest_increment=1e-4)
"""Load steps: a leaflet without fluid is slack until it is under tension."""
KPA = 1e4
"""1 kPa [dyn/cm^2]."""


def changed_model(model: StaticsModel, values: Mapping[str, str], file: Path | None) -> StaticsModel:
    """Return a model with other values, as texts with their units.

    Raises:
        CaseError: A key is unknown, or a value cannot be used.
    """
    raw = {**model.model_dump(), **values}
    try:
        return StaticsModel.model_validate(raw)
    except ValidationError as error:
        raise one_line(error, raw, file, ()) from None


@dataclass(frozen=True, kw_only=True)
class SolidAtRest:
    """A solid of a case in static equilibrium.

    Attributes:
        given: Its table in the case.
        mesh: Its mesh, of a valve that of one leaflet.
        solution: Displacement and pressure.
        stress: Strain and stress.
        planes: What it may touch.
    """

    given: Solid
    mesh: SolidMesh
    solution: statics.StaticSolution
    stress: Stress
    planes: tuple[statics.Contact, ...]

    def numbers(self) -> dict[str, float]:
        """Return what is reported, by name with unit.

        Strain and stress are the largest principal ones, Green's and Cauchy's; "p99": 99 % of the volume does not
        exceed it.

        Note:
            Collective.
        """
        found = _peaks(self.stress) | _movement(self.solution, self.given)
        if self.given.element == "solid_shell":  # others are incompressible
            found["volume_change_percent"] = 100.0 * (self.solution.volume_ratio() - 1.0)
        if self.planes:
            u = self.solution.displacement
            found["contact_area_cm2"] = statics.contact_area(self.mesh, u, self.planes)
        return found


def solve_solid(case: Case, model: StaticsModel, comm: MPI.Comm = MPI.COMM_SELF) -> SolidAtRest:
    """Find the static equilibrium of a solid of a case under a pressure; of a valve that of one leaflet.

    Solid-shell elements where the case has them, with its bulk modulus; exactly incompressible mixed elements
    elsewhere. A leaflet stays in its sector, between two planes without friction that its neighbours' images reach
    from the other side: three leaflets that close alike.

    Args:
        case: The case; its fluid, circuits and loads are not looked at.
        model: Which solid, what holds it and what loads it.
        comm: Communicator of the solution.

    Raises:
        CaseError: The case has no such solid, or a tag is none of its mesh.
        ConvergenceError: No equilibrium was found.

    Note:
        Collective.
    """
    given = _solid(case, model)
    mesh = _mesh(case, given, comm)
    material = make_material(given.material.model, given.material.parameters)
    formulation = _formulation(given)
    planes = _planes(model)
    held = [statics.Fixed(on=support.on, components=support.components) for support in model.held]
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # of steps that Newton's method takes back
            solution = statics.solve(
                mesh,
                material,
                fixed=[*held, *planes],
                loads=[Pressure(on=model.on, value=model.pressure)],
                formulation=formulation,
                options=OPTIONS,
            )
    except CaseError as error:
        raise CaseError(error.reason, file=case.file, key=f"statics.{error.key}", value=error.value) from None
    stress = stress_of_equilibrium(solution, mesh, material, formulation)
    return SolidAtRest(given=given, mesh=mesh, solution=solution, stress=stress, planes=planes)


def _formulation(given: Solid) -> statics.SolidShell | statics.TaylorHood:
    if given.element == "solid_shell":
        return statics.SolidShell(nu_stab=given.nu_stab, kappa=given.kappa, volumetric=given.volumetric)
    return statics.TAYLOR_HOOD


def _solid(case: Case, model: StaticsModel) -> Solid:
    found = next((solid for solid in case.solid if solid.name == model.solid), None)
    if found is None:
        names = ", ".join(solid.name for solid in case.solid) or "none"
        raise CaseError(
            f"the case has no such solid; it has {names}",
            file=case.file,
            key="statics.solid",
            value=model.solid,
        )
    if found.mesh.valve is None and model.contact:
        message = "only a valve that valvefsi meshes knows the planes between its leaflets"
        raise CaseError(message, file=case.file, key="statics.contact", value=list(model.contact))
    return found


def _mesh(case: Case, given: Solid, comm: MPI.Comm) -> SolidMesh:
    """Return the mesh of a solid, of a valve that of one leaflet, with its fibres."""
    mesh = (
        leaflet_mesh(given.mesh.valve, case.grid.spacing, comm)
        if given.mesh.valve is not None
        else solid_mesh(case, case.solid.index(given), comm)
    )
    return add_fibres(mesh, given.fibre, f"solid.{given.name}", given.material, given.mesh.leaflets)


def _planes(model: StaticsModel) -> tuple[statics.Contact, ...]:
    """Return the two planes between a leaflet and its neighbours."""
    if not model.contact:
        return ()
    return tuple(
        statics.Contact(
            on=model.contact,
            normal=(-math.sin(SECTOR), side * math.cos(SECTOR), 0.0),
            stiffness=model.pressure / model.contact_depth,
        )
        for side in (-1.0, 1.0)
    )


def _peaks(stress: Stress) -> dict[str, float]:
    comm = stress.mesh.comm
    values = stress.at_points("principal_stretches", "principal_stresses")
    parts = {
        "largest_principal_strain": (0.5 * (values["principal_stretches"][..., 0] ** 2 - 1.0), ""),
        "largest_principal_stress": (values["principal_stresses"][..., 0] / KPA, "_kPa"),
    }
    volume, found = together(comm, stress.point_volumes()), {}
    for name, (array, unit) in parts.items():
        x = together(comm, array)
        found[f"{name}_p99{unit}"] = percentile(x, volume)
        found[f"{name}_max{unit}"] = float(x.max())
    return found


def _movement(solution: statics.StaticSolution, given: Solid) -> dict[str, float]:
    """Return how far the solid moves, and of a leaflet the middle of its free edge [mm]."""
    space, shape = solution.displacement.function_space, given.mesh.valve
    comm, dim = space.mesh.comm, space.mesh.geometry.dim
    owned = space.dofmap.index_map.size_local
    X = together(comm, space.tabulate_dof_coordinates()[:owned]).reshape(-1, 3)
    u = together(comm, solution.displacement.x.array[: dim * owned]).reshape(-1, dim)
    moved = 10.0 * np.linalg.norm(u, axis=1)
    found = {"largest_displacement_mm": float(moved.max())}
    if shape is not None:
        middle = shape.geometry().free_edge(np.zeros(1))[0] + [0.0, 0.0, shape.base]
        node = int(np.argmin(np.linalg.norm(X - middle, axis=1)))
        found["free_edge_displacement_mm"] = float(moved[node])
    return found
