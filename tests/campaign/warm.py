"""The command line in processes forked from one that has imported the libraries: a start takes tenths of a second.

Most of a short run is the import of its libraries. A server imports them once and begins neither MPI nor PETSc; for
each process of a job a small client (under ``mpirun`` one for each rank) hands its arguments, environment, folder and
open files to the server, which forks. The fork begins MPI and calls the `main` that ``python -m valvefsi`` calls. It
is a process of its own: it is killed, and its client ends as it ended, so that a launcher sees what it would see.
Kills during the import of the libraries, before the command line has read anything, do not occur.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT, CLIENT = Path(__file__).parents[2], Path(__file__).with_name("client.py")
LIBRARIES = """
dolfinx.fem.petsc dolfinx.mesh dolfinx.io dolfinx.geometry dolfinx.jit ffcx.codegeneration.jit gmsh meshio numba
matplotlib.figure matplotlib.backends.backend_agg matplotlib.streamplot matplotlib.animation mpl_toolkits.mplot3d
scipy.linalg scipy.fft scipy.sparse.linalg scipy.optimize scipy.interpolate scipy.spatial scipy.stats
PIL.PngImagePlugin PIL.GifImagePlugin pydantic pint rich.table rich.progress
valvefsi.cli.closing valvefsi.case.build valvefsi.case.valve_report valvefsi.run.pictures valvefsi.post.plots
valvefsi.post.movies valvefsi.fitting.biaxial valvefsi.benchmarks.immersed.compression
"""
BEGINNING, ENDING = 120.0, 300.0
"""Seconds until a server, or the end of its processes, is given up."""


class Warm:
    """A server of forks, and what it has forked."""

    def __init__(self) -> None:
        self._last: dict[int, int] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="warm")
        place = Path(self._folder.name) / "socket"
        self.begin = ("-I", "-S", str(CLIENT), str(place))
        """How Python comes to the command line, for `Job.start`."""
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        self._server = subprocess.Popen(
            [sys.executable, "-m", "tests.campaign.warm", str(place)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            cwd=ROOT,
            env=environment,
        )
        deadline = time.monotonic() + BEGINNING
        while not place.exists():
            if self._server.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the server of forks does not begin")
            time.sleep(0.05)

    def ranks(self) -> dict[int, int]:
        """Return the processes that are alive, by rank."""
        pids = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit()]
        ranks = {pid: self._rank(pid) for pid in pids}
        return {rank: pid for pid, rank in ranks.items() if rank is not None}

    def spent(self, rank: int) -> float | None:
        """Return the computing time of a rank's process so far [s]; None where there is none."""
        try:
            return float((Path("/proc") / str(self._find(rank)) / "schedstat").read_text().split()[0]) * 1e-9
        except OSError:
            return None

    def kill(self, rank: int) -> bool:
        """Kill a rank's process outright; return whether it was there."""
        pid = self._find(rank)
        if pid is None:
            return False
        os.kill(pid, signal.SIGKILL)
        return True

    def _rank(self, pid: int) -> int | None:
        """Return the rank of a process; None where it has ended, or is none of the server's."""
        try:
            text = (Path("/proc") / str(pid) / "stat").read_text()
        except OSError:
            return None
        name, _, rest = text.partition("(")[2].rpartition(")")
        state, parent = rest.split()[:2]
        ours = int(parent) == self._server.pid and name.startswith("rank") and state != "Z"
        return int(name[4:]) if ours else None

    def _find(self, rank: int) -> int | None:
        """Return the process of a rank; all processes are looked at only where the last one has ended."""
        pid = self._last.get(rank)
        if pid is None or self._rank(pid) != rank:
            self._last = self.ranks()
        return self._last.get(rank)

    def settle(self) -> bool:
        """Wait until no process is left; return whether they ended by themselves."""
        deadline = time.monotonic() + ENDING
        while pids := self.ranks().values():
            if time.monotonic() > deadline:
                for pid in pids:
                    os.kill(pid, signal.SIGKILL)
                return False
            time.sleep(0.02)
        return True

    def close(self) -> None:
        """End the server and what it has forked."""
        self._server.communicate()
        self._folder.cleanup()


def serve(place: Path) -> None:
    """Fork for each client that connects, until the standard input ends."""
    parts = _import()
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(str(place.with_suffix(".new")))
    listener.listen()
    place.with_suffix(".new").rename(place)
    clients: dict[int, socket.socket] = {}  # by process
    ends: dict[int, int] = {}  # processes by the file that is ready at their end
    while True:
        ready, _, _ = select.select([0, listener, *clients.values(), *ends], [], [])
        if 0 in ready:
            for pid in ends.values():
                os.kill(pid, signal.SIGKILL)
            return
        for pid, client in list(clients.items()):
            if client in ready:
                sent = client.recv(32)
                os.kill(pid, int(sent) if sent else signal.SIGKILL)
                if not sent:
                    clients.pop(pid).close()
        for end in [end for end in ends if end in ready]:
            _bury(ends.pop(end), end, clients)
        if listener in ready:
            client, _ = listener.accept()
            request, files, _, _ = socket.recv_fds(client, 1 << 20, 8)
            pid = os.fork()
            if pid == 0:
                _work(json.loads(request), files, parts)
            for file in files:
                os.close(file)
            clients[pid] = client
            ends[os.pidfd_open(pid)] = pid


def _bury(pid: int, end: int, clients: dict[int, socket.socket]) -> None:
    """Tell the client of a process how it ended."""
    os.close(end)
    _, status = os.waitpid(pid, 0)
    client = clients.pop(pid, None)
    if client is not None:
        with contextlib.suppress(OSError):  # the client may have gone
            client.send(str(status).encode())
        client.close()


def _import() -> tuple[Any, Any]:
    """Import the libraries without beginning MPI; return MPI and PETSc."""
    import mpi4py

    mpi4py.rc.initialize, mpi4py.rc.finalize = False, True
    import petsc4py.lib
    from mpi4py import MPI

    petsc = petsc4py.lib.ImportPETSc()
    sys.modules["petsc4py.PETSc"] = petsc
    for name in LIBRARIES.split():
        importlib.import_module(name)
    if MPI.Is_initialized() or len(list(Path("/proc/self/task").iterdir())) > 1:
        raise RuntimeError("a process with MPI or threads cannot be forked")
    return MPI, petsc


def _work(request: dict[str, Any], files: list[int], parts: tuple[Any, Any]) -> None:
    """Be one process of the command line; leaves with its exit code."""
    os.setsid()
    for target, file in zip((0, 1, 2), (os.open(os.devnull, os.O_RDONLY), *files), strict=False):
        os.dup2(file, target)
    os.environ.clear()
    os.environ.update(request["environment"])
    if len(files) > 2:  # MPI's way to its launcher
        os.environ["PMI_FD"] = str(files[2])
    os.chdir(request["folder"])
    Path("/proc/self/comm").write_text(f"rank{os.environ.get('PMI_RANK', '0')}", encoding="ascii")
    sys.argv = ["valvefsi", *request["arguments"]]
    mpi, petsc = parts
    mpi.Init_thread(mpi.THREAD_MULTIPLE)
    petsc._initialize()
    from valvefsi.cli import main

    main()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
