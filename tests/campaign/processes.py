"""Runs in processes of their own that are killed, stopped, or out of disk, and what they leave."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.io.history import read_history

ROOT = Path(__file__).parents[2]
BLOCK = """
[grid]
lower = [0, 0]
upper = [1, 1]
cells = [32, 32]
[fluid]
viscosity = 0.1
sides.y_upper = { velocity = [1.0, 0.0] }
[time]
dt = "1 ms"
t_end = "0.3 s"
[output]
frames = 10
history_every = 7
checkpoint_every = 10
[[solid]]
name = "block"
mesh = { shape = "rectangle", lower = [0.375, 0.375], size = [0.25, 0.25], elements = [8, 8] }
material = { model = "neo_hookean", c1 = 10.0 }
"""
VALVE = (
    "grid.h=2mm",
    "grid.core_lower=['-2.1 cm', '-2.1 cm', '-2 cm']",
    "grid.core_upper=['2.1 cm', '2.1 cm', '6 cm']",
    "solid.leaflets.mesh.valve.ratio=1.5",
    "time.dt_per_h='0.0002 s/cm'",
    "time.control=adaptive",
    "time.t_end='1.6 ms'",
    "output.history_every=4",
    "output.checkpoint_every=4",
    "output.frames=4",
)
SMALL_DISK = """
from mpi4py import MPI
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
from valvefsi.cli import main
main()
"""
"""The command line where no file grows above a limit; MPI itself has begun before."""
SAME, PATIENCE = 1e-12, 300.0


@dataclass(frozen=True)
class Job:
    """A run of the command line.

    Attributes:
        name: What it is.
        arguments: After ``valvefsi``, without ``--out``.
        ranks: Number of ranks.
    """

    name: str
    arguments: tuple[str, ...]
    ranks: int = 1

    def start(self, out: Path, *more: str, limit: int | None = None) -> subprocess.Popen[str]:
        """Start it, in a session of its own; ``limit`` is the largest file it may write [bytes]."""
        launch = ["mpirun", "-n", str(self.ranks)] if self.ranks > 1 else []
        begin = ["-m", "valvefsi"] if limit is None else ["-c", SMALL_DISK.format(limit)]
        command = [*launch, sys.executable, *begin, *self.arguments, "--out", str(out), *more]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        return subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=environment,
        )

    def run(self, out: Path, *more: str, limit: int | None = None) -> tuple[int, str]:
        """Run it to its end; return its exit code and what it said."""
        process = self.start(out, *more, limit=limit)
        try:
            _, said = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return -1, "hang"
        return process.returncode, said


def ranks_of(process: subprocess.Popen[str]) -> list[int]:
    """Return the processes of the ranks, by rank; the process itself where it has no launcher."""
    found: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        try:
            pid = int(entry.name)
            same = os.getsid(pid) == os.getsid(process.pid) or _descends(pid, process.pid)
            variables = dict(
                item.split(b"=", 1) for item in (entry / "environ").read_bytes().split(b"\0") if b"=" in item
            )
            line = (entry / "cmdline").read_bytes()
        except (OSError, ValueError):
            continue
        if same and (b"valvefsi" in line or b"-c" in line) and b"mpirun" not in line.split(b"\0")[0]:
            rank = variables.get(b"PMI_RANK", variables.get(b"OMPI_COMM_WORLD_RANK"))
            if rank is not None or pid == process.pid:
                found[int(rank or 0)] = pid
    return [found[rank] for rank in sorted(found)]


def _descends(pid: int, ancestor: int) -> bool:
    while pid > 1:
        if pid == ancestor:
            return True
        pid = int((Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[1])
    return False


def difference(ours: Path, theirs: Path) -> float:
    """Return the largest difference of any history of two runs, as a part of each column's largest value."""
    return max(_gap(ours / path.name, path) for path in theirs.glob("*.csv"))


def _gap(ours: Path, theirs: Path) -> float:
    if not ours.is_file():
        return float("inf")
    a, b = read_history(ours), read_history(theirs)
    if a.keys() != b.keys() or len(a["step"]) != len(b["step"]):
        return float("inf")
    gaps = []
    for name, values in b.items():
        mine, other = np.array(a[name]), np.array(values)
        gaps.append(np.abs(mine - other).max() / max(np.abs(other).max(), 1e-12))
    return float(max(gaps))


def kill_and_resume(job: Job, whole: Path, out: Path, rng: random.Random, length: float) -> str:
    """Kill a run outright at a moment within ``length`` seconds, resume it, and say what came of it."""
    shutil.rmtree(out, ignore_errors=True)
    process = job.start(out)
    deadline = time.monotonic() + rng.uniform(0.0, length)
    while time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.005)
    ended = process.poll() is not None
    pids = [] if ended else ranks_of(process)
    victim = rng.choice(pids) if pids else process.pid
    if not ended:
        os.kill(victim, signal.SIGKILL)
    try:
        process.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return "the other ranks hung"
    code, said = job.run(out, "--resume")
    how = "resumed"
    if code == 2 and ("no whole checkpoint" in said or "no checkpoint" in said):
        code, said = job.run(out)
        how = "begun anew"
    if code != 0:
        return f"failed: {said.strip().splitlines()[-1] if said.strip() else code}"
    gap = difference(out, whole)
    return f"{how}, same answer" if gap <= SAME else f"another answer: {gap:.1e}"


def full_disk_and_resume(job: Job, whole: Path, out: Path, limit: int) -> str:
    """Let no file grow above a limit, then lift it and resume."""
    shutil.rmtree(out, ignore_errors=True)
    code, said = job.run(out, limit=limit)
    lines = [line for line in said.splitlines() if line.startswith(("error", "Traceback"))]
    if code != 4 or len(lines) != 1 or "Traceback" in said:
        return f"not one line: exit {code}, {said.strip()[-200:]}"
    code, said = job.run(out, "--resume")
    if code == 2 and "no whole checkpoint" in said:
        code, said = job.run(out, "--overwrite")
    return (
        "one line, same answer"
        if code == 0 and difference(out, whole) <= SAME
        else f"exit {code}: {said[-200:]}"
    )


def stop_and_continue(job: Job, whole: Path, out: Path, rng: random.Random, length: float) -> str:
    """Stop every rank for a second and let it go on."""
    shutil.rmtree(out, ignore_errors=True)
    process = job.start(out)
    time.sleep(rng.uniform(0.3, 0.9) * length)
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for pid in ranks_of(process):
            os.kill(pid, number)
        time.sleep(1.0)
    _, said = process.communicate(timeout=PATIENCE)
    return (
        "same answer"
        if process.returncode == 0 and difference(out, whole) <= SAME
        else f"failed: {said[-200:]}"
    )


def jobs(folder: Path) -> list[Job]:
    """Return the runs that are killed: a block in two dimensions and a valve with circuits, on one and two ranks."""
    case = folder / "block.toml"
    case.write_text(BLOCK)
    valve = (
        "run",
        str(ROOT / "demos" / "pericardial_valve.toml"),
        *(x for text in VALVE for x in ("--set", text)),
    )
    return [
        Job("block, one rank", ("run", str(case))),
        Job("block, two ranks", ("run", str(case)), 2),
        Job("valve, one rank", valve),
        Job("valve, two ranks", valve, 2),
    ]


def attack(job: Job, folder: Path, count: int, seed: int) -> dict[str, int]:
    """Kill a run ``count`` times, fill its disk and stop it; return how often what came of it."""
    rng = random.Random(f"{seed} {job.name}")
    whole, out = folder / "whole", folder / "killed"
    began = time.monotonic()
    code, said = job.run(whole)
    if code != 0:
        return {f"the run itself fails: {said[-300:]}": 1}
    length, outcomes = time.monotonic() - began, []
    for _ in range(count):
        outcomes.append("kill -9: " + kill_and_resume(job, whole, out, rng, length))
    largest = max(path.stat().st_size for path in (whole / "checkpoints").iterdir())
    for limit in (largest // 2, 2000):
        outcomes.append("full disk: " + full_disk_and_resume(job, whole, out, limit))
    outcomes.append("stopped and continued: " + stop_and_continue(job, whole, out, rng, length))
    return {name: outcomes.count(name) for name in dict.fromkeys(outcomes)}
