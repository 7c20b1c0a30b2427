"""The cylinder on a mesh that fits it: its mesh, its drag beside that of the immersed one, what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from valvefsi.benchmarks import cylinder, cylinder_fitted
from valvefsi.benchmarks.cylinder_fitted import mesh_around, run
from valvefsi.benchmarks.parameters import defaults
from valvefsi.errors import CaseError
from valvefsi.runtime import dolfinx_compat as compat

WORLD = MPI.COMM_WORLD


def test_the_mesh_fits_the_cylinder_and_the_box():
    box = mesh_around(0.1, 8.0, WORLD)
    ds = ufl.Measure("ds", box.mesh, subdomain_data=box.facet_tags, metadata={"quadrature_degree": 8})
    dx = ufl.Measure("dx", box.mesh, metadata={"quadrature_degree": 8})

    def total(measure):
        one = fem.Constant(box.mesh, 1.0)
        return WORLD.allreduce(fem.assemble_scalar(compat.compile_form(one * measure)))

    assert total(dx) == pytest.approx(18.0 * 8.0 - np.pi / 4, rel=1e-7)
    lengths = {name: total(ds(box.tag(name)[1])) for name in ("inlet", "sides", "outlet", "cylinder")}
    assert lengths == pytest.approx({"inlet": 8.0, "sides": 36.0, "outlet": 8.0, "cylinder": np.pi}, rel=1e-5)


def test_the_drag_at_first_is_that_of_the_immersed_cylinder():
    """Two methods that share neither grid nor elements nor how they find the force."""
    values = {"reynolds": 40.0, "width": 12.0, "courant": 0.16}
    flow, _ = cylinder_fitted.flow_around(0.08, values, WORLD)
    fitted = cylinder_fitted.march(flow, 2.0)
    parameters = defaults(cylinder.PARAMETERS) | {"reynolds": 40.0, "width": 12.0}
    model, dt = cylinder.build(20, parameters, WORLD)
    immersed = cylinder.march(model, dt, 2.0)
    drag = [curves[1][curves[0] > 1.0].mean() for curves in (fitted, immersed)]
    assert drag[1] == pytest.approx(drag[0], rel=0.02)


def test_the_command_writes_its_forces(shared_tmp):
    result = run(size=0.2, out=shared_tmp, overrides=["t_end=0.5", "width=6"])
    if WORLD.rank == 0:
        assert json.loads((shared_tmp / "result.json").read_text())["benchmark"] == "cylinder-fitted"
        assert (shared_tmp / "forces.png").stat().st_size > 10000
    assert [entry["reference"] for entry in result["table"]] == [1.34, 0.345, 0.165]


@pytest.mark.parametrize(
    ("size", "override", "message"),
    [
        (0.0, "t_end=1", "--size = 0.0: expected a size above 0 and up to 0.2"),
        (0.3, "t_end=1", "--size = 0.3"),
        (0.1, "width=3", "width = 3.0: expected at least 4 diameters"),
        (0.1, "reynold=3", "did you mean 'reynolds'"),
    ],
)
def test_what_cannot_be_used_is_refused(size, override, message, tmp_path):
    with pytest.raises(CaseError, match=message):
        run(size=size, out=tmp_path, overrides=[override])
