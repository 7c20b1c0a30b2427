"""The one module that knows DOLFINx releases."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from dolfinx import fem, mesh
from mpi4py import MPI

from valvefsi import dolfinx_compat as compat

PACKAGE = Path(__file__).parents[1] / "valvefsi"


def test_the_release_in_use_is_one_of_those_supported():
    assert (0, 9) <= compat.VERSION <= (0, 11)


def test_no_other_module_asks_for_the_release():
    for path in PACKAGE.rglob("*.py"):
        if path.name != "dolfinx_compat.py":
            text = path.read_text(encoding="utf-8")
            assert "dolfinx.__version__" not in text, path
            assert "compat.VERSION" not in text, path


def test_a_vector_has_room_for_the_ghosts_of_its_space(comm):
    domain = mesh.create_unit_square(comm, 4, 4)
    space = fem.functionspace(domain, ("Lagrange", 2, (2,)))
    vector = compat.create_vector(space)
    index_map = space.dofmap.index_map
    assert vector.getLocalSize() == 2 * index_map.size_local
    assert vector.getBlockSize() == 2
    with vector.localForm() as local:
        assert local.getSize() == 2 * (index_map.size_local + index_map.num_ghosts)


def test_points_of_interpolation_are_an_array():
    space = fem.functionspace(mesh.create_unit_square(MPI.COMM_SELF, 1, 1), ("Lagrange", 2))
    assert np.asarray(compat.interpolation_points(space)).shape == (6, 2)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts another Python")
def test_a_dolfinx_without_the_wheel_imports_too():
    code = "import sys; sys.modules['dolfinx_solver'] = None; import valvefsi.dolfinx_compat as c; print(c.VERSION)"
    try:
        import dolfinx_solver  # noqa: F401

        code = "import dolfinx_solver; " + code
    except ImportError:
        pass
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
