"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import os
import re
import shutil
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.pop("COLUMNS", None)  # of the shell that tests are run in

import pytest
from matplotlib.figure import Figure
from mpi4py import MPI

from tests.figures import faults

ONE_RANK = (
    "fitting",
    "verification/test_collection.py",
    "verification/test_refinement.py",
    "case/test_target.py",
    "circulation/test_linear.py",
    "circulation/test_orifice.py",
    "circulation/test_orifice_samples.py",
    "circulation/test_sampling.py",
    "circulation/test_signs.py",
    "benchmarks/test_options.py",
    "coupling/test_kernels.py",
    "coupling/test_offsets.py",
    "geometry/test_aortic_section.py",
    "geometry/test_patches.py",
    "post/test_plots.py",
    "post/test_projected_area.py",
    "post/test_valve_comparison.py",
    "post/test_valve_numbers.py",
    "post/test_valve_waveform_plots.py",
    "report",
    "solid/test_material_closed_forms.py",
    "solid/test_material_parameters.py",
    "solid/test_materials.py",
    "studies/test_grids.py",
    "studies/test_polynomial_chaos.py",
    "studies/test_runner.py",
    "studies/test_sample_inputs.py",
    "studies/test_sampling.py",
    "studies/test_sobol_design.py",
    "studies/test_sweep.py",
    "studies/test_stages.py",
    "test_credibility.py",
    "test_demos.py",
    "test_documents.py",
    "test_layers.py",
    "test_readme.py",
    "test_reference_headers.py",
    "test_release.py",
)
"""Folders and files in which nothing knows of ranks: fits, files of numbers, energies at a point, words. Not run under
mpirun, where every rank would do the same."""
LONGEST = ("test_demos.py", "test_readme.py")
"""Files of tests that take tens of seconds each."""
TESTS = Path(__file__).parent


def pytest_ignore_collect(collection_path):
    """Leave out what cannot differ between ranks, where there are several."""
    if MPI.COMM_WORLD.size > 1 and collection_path.relative_to(TESTS).as_posix() in ONE_RANK:
        return True
    return None


def pytest_collection_modifyitems(items):
    """Begin with the longest, so that no process is left with one of them when all others are done."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


def pytest_collection_finish(session):
    """Leave modules and thousands of collected tests out of every later search for unused cycles."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def comm():
    """Return the world communicator."""
    return MPI.COMM_WORLD


@pytest.fixture
def shared_tmp(tmp_path, comm):
    """Return a temporary folder that is the same on all ranks."""
    path = comm.bcast(str(tmp_path), root=0)
    comm.barrier()
    yield Path(path)
    comm.barrier()


@pytest.fixture(autouse=True)
def picture_faults(monkeypatch, request):
    """Look at every figure that a test saves; keep a copy where VALVEFSI_PICTURES names a folder."""
    found, save, kept = [], Figure.savefig, os.environ.get("VALVEFSI_PICTURES")

    def saving(figure, place, *args, **options):
        if str(place).endswith(".png"):
            options.setdefault("pil_kwargs", {"compress_level": 1})  # a file that is soon gone
        save(figure, place, *args, **options)
        if "dpi" in options or not str(place).endswith(".png"):  # it was drawn in other pixels
            figure.draw_without_rendering()
        found.extend(f"{getattr(place, 'name', place)}: {fault}" for fault in faults(figure))
        if kept and isinstance(place, Path):
            name = re.sub(r"[^\w.-]+", "_", f"{request.node.name}.{place.name.lstrip('.')}")
            shutil.copy(place, Path(kept) / name)

    monkeypatch.setattr(Figure, "savefig", saving)
    yield found
    assert not found, "\n".join(["faults of pictures:", *dict.fromkeys(found)])


@pytest.fixture(autouse=True, scope="module")
def _collect():
    """Free the communicators of unused meshes, of which an MPI library has only some two thousand."""
    yield
    gc.collect()
