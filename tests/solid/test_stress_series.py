"""Stress in the ParaView series of a coupled run."""

from __future__ import annotations

import numpy as np
import pytest
from mpi4py import MPI

from tests.coupled_case import simulation
from valvefsi.io.solid_body import read_body
from valvefsi.post.plots.solid import draw_folder


def test_a_coupled_run_writes_the_stress_of_its_solids(shared_tmp):
    sim = simulation(shared_tmp, stress=("von_mises", "cauchy", "J", "fibre_stretch"))
    state = sim.run().state
    if MPI.COMM_WORLD.rank == 0:
        files = sorted((shared_tmp / "paraview" / "block_stress").glob("*.vtu"))
        assert len(files) == 5  # the start and four frames
        body = read_body(files[-1])
        stress = body.values["von Mises stress [dyn/cm^2]"]
        assert "fibre stretch [-]" not in body.values  # the block has no fibres
        sigma = body.values["Cauchy stress [dyn/cm^2]"].reshape(-1, 3, 3)
        mean = np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
        np.testing.assert_allclose(stress, np.sqrt(1.5 * ((sigma - mean) ** 2).sum(axis=(1, 2))), rtol=1e-4)
        assert stress.max() > 5.0
        assert read_body(files[0]).values["von Mises stress [dyn/cm^2]"].max() == pytest.approx(0.0, abs=1e-8)
        moved = np.linalg.norm(body.points - body.reference, axis=1).max()
        assert moved > 0.01
    chi, X = state.bodies[0]["chi"], sim.model.bodies[0].solid.X
    assert MPI.COMM_WORLD.allreduce(np.linalg.norm(chi - X, axis=1).max(initial=0.0), op=MPI.MAX) > 0.01


@pytest.mark.serial
def test_the_stress_of_a_run_is_drawn(tmp_path):
    simulation(tmp_path, MPI.COMM_SELF, steps=10, stress=("von_mises",)).run()
    made = draw_folder(tmp_path, tmp_path / "pictures", field="von Mises stress", t=None)
    assert any("stress" in path.name for path in made)
    assert all(path.stat().st_size > 5000 for path in made)
