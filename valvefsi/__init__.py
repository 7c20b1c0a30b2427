"""valvefsi: heart-valve mechanics from bench data to a verified simulation.

Importing the package is cheap: DOLFINx, PETSc, numba and gmsh are imported by the modules that need them.
"""

from __future__ import annotations

import os

# One process per core is the way this code runs in parallel; threads of the BLAS under it only get in the way.
# Both must be set before numpy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.1.0"
