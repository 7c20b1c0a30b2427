"""All benchmarks by the name of their command: where each is, and what it is in a line; imports nothing heavy."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from valvefsi.benchmarks.frame import Command


@dataclass(frozen=True)
class Entry:
    """A benchmark.

    Attributes:
        name: Name of the command.
        group: Heading under which it is listed.
        place: Module below `valvefsi.benchmarks` and class, ``module:Class``.
        help: What it is, in a line.
        former: Earlier names of the command, which still work.
    """

    name: str
    group: str
    place: str
    help: str
    former: tuple[str, ...] = ()

    def load(self) -> type[Command]:
        """Return the benchmark's class."""
        module, _, name = self.place.partition(":")
        kind: type[Command] = getattr(importlib.import_module(f"valvefsi.benchmarks.{module}"), name)
        return kind


TABLE = """
Flows:
    taylor-green | flows.taylor_green:TaylorGreen | Decay of the Taylor-Green vortex at Re 1600, in the eighth \
        that its symmetry leaves.
    channel | flows.channel:Channel | Poiseuille and Womersley flow between open sides against their closed forms.
    cavity | flows.cavity:Cavity | Steady flow in a cavity with a sliding lid against a published table.
    cylinder | flows.cylinder:Cylinder | Drag, lift and shedding of a rigid cylinder at Re 100, held in the flow \
        on a graded grid.
    cylinder-fitted | flows.cylinder:CylinderFitted | Flow past a cylinder at Re 100 on a mesh that fits \
        it, with finite elements: an independent answer.
    tube | flows.tube:Tube | Flow in a tube of held points at any angle to the grid, against the start-up series.
    leakage | flows.leakage:Leakage | Leakage test: what flows through the aortic test section, closed by a \
        plate, under 100 mmHg.
Immersed bodies:
    compression | immersed.compression:Compression | Benchmark E.1: a block compressed by a load, immersed, \
        against the incompressible statics.
    torsion | immersed.torsion:Torsion | Benchmark E.2: torsion of a column, immersed; finer grids are 1.5, 2, 3 \
        and 4 times the first.
    cook | immersed.cook:Cook | Cook's membrane, immersed, against the incompressible statics of the same run.
    shell | immersed.shell:Shell | A thick shell and a closed membrane at rest: pressure and spurious velocity \
        against closed forms.
    plate | immersed.plate:Plate | A plate thinner than the kernel: deflection at rest and bending waves against \
        closed forms.
    sphere-in-cavity | immersed.cavity_solids:SphereInCavity | A soft sphere in a lid-driven cavity: volume kept, \
        and the speed of a coupled step.
    disk-in-cavity | immersed.cavity_solids:DiskInCavity | A soft disk in a lid-driven cavity: path and area on \
        several grids; where its nodes are drawn apart it leaks.
    valve-2d | immersed.valve_2d:Valve2D | Two leaflets bent by a pulsating inflow, against the tips' \
        displacements of other codes.
    turek-fsi | immersed.turek:TurekFsi | A flag that swings behind a cylinder (Turek and Hron 2006): \
        displacement of its tip, drag and lift.
Solids alone (statics):
    statics-compression | statics.solids:StaticCompression | Benchmark E.1 as incompressible statics: u_y of \
        the top centre is -3.9212 cm.
    statics-cook | statics.solids:StaticCook | Cook's membrane as incompressible statics, beside the published band.
    statics-torsion | statics.solids:StaticTorsion | Benchmark E.2 as incompressible statics: u_y of the top \
        centre at five angles up to 2.5 pi.
    thick-shells | statics.thick_shells:ThickShells | A thick cylinder and a thick sphere under inner pressure, \
        against their closed forms.
    shells | statics.shells:Shells | Thin shells that turn far, of solid-shell elements: cantilever, slit ring, \
        hemisphere, pulled cylinder, against a published table.
    hgo-strip | statics.hgo_strip:HgoStrip | A strip of the HGO material, flat and inflated as a ring, against \
        the homogeneous solution (S1-S3).
    bending | statics.bending:Bending | A strip of solid-shell elements bent, pulled and twisted, against \
        incompressible elements.
    strips | statics.strips:Strips | Many such strips: thickness, layers, edges, fibres, curvature; which pass and \
        which find no equilibrium.
    land | statics.land:Land | Land et al. 2015, cardiac mechanics: beam, inflation, contraction.
Studies and speed:
    kernels | studies.kernels:Kernels | Every kernel at several ratios of mesh to grid, both couplings; goes on \
        where it was interrupted.
    bulk-modulus | studies.bulk_modulus:BulkModulus | A leaflet's patch under 100 mmHg: volume, shape and stable step \
        over the bulk modulus.
    speed | studies.speed:Speed | Time a step of the fluid against a pair of cosine transforms of the same grid.
"""
"""Group; below it name of the command, module and class, what it is."""
FORMER = {"leakage": ("plug",)}
"""Earlier names of commands."""


def _entries() -> list[Entry]:
    entries, group = [], ""
    for line in TABLE.strip().splitlines():
        if line.endswith(":"):
            group = line[:-1]
        else:
            name, place, text = (" ".join(part.split()) for part in line.split("|"))
            entries.append(Entry(name, group, place, text, FORMER.get(name, ())))
    return entries


ENTRIES = tuple(_entries())


def markdown() -> str:
    """Return the commands as tables in Markdown, one for each group."""
    parts = []
    for group in dict.fromkeys(entry.group for entry in ENTRIES):
        lines = [f"| `{e.name}` | {e.help} |" for e in ENTRIES if e.group == group]
        parts.append(
            "\n".join([f"**{group}**", "", "| `valvefsi bench` | what it is |", "|---|---|", *lines])
        )
    return "\n\n".join(parts) + "\n"
