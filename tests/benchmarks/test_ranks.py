"""Every benchmark with a body gives one answer on one rank and on all, to what round-off grows to in a few steps."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from mpi4py import MPI

from tests.benchmarks.tiny import KINDS
from valvefsi.benchmarks.immersed import cook

WORLD = MPI.COMM_WORLD
TIMES = {
    "cell_steps_per_s",
    "date",
    "environment",
    "pair_s",
    "pairs",
    "phases_pairs",
    "peak_memory_gib",
    "ranks",
    "step_ms",
}
TIMES |= {"peak_memory_gib", "step_s", "table", "timing", "wall_s"}
"""Keys of a result that hold times, or what was run where; the table repeats its numbers among times."""


RUNS = {
    "cook": {"grid": 20, "ratio": 1.0, "stabilised": "on", "overrides": ["t_end=0.05"]},
    "torsion": {"grid": 6, "ratio": 1.0, "stabilised": "on", "overrides": ["t_end=0.01"]},
    "compression": {"elements": 8, "grid": 16, "overrides": ["t_end=0.1"]},
    "shell": {"grid": 24, "refine": 0, "couplings": ("nodal", "elemental"), "overrides": ["t_end=0.02"]},
    "sphere-in-cavity": {"grid": 16, "elements": 4, "steps": 4},
    "disk-in-cavity": {"grid": 16, "refine": 0, "t_end": 0.08},
    "kernels": {
        "problems": ("shell",),
        "kernels": ("composite_bspline32",),
        "ratios": (1.0,),
        "couplings": ("nodal",),
        "stabilised": "off",
        "grids": {"shell": 24},
        "overrides": ["shell.t_end=0.02"],
    },
    "turek-fsi": {"case": "fsi2", "cells": 2, "t_end": 0.01},
    "valve-2d": {"cells": 24, "t_end": 0.002},
    "cylinder": {"cells": 8, "overrides": ["t_end=0.5", "width=12"]},
    "cylinder-fitted": {"size": 0.2, "overrides": ["t_end=0.5", "width=6"]},
    "leakage": {"overrides": ["h=2 mm", "dt=0.1 ms", "t_end=2 ms"]},
}

FLOORS = {"turek-fsi": 1e-8}
"""Where not 1e-12: nodes at 60 cm carry round-off of 1e-14 cm into elements and springs of 1e9 dyn/cm^2, and forces of
5 N/m are told in N/m."""


def numbers(result, path=()):
    """All numbers of a result that are not times, by where they are."""
    if isinstance(result, Mapping):
        items = [(key, value) for key, value in result.items() if key not in TIMES]
    elif isinstance(result, list):
        items = list(enumerate(result))
    else:
        known = isinstance(result, int | float) and not isinstance(result, bool)
        return {path: float(result)} if known else {}
    return {key: value for name, part in items for key, value in numbers(part, (*path, name)).items()}


def test_numbers_of_a_result_are_found_and_times_are_not():
    result = {"runs": [{"J": [1, 2.5], "wall_s": 3.0, "failed": None}], "table": [1.0], "ok": True}
    assert numbers(result) == {("runs", 0, "J", 0): 1.0, ("runs", 0, "J", 1): 2.5}


@pytest.mark.skipif(WORLD.size == 1, reason="needs two ranks")
@pytest.mark.parametrize("name", list(RUNS))
def test_a_benchmark_does_not_see_the_number_of_ranks(name, shared_tmp, monkeypatch):
    empty = lambda self, path, **_: Path(path).touch()  # noqa: E731 - drawing takes most of the time
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", empty)
    monkeypatch.setattr(cook, "FINE", 8)
    benchmark = KINDS[name].load()(**RUNS[name])
    benchmark.run(out=shared_tmp / "together", comm=WORLD)
    different = None
    if WORLD.rank == 0:
        benchmark.run(out=shared_tmp / "alone", comm=MPI.COMM_SELF)
        files = [shared_tmp / folder / "result.json" for folder in ("together", "alone")]
        together, alone = (numbers(json.loads(file.read_text())) for file in files)
        assert len(alone) > 3
        different = [
            (key, together.get(key), value)
            for key, value in alone.items()
            if together.get(key) != pytest.approx(value, rel=1e-9, abs=FLOORS.get(name, 1e-12), nan_ok=True)
        ]
    assert WORLD.bcast(different) == []
