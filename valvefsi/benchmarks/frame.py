"""The frame of all benchmarks.

A benchmark states its options and parameters, its runs, what one of them measures, what it is compared with and what
is drawn. `Benchmark.run` owns the rest: the series of runs, finished ones that a folder keeps, the clock, memory,
``result.json`` after each run (so that a finer one that is stopped loses nothing), pictures at the end.
"""

from __future__ import annotations

import gc
import json
import time
from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from mpi4py import MPI

from valvefsi.benchmarks.options import Parameters, Values, check_options, option, read_parameters
from valvefsi.benchmarks.results import Row, peak_memory, plain, write_result
from valvefsi.io.folder import write_text
from valvefsi.runtime.environment import environment
from valvefsi.runtime.memory import keep_freed_memory
from valvefsi.types import Progress

Record = dict[str, Any]
"""What one run gives, by name; names that begin with "_" are for pictures and in no file."""

Result = dict[str, Any]
"""The contents of ``result.json``."""

R = TypeVar("R")
"""What tells one run of a benchmark from another: its cells, its numerics."""
K = TypeVar("K")
"""What a benchmark is compared with, computed before the first run."""
Announce = Callable[[str, int, int, float | None], Progress | None]
"""Called before each run with its name, how many of how many are done, and the time to go [s] if known; at the end with
all done. Makes what shows the run."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """Where one run happens, or all of a command.

    Attributes:
        folder: Folder of its files, not made yet.
        comm: Communicator.
        progress: Called after every step; may be left out.
        announce: Makes what shows each run of a command; may be left out.
        resume: Whether to go on from a checkpoint in the folder.
    """

    folder: Path
    comm: MPI.Comm
    progress: Progress | None = None
    announce: Announce | None = None
    resume: bool = False

    def show(self, step: int, t: float, t_end: float, **info: Any) -> None:
        """Show how far the run is."""
        if self.progress is not None:
            self.progress(step, t, t_end, info)


@dataclass(frozen=True, kw_only=True)
class Report:
    """What the runs so far say.

    Attributes:
        parameters: What was run.
        table: Lines that compare.
        quantities: Numbers by name.
        reference: What they are compared with.
        timing: Numbers beside the wall-clock time.
        more: Further entries of ``result.json``.
        draw: Draws pictures into a folder (called on rank 0), of a `Single` benchmark.
    """

    parameters: Mapping[str, Any]
    table: Sequence[Row]
    quantities: Mapping[Any, Any] = field(default_factory=dict)
    reference: Mapping[str, Any] = field(default_factory=dict)
    timing: Mapping[str, Any] = field(default_factory=dict)
    more: Mapping[str, Any] = field(default_factory=dict)
    draw: Callable[[Path], None] | None = None


@dataclass(frozen=True, kw_only=True)
class Command(ABC):
    """What ``valvefsi bench`` runs; its fields are options.

    Raises:
        CaseError: An option or an override cannot be used.
    """

    name: ClassVar[str]
    resumable: ClassVar[bool] = False
    """Whether an interrupted run can go on from its checkpoint."""

    overrides: Sequence[str] = option(
        (), "Set a parameter, such as t_end='2 s'. Repeatable.", flag="--set", metavar="KEY=VALUE"
    )

    def __post_init__(self) -> None:
        """Refuse what cannot be run before any work."""
        check_options(self)

    @property
    def folder(self) -> str:
        """Name of the folder of the results."""
        return self.name

    def run(
        self,
        *,
        out: Path,
        comm: MPI.Comm = MPI.COMM_WORLD,
        progress: Announce | None = None,
        resume: bool = False,
    ) -> Result:
        """Run everything and write it down (collective).

        Args:
            out: Folder of the results.
            comm: Communicator.
            progress: Makes what shows each run.
            resume: Go on from checkpoints of an earlier run in the folder.

        Returns:
            The contents of ``result.json``.

        Raises:
            CaseError: Something cannot be used.
        """
        keep_freed_memory()
        return self.execute(Job(folder=Path(out), comm=comm, announce=progress, resume=resume))

    @abstractmethod
    def execute(self, session: Job) -> Result:
        """Run everything and write it down, see `run` (collective)."""

    def written(self, report: Report, session: Job) -> Result:
        """Write ``result.json`` and return what it holds (collective)."""
        result = {
            "benchmark": self.name,
            "parameters": dict(report.parameters),
            "quantities": dict(report.quantities),
            "reference": dict(report.reference),
            **report.more,
            "table": list(report.table),
            "timing": dict(report.timing),
            "environment": environment(session.comm),
        }
        write_result(session.folder, result, session.comm)
        return result


@dataclass(frozen=True, kw_only=True)
class Benchmark(Command, Generic[R, K]):
    """A benchmark: a series of runs that are compared with references."""

    parameters: ClassVar[Parameters] = {}
    keeps: ClassVar[bool] = False
    """Whether finished runs stay in the folder and are not run again."""

    def __post_init__(self) -> None:
        """Refuse what cannot be run before any work."""
        super().__post_init__()
        self.check(self.values)

    @cached_property
    def values(self) -> Values:
        """The parameters in CGS."""
        return self.read()

    def read(self) -> Values:
        """Read the parameters; numbers are positive unless a benchmark reads them otherwise."""
        return self.ended(read_parameters(self.parameters, self.overrides))

    def ended(self, values: Values) -> Values:
        """Return the parameters with the end of the run that an option of its own gives, where it does."""
        t_end = getattr(self, "t_end", None)
        return values if t_end is None else values | {"t_end": t_end}

    def check(self, values: Values) -> None:
        """Refuse parameters that cannot be run, by a CaseError."""
        return

    def published(self, *keys: str) -> bool:
        """Whether the parameters, or some of them, are those of the publication."""
        chosen = [key for key in keys or self.parameters if key in self.values]
        return all(self.values[key] == self.parameters[key][0] for key in chosen)

    @abstractmethod
    def runs(self) -> Sequence[R]:
        """Return the runs, the coarsest first."""

    @abstractmethod
    def one(self, run: R, job: Job) -> Record:
        """Return what one run gives, the same on all ranks (collective)."""

    @abstractmethod
    def report(self, records: Sequence[Record], reference: K) -> Report:
        """Return what the runs so far say."""

    def references(self, comm: MPI.Comm) -> K:
        """Return what the runs are compared with, where it takes work (collective)."""
        return None  # type: ignore[return-value]

    def draw(self, records: Sequence[Record], reference: K, out: Path) -> None:
        """Draw pictures (on rank 0)."""
        return

    def label(self, run: R) -> str:
        """Return the name of a run: what is shown of it, and its folder."""
        return self.name if len(self.runs()) == 1 else str(run)

    def place(self, run: R, out: Path) -> Path:
        """Return the folder of a run."""
        return out

    def values_of(self, run: R) -> Values:
        """Return the parameters that a run depends on."""
        return self.values

    def alike(self, run: R) -> Sequence[Hashable]:
        """Return kinds that a run belongs to and that take about as long, the narrowest first; none: no forecast."""
        return ()

    def execute(self, session: Job) -> Result:
        """Run the series, see `Command.run`."""
        runs, forecast, comm = self.runs(), Forecast(self), session.comm
        reference = self.references(comm)
        records: list[Record] = []
        result: Result = {}
        announce = session.announce or (lambda *_: None)
        for k, one in enumerate(runs):
            progress = announce(self.label(one), k, len(runs), forecast.left(runs[k:]))
            job = Job(
                folder=self.place(one, session.folder), comm=comm, progress=progress, resume=session.resume
            )
            records.append(self._record(one, job))
            forecast.add(one, records[-1]["wall_s"])
            report = self.report(records, reference)
            whole = {"wall_s": sum(record["wall_s"] for record in records)}
            whole["peak_memory_gib"] = records[-1]["peak_memory_gib"]
            result = self.written(replace(report, timing=whole | dict(report.timing)), session)
        announce("", len(runs), len(runs), 0.0)
        if comm.rank == 0:
            self.draw(records, reference, session.folder)
        comm.barrier()
        return result

    def _record(self, run: R, job: Job) -> Record:
        """Return the record of a run, that of its folder where it is kept (collective)."""
        question = {"benchmark": self.name, "run": run, "values": self.values_of(run)}
        entry = job.comm.bcast(
            _record_of(job.folder, question) if self.keeps and job.comm.rank == 0 else None
        )
        if entry is not None:
            return dict(entry)
        begin = time.perf_counter()
        record = self.one(run, job)
        record["wall_s"] = job.comm.allreduce(time.perf_counter() - begin, op=MPI.MAX)
        record |= {"ranks": job.comm.size, "date": time.strftime("%Y-%m-%d")}
        record["peak_memory_gib"] = peak_memory(job.comm)
        gc.collect()  # frees communicators of this run's meshes, of which an MPI library has only some thousand
        if self.keeps and job.comm.rank == 0:
            job.folder.mkdir(parents=True, exist_ok=True)
            text = json.dumps({"asked": question, "record": public(record)}, default=plain)
            write_text(job.folder / "run.json", text + "\n")
        return record


@dataclass(frozen=True, kw_only=True)
class Single(Benchmark[None, None]):
    """A benchmark of one run, whose report says all; ``cell_steps`` in its timing become a speed."""

    @abstractmethod
    def measured(self, job: Job) -> Report:
        """Return what the run says (collective)."""

    def runs(self) -> list[None]:
        """Return the only run."""
        return [None]

    def one(self, run: None, job: Job) -> Record:
        """Return the report."""
        return {"_report": self.measured(job)}

    def report(self, records: Sequence[Record], reference: None) -> Report:
        """Return the report with the speed."""
        (r,) = records
        timing = dict(r["_report"].timing)
        if "cell_steps" in timing:
            timing["cell_steps_per_s"] = timing.pop("cell_steps") / r["wall_s"]
        return replace(r["_report"], timing=timing)

    def draw(self, records: Sequence[Record], reference: None, out: Path) -> None:
        """Draw what the report draws."""
        if (draw := records[0]["_report"].draw) is not None:
            draw(out)


def public(record: Mapping[str, Any], *without: str) -> Record:
    """Return a record as files hold it, without some entries and without those for pictures."""
    return {key: value for key, value in record.items() if not key.startswith("_") and key not in without}


def refined(cells: int, refine: int, ratio: float = 2.0) -> list[int]:
    """Return the cells of a grid and of ``refine`` finer ones, each ``ratio`` times as fine as the one before."""
    return [round(cells * ratio**k) for k in range(refine + 1)]


class Forecast:
    """What the rest of a series may take, from finished runs of the same kind."""

    def __init__(self, benchmark: Benchmark[Any, Any]) -> None:
        self.alike = benchmark.alike
        self.seen: dict[Hashable, list[float]] = defaultdict(list)

    def add(self, run: Any, wall_s: float) -> None:
        """Take note of a finished run."""
        for kind in self.alike(run):
            self.seen[kind].append(wall_s)

    def left(self, runs: Sequence[Any]) -> float | None:
        """Return the time that runs may take [s], None where nothing is known."""
        total = 0.0
        for run in runs:
            times = next((self.seen[kind] for kind in self.alike(run) if kind in self.seen), None)
            if times is None:
                return None
            total += sum(times) / len(times)
        return total


def _record_of(folder: Path, question: Mapping[str, Any]) -> Record | None:
    """Return the record of a finished run of the same numbers."""
    try:
        entry = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    same = isinstance(entry, dict) and entry.get("asked") == json.loads(json.dumps(question, default=plain))
    return dict(entry["record"]) if same else None
