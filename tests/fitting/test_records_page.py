"""The examples on the page of records are read by the reader that the page says, as the page says."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from valvefsi.case.expressions import read_table
from valvefsi.fitting.bench_beat import read_bench_beat
from valvefsi.fitting.biaxial_records import Reading, read_biaxial
from valvefsi.fitting.waveforms import read_waveforms
from valvefsi.units import MMHG

pytestmark = pytest.mark.serial  # nothing in it runs in parallel
PAGE = (Path(__file__).parents[2] / "docs" / "records.md").read_text(encoding="utf-8")


def example(tmp_path, heading, number=0):
    """A file with an example under a heading of the page."""
    section = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    path = tmp_path / "example.csv"
    path.write_text(re.findall(r"```\n(.*?)```", section, re.S)[number], encoding="utf-8")
    return path


def test_biaxial_tests(tmp_path):
    plain = read_biaxial(example(tmp_path, "Biaxial tests"))
    assert (plain.measure, plain.names, plain.notes) == ("pk1", ("equibiaxial",), ())
    np.testing.assert_allclose(plain.F[2], np.diag([1.09, 1.15]))
    machine = read_biaxial(example(tmp_path, "Biaxial tests", 1), Reading(decimal=",", areas=(0.06, 0.06)))
    np.testing.assert_allclose(machine.F[2], np.diag([1.09, 1.15]))
    assert machine.stress[2, 0] == pytest.approx(190 / 6)


def test_flow_loops(tmp_path):
    waves = read_waveforms(example(tmp_path, "Flow loops"))
    assert list(waves.values) == ["p_ao", "q_ao"]
    assert waves["p_ao"][-1] == pytest.approx(83.7 * MMHG)


def test_measured_beats(tmp_path):
    path = example(tmp_path, "Measured beats")
    last = path.read_text().splitlines()[-1].partition(",")[2]
    path.write_text(path.read_text() + "".join(f"{t:.3f},{last}\n" for t in np.arange(0.02, 0.857, 0.005)))
    beat = read_bench_beat(path)
    assert (beat.period, beat.cycles) == (0.857, 1)
    assert set(beat.values) == {"p_lv", "p_ao", "q_ao", "pdva"}
    assert list(beat.deviations) == ["q_ao"]


def test_tables_of_a_case(tmp_path):
    table = read_table(example(tmp_path, "Tables of a case"))
    assert table.at(0.003) == {"p_pump_mmHg": 42.6}
