"""One tiny run of every benchmark: seconds of work, every quantity of its result."""

from __future__ import annotations

from valvefsi.benchmarks.registry import ENTRIES

KINDS = {entry.name: entry for entry in ENTRIES}
TINY = {
    "channel": {"cells": 8},
    "cavity": {"cells": 8, "overrides": ["steady=1e-2"]},
    "taylor-green": {"cells": 8, "overrides": ["t_end=10.2"]},
    "cylinder": {"cells": 8, "overrides": ["t_end=0.5", "width=12"]},
    "cylinder-fitted": {"size": 0.2, "overrides": ["t_end=0.5", "width=6"]},
    "tube": {"grid": "5 mm", "overrides": ["t_end=0.05"]},
    "leakage": {"overrides": ["h=2 mm", "dt=0.1 ms", "t_end=2 ms"]},
    "compression": {"elements": 8, "grid": 16, "overrides": ["t_end=0.1"]},
    "compression-series": {"grid": 8, "refine": 1, "overrides": ["t_end=0.1"]},
    "torsion": {"grid": 6, "ratio": 1.3, "overrides": ["t_end=0.01", "angle=0.2"]},
    "cook": {"grid": 12, "overrides": ["t_end=0.1"]},
    "shell": {"grid": 24, "refine": 0, "couplings": ("nodal", "elemental"), "overrides": ["t_end=0.01"]},
    "plate": {"thickness": (2.0,), "length": 8, "overrides": ["periods=0.5"]},
    "sphere-in-cavity": {"grid": 12, "elements": 2, "steps": 4},
    "disk-in-cavity": {"grid": 12, "refine": 2, "t_end": 0.02},
    "valve-2d": {"cells": 24, "t_end": 0.002},
    "turek-fsi": {"case": "fsi2", "cells": 2, "t_end": 0.01},
    "statics-compression": {"elements": 2},
    "statics-cook": {"elements": 2},
    "statics-torsion": {"cell": "hexahedron", "elements": 1},
    "thick-shells": {},
    "shells": {"refine": 0},
    "hgo-strip": {},
    "land": {"problem": (1,)},
    "kernels": {
        "kernels": ("bspline3",),
        "ratios": (1.0,),
        "couplings": ("nodal",),
        "grids": {"compression": 16, "cook": 12, "shell": 16},
        "overrides": ["compression.t_end=0.3", "cook.t_end=0.2", "shell.t_end=0.05"],
    },
    "speed": {"sizes": (8, 12), "steps": 2},
}


def tiny(name):
    """The tiny run of a benchmark."""
    return KINDS[name.removesuffix("-series")].load()(**TINY[name])
