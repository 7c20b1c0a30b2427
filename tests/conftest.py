"""Fixtures that all tests share."""

from __future__ import annotations

import gc
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import pytest
from mpi4py import MPI


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


@pytest.fixture(autouse=True, scope="module")
def _collect():
    """Free the communicators of unused meshes, of which an MPI library has only some two thousand."""
    yield
    gc.collect()
