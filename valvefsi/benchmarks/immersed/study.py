"""A grid study of an immersed problem, stabilised and not: runs, table, observed order, picture, ``result.json``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from mpi4py import MPI

from valvefsi.benchmarks.immersed import Numerics, Problem, each_run
from valvefsi.benchmarks.parameters import read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.errors import CaseError
from valvefsi.run.simulation import Progress

if TYPE_CHECKING:
    from valvefsi.post.plots.immersed import Line

BOTH = "both"
KINDS = {True: "stabilised", False: "not stabilised"}


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        numerics: The coarsest grid and how it is coupled; its ``nu_stab`` is the value of the stabilised runs.
        stabilised: "on", "off" or "both".
        refine: Number of finer grids.
        overrides: ``key=value``, names of the benchmark's parameters.
        grids: The grids in multiples of the coarsest.
    """

    numerics: Numerics
    stabilised: str = BOTH
    refine: int = 0
    overrides: Sequence[str] = ()
    grids: tuple[float, ...] = (1.0, 2.0, 4.0, 8.0)

    def runs(self) -> list[Numerics]:
        """Return the runs, from the coarsest grid on.

        Raises:
            CaseError: ``stabilised`` or ``refine`` cannot be used.
        """
        values = {"on": [self.numerics.nu_stab], "off": [None], BOTH: [self.numerics.nu_stab, None]}
        if self.stabilised not in values or not 0 <= self.refine < len(self.grids):
            message = f'expected "on", "off" or "both", and refine from 0 to {len(self.grids) - 1}'
            raise CaseError(message, key="--stabilised", value=self.stabilised)
        return [
            replace(self.numerics, grid=round(self.numerics.grid * factor), nu_stab=nu)
            for nu in values[self.stabilised]
            for factor in self.grids[: self.refine + 1]
        ]


@dataclass(frozen=True, kw_only=True)
class Study:
    """A grid study.

    Attributes:
        problem: What is run.
        parameters: Default and unit of what ``--set`` reaches.
        main: The quantity that is compared, its label and its unit.
        change: Column of the change of volume over time, its label.
        reference: ``reference(values, comm)`` value and source, found in the same run.
        more: ``more(values)`` further values to compare with and their sources.
        column: Column of the main quantity in the history.
        title: Heading of the picture.
        mixed: ``mixed(values, numerics, comm)`` the incompressible answer on the mesh of one grid, to be drawn over the
            grids; None where it is not computed.
    """

    problem: Problem
    parameters: Mapping[str, tuple[float, str]]
    main: tuple[str, str, str]
    change: tuple[str, str]
    reference: Callable[[Mapping[str, float], Numerics, MPI.Comm], tuple[float, str]]
    column: str
    title: str
    more: Callable[[Mapping[str, float]], Sequence[tuple[float | str, str]]] = lambda values: ()
    mixed: Callable[[Mapping[str, float], Numerics, MPI.Comm], float] | None = None


def run_study(
    study: Study,
    setup: Setup,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Progress | None] | None = None,
) -> dict[str, object]:
    """Run a grid study; runs that the folder holds already are not run again.

    Args:
        study: The benchmark.
        setup: What is run.
        out: Folder of the results.
        comm: Communicator.
        progress: Makes what shows a run from its name.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: The setup cannot be used.

    Note:
        Collective.
    """
    values = read_parameters(study.parameters, setup.overrides)
    runs = setup.runs()
    known, source = study.reference(values, runs[-1], comm)
    records = each_run(study.problem, runs, values, Path(out), comm=comm, progress=progress)
    by_grid = {n.grid: study.mixed(values, n, comm) for n in runs} if study.mixed else {}
    result = {
        "benchmark": study.problem.name,
        "parameters": dict(values) | {"refine": setup.refine, "stabilised": setup.stabilised},
        "quantities": {_name(r): r["quantities"] for r in records},
        "reference": {study.main[0]: known, "source": source, "same_mesh": by_grid},
        "runs": [{k: v for k, v in r.items() if k != "history"} for r in records],
        "table": _table(study, records, (known, source), values),
        "timing": {"wall_s": sum(r["wall_s"] for r in records)},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        _draw(study, records, (known, by_grid), Path(out) / f"{study.problem.name}.png")
    comm.barrier()
    return result


def held(record: Mapping) -> bool:
    """Whether a run was stabilised."""
    return record["numerics"]["nu_stab"] is not None


def _name(record: Mapping) -> str:
    return Numerics(**record["numerics"]).name


def _label(record: Mapping) -> str:
    return f"N = {record['numerics']['grid']}, {KINDS[held(record)]}"


def _table(
    study: Study, records: Sequence[Mapping], known: tuple[float, str], values: Mapping[str, float]
) -> list[dict[str, object]]:
    name, label, unit = study.main
    lines = []
    for record in records:
        if record["failed"]:
            lines.append(row(f"{label}, {_label(record)}", "broke down", source=record["failed"][:70]))
            continue
        q = record["quantities"]
        lines.append(row(f"{label}, {_label(record)}", q[name], *known, unit=unit))
        lines.append(
            row(f"  {study.change[1]}", q["change_percent"], 0.0, "incompressible", unit="%", relative=False)
        )
        if "largest_change_percent" in q:
            most = {"reference": 0.0, "source": "incompressible", "unit": "%", "relative": False}
            lines.append(row("  the most during the run", q["largest_change_percent"], **most))
        lines.append(row("  J, smallest ... largest", f"{q['J_min']:.2f} ... {q['J_max']:.2f}"))
    for value, source in study.more(values):
        lines.append(row(f"{label}, elsewhere", value, source=source, unit=unit))
    return lines + _orders(study, records, known[0]) + _gain(study, records)


def order_of(errors: Sequence[float], grids: Sequence[int]) -> float | None:
    """Return the order of the last refinement from errors; None where there are too few or they change sign."""
    if len(errors) < 2 or errors[-1] * errors[-2] <= 0:
        return None
    return math.log(errors[-2] / errors[-1]) / math.log(grids[-1] / grids[-2])


def _orders(study: Study, records: Sequence[Mapping], known: float) -> list[dict[str, object]]:
    lines = []
    for kind, text in KINDS.items():
        series = [r for r in records if held(r) is kind and not r["failed"]]
        grids = [r["numerics"]["grid"] for r in series]
        for key, label, exact in (
            (study.main[0], study.main[1], known),
            ("change_percent", study.change[1], 0.0),
        ):
            order = order_of([r["quantities"][key] - exact for r in series], grids)
            if order is not None:
                lines.append(row(f"observed order, {label}, {text}", order, source="last two grids"))
    return lines


def _gain(study: Study, records: Sequence[Mapping]) -> list[dict[str, object]]:
    """How many times smaller the change of volume is with the stabilisation, grid by grid."""
    lines = []
    for record in (r for r in records if held(r) and not r["failed"]):
        grid = record["numerics"]["grid"]
        free = [r for r in records if not held(r) and r["numerics"]["grid"] == grid and not r["failed"]]
        for other in free:
            gain = abs(other["quantities"]["change_percent"] / record["quantities"]["change_percent"])
            lines.append(row(f"{study.change[1]}, not stabilised / stabilised, N = {grid}", gain))
    return lines


def _draw(
    study: Study, records: Sequence[Mapping], answers: tuple[float, Mapping[int, float]], path: Path
) -> None:
    """Draw both quantities over time and, with several grids, over the grids (as S4 and S5, c and d)."""
    from valvefsi.post.plots.immersed import Panel, panels

    known, by_grid = answers
    _, label, unit = study.main
    lines = {study.column: _over_time(records, study.column)}
    lines[study.change[0]] = [replace(line, label="") for line in _over_time(records, study.change[0])]
    same = {"reference": known, "reference_label": "incompressible statics"}
    shown = [
        Panel(lines=lines[study.column], xlabel="t [s]", ylabel=f"{label} [{unit}]", **same),
        Panel(lines=lines[study.change[0]], xlabel="t [s]", ylabel=f"{study.change[1]} [%]", reference=0.0),
    ]
    if len({r["numerics"]["grid"] for r in records}) > 1:
        main, change = (_over_grids(records, key) for key in (study.main[0], "change_percent"))
        main += _mixed_line(by_grid)
        size = f"size of the {study.change[1]} at the end [%]"
        shown += [
            Panel(lines=main, xlabel="cells N", ylabel=f"{label} [{unit}]", log="x", **same),
            Panel(lines=change, xlabel="cells N", ylabel=size, log="xy"),
        ]
    n = records[0]["numerics"]
    caption = f"{n['kernel']}, {n['coupling']}, elements of {n['ratio']:g} h"
    panels(path, shown, title=study.title, caption=caption, columns=2)


def _over_time(records: Sequence[Mapping], column: str) -> list[Line]:
    from valvefsi.post.plots.immersed import Line

    grids = sorted({r["numerics"]["grid"] for r in records})
    return [
        Line(
            label=_label(r),
            x=r["history"]["t_s"],
            y=r["history"][column],
            colour=grids.index(r["numerics"]["grid"]),
            style="-" if held(r) else "--",
        )
        for r in records
    ]


def _over_grids(records: Sequence[Mapping], key: str) -> list[Line]:
    """Return a quantity over the cells, one line for each kind of run."""
    from valvefsi.post.plots.immersed import Line

    lines = []
    for colour, (kind, text) in enumerate(KINDS.items()):
        series = [r for r in records if held(r) is kind and not r["failed"]]
        x, y = [r["numerics"]["grid"] for r in series], [r["quantities"][key] for r in series]
        if series:
            lines.append(Line(label=text, x=x, y=y, colour=colour, style="o-" if kind else "s--"))
    return lines


def _mixed_line(by_grid: Mapping[int, float]) -> list[Line]:
    from valvefsi.post.plots.immersed import Line

    x, y = list(by_grid), list(by_grid.values())
    return [Line(label="mixed elements, same mesh", x=x, y=y, colour=2, style="^:")] if by_grid else []
