"""valvefsi: heart-valve mechanics from bench data to a verified simulation.

    result = valvefsi.simulate("case.toml", fluid__viscosity="2 cP")
    result = valvefsi.open("results/case")

Importing the package is cheap: DOLFINx, PETSc, numba and gmsh are imported by the modules that need them.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from valvefsi.errors import ValvefsiError
    from valvefsi.scripting.result import Result
    from valvefsi.scripting.simulate import open_run as open
    from valvefsi.scripting.simulate import simulate

__all__ = ["Result", "ValvefsiError", "open", "simulate"]

# Threads of the BLAS under this code only get in the way; it has its own, see `valvefsi.runtime.threads`, as many as
# OMP_NUM_THREADS says where that is set. All must be set before numpy is imported.
if "OMP_NUM_THREADS" in os.environ:
    os.environ.setdefault("VALVEFSI_THREADS", os.environ["OMP_NUM_THREADS"])
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.2.0"

# What a script needs, loaded when it is first asked for: (module, name).
_LAZY = {
    "Result": ("valvefsi.scripting.result", "Result"),
    "ValvefsiError": ("valvefsi.errors", "ValvefsiError"),
    "open": ("valvefsi.scripting.simulate", "open_run"),
    "simulate": ("valvefsi.scripting.simulate", "simulate"),
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'valvefsi' has no attribute {name!r}")
    module, attribute = _LAZY[name]
    return getattr(importlib.import_module(module), attribute)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
