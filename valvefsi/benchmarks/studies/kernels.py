"""The kernel study: every kernel at several ratios of mesh to grid, both couplings, with and without stabilisation.

One run for each of them on each problem of `kernel_problems`; a run that breaks down or leaks is a result too. From the
table follow rules: at which ratios a kernel stays within a factor of the best error on every problem, without a leak.
"""

from __future__ import annotations

import csv
import gc
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.immersed import Numerics
from valvefsi.benchmarks.kernel_problems import PROBLEMS, StudyProblem, run_halving
from valvefsi.benchmarks.kernel_rules import Rule, rules, sound
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.benchmarks.static_study import read_parameters
from valvefsi.case.overrides import nearest
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError

STABILISED = {"on": (True,), "off": (False,), "both": (True, False)}
SHORT = {"piecewise_linear": "PWL"}

Progress = Callable[[int, int, str, float | None], None]


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        problems: Names in `PROBLEMS`.
        kernels: Names of the kernels.
        ratios: Element size over grid spacing.
        couplings: "nodal", "elemental" or "lumped".
        stabilised: "on", "off" or "both".
        nu_stab: Numerical Poisson ratio of the stabilised runs.
        grids: Cells along the box by problem, where not the default.
        factor: How many times the best error a recommended choice may have.
        overrides: ``problem.key=value``.
    """

    problems: Sequence[str] = tuple(PROBLEMS)
    kernels: Sequence[str] = tuple(KERNELS)
    ratios: Sequence[float] = (0.5, 0.75, 1.0, 1.5, 2.0)
    couplings: Sequence[str] = ("nodal", "elemental")
    stabilised: str = "both"
    nu_stab: float = 0.4
    grids: Mapping[str, int] = field(default_factory=dict)
    factor: float = 3.0
    overrides: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Check the names and the numbers."""
        _check_names("--problems", self.problems, PROBLEMS)
        _check_names("--kernels", self.kernels, KERNELS)
        _check_names("--couplings", self.couplings, ("nodal", "elemental", "lumped"))
        _check_names("--stabilised", (self.stabilised,), STABILISED)
        _check_names("--grid", tuple(self.grids), PROBLEMS, empty=True)
        if not self.ratios or not all(0.1 <= ratio <= 4.0 for ratio in self.ratios):
            raise CaseError("expected numbers from 0.1 to 4", key="--ratios", value=list(self.ratios))
        if not all(n >= 8 for n in self.grids.values()):
            raise CaseError("expected at least 8 cells", key="--grid", value=dict(self.grids))
        if not -1.0 < self.nu_stab < 0.5:
            raise CaseError("expected above -1 and below 0.5", key="--nu-stab", value=self.nu_stab)
        if not self.factor >= 1.0:
            raise CaseError("expected 1 or more", key="--factor", value=self.factor)

    def runs(self) -> list[tuple[StudyProblem, Numerics]]:
        """Return all runs, kernel by kernel, so that an interrupted study holds whole kernels."""
        chosen = []
        for kernel in self.kernels:
            for problem in (PROBLEMS[name] for name in self.problems):
                kinds = STABILISED[self.stabilised] if problem.stabilised else (False,)
                chosen += [
                    (
                        problem,
                        Numerics(
                            grid=self.grids.get(problem.name, problem.grid),
                            ratio=ratio,
                            kernel=kernel,
                            coupling=coupling,
                            nu_stab=self.nu_stab if kind else None,
                        ),
                    )
                    for coupling in self.couplings
                    for kind in kinds
                    for ratio in self.ratios
                ]
        return chosen

    def values(self) -> dict[str, dict[str, float]]:
        """Return the parameters of each problem in CGS, with overrides."""
        given = defaultdict(list)
        for text in self.overrides:
            name, dot, rest = text.partition(".")
            if not dot or name not in self.problems:
                message = "expected PROBLEM.KEY=VALUE, such as cook.t_end='8 s', of a problem in the study"
                raise CaseError(message, key="--set", value=text)
            given[name].append(rest)
        return {name: read_parameters(PROBLEMS[name].parameters, given[name]) for name in self.problems}


def _check_names(
    key: str, names: Sequence[str], known: Mapping | Sequence[str], *, empty: bool = False
) -> None:
    if not (names or empty):
        raise CaseError(f"expected some of {', '.join(known)}", key=key)
    for name in names:
        if name not in known:
            message = f"expected some of {', '.join(known)}{nearest(name, list(known))}"
            raise CaseError(message, key=key, value=name)


def run(
    setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD, progress: Progress | None = None
) -> dict[str, object]:
    """Run the study; finished runs that the folder holds, with the same numbers, are not run again.

    Args:
        setup: What is run.
        out: Folder of the results: ``result.json``, ``kernels.csv``, ``kernels.png`` and the runs.
        comm: Communicator.
        progress: Called before each run and at the end with the number of runs done, of all, the next run's name and
            the time left [s], None where not known yet.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: An override cannot be used.

    Note:
        Collective.
    """
    values, out = setup.values(), Path(out)
    known = {name: PROBLEMS[name].reference(values[name], comm) for name in setup.problems}
    lines = _lines(setup, values, known, out, comm, progress)
    floors = {name: PROBLEMS[name].floor for name in setup.problems}
    free = [name for name in setup.problems if not PROBLEMS[name].stabilised]
    found = rules(lines, floors=floors, factor=setup.factor, free=free)
    result = {
        "benchmark": "kernels",
        "parameters": values
        | {"nu_stab": setup.nu_stab, "factor": setup.factor, "ratios": list(setup.ratios)},
        "reference": known,
        "limits": {
            name: {"leak_percent": PROBLEMS[name].leak, "floor_percent": floors[name]} for name in floors
        },
        "runs": lines,
        "rules": [rule.as_dict() for rule in found],
        "table": _table(found, lines, setup.factor),
        "timing": {"wall_s": sum(line["wall_s"] for line in lines)},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        write_table(out / "kernels.csv", lines)
        _draw(setup, lines, out / "kernels.png")
    comm.barrier()
    return result


def _lines(
    setup: Setup,
    values: Mapping[str, Mapping[str, float]],
    known: Mapping[str, float],
    out: Path,
    comm: MPI.Comm,
    progress: Progress | None,
) -> list[dict[str, object]]:
    """Return one line of the table for each run, in order (collective)."""
    runs, lines, watch = setup.runs(), [], TimeLeft()
    for k, (problem, numerics) in enumerate(runs):
        if progress is not None:
            progress(k, len(runs), f"{problem.name} {numerics.name}", watch.left(runs[k:]))
        folder = out / problem.name / numerics.name
        record = run_halving(problem, numerics, values[problem.name], folder, comm)
        watch.add(problem, numerics, record["wall_s"])
        lines.append(line_of(problem, numerics, record, known[problem.name]))
        gc.collect()  # frees the communicators of this run's meshes, of which an MPI library has only some thousand
    if progress is not None:
        progress(len(runs), len(runs), "", 0.0)
    return lines


def line_of(
    problem: StudyProblem, numerics: Numerics, record: Mapping, reference: float
) -> dict[str, object]:
    """Return a line of the table: which run, its measures, whether it leaks, and why it broke down."""
    empty = dict.fromkeys(("error_percent", "change_percent", "J_spread", "u_max_cm_s"))
    measures = empty if record["failed"] else problem.measures(record, reference)
    change = measures["change_percent"]
    return {
        "problem": problem.name,
        "kernel": numerics.kernel,
        "coupling": numerics.coupling,
        "stabilised": numerics.nu_stab is not None,
        "ratio": numerics.ratio,
        "mesh_ratio": problem.ratio(numerics),
        "grid": numerics.grid,
        **measures,
        "leaks": change is not None and change > problem.leak,
        "failed": record["failed"],
        "step_halvings": record["halvings"],
        "wall_s": record["wall_s"],
    }


class TimeLeft:
    """What the rest of a study may take, from the runs of the same kind that are done."""

    def __init__(self) -> None:
        self.seen: dict[tuple, list[float]] = defaultdict(list)

    def add(self, problem: StudyProblem, numerics: Numerics, wall_s: float) -> None:
        """Take note of a finished run."""
        for kind in _kinds(problem, numerics):
            self.seen[kind].append(wall_s)

    def left(self, runs: Sequence[tuple[StudyProblem, Numerics]]) -> float | None:
        """Return the time that runs may take [s], None where nothing is known."""
        if not self.seen:
            return None
        return sum(self._expected(problem, numerics) for problem, numerics in runs)

    def _expected(self, problem: StudyProblem, numerics: Numerics) -> float:
        times = next(self.seen[kind] for kind in _kinds(problem, numerics) if kind in self.seen)
        return sum(times) / len(times)


def _kinds(problem: StudyProblem, numerics: Numerics) -> list[tuple]:
    """Return the kinds a run belongs to, the narrowest first."""
    return [
        (problem.name, numerics.coupling, numerics.ratio),
        (problem.name, numerics.coupling),
        (problem.name,),
        (),
    ]


def write_table(path: Path, lines: Sequence[Mapping[str, object]]) -> None:
    """Write the lines as CSV; numbers keep all their digits, what is not known is empty."""
    with path.open("w", newline="") as file:
        table = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
        table.writeheader()
        table.writerows(lines)


def _table(found: Sequence[Rule], lines: Sequence[Mapping], factor: float) -> list[dict[str, object]]:
    """Return what is printed: the rule of each choice, then how many runs broke down or leaked."""
    shown = [row("mesh over grid that fits", "", source=f"no leak, error within {factor:g} times the best")]
    shown += [row(rule.name, rule.span or "none", source=rule.text) for rule in found]
    for word, count in (
        ("broke down", sum(line["failed"] is not None for line in lines)),
        ("leak", sum(bool(line["leaks"]) for line in lines)),
        ("sound", sum(sound(line) for line in lines)),
    ):
        shown.append(row(f"runs, {word}", count, source=f"of {len(lines)}"))
    return shown


def _draw(setup: Setup, lines: Sequence[Mapping], path: Path) -> None:
    from valvefsi.post.plots.kernel import HeatMap, heat_maps

    found = {(r["problem"], r["stabilised"], r["coupling"], r["kernel"], r["ratio"]): r for r in lines}
    columns = [
        (PROBLEMS[name], kind)
        for name in setup.problems
        for kind in (STABILISED[setup.stabilised] if PROBLEMS[name].stabilised else (False,))
    ]

    def heat_map(problem: StudyProblem, kind: bool, coupling: str, key: str) -> HeatMap:
        cells = [
            [found[problem.name, kind, coupling, kernel, ratio] for ratio in setup.ratios]
            for kernel in setup.kernels
        ]
        state = "" if not problem.stabilised else "stabilised: " if kind else "not stabilised: "
        return HeatMap(
            title=problem.title,
            values=[[r[key] for r in line] for line in cells],
            leaks=[[bool(r["leaks"]) for r in line] for line in cells],
            label=f"{state}{LABELS[key]}",
            limits=LIMITS[key],
        )

    def change_of(problem: StudyProblem) -> str:
        return "change_percent" if problem.stabilised else "u_max_cm_s"

    panels = {
        f"{coupling}: {word}": [
            heat_map(problem, kind, coupling, key or change_of(problem)) for problem, kind in columns
        ]
        for word, key in (("error", "error_percent"), ("change of area, spurious velocity", None))
        for coupling in setup.couplings
    }
    heat_maps(path, panels, rows=[SHORT.get(k, k) for k in setup.kernels], columns=setup.ratios)


LABELS = {"error_percent": "|error| [%]", "change_percent": "area change [%]", "u_max_cm_s": "|u| [cm/s]"}
LIMITS = {"error_percent": (0.5, 20.0), "change_percent": (0.02, 5.0), "u_max_cm_s": (1.0e-6, 3.0e-4)}
