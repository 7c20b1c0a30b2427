"""Processes that are killed, stopped, out of disk, or whose clock jumps, and what they leave."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tests.campaign.comparison import differences, torn
from tests.campaign.warm import Warm
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
BIAXIAL = "protocol,stretch1,stretch2,P11_kPa,P22_kPa\n" + "\n".join(
    f"{1 + k // 8},{1 + 0.02 * (k % 8)},{1 + 0.015 * (k % 8)},{(k % 8) ** 2},{1.2 * (k % 8) ** 2}"
    for k in range(24)
)
SMALL_DISK = """
from mpi4py import MPI
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))
from valvefsi.cli import main
main()
"""
"""The command line where no file grows above a limit; MPI itself has begun before."""
JUMPING = """
import os, random, time
rng = random.Random({0} + 1000 * int(os.environ.get("PMI_RANK", "0")))
def jumping(clock, back):
    shift = 0.0
    def read():
        nonlocal shift
        if rng.random() < 0.02:
            shift += rng.choice((0.5, 700.0, 86400.0, *back))
        return clock() + shift
    return read
time.time = jumping(time.time, (-3600.0, -5.0))
time.perf_counter, time.monotonic = jumping(time.perf_counter, ()), jumping(time.monotonic, ())
from valvefsi.cli import main
main()
"""
"""The command line where clocks jump, on each rank by itself; those that the system keeps monotonic do not go back."""
SHORTER = ("--set", "time.t_end='0.06 s'", "--set", "output.frames=4")
UNSTRESSED = ("--set", "output.stress=[]")
"""Of two ranks: fewer steps; no stress in the frames, which takes most of the time and hundreds of messages."""
SERIES = ("--grid", "16", "--refine", "1", "--set", "t_end='4 s'")
SAME, PATIENCE, ENDING = 1e-12, 1800.0, 300.0
"""Difference that counts as none; seconds until a run hangs, and until ranks hang of which one was killed."""
Popen = subprocess.Popen[str]


@dataclass(frozen=True)
class Job:
    """A process of the command line.

    Attributes:
        name: What it is.
        arguments: After ``valvefsi``, without ``--out``.
        ranks: Number of ranks.
        file: Name of the file that ``--out`` means, in the folder of the job; empty where it means the folder.
        again: What goes on with it, or does it again, after it was killed.
        writes_late: Whether it writes at its end only, so that half of the kills wait for its first file.
        begin: How Python comes to the command line.
    """

    name: str
    arguments: tuple[str, ...]
    ranks: int = 1
    file: str = ""
    again: tuple[str, ...] = ("--resume",)
    writes_late: bool = False
    begin: tuple[str, ...] = ("-m", "valvefsi")

    def forked_by(self, warm: Warm) -> Job:
        """Return the same job, done by processes that a server forks."""
        return replace(self, begin=warm.begin)

    def start(self, out: Path, *more: str, begin: Sequence[str] = ()) -> Popen:
        """Start it, in a session of its own; ``begin`` stands for `Job.begin`."""
        launch = ["mpirun", "-n", str(self.ranks)] if self.ranks > 1 else []
        place = str(out / self.file) if self.file else str(out)
        command = [*launch, sys.executable, *(begin or self.begin), *self.arguments, "--out", place, *more]
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
        return subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=environment,
            cwd=ROOT,
        )

    def run(self, out: Path, *more: str, begin: Sequence[str] = ()) -> tuple[int, str]:
        """Run it to its end; return its exit code and what it said."""
        process = self.start(out, *more, begin=begin)
        try:
            _, said = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return -1, "hang"
        return process.returncode, said


def ranks_of(process: Popen) -> list[int]:
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


def empty(out: Path) -> None:
    """Make a folder that holds nothing."""
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)


def go_on(job: Job, whole: Path, out: Path, *, checkpoints: bool = True) -> str:
    """Go on with what was broken off, begin anew where there is nothing to go on from, and compare every file."""
    code, said = job.run(out, *job.again)
    how = "resumed" if job.again else "done again"
    if "--resume" in job.again and nothing_to_resume(code, said):
        code, said = job.run(out, "--overwrite")
        how = "begun anew"
    if code != 0:
        return f"failed: {said.strip().splitlines()[-1] if said.strip() else code}"
    return f"{how}, {answer(whole, out, checkpoints=checkpoints)}"


def nothing_to_resume(code: int, said: str) -> bool:
    """Return whether a process ended because there was no checkpoint to resume from."""
    return code == 2 and ("no whole checkpoint" in said or "no checkpoint" in said)


def answer(whole: Path, out: Path, *, checkpoints: bool = True) -> str:
    """Say whether every file of a folder is that of the uninterrupted run."""
    gaps = {name: gap for name, gap in differences(out, whole, checkpoints=checkpoints).items() if gap > SAME}
    if not gaps:
        return "same in every file"
    worst = max(gaps, key=gaps.__getitem__)
    return f"another answer in {len(gaps)} files: {worst} {gaps[worst]:.1e}"


def full_disk_and_resume(job: Job, whole: Path, out: Path, limit: int) -> str:
    """Let no file grow above a limit [bytes], then lift it and go on."""
    empty(out)
    code, said = job.run(out, begin=("-c", SMALL_DISK.format(limit)))
    return _one_line(out, code, said) or go_on(job, whole, out)


def small_disk_and_resume(job: Job, whole: Path, out: Path, part: float) -> str:
    """Run on a disk of a part of the size that is needed, make it larger, and go on; needs the right to mount."""
    size = sum(path.stat().st_size for path in whole.rglob("*") if path.is_file())
    empty(out)
    if not _mount(out, f"size={int(part * size)}"):
        return "not run: no disk can be mounted here"
    try:
        code, said = job.run(out)
        fault = _one_line(out, code, said)
        if fault:
            return fault
        if not _mount(out, f"remount,size={4 * size + 2**24}"):
            return "not run: the disk cannot be made larger"
        return go_on(job, whole, out)
    finally:
        subprocess.run(["umount", str(out)], check=False, capture_output=True)


def _mount(folder: Path, options: str) -> bool:
    command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    return subprocess.run(command, check=False, capture_output=True).returncode == 0


def _one_line(out: Path, code: int, said: str) -> str:
    """Return what is wrong with the end of a process that had no disk left, nothing if all is right."""
    lines = [line for line in said.splitlines() if line.startswith(("error", "Traceback"))]
    internals = any(word in said for word in ("Traceback", "error stack", "MPI_"))
    if code != 4 or len(lines) != 1 or internals:
        return f"not one line: exit {code}, {said.strip()[-200:]}"
    broken = next(torn(out), None)
    return f"torn file {broken}" if broken else ""


def stop_and_continue(job: Job, whole: Path, out: Path, rng: random.Random, length: float) -> str:
    """Stop every rank for a second and let it go on."""
    empty(out)
    process = job.start(out)
    time.sleep(rng.uniform(0.3, 0.9) * length)
    for number in (signal.SIGSTOP, signal.SIGCONT):
        for pid in ranks_of(process):
            os.kill(pid, number)
        time.sleep(1.0)
    _, said = process.communicate(timeout=PATIENCE)
    return answer(whole, out) if process.returncode == 0 else f"failed: {said[-200:]}"


def jump_the_clock(job: Job, whole: Path, out: Path, seed: int) -> str:
    """Run with clocks that jump; checkpoints by the clock may come at other steps than in the whole run."""
    empty(out)
    code, said = job.run(out, begin=("-c", JUMPING.format(seed)))
    return answer(whole, out, checkpoints=False) if code == 0 else f"failed: exit {code}, {said[-200:]}"


def jobs(folder: Path) -> list[Job]:
    """Return the processes that are killed.

    A block in two dimensions, a valve with circuits and adaptive steps, a fit, a series, a movie.
    """
    case, record = folder / "block.toml", folder / "record.csv"
    case.write_text(BLOCK, encoding="utf-8")
    record.write_text(BIAXIAL, encoding="utf-8")
    valve = (
        "run",
        str(ROOT / "demos" / "pericardial_valve.toml"),
        *(x for text in VALVE for x in ("--set", text)),
    )
    block = ("run", str(case))
    movie = Job("movie", ("movie", str(folder / "movie_of")), file="movie.gif", again=(), writes_late=True)
    return [
        Job("block, one rank", block),
        Job("block, two ranks", (*block, *SHORTER), 2),
        Job("valve, one rank", valve),
        Job("valve, two ranks", (*valve, *UNSTRESSED), 2),
        Job(
            "fit of 32 starts", ("fit", "biaxial", str(record), "--starts", "32"), again=(), writes_late=True
        ),
        Job("series of four runs", ("bench", "compression", *SERIES), again=()),
        movie,
    ]


def prepare(job: Job, folder: Path) -> None:
    """Make what a job needs: the run that a movie is of."""
    if job.name == "movie":
        code, said = Job("", ("run", str(folder / "block.toml"))).run(folder / "movie_of", "--overwrite")
        if code != 0:
            raise RuntimeError(f"the run of the movie fails: {said[-300:]}")


def attack(job: Job, folder: Path, seed: int) -> Iterator[str]:
    """Fill a process' disk, stop it, let its clock jump; yield what came of each."""
    rng = random.Random(f"{seed} {job.name}")
    whole, out = folder / "whole", folder / "attacked"
    empty(whole)
    began = time.monotonic()
    code, said = job.run(whole)
    if code != 0:
        yield f"the run itself fails: {said[-300:]}"
        return
    length = time.monotonic() - began
    largest = max(path.stat().st_size for path in whole.rglob("*") if path.is_file())
    for limit in (largest // 2, 2000):
        yield f"full disk: {full_disk_and_resume(job, whole, out, limit)}"
    for part in (0.2, 0.7):
        yield f"full disk: {small_disk_and_resume(job, whole, out, part)}"
    for _ in range(2):
        yield f"stopped and continued: {stop_and_continue(job, whole, out, rng, length)}"
    for number in range(2):
        yield f"clock that jumps: {jump_the_clock(job, whole, out, seed + number)}"
