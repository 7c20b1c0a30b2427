# %% [markdown]
# # A leaflet closes under a ramped pressure, in vacuum
#
# What it shows: a leaflet mesh, fibres around the valve's axis, the modified HGO material, explicit dynamics with a
# follower pressure, the energy balance, stress and fibre stretch in a picture and a ParaView file.
# Reference: none outside; the energy balance is exact, and the closed leaflet is compared with the mirror image of
# the open one. Run time: about 10 s on one rank; also under mpirun.

# %% Parameters (CGS): the moduli are of the size of a leaflet's, not a fit to one
import os
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpi4py import MPI

from valvefsi.geometry.benchmark_shapes import leaflet
from valvefsi.io.solid_body import Body, write_body
from valvefsi.post.plots.base import LINES, STYLE
from valvefsi.post.plots.solid import deformed
from valvefsi.solid.dynamics import CentralDifferences, MovingSolid, run
from valvefsi.solid.loads import Pressure, Ramp
from valvefsi.solid.materials import fibres
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.statics.formulations import NearlyIncompressible
from valvefsi.solid.statics.supports import Fixed
from valvefsi.solid.stress import LABELS, Stress

ELEMENTS = (10, 6)  # around and up; larger is slower
RADIUS, HEIGHT, HALF_ANGLE = 1.25, 1.4, 40.0
PRESSURE, RAMP, T_END = 8000.0, 0.020, 0.040  # 6 mmHg within 20 ms
DAMPING = 3000.0  # dyn s/cm^4, in place of the fluid that the leaflet would have to move
OUT = Path(os.environ.get("VALVEFSI_DEMO_OUT", "results/demo_leaflet_closing"))
comm = MPI.COMM_WORLD

# %% Mesh: a patch of a cylinder about z, attached along a parabola; it bulges outwards, it is open
mesh = leaflet(comm, radius=RADIUS, height=HEIGHT, thickness=0.05, half_angle=HALF_ANGLE, elements=ELEMENTS)
mesh = mesh.with_fibres(around=fibres.circumferential(mesh))

# %% Material: exponential matrix and fibres around the axis, quadratic elements, volume held by nu_stab = 0.45
material = HGO(c10=31250.0, c01=8.0, families=(FibreFamily(k1=2e5, k2=20.0, kappa=0.1, fibre="around"),))
solid = MovingSolid(
    mesh,
    material,
    density=1.0,
    supports=[Fixed(on=("attached", "sides"))],
    loads=[Pressure(on=("outer",), value=PRESSURE)],
    ramp=Ramp(duration=RAMP, shape="smooth"),
    formulation=NearlyIncompressible(degree=2, nu_stab=0.45),
)
solid.damping = DAMPING

# %% Run: the leaflet buckles and snaps inwards, which no static solution can follow
stepper = CentralDifferences(solid)
middle = (RADIUS, 0.0, HEIGHT)  # of the free edge
times, places, records = [], [], []


def note(t, energies):
    """Keep every fiftieth step."""
    if round(t / stepper.dt) % 50 == 0:
        times.append(t)
        places.append(middle[0] + solid.displacement_at(middle)[0])
        records.append(energies)


last = run(stepper, T_END, note)
place = middle[0] + solid.displacement_at(middle)[0]

# %% Compare: with the open leaflet mirrored in the plane through its attached ends
chord = RADIUS * np.cos(np.radians(HALF_ANGLE))
mirrored = 2 * chord - RADIUS
if comm.rank == 0:
    print(
        f"{round(T_END / stepper.dt)} steps of {stepper.dt * 1e6:.2f} us, critical {stepper.critical * 1e6:.2f} us"
    )
    print(f"free edge: from {RADIUS:.3f} to {place:.3f} cm off the axis; its mirror image {mirrored:.3f} cm")
    print(f"energy balance: {last.balance:.3g} erg of {last.work:.4g} erg of work")

# %% Plot: the closed leaflet with its fibre stretch; the free edge and the energies over time
stress = Stress(solid.u, material, kappa=solid.kappa, fibres=mesh.fibres, fibre="around")
gathered = stress.gather()
if comm.rank == 0:
    points, cells, fields, reference = gathered
    body = Body(points=points, cells=cells, values=fields, reference=reference, shown=LABELS["fibre_stretch"])
    deformed(
        OUT / "closed.png", body, title="Closed leaflet", caption=f"t = {solid.t * 1e3:.0f} ms, outline: open"
    )
    write_body(OUT / "closed.vtu", body)
    with mpl.rc_context(STYLE):
        figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 3.8), layout="constrained", dpi=160)
        ms = np.array(times) * 1e3
        left.plot(ms, places, color=LINES[0])
        left.axhline(mirrored, color="0.4", dashes=(5, 3), linewidth=1)
        left.set(
            xlabel="t [ms]", ylabel="x of the free edge [cm]", title="open: 1.25 cm; dashed: mirror image"
        )
        for name, colour in zip(("work", "stored", "lost", "kinetic"), LINES, strict=False):
            right.plot(ms, [getattr(e, name) for e in records], color=colour, label=name)
        right.plot(ms, [e.balance for e in records], color="0.2", linewidth=1, label="balance")
        right.set(xlabel="t [ms]", ylabel="energy [erg]")
        right.legend(frameon=False)
        figure.savefig(OUT / "history.png")

# %% What this demo claims
assert place < chord - 0.2
assert abs(place - mirrored) < 0.2
assert abs(last.balance) < 1e-4 * last.work
