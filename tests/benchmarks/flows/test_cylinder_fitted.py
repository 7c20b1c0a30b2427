"""The cylinder on a mesh that fits it: its mesh, its drag beside that of the immersed one, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from valvefsi.benchmarks.flows.cylinder import Cylinder, CylinderFitted, flow_around, march
from valvefsi.benchmarks.frame import Job
from valvefsi.errors import CaseError
from valvefsi.geometry.flow_shapes import box_around_cylinder
from valvefsi.runtime import dolfinx_compat as compat

WORLD = MPI.COMM_WORLD


def test_the_mesh_fits_the_cylinder_and_the_box():
    box = box_around_cylinder(0.1, 8.0, WORLD)
    ds = ufl.Measure("ds", box.mesh, subdomain_data=box.facet_tags, metadata={"quadrature_degree": 8})
    dx = ufl.Measure("dx", box.mesh, metadata={"quadrature_degree": 8})

    def total(measure):
        one = fem.Constant(box.mesh, 1.0)
        return WORLD.allreduce(fem.assemble_scalar(compat.compile_form(one * measure)))

    assert total(dx) == pytest.approx(18.0 * 8.0 - np.pi / 4, rel=1e-7)
    lengths = {name: total(ds(box.tag(name)[1])) for name in ("inlet", "sides", "outlet", "cylinder")}
    assert lengths == pytest.approx({"inlet": 8.0, "sides": 36.0, "outlet": 8.0, "cylinder": np.pi}, rel=1e-5)


def test_the_drag_at_first_is_that_of_the_immersed_cylinder(shared_tmp):
    """Two methods that share neither grid nor elements nor how they find the force."""
    job = Job(folder=shared_tmp, comm=WORLD)
    values = {"reynolds": 40.0, "width": 12.0, "courant": 0.16}
    fitted = march(flow_around(0.08, values, WORLD)[0], 2.0, job)
    benchmark = Cylinder(cells=20, overrides=["reynolds=40", "width=12", "t_end=2"])
    immersed = benchmark.one(20, job)["_forces"]
    drag = [curves.drag[curves.t > 1.0].mean() for curves in (fitted, immersed)]
    assert drag[1] == pytest.approx(drag[0], rel=0.02)


@pytest.mark.parametrize(
    ("size", "override", "message"),
    [
        (0.0, "t_end=1", "--size = 0.0: expected a size above 0 and up to 0.2"),
        (0.3, "t_end=1", "--size = 0.3"),
        (0.1, "width=3", "width = 3.0: expected at least 4 diameters"),
        (0.1, "reynold=3", "did you mean 'reynolds'"),
    ],
)
def test_what_cannot_be_used_is_refused(size, override, message):
    with pytest.raises(CaseError, match=message):
        CylinderFitted(size=size, overrides=[override])
