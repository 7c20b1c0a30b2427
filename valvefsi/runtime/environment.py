"""What a result was made with: versions, machine, ranks and date."""

from __future__ import annotations

import importlib.metadata
import math
import os
import platform
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

import valvefsi
from valvefsi.runtime.memory import machine_memory

PACKAGES = ("fenics-dolfinx", "fenics-ufl", "numpy", "scipy", "numba", "mpi4py", "gmsh")


def environment(comm: MPI.Comm) -> dict[str, Any]:
    """Return versions, platform, ranks and date that belong to a result."""
    versions = {"valvefsi": valvefsi.__version__, "python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    from valvefsi.runtime.dolfinx_compat import RELEASE

    versions["fenics-dolfinx"] = str(RELEASE)
    return {
        "versions": versions,
        "platform": platform.platform(),
        "processor": platform.machine(),
        "mpi": MPI.Get_library_version().split("\n")[0].strip("\0 "),
        "ranks": comm.size,
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def machine() -> dict[str, Any]:
    """Return the processor's name, the cores that this process may use, and the memory [GiB]."""
    memory = machine_memory() / 2**30
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": _processor(),
        "cores": cores,
        "memory_gib": memory if math.isfinite(memory) else None,
    }


def _processor() -> str:
    """Return the name of the processor as the system knows it, its kind where it does not."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())
