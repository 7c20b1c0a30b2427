"""The one module that knows DOLFINx releases."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ffcx.naming
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI


def test_the_release_in_use_is_one_of_those_supported():
    assert (0, 9) <= compat.VERSION <= (0, 11)


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
    code = (
        "import importlib.util, sys\n"
        "if importlib.util.find_spec('dolfinx_solver'): import dolfinx_solver\n"
        "sys.modules['dolfinx_solver'] = None\n"
        "import valvefsi.runtime.dolfinx_compat\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_compilation_that_was_killed_is_forgotten_and_others_are_not(tmp_path):
    now = time.time()
    for name, age in (("killed.c", 1000), ("done.c", 1000), ("done.c.cached", 1000), ("running.c", 10)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (now - age, now - age))
    assert compat.forget_interrupted_compilations(tmp_path) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"done.c", "done.c.cached", "running.c"}


def test_an_expression_has_one_name_however_many_variables_were_made_before(monkeypatch):
    """Else every stress of a process is compiled anew."""
    names, signature = [], ffcx.naming.compute_signature

    def kept(*arguments):
        names.append(signature(*arguments))
        return names[-1]

    monkeypatch.setattr(ffcx.naming, "compute_signature", kept)
    domain, point = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1), np.full((1, 3), 0.25)
    u = fem.Function(fem.functionspace(domain, ("DG", 0)))
    u.x.array[:] = 3.0
    for _ in range(2):
        a, b = ufl.variable(u), ufl.variable(2.0 * u)
        derivatives = ufl.as_vector([ufl.diff(a**2 * b, a), ufl.diff(a**2 * b, b)])
        values = compat.evaluate(compat.compile_expression(derivatives, point, MPI.COMM_SELF), domain, [0])
        np.testing.assert_allclose(values, [[2 * 3.0 * 6.0, 9.0]], rtol=1e-14)
        compat.compile_at_point(derivatives)
    half = len(names) // 2
    assert len(set(names)) >= 2
    assert names[:half] == names[half:]
