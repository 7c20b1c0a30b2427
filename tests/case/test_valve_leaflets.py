"""What a run of a valve tells of its leaflets: strain and stress at the frames."""

from __future__ import annotations

import json

import numpy as np
import pytest
from mpi4py import MPI

from tests.case.test_case_valve import coarse
from valvefsi.case.build import build, run_case
from valvefsi.io.history import read_history
from valvefsi.io.solid_body import read_body
from valvefsi.run.recorded_stress import leaflet_peaks

FRAMES = "output.frames=3"


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    folder = tmp_path_factory.mktemp("leaflets") if MPI.COMM_WORLD.rank == 0 else None
    folder = MPI.COMM_WORLD.bcast(folder) / "run"
    run_case(coarse(6, FRAMES), out=folder)
    return folder


def test_the_peaks_of_each_leaflet_are_in_a_table_and_in_the_summary(ran):
    table = read_history(ran / "leaflets.csv")
    assert table["step"] == [0, 2, 4, 6]
    for k in (1, 2, 3):
        strain, top = (table[f"leaflet_{k}_green_strain_{kind}"] for kind in ("p99", "max"))
        assert abs(top[0]) < 1e-9
        assert all(0.0 < a <= b for a, b in zip(strain[1:], top[1:], strict=True))
        assert table[f"leaflet_{k}_von_mises_max_kPa"][-1] > 0.0
    # The box of fluid has no threefold symmetry; after six steps from rest the leaflets still hardly differ.
    ends = [table[f"leaflet_{k}_von_mises_p99_kPa"][-1] for k in (1, 2, 3)]
    assert np.ptp(ends) < 0.2 * max(ends)
    if MPI.COMM_WORLD.rank == 0:
        told = json.loads((ran / "summary.json").read_text())["valve"]["leaflets"]
        assert told == leaflet_peaks(ran)
        peak = told["leaflet_2"]["von_mises_max_kPa"]
        column = table["leaflet_2_von_mises_max_kPa"]
        assert peak["value"] == max(column)
        assert peak["t_s"] == table["t_s"][column.index(max(column))]


def test_the_fields_of_the_demo_are_beside_the_frames(ran):
    files = sorted((ran / "paraview" / "leaflets_stress").glob("*.vtu"))
    assert len(files) == 4
    body = read_body(files[-1])
    table = read_history(ran / "leaflets.csv")
    peak = max(table[f"leaflet_{k}_von_mises_max_kPa"][-1] for k in (1, 2, 3))
    # The field is projected to the nodes, the peak is at a point.
    assert 0.3 * peak < 1e-4 * body.values["von Mises stress [dyn/cm^2]"].max() < 2.0 * peak
    assert body.values["principal stretches [-]"].shape[1] == 3


def test_a_restart_goes_on_with_the_table(ran):
    folder = ran.parent / "resumed"
    build(coarse(6, FRAMES, "time.t_end='160 us'", "output.checkpoint_every=4"), folder).run()
    build(coarse(6, FRAMES), folder).run(resume=True)
    mine, expected = (read_history(path / "leaflets.csv") for path in (folder, ran))
    assert mine["step"][-1] == expected["step"][-1]
    for name in expected:
        assert mine[name][-1] == pytest.approx(expected[name][-1], rel=1e-6), name
