"""``valvefsi doctor``: what of an installation works, how fast it is, and what to do about the rest."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import typer

from valvefsi.errors import SurroundingsError
from valvefsi.runtime.installing import how_to_add, how_to_set_up, source_tree

PATIENCE = 120.0
"""Longest time that another process may take [s]."""
START, PAIRS = 3.0, 15.0
"""Start of the command [s] and step of the fluid [cosine transforms and back] above which something is slow."""
COUNT_RANKS = "from mpi4py import MPI; c = MPI.COMM_WORLD; c.rank or print(c.size)"
BLOCK = {
    "grid": {"lower": [0, 0], "upper": [1, 1], "cells": [16, 16]},
    "fluid": {"viscosity": 0.1, "sides": {"y_upper": {"velocity": [1.0, 0.0]}}},
    "time": {"dt": "2 ms", "t_end": "20 ms"},
    "output": {"frames": 0},
    "solid": [
        {
            "name": "block",
            "mesh": {
                "shape": "rectangle",
                "lower": [0.375, 0.375],
                "size": [0.25, 0.25],
                "elements": [4, 4],
            },
            "material": {"model": "neo_hookean", "c1": 10.0},
        }
    ],
}
"""A soft block in a cavity, as small as it can be: meshes, forms, compiled loops, coupling and files."""
BOX = 48
"""Cells along each edge of the box whose step is timed."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What a check has found.

    Attributes:
        good: Whether it is as it should be.
        text: What there is.
        advice: What to do where it is not good.
    """

    good: bool
    text: str
    advice: str = ""


@dataclass(frozen=True, kw_only=True)
class Check:
    """A part of an installation.

    Attributes:
        name: What it is.
        look: Looks at it; an error that it raises is what is wrong.
        needed: Whether nothing can be run without it.
        advice: What to do where it raises.
    """

    name: str
    look: Callable[[], Finding]
    needed: bool = True
    advice: str = how_to_set_up()


def _python() -> Finding:
    good = sys.version_info >= (3, 11)
    text = f"{platform.python_version()}, {platform.system()} on {platform.machine()}"
    return Finding(good=good, text=text, advice="Python 3.11 or newer is needed")


def _machine() -> Finding:
    from valvefsi.run.disk import disk_free
    from valvefsi.runtime.memory import machine_memory

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] / (cores or 1)
    text = f"{cores} cores, {machine_memory() / 1e9:.3g} GB of memory, {disk_free(Path()) / 1e9:.3g} GB free here"
    advice = f"other programs want {load:.1f} times the cores there are: runs and times below are slow"
    return Finding(good=load < 1.5, text=text, advice=advice)


def _dolfinx() -> Finding:
    from valvefsi.runtime.dolfinx_compat import RELEASE

    return Finding(good=True, text=f"{RELEASE}, real numbers")


def _two_ranks() -> Finding:
    beside = Path(sys.executable).with_name("mpirun")
    program = str(beside) if beside.exists() else shutil.which("mpirun")
    if program is None:
        return Finding(
            good=False,
            text="no mpirun",
            advice=f"{how_to_set_up()}; with Debian's own DOLFINx apt-get install openmpi-bin",
        )
    ranks = ("PMI", "OMPI_", "PMIX", "HYDRA", "MPI")
    own = {k: v for k, v in os.environ.items() if not k.startswith(ranks)}
    done = subprocess.run(
        [program, "-n", "2", sys.executable, "-c", COUNT_RANKS],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
        env=own,
    )
    advice = f"{program} belongs to another MPI than mpi4py; use the one beside {sys.executable}"
    return Finding(
        good=done.stdout.strip() == "2", text=f"two ranks see each other ({program})", advice=advice
    )


def _meshes() -> Finding:
    from valvefsi.cli.new import STARTS
    from valvefsi.geometry.importing import import_mesh

    with tempfile.TemporaryDirectory() as folder:
        flap = STARTS / "own-mesh" / "flap.stl"
        numbers = import_mesh(flap, Path(folder) / "flap.msh", scale=0.1, size=0.3)
    return Finding(good=True, text=f"a surface is filled with {numbers['cells']} tetrahedra")


def _run() -> Finding:
    from mpi4py import MPI

    from valvefsi.case import parse_case
    from valvefsi.case.build import run_case

    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        last = run_case(parse_case(BLOCK), out=Path(folder), comm=MPI.COMM_SELF)["timing"]
    wall = time.perf_counter() - started
    steps = last["steps"] if isinstance(last, dict) else 0
    text = f"a block in a cavity, {steps} steps and pictures in {wall:.1f} s"
    return Finding(good=steps == 10, text=text)


def _speed() -> Finding:
    import numpy as np
    from mpi4py import MPI
    from scipy.fft import dctn, idctn

    from valvefsi.fluid.boundary import Boundary
    from valvefsi.fluid.navier_stokes import ExplicitViscosity
    from valvefsi.grid import MacGrid

    grid = MacGrid([0.0] * 3, [1.0] * 3, [BOX] * 3, [False] * 3, MPI.COMM_SELF)
    fluid = ExplicitViscosity(grid, Boundary(grid, {}), rho=1.0, mu=0.01, advection="xsppm7")
    u, p, f, x = grid.zero_faces(), grid.zeros(), grid.zero_faces(), np.zeros((BOX,) * 3)

    def step() -> object:
        N = fluid.advection(u)
        return fluid.step(u, p, (N, N, 1.0), f, 0.0, 1e-4)

    pair = _shortest(lambda: idctn(dctn(x, workers=1), workers=1))
    pairs = _shortest(step) / pair
    text = f"a step of {BOX} x {BOX} x {BOX} cells takes {pairs:.1f} cosine transforms and back"
    advice = "check OMP_NUM_THREADS and what else runs; `valvefsi bench speed` says which part is slow"
    return Finding(good=pairs < PAIRS, text=text, advice=advice)


def _shortest(call: Callable[[], object]) -> float:
    """Return the shortest time of some calls, after one that compiles [s]."""
    call()
    times = []
    for _ in range(5):
        started = time.perf_counter()
        call()
        times.append(time.perf_counter() - started)
    return min(times)


def _start() -> Finding:
    started = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "valvefsi", "--version"], capture_output=True, timeout=PATIENCE, check=True
    )
    took = time.perf_counter() - started
    advice = "the disk or the machine is slow; the second start is faster than the first"
    return Finding(good=took < START, text=f"valvefsi --version in {took:.1f} s", advice=advice)


def _pictures() -> Finding:
    from valvefsi.post.plots.solid import can_render

    advice = (
        f"{how_to_add('plot')} and, on Debian, apt-get install libegl1; until then matplotlib draws bodies"
    )
    good = can_render()
    return Finding(
        good=good, text="pyvista draws without a display" if good else "no pyvista or EGL", advice=advice
    )


def _ffmpeg() -> Finding:
    from valvefsi.post.movies import find_ffmpeg

    where = find_ffmpeg()
    advice = (
        f"movies are .gif without it; {how_to_add('movies')} brings one, on Debian apt-get install ffmpeg"
    )
    return Finding(good=where is not None, text=where or "not here, no .mp4", advice=advice)


def _path() -> Finding:
    where = shutil.which("valvefsi")
    advice = f'export PATH="{Path(sys.executable).parent}:$PATH"'
    return Finding(good=where is not None, text=where or "valvefsi is not on PATH", advice=advice)


LIBRARIES = (
    "gcc libc6-dev python3-dev libglu1-mesa libgl1 libxft2 libxcursor1 libxinerama1 libxrender1 libxfixes3 "
    "libfontconfig1 libgomp1"
)
"""What compiled forms and gmsh's wheel need of Debian."""
COMPILER = (
    f"{how_to_set_up()} names the packages that are missing, a C compiler or shared libraries"
    if source_tree()
    else f"a C compiler, Python's header files and gmsh's libraries; on Debian apt-get install {LIBRARIES}"
)
CHECKS = (
    Check(name="Python", look=_python),
    Check(name="machine", look=_machine, needed=False),
    Check(name="command", look=_path, needed=False),
    Check(name="start", look=_start, needed=False),
    Check(name="DOLFINx", look=_dolfinx, advice=how_to_add("dolfinx")),
    Check(name="MPI", look=_two_ranks, needed=False),
    Check(name="gmsh", look=_meshes, advice=COMPILER),
    Check(name="coupled run", look=_run, advice=COMPILER),
    Check(name="speed", look=_speed, needed=False),
    Check(name="3-D pictures", look=_pictures, needed=False),
    Check(name="ffmpeg", look=_ffmpeg, needed=False),
)


def doctor() -> None:
    """Say what of the installation works, how fast it is, and what to do about the rest; half a minute."""
    broken = []
    for check in CHECKS:
        finding = found_by(check)
        verdict = "ok" if finding.good else "FAILS" if check.needed else "note"
        typer.echo(f"{verdict:5s}  {check.name:12s}  {finding.text}")
        if not finding.good:
            typer.echo(f"{'':21s}-> {finding.advice}")
            broken += [check.name] if check.needed else []
        sys.stdout.flush()
    if broken:
        raise SurroundingsError(f"nothing can be run before this is put right: {', '.join(broken)}")


def found_by(check: Check) -> Finding:
    """Return what a check finds; whatever it raises is a finding, too."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return check.look()
    except Exception as error:
        text = " ".join(str(error).split()) or type(error).__name__
        return Finding(good=False, text=text[:200], advice=check.advice)
