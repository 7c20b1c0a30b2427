"""A valve's mesh in a file, as a user brings one, and cases that read it."""

from __future__ import annotations

import meshio
import numpy as np
from mpi4py import MPI

from tests.case.test_case_valve import COARSE, DEMO
from valvefsi.case import load_case
from valvefsi.geometry.valve import mesh_valve, write_valve

STENTLESS = "housing={annulus='-1 mm'}"


def demo_leaflets(ratio=1.5, layers=1, cell="hexahedron", h=0.2):
    """The leaflets that the demo's case makes on a grid of 2 mm."""
    shape = load_case(DEMO, COARSE).solid[0].mesh.valve
    return mesh_valve(shape.geometry(), size=ratio * h, layers=layers, cell=cell)


def written(folder, **options):
    """Write the demo's leaflets as leaflets.msh; the same file for all ranks."""
    path = folder / "leaflets.msh"
    if MPI.COMM_WORLD.rank == 0:
        write_valve(path, demo_leaflets(**options))
    MPI.COMM_WORLD.barrier()
    return path


def own(path, *more, steps=6, leaflets="diameter = '25 mm', directions = 'data'", mesh=""):
    """The demo's case with leaflets from a file."""
    mesh = f"solid.leaflets.mesh={{ file = '{path}', leaflets = {{ {leaflets} }} {mesh} }}"
    return load_case(DEMO, [*COARSE, f"time.t_end='{40 * steps} us'", mesh, *more])


def tube(radius, z, around=48, along=30):
    """A tube of triangles about the z axis; corners and triangles."""
    phi = 2 * np.pi * np.arange(around) / around
    ends = np.linspace(*z, along + 1)
    points = np.stack(
        [
            np.tile(radius * np.cos(phi), along + 1),
            np.tile(radius * np.sin(phi), along + 1),
            ends.repeat(around),
        ],
        axis=1,
    )
    index = np.arange(len(points)).reshape(along + 1, around)
    turned = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], turned[:-1], turned[1:], index[1:]], axis=-1).reshape(-1, 4)
    return points, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def write_stl(path, points, triangles):
    """Write triangles as an STL file, on rank 0."""
    if MPI.COMM_WORLD.rank == 0:
        meshio.Mesh(points, [("triangle", triangles)]).write(path, binary=True)
    MPI.COMM_WORLD.barrier()
    return path
