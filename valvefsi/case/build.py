"""From a case to a simulation: grid, fluid, meshes, solids, couplings, output."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path

from mpi4py import MPI

from valvefsi.bodies.elastic import Elastic
from valvefsi.bodies.heavy import Heavy
from valvefsi.bodies.slip import DarcySlip, Slip, UnresolvedSlip
from valvefsi.case.cell_reynolds import cell_reynolds_number
from valvefsi.case.circuit_tables import say_unconnected
from valvefsi.case.circulation import build_circulation, connected
from valvefsi.case.fibres import add_fibres
from valvefsi.case.materials import make_material, say_provenance
from valvefsi.case.meshes import solid_mesh
from valvefsi.case.models import Case, Solid
from valvefsi.case.origins import write_provenance
from valvefsi.case.plan_warnings import plan_warnings
from valvefsi.case.reading import load_case
from valvefsi.case.resuming import (
    check_shapes,
    check_start,
    clear,
    provenance_of,
    run_folder,
    shown_pair,
    start_time,
)
from valvefsi.case.schedule import schedule_of
from valvefsi.case.sides import build_fluid, build_grid
from valvefsi.case.target import at_target, plan_target, target_numbers
from valvefsi.case.valve import check_leaflets, find_orifice
from valvefsi.case.valve_report import report_valve
from valvefsi.case.walls import build_rigid, on_posts
from valvefsi.case.writing import to_toml
from valvefsi.coupling.elemental import ElementalCoupling
from valvefsi.coupling.transfer import Coupling
from valvefsi.errors import CaseError, made_on_root, raise_together
from valvefsi.fluid.navier_stokes import NavierStokes
from valvefsi.fsi import Model, State
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.grid import MacGrid
from valvefsi.io.folder import write_text
from valvefsi.io.history import read_history
from valvefsi.post.diagnostics import Section
from valvefsi.post.diagnostics.control_volume import ControlVolume
from valvefsi.run.checkpoints import load_state
from valvefsi.run.energy import balance
from valvefsi.run.forces import ForceOutput
from valvefsi.run.pictures import ENDED
from valvefsi.run.planning import plan
from valvefsi.run.recording import Output, Probe
from valvefsi.run.regridding import regridded
from valvefsi.run.schedule import check_end
from valvefsi.run.simulation import Simulation
from valvefsi.run.statistics import Line
from valvefsi.solid.elements.element_points import ElementPoints
from valvefsi.solid.loads import DeadLoad, Ramp, Tether
from valvefsi.solid.structure import Damping, Discretisation, Structure
from valvefsi.types import Progress

Changes = tuple[dict[str, object], ...]


def build(case: Case, out: Path, comm: MPI.Comm = MPI.COMM_WORLD, changes: Changes = ()) -> Simulation:
    """Build the simulation of a case.

    Args:
        case: The case, checked.
        out: Folder of the run.
        comm: Communicator of the run.
        changes: Changes of the case since the run began, see `run_folder`.

    Raises:
        CaseError: A mesh does not fit the case.

    Note:
        Collective. The case is written to ``case.toml`` in the folder when the simulation is run.
    """
    say_unconnected(case.circuit, comm.rank, tuple(connected(case).values()))
    grid = build_grid(case, comm)
    fluid = build_fluid(case, grid)
    meshes: dict[int, SolidMesh] = {}
    for k in range(
        len(case.solid)
    ):  # never in a temporary: a mesh freed while an error is raised blocks mpi4py's lock
        meshes[k] = solid_mesh(case, k, comm)
    edges = check_leaflets(case, meshes)
    rigid = build_rigid(case, grid, edges)  # first: it says what is wrong with own leaflets
    elastic = [
        on_posts(case, _body(fluid, given, build_solid(case, k, comm, meshes[k]), case.fluid.density), edges)
        for k, given in enumerate(case.solid)
    ]
    circulation = build_circulation(case)
    bodies = (*elastic, *rigid)
    model = Model(grid=grid, fluid=fluid, bodies=bodies, circulation=circulation)
    return Simulation(model, schedule_of(case), _output(case, out, grid, changes, meshes))


def _coupling(fluid: NavierStokes, given: Solid, solid: Structure) -> Coupling | ElementalCoupling:
    grid, signs = fluid.grid, fluid.boundary.signs
    if given.coupling == "nodal":
        return Coupling(grid, given.kernel, signs)
    points = ElementPoints(solid, given.mass)
    return ElementalCoupling(grid, given.kernel, points, given.point_gap, signs)


def _body(fluid: NavierStokes, given: Solid, solid: Structure, rho: float) -> Elastic:
    """Return a solid of a case as a body, with excess mass where it is heavier than the fluid. Collective."""
    coupling = _coupling(fluid, given, solid)
    slip = _slip(given, solid)
    if given.density is not None and given.density > rho:
        return Heavy(solid, coupling, rho=rho, density=given.density, slip=slip)
    return Elastic(solid, coupling, slip=slip)


def _slip(given: Solid, solid: Structure) -> Slip | None:
    if not given.permeability > 0.0:
        return None
    law = UnresolvedSlip if given.seepage == "unresolved" else DarcySlip
    return law(given.permeability, solid.weights[:, None])


def write_case(case: Case, out: Path, comm: MPI.Comm, changes: Changes = ()) -> None:
    """Keep the case beside its results, with what was changed on the way. Collective."""
    error = None
    try:
        if comm.rank == 0:
            before = [shown_pair(case, str(c["key"]), c["old"], c["new"])[0] for c in changes]
            notes = [
                f"# t = {c['t_s']:.9g} s: {c['key']} was {old}"
                for c, old in zip(changes, before, strict=True)
            ]
            write_text(Path(out) / "case.toml", "\n".join([*notes, to_toml(case)]))
    except OSError as failure:
        error = failure
    raise_together(comm, error)


def plan_case(case: Case, comm: MPI.Comm = MPI.COMM_WORLD, out: Path = Path()) -> dict[str, object]:
    """Return the plan of a case that would run in a folder, see `valvefsi.run.planning`. Collective."""
    check_start(case)
    case, chosen = at_target(case, comm)
    begin = start_time(case)
    entries = [*plan(build(case, out, comm), begin), *cell_reynolds_number(case), *plan_warnings(case)]
    return {"plan": [*entries, *plan_target(case, chosen)]}


def run_case(
    case: Case,
    *,
    out: Path,
    resume: bool = False,
    overwrite: bool = False,
    allow_change: bool = False,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Progress | None = None,
) -> dict[str, object]:
    """Run a case, with pictures and ``summary.json`` at the end.

    Args:
        case: The case.
        out: Folder of the results.
        resume: Whether to go on from the last checkpoint in the folder.
        overwrite: Whether a run in the folder may be replaced.
        allow_change: Whether a run that goes on may differ in what is no part of its state, such as a material.
        comm: Communicator of the run.
        progress: Called after every step.

    Returns:
        The last row of the history and the timing, as in ``summary.json``; of a run that had ended already, those of
        its summary, which stays, and ``finished``.

    Note:
        Collective.
    """
    out = Path(out)
    case, chosen = at_target(case, comm)
    options = {"resume": resume, "overwrite": overwrite, "allow_change": allow_change}
    with run_folder(case, out, comm, **options) as changes:
        simulation = build(case, out, comm, changes)
        if case.start is not None and case.start.run and not resume:
            simulation.initial = _state_of(Path(case.start.run), case, simulation)
        if overwrite and not resume:
            clear(out, comm)
        write_case(case, out, comm, changes)
        write_provenance(case, out, comm, resume=resume)
        outcome = simulation.run(resume=resume, progress=progress)
        ended = None if outcome.steps or changes else _summary(out, comm)
        if ended is not None:
            return {**ended, "finished": True}
        last = simulation.pictures(outcome.state, title=case.title)
        result = {"last": last, "timing": outcome.timing(simulation.model.grid)}
        if changes:
            result["changes"] = list(changes)
        if chosen is not None:
            result["target"] = target_numbers(case, chosen)
        return made_on_root(comm, lambda: _summed_up(case, out, result), ENDED)


def _summed_up(case: Case, out: Path, result: dict[str, object]) -> dict[str, object]:
    """Return a result with the numbers of the whole run, written as its summary."""
    history = read_history(out / "history.csv")
    if case.start is not None and case.start.run:
        result["start"] = {"run": case.start.run, "t_s": history["t_s"][0]}
    if case.output.energy:
        result["energy"] = balance(history, history["t_s"][0], history["t_s"][-1])
    result |= report_valve(case, out)
    write_text(out / "summary.json", json.dumps(result, indent=2) + "\n")
    return result


def _state_of(folder: Path, case: Case, fine: Simulation) -> State:
    """Return the newest state of the run that a case begins from, on the case's own grid and meshes. Collective."""
    try:
        if folder == fine.output.directory.resolve():
            raise CaseError("a run cannot begin from itself; give another --out", key="start.run")
        begun = load_case(folder / "case.toml", trust=case.trust)
        check_shapes(begun, case)
        coarse = build(begun, folder, MPI.COMM_SELF)
        state = load_state(coarse.model, coarse.output, coarse.memory)
        if state is None:
            message = "there is no whole checkpoint to begin from"
            raise CaseError(message, key="start.run", value=str(folder))
        check_end(state.t, state.dt, case.time.t_end, case.file)
        return regridded(coarse.model, state, fine.model, fine.schedule.dt)
    except CaseError as error:
        raise CaseError(
            error.reason, file=error.file or case.file, key=error.key, value=error.value
        ) from None


def _summary(out: Path, comm: MPI.Comm) -> dict[str, object] | None:
    """Return the summary of a run that has ended, None where there is none. Collective."""
    found = None
    if comm.rank == 0:
        with contextlib.suppress(OSError, ValueError):
            found = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    summary: dict[str, object] | None = comm.bcast(found, root=0)
    return summary


def build_solid(case: Case, number: int, comm: MPI.Comm, mesh: SolidMesh | None = None) -> Structure:
    """Build one solid of a case, on its mesh where that is at hand. Collective."""
    given = case.solid[number]
    mesh = mesh if mesh is not None else solid_mesh(case, number, comm)
    key = f"solid.{given.name}"
    mesh = add_fibres(mesh, given.fibre, key, given.material, given.mesh.leaflets)
    say_provenance(given.material, key, comm)
    try:
        return Structure(
            mesh,
            make_material(given.material.model, given.material.parameters),
            name=given.name,
            nu_stab=given.nu_stab,
            discretisation=_discretisation(given),
            damping=Damping(body=given.damping, viscosity=given.viscosity),
            tethers=_tethers(given),
            loads=_loads(given),
        )
    except CaseError as error:
        place = key if error.key is None else f"{key}.{error.key}"
        raise CaseError(error.reason, file=case.file, key=place, value=error.value) from None


def _discretisation(solid: Solid) -> Discretisation:
    own = solid.mesh.leaflets
    faces: tuple[tuple[str, ...], tuple[str, ...]] | None = None
    if solid.faces:
        faces = ((solid.faces[0],), (solid.faces[1],))
    elif solid.element == "solid_shell" and solid.mesh.valve_diameter is not None:
        faces = (own.inflow, own.outflow) if own is not None else (("inflow",), ("outflow",))
    return Discretisation(
        element=solid.element,
        faces=faces,
        degree=solid.degree,
        quadrature_degree=solid.quadrature_degree,
        volumetric=solid.volumetric,
        kappa=solid.kappa,
        volumetric_degree=solid.volumetric_degree,
    )


def _tethers(solid: Solid) -> list[Tether]:
    return [
        Tether(on=t.on or None, components=t.components, stiffness=t.stiffness, damping=t.damping)
        for t in solid.tether
    ]


def _loads(solid: Solid) -> list[DeadLoad]:
    return [
        DeadLoad(on=q.on, traction=q.traction, ramp=Ramp(duration=q.ramp, shape=q.ramp_shape))
        for q in solid.load
    ]


def _sections(case: Case, grid: MacGrid) -> dict[str, Section]:
    sections = {}
    for number, given in enumerate(case.output.section):
        key = f"output.section.{given.name}"
        if given.name in sections:
            raise CaseError(
                "two sections have this name",
                file=case.file,
                key=f"output.section.{number}.name",
                value=given.name,
            )
        if given.centre and len(given.centre) != grid.dim:
            raise CaseError(
                f"expected {grid.dim} entries", file=case.file, key=f"{key}.centre", value=list(given.centre)
            )
        section = Section(
            axis="xyz".index(given.axis),
            position=given.position,
            centre=tuple(given.centre) or None,
            radius=given.radius or 0.0,
        )
        try:
            section.check(grid)
        except ValueError as error:
            raise CaseError(str(error), file=case.file, key=key) from None
        sections[given.name] = section
    return sections


def _forces(case: Case, grid: MacGrid) -> tuple[ForceOutput, ...]:
    names = [solid.name for solid in case.solid] + (["housing"] if case.housing else [])
    forces = []
    for number, given in enumerate(case.output.force):
        key = f"output.force.{number}"
        unknown = next((name for name in given.body if name not in names), None)
        if unknown is not None or not given.body:
            message = f"expected names of {', '.join(names) or 'bodies, there are none'}"
            raise CaseError(message, file=case.file, key=f"{key}.body", value=list(given.body))
        box = (given.lower, given.upper) if given.lower else None
        if box is not None:
            try:
                ControlVolume(grid, *box)
            except ValueError as error:
                raise CaseError(str(error), file=case.file, key=key) from None
        bodies = tuple(names.index(name) for name in given.body)
        forces.append(ForceOutput(name=given.name, bodies=bodies, box=box))
    return tuple(forces)


def _output(
    case: Case, out: Path, grid: MacGrid, changes: Changes, meshes: Mapping[int, SolidMesh]
) -> Output:
    probes = tuple(
        Probe(name=probe.name, body=number, at=tuple(probe.at))
        for number, solid in enumerate(case.solid)
        for probe in solid.probe
    )
    return Output(
        directory=Path(out),
        history_every=case.output.history_every,
        frames=case.output.frames,
        checkpoint_every=case.output.checkpoint_every,
        checkpoint_wall_s=case.output.checkpoint_wall,
        keep_checkpoints=case.output.keep_checkpoints,
        probes=probes,
        forces=_forces(case, grid),
        energy=case.output.energy,
        orifice=find_orifice(case, meshes),
        averages_from=case.output.averages_from,
        lines={
            line.name: Line(start=line.start, end=line.end, points=line.points) for line in case.output.line
        },
        every=case.output.fluid_every,
        part=(case.output.fluid_lower, case.output.fluid_upper) if case.output.fluid_lower else None,
        sections=_sections(case, grid),
        dissipation=case.output.dissipation,
        stress=case.output.stress,
        provenance=provenance_of(case, changes),
        units=case.output.units,
    )
