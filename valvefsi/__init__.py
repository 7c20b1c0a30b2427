"""valvefsi: heart-valve mechanics from bench data to a verified simulation.

Importing the package is cheap: DOLFINx, PETSc, numba and gmsh are imported by the modules that need them.
"""

from __future__ import annotations

import os

# Threads of the BLAS under this code only get in the way; it has its own, see `valvefsi.runtime.threads`, as many as
# OMP_NUM_THREADS says where that is set. All must be set before numpy is imported.
if "OMP_NUM_THREADS" in os.environ:
    os.environ.setdefault("VALVEFSI_THREADS", os.environ["OMP_NUM_THREADS"])
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
