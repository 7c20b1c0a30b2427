"""The kernel study: every kernel at several ratios of mesh to grid, both couplings, with and without stabilisation.

One run for each of them on each problem of `kernel_problems`; a run that breaks down or leaks is a result too. From the
table follow rules: at which ratios a kernel stays within a factor of the best error on every problem, without a leak.
"""

from __future__ import annotations

import csv
import math
from collections import defaultdict
from collections.abc import Collection, Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Record, Report
from valvefsi.benchmarks.immersed.study import COUPLINGS, KINDS, STATES, Numerics
from valvefsi.benchmarks.options import Values, option, read_parameters
from valvefsi.benchmarks.results import Row, row
from valvefsi.benchmarks.studies.kernel_problems import PROBLEMS, StudyProblem, run_halving
from valvefsi.coupling.kernels import KERNELS
from valvefsi.errors import CaseError
from valvefsi.io.folder import replacing
from valvefsi.post.plots.kernel import HeatMap, heat_maps


@dataclass(frozen=True, kw_only=True)
class Rule:
    """What the table says about one kernel, coupling and stabilisation.

    Attributes:
        kernel: Name of the kernel.
        coupling: "nodal", "elemental" or "lumped".
        stabilised: Whether there is a volumetric energy.
        ratios: Ratios at which every problem is sound and its error within the factor of the best.
        fits: The same for each problem alone.
        best: Ratio whose largest error, in multiples of the best on each problem, is smallest; None where
            no ratio is sound on every problem.
        multiple: That largest error, in multiples of the best.
        errors: Magnitude of the error at that ratio by problem [%].
        change: Largest change of area of the loaded bodies at that ratio [%].
        why: Where no ratio is sound, what went wrong.
    """

    kernel: str
    coupling: str
    stabilised: bool
    ratios: tuple[float, ...]
    fits: Mapping[str, tuple[float, ...]]
    best: float | None
    multiple: float | None
    errors: Mapping[str, float]
    change: float | None
    why: str = ""


def sound(line: Record) -> bool:
    """Whether a run neither broke down nor leaks."""
    return line["failed"] is None and not line["leaks"]


def rules(
    lines: Sequence[Record], *, floors: Mapping[str, float], factor: float, free: Collection[str] = ()
) -> list[Rule]:
    """Return the rule of each kernel, coupling and stabilisation, the best choice first.

    The error of a run counts in multiples of the smallest one of all sound runs of its problem, or of the floor where
    that is larger.

    Args:
        lines: The lines of the table.
        floors: Error by problem below which runs count as equally good [%].
        factor: Largest multiple that a recommended ratio may have on any problem.
        free: Problems that no stabilisation acts on; they count for both kinds.
    """
    best = {}
    for problem, floor in floors.items():
        errors = [abs(r["error_percent"]) for r in lines if r["problem"] == problem and sound(r)]
        best[problem] = max(floor, min(errors, default=floor))
    kinds = sorted({line["stabilised"] for line in lines if line["problem"] not in free}, reverse=True)
    table = []
    for kernel, coupling in dict.fromkeys((line["kernel"], line["coupling"]) for line in lines):
        both = [line for line in lines if (line["kernel"], line["coupling"]) == (kernel, coupling)]
        for kind in kinds or [False]:
            own = [line for line in both if line["stabilised"] == kind or line["problem"] in free]
            name = {"kernel": kernel, "coupling": coupling, "stabilised": kind}
            table.append(Rule(**name, **_verdict(own, best, factor)))
    return sorted(table, key=lambda rule: (rule.multiple is None, rule.multiple))


def _verdict(lines: Sequence[Record], best: Mapping[str, float], factor: float) -> dict[str, Any]:
    """Return what the runs of one choice say, as the attributes of a rule."""
    fits: dict[str, tuple[float, ...]] = {line["problem"]: () for line in lines}
    largest = dict.fromkeys((line["ratio"] for line in lines), 0.0)  # infinite where a run is not sound
    for line in lines:
        name, ratio = line["problem"], line["ratio"]
        multiple = abs(line["error_percent"]) / best[name] if sound(line) else math.inf
        largest[ratio] = max(largest[ratio], multiple)
        fits[name] += (ratio,) * (multiple <= factor)
    top = min(
        (ratio for ratio in largest if largest[ratio] < math.inf), key=lambda r: largest[r], default=None
    )
    here = [line for line in lines if line["ratio"] == top]
    return {
        "ratios": tuple(ratio for ratio, multiple in largest.items() if multiple <= factor),
        "fits": fits,
        "best": top,
        "multiple": largest.get(top),
        "errors": {line["problem"]: abs(line["error_percent"]) for line in here},
        "change": max((line["change_percent"] for line in here), default=None),
        "why": _why(lines) if top is None else "",
    }


def _why(lines: Sequence[Record]) -> str:
    broken, leaking = ([r for r in lines if r["failed"] is not None], [r for r in lines if r["leaks"]])
    parts = (("breaks down:", broken), ("leaks:", leaking))
    return "; ".join(f"{word} {', '.join(sorted({r['problem'] for r in bad}))}" for word, bad in parts if bad)


SHORT = {"piecewise_linear": "PWL"}
KEYS = ("error_percent", "change_percent", "J_spread", "u_max_cm_s")
"""What is measured of each run."""


@dataclass(frozen=True, kw_only=True)
class One:
    """One run: a problem and how it is discretised."""

    problem: str
    numerics: Numerics


@dataclass(frozen=True, kw_only=True)
class Kernels(Benchmark[One, dict[str, float]]):
    """The study; finished runs that the folder holds, with the same numbers, are not run again."""

    name = "kernels"
    keeps = True

    problems: tuple[str, ...] = option(
        tuple(PROBLEMS), "Some of compression, cook, shell.", metavar="P,P", choices=tuple(PROBLEMS)
    )
    kernels: tuple[str, ...] = option(
        tuple(KERNELS), "Kernels, or all.", metavar="K,K|all", choices=tuple(KERNELS), everything=True
    )
    ratios: tuple[float, ...] = option(
        (0.5, 0.75, 1.0, 1.5, 2.0), "Element size over grid spacing.", metavar="R,R", least=0.1, most=4.0
    )
    couplings: tuple[str, ...] = option(
        ("nodal", "elemental"), "nodal, elemental, lumped.", metavar="C,C", choices=COUPLINGS
    )
    stabilised: str = option("both", "on, off or both.", choices=tuple(STATES))
    nu_stab: float = option(0.4, "Numerical Poisson ratio of stabilised runs.", between=(-1.0, 0.5))
    grids: Mapping[str, int] | None = option(
        None, "Cells along the box of a problem. Repeatable.", flag="--grid", metavar="PROBLEM=N"
    )
    factor: float = option(3.0, "How many times the best error a recommended choice may have.", least=1.0)

    def check(self, values: Values) -> None:
        if not self.ratios:
            raise CaseError("expected numbers from 0.1 to 4", key="--ratios")
        for name, n in (self.grids or {}).items():
            if name not in PROBLEMS:
                raise CaseError(f"expected some of {', '.join(PROBLEMS)}", key="--grid", value=name)
            if n < 8:
                raise CaseError("expected at least 8 cells", key=f"--grid {name}", value=n)

    def read(self) -> Values:
        texts = defaultdict(list)
        for text in self.overrides:
            name, dot, rest = text.partition(".")
            if not dot or name not in self.problems:
                message = "expected PROBLEM.KEY=VALUE, such as cook.t_end='8 s', of a problem in the study"
                raise CaseError(message, key="--set", value=text)
            texts[name].append(rest)
        return {name: read_parameters(PROBLEMS[name].parameters, texts[name]) for name in self.problems}

    def kinds(self, problem: StudyProblem) -> tuple[bool, ...]:
        """Return whether a problem is run stabilised and not."""
        return STATES[self.stabilised] if problem.stabilised else (False,)

    def runs(self) -> list[One]:
        return [
            One(
                problem=name,
                numerics=Numerics(
                    grid=(self.grids or {}).get(name, PROBLEMS[name].grid),
                    ratio=ratio,
                    kernel=kernel,
                    coupling=coupling,
                    nu_stab=self.nu_stab if kind else None,
                ),
            )
            for kernel in self.kernels
            for name in self.problems
            for coupling in self.couplings
            for kind in self.kinds(PROBLEMS[name])
            for ratio in self.ratios
        ]

    def label(self, run: One) -> str:
        return f"{run.problem} {run.numerics.name}"

    def place(self, run: One, out: Path) -> Path:
        return out / run.problem / run.numerics.name

    def values_of(self, run: One) -> Values:
        return dict(self.values[run.problem])

    def alike(self, run: One) -> list[Hashable]:
        name, n = run.problem, run.numerics
        return [(name, n.coupling, n.ratio), (name, n.coupling), name, ()]

    def references(self, comm: MPI.Comm) -> dict[str, float]:
        return {name: PROBLEMS[name].reference(self.values[name], comm) for name in self.problems}

    def one(self, run: One, job: Job) -> Record:
        record = run_halving(PROBLEMS[run.problem], run.numerics, self.values_of(run), job)
        return {"problem": run.problem, **record}

    def report(self, records: Sequence[Record], reference: dict[str, float]) -> Report:
        lines, problems = self.lines(records, reference), [PROBLEMS[name] for name in self.problems]
        floors = {problem.name: problem.floor for problem in problems}
        free = [problem.name for problem in problems if not problem.stabilised]
        table = rules(lines, floors=floors, factor=self.factor, free=free)
        numbers = {"nu_stab": self.nu_stab, "factor": self.factor, "ratios": list(self.ratios)}
        limits = {p.name: {"leak_percent": p.leak, "floor_percent": p.floor} for p in problems}
        return Report(
            parameters=self.values | numbers,
            reference=reference,
            more={"limits": limits, "runs": lines, "rules": [asdict(rule) for rule in table]},
            table=_table(table, lines, self.factor),
        )

    def lines(self, records: Sequence[Record], reference: Mapping[str, float]) -> list[Record]:
        """Return which run each is, its measures, whether it leaks, and why it broke down."""
        lines = []
        for record in records:
            problem, numerics = PROBLEMS[record["problem"]], Numerics(**record["numerics"])
            measures: dict[str, float | None] = dict.fromkeys(KEYS)
            if not record["failed"]:
                measures = problem.measures(record["quantities"], reference[problem.name])
            change = measures["change_percent"]
            lines.append(
                {
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
            )
        return lines

    def draw(self, records: Sequence[Record], reference: dict[str, float], out: Path) -> None:
        lines = self.lines(records, reference)
        with replacing(out / "kernels.csv") as path, path.open("w", newline="") as file:
            table = csv.DictWriter(file, list(lines[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(lines)
        _draw(self, lines, out / "kernels.png")


def _table(table: Sequence[Rule], lines: Sequence[Record], factor: float) -> list[Row]:
    """Return what is printed: the rule of each choice, then how many runs broke down or leaked."""
    rows = [row("mesh over grid that fits", "", source=f"no leak, error within {factor:g} times the best")]
    for rule in table:
        name = f"{rule.kernel}, {rule.coupling}, {KINDS[rule.stabilised]}"
        errors = ", ".join(f"{problem} {error:.2g} %" for problem, error in rule.errors.items())
        text = rule.why if rule.best is None else f"best {rule.best:g}: {errors}"
        rows.append(row(name, ", ".join(f"{ratio:g}" for ratio in rule.ratios) or "none", source=text))
    counts = {
        "broke down": sum(line["failed"] is not None for line in lines),
        "leak": sum(bool(line["leaks"]) for line in lines),
        "sound": sum(map(sound, lines)),
    }
    return rows + [row(f"runs, {word}", n, source=f"of {len(lines)}") for word, n in counts.items()]


def _draw(study: Kernels, lines: Sequence[Record], path: Path) -> None:
    by_choice = {(r["problem"], r["stabilised"], r["coupling"], r["kernel"], r["ratio"]): r for r in lines}
    columns = [(PROBLEMS[name], kind) for name in study.problems for kind in study.kinds(PROBLEMS[name])]

    def heat_map(problem: StudyProblem, kind: bool, coupling: str, key: str) -> HeatMap:
        cells = [
            [by_choice[problem.name, kind, coupling, kernel, ratio] for ratio in study.ratios]
            for kernel in study.kernels
        ]
        state = f"{KINDS[kind]}: " if problem.stabilised else ""
        return HeatMap(
            title=problem.title,
            values=[[r[key] for r in line] for line in cells],
            leaks=[[bool(r["leaks"]) for r in line] for line in cells],
            label=f"{state}{LABELS[key]}",
            limits=LIMITS[key],
        )

    panels = {
        f"{coupling}: {word}": [
            heat_map(problem, kind, coupling, own if problem.stabilised else other)
            for problem, kind in columns
        ]
        for word, own, other in (
            ("error", "error_percent", "error_percent"),
            ("change of area, spurious velocity", "change_percent", "u_max_cm_s"),
        )
        for coupling in study.couplings
    }
    heat_maps(path, panels, rows=[SHORT.get(k, k) for k in study.kernels], columns=study.ratios)


LABELS = {"error_percent": "|error| [%]", "change_percent": "area change [%]", "u_max_cm_s": "|u| [cm/s]"}
LIMITS = {"error_percent": (0.5, 20.0), "change_percent": (0.02, 5.0), "u_max_cm_s": (1.0e-6, 3.0e-4)}
