"""What every benchmark leaves behind: ``result.json`` and the environment it was made in."""

from __future__ import annotations

import importlib.metadata
import json
import platform
import time
from pathlib import Path

import numpy as np
from mpi4py import MPI

import valvefsi

PACKAGES = ("fenics-dolfinx", "fenics-ufl", "numpy", "scipy", "numba", "mpi4py", "gmsh")


def environment(comm: MPI.Comm) -> dict[str, object]:
    """Versions, platform, ranks and date that belong to a result."""
    versions = {"valvefsi": valvefsi.__version__, "python": platform.python_version()}
    for name in PACKAGES:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    from valvefsi.runtime.dolfinx_compat import RELEASE

    versions["fenics-dolfinx"] = RELEASE
    return {
        "versions": versions,
        "platform": platform.platform(),
        "processor": platform.machine(),
        "mpi": MPI.Get_library_version().split("\n")[0].strip("\0 "),
        "ranks": comm.size,
        "date": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def write_result(out: Path, result: dict[str, object], comm: MPI.Comm) -> Path:
    """Write ``result.json`` on rank 0; numbers keep all their digits.

    Args:
        out: Folder of the result, made if need be.
        result: What to write.
        comm: Communicator of the run.
    """
    path = Path(out) / "result.json"
    if comm.rank == 0:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=2, default=_plain) + "\n")
    comm.barrier()
    return path


def _plain(value: object) -> object:
    if isinstance(value, np.generic | np.ndarray):
        return value.tolist()
    return str(value)


def row(
    quantity: str,
    computed: float | str,
    reference: float | str | None = None,
    source: str = "",
    *,
    unit: str = "",
    relative: bool = True,
) -> dict[str, object]:
    """One line of a benchmark's table: what was computed, what it is compared with, where that comes from."""
    difference = None
    if isinstance(computed, float) and isinstance(reference, float) and reference and relative:
        difference = 100.0 * (computed - reference) / abs(reference)
    return {
        "quantity": quantity,
        "computed": computed,
        "reference": reference,
        "difference_percent": difference,
        "unit": unit,
        "source": source,
    }
