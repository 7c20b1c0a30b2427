"""From the tables of a valve and its test section to meshes and rigid surfaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from valvefsi.bodies.filling import Filling
from valvefsi.bodies.patches import PatchedSurface
from valvefsi.bodies.rigid import RigidSurface
from valvefsi.case.models import Case
from valvefsi.case.valve_tables import ValveShape
from valvefsi.coupling.kernel_properties import largest_square_sum
from valvefsi.coupling.offsets import surface_offset
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, StabilityError, raise_together
from valvefsi.geometry.aortic_section import PointSurface, attachment_line, joined
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.geometry.patches import patch_labels
from valvefsi.geometry.valve import ValveMesh, distribute, mesh_valve
from valvefsi.grid import MacGrid
from valvefsi.run.recording import Orifice
from valvefsi.solid.materials import fibres
from valvefsi.types import Array, Indices

KERNEL = "composite_bspline32"
"""Kernel of rigid surfaces: it turns a uniform pressure on them into the gradient of one."""

LINE = 720
"""Points around the axis that mark where the leaflets are attached."""


def valve_mesh(shape: ValveShape, h: float, comm: MPI.Comm) -> SolidMesh:
    """Mesh the leaflets of a valve for a grid of spacing h, with fibre fields fibre_1, ... and fibre, the first.

    The leaflets' own directions are the fields circumferential and radial.

    Note:
        Collective.
    """
    made = moved(mesh_valve(shape.geometry(), size=shape.ratio * h, layers=shape.layers), shape.base)
    mesh = distribute(made, comm)
    middles = made.points[made.cells].mean(axis=1)
    fields = {name: fibres.from_cells(mesh, middles, vectors) for name, vectors in made.fibres.items()}
    return mesh.with_fibres(**fields, fibre=fields["fibre_1"])


def moved(mesh: ValveMesh, z: float) -> ValveMesh:
    """Return a valve's mesh, moved along its axis."""
    return replace(mesh, points=mesh.points + [0.0, 0.0, z])


def find_orifice(case: Case) -> Orifice | None:
    """Return the orifice of a case with a valve in a housing, None without one."""
    found = stented(case)
    return None if found is None else Orifice(body=found[0], radius=0.5 * found[1].diameter)


def stented(case: Case) -> tuple[int, ValveShape] | None:
    """Return number of the solid and shape of the valve in a case's housing, None without one."""
    stent = case.housing.stent if case.housing is not None else None
    for number, solid in enumerate(case.solid):
        if solid.name == stent and solid.mesh.valve is not None:
            return number, solid.mesh.valve
    return None


def valve_of(case: Case) -> tuple[str, ValveShape]:
    """Return name and shape of the valve in a case's housing.

    Raises:
        CaseError: There is none.
    """
    found = stented(case)
    if found is None:
        raise CaseError("there is no valve in a housing", file=case.file, key="housing.stent")
    return case.solid[found[0]].name, found[1]


def build_rigid(case: Case, grid: MacGrid) -> tuple[RigidSurface, ...]:
    """Build the housing of a case, with its stent, and what fills the box outside.

    Springs and dampers are a given part of what an explicit step carries on the mass that the kernel moves, see
    `valvefsi.run.planning`.

    Raises:
        CaseError: The housing does not fit into the part of the box that has cells of the smallest width.

    Note:
        Collective.
    """
    housing = case.housing
    if housing is None:
        return ()
    surface, labels = _patched_section(case)
    h = case.grid.spacing
    share = housing.hold * case.fluid.density * h / largest_square_sum(KERNEL)
    problem = rigid = None
    try:
        rigid = PatchedSurface(
            surface,
            labels,
            Coupling(grid, KERNEL),
            name="housing",
            stiffness=share / case.dt**2,
            damping=share / case.dt,
            slip=_end_slip(case, surface),
        )
    except StabilityError as error:
        message = f"the housing does not fit into the core of the box: {error}"
        problem = CaseError(
            message, file=case.file, key="housing", value=f"radius {housing.section().widest:.4g} cm"
        )
    raise_together(grid.comm, problem)
    assert rigid is not None  # or all ranks have raised
    return (rigid, _filling(case, grid)) if housing.fill else (rigid,)


def _filling(case: Case, grid: MacGrid) -> Filling:
    """Return what holds the fluid outside the housing still."""
    housing, h, (low, high) = case.housing, case.grid.spacing, case.grid.bounds[2]
    assert housing is not None  # `build_rigid` has looked
    share = housing.hold * case.fluid.density
    return Filling(
        housing.section().housing(h, (low, high)),
        Coupling(grid, KERNEL),
        name="filling",
        stiffness=share / case.dt**2,
        damping=share / case.dt,
    )


def _end_slip(case: Case, surface: PointSurface) -> Array:
    """Return the rates at which points slip back, ``(num_points, 3, 3)`` [1/s].

    Points whose kernel reaches the faces of a side see the velocity there, which no force changes: along the side's
    normal they would be carried on for as long as a run lasts, and push the fluid beside them harder and harder. There
    they slip back half their way in a step; what bears pressures, across the wall, is held as everywhere.
    """
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    z, reach = surface.points[:, 2], 1.5 * h - 1e-9
    slip = np.zeros((len(z), 3, 3))
    slip[(z < low + reach) | (z > high - reach), 2, 2] = 0.5 / case.dt
    return slip


def _patched_section(case: Case) -> tuple[PointSurface, Indices]:
    """Return the points of the housing and its stent, and the patch of each.

    The points lie outside the surfaces by the kernel's offset, so that the fluid is at rest on them.
    """
    h, (low, high) = case.grid.spacing, case.grid.bounds[2]
    housing = case.housing
    assert housing is not None  # `build_rigid` has looked
    section = housing.section()
    ends = (low + 0.5 * h, high - 0.5 * h)
    surfaces, seam = [section.housing(h, ends)], None
    if housing.stent is not None:
        _, shape = valve_of(case)
        surfaces.append(section.stent(h, shape.geometry(), shape.base))
        seam = attachment_line(shape.geometry(), shape.base, LINE)
    labels = patch_labels(surfaces, h, ends, seam)
    whole = joined(*surfaces)
    return whole.moved(h * surface_offset(KERNEL, whole.normals, (0.0, 0.0, 1.0))), labels
