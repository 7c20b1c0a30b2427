"""What the static benchmarks share: parameters, refinement, observed order, table, pictures, ``result.json``.

A benchmark states its quantities on one mesh; `run_study` solves it on a series of meshes, each twice as fine as
the one before, for every kind of cell asked for, and compares the finest answer with the references.
"""

from __future__ import annotations

import itertools
import math
import resource
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mpi4py import MPI

from valvefsi.benchmarks.parameters import Parameters, read_parameters
from valvefsi.benchmarks.results import environment, row, write_result
from valvefsi.case.overrides import nearest
from valvefsi.errors import CaseError
from valvefsi.io.solid_body import Body, write_body
from valvefsi.post.plots.convergence import Convergence, convergence
from valvefsi.post.plots.solid import deformed
from valvefsi.solid.statics import SolverOptions

SIMPLEX = {"triangle", "tetrahedron"}
DIRECT = SolverOptions()
"""How the equilibrium is sought unless something else is asked for."""


@dataclass(frozen=True, kw_only=True)
class Setup:
    """What is run.

    Attributes:
        cell: Kind of cell, or "both" for simplices and for quadrilaterals or hexahedra.
        elements: Elements along the benchmark's shortest counted edge on the coarsest mesh; None for its default.
        refine: How many times the mesh is refined, each time to half the cell size.
        overrides: ``key=value``, names of the benchmark's parameters.
        iterative: Whether FGMRES with multigrid takes the place of the factorisation, for large meshes.
    """

    cell: str = "both"
    elements: int | None = None
    refine: int = 0
    overrides: Sequence[str] = ()
    iterative: bool = False


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A value to compare with.

    Attributes:
        value: The value; None where only a band is known.
        source: Where it is from.
        band: Smallest and largest published value.
        exact: Whether errors against it measure the order.
    """

    value: float | None = None
    source: str = ""
    band: tuple[float, float] | None = None
    exact: bool = False


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What one mesh gives.

    Attributes:
        values: The quantities by name; a name ends in its unit, ``u_y_cm``.
        unknowns: Number of unknowns.
        body: What `solid_plots.deformed` draws, on rank 0.
    """

    values: Mapping[str, float]
    unknowns: int
    body: Body | None = None


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A static benchmark.

    Attributes:
        name: Name of the command and of the result.
        title: Heading of the pictures.
        parameters: What ``--set`` reaches.
        cells: Its kinds of cell, simplices first.
        elements: Default of `Setup.elements`.
        solve: ``solve(values, cell, elements, comm)`` answers on one mesh.
        references: ``references(values)`` by quantity; empty where the parameters are not the published ones.
        units: Unit and label of each quantity.
        iterative: Whether ``solve(values, cell, elements, comm, options)`` takes the options of the solver too.
    """

    name: str
    title: str
    parameters: Parameters
    cells: tuple[str, ...]
    elements: int
    solve: Callable[..., Answer]
    references: Callable[[Mapping[str, float]], Mapping[str, Sequence[Reference]]]
    units: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    iterative: bool = False


def chosen_cells(benchmark: Benchmark, cell: str) -> tuple[str, ...]:
    """Return the kinds of cell that ``--cell`` asks for.

    Raises:
        CaseError: The benchmark has no such cell.
    """
    if cell == "both":
        return benchmark.cells
    names = {"simplex": next((c for c in benchmark.cells if c in SIMPLEX), cell)}
    kind = names.get(cell, cell)
    if kind not in benchmark.cells:
        known = ["both", "simplex", *benchmark.cells]
        raise CaseError(f"no such cell here{nearest(cell, known)}", key="--cell", value=cell)
    return (kind,)


def observed_order(values: Sequence[float], exact: float | None = None) -> float | None:
    """Return the order of the last refinement, from errors or from successive differences.

        log2(|v1 - v| / |v2 - v|), without an exact value log2(|v1 - v0| / |v2 - v1|)

    Args:
        values: Answers on meshes of cell size h, h/2, h/4, ...
        exact: The value they tend to.

    Returns:
        The order; None where there are too few answers, or the differences change sign or are at round-off.
    """
    gaps = (
        [value - exact for value in values]
        if exact is not None
        else [b - a for a, b in itertools.pairwise(values)]
    )
    if len(gaps) < 2 or gaps[-1] * gaps[-2] <= 0 or abs(gaps[-1]) < 1e-10 * abs(values[-1]):
        return None
    return math.log2(gaps[-2] / gaps[-1])


def extrapolated(values: Sequence[float]) -> float | None:
    """Return Richardson's extrapolation of the last three answers with their observed order, None without one."""
    order = observed_order(values)
    if order is None or order < 0.3:
        return None
    return values[-1] + (values[-1] - values[-2]) / (2**order - 1)


def run_study(
    benchmark: Benchmark, setup: Setup, *, out: Path, comm: MPI.Comm = MPI.COMM_WORLD
) -> dict[str, object]:
    """Solve a benchmark on every mesh asked for; write pictures and ``result.json``.

    Args:
        benchmark: The benchmark.
        setup: Cells, refinement and parameters.
        out: Folder of the results.
        comm: Communicator.

    Returns:
        The contents of ``result.json``.

    Raises:
        CaseError: The setup cannot be used.

    Note:
        Collective.
    """
    values = read_parameters(benchmark.parameters, setup.overrides)
    cells = chosen_cells(benchmark, setup.cell)
    elements = setup.elements if setup.elements is not None else benchmark.elements
    if elements < 1 or setup.refine < 0:
        raise CaseError(
            "expected whole numbers, elements >= 1, refine >= 0", key="--refine", value=setup.refine
        )
    if setup.iterative and not benchmark.iterative:
        raise CaseError(f"{benchmark.name} has no iterative solver", key="--iterative")
    more = (SolverOptions(solver="fieldsplit"),) if setup.iterative else ()
    levels = [
        _solve(benchmark, values, (c, elements * 2**k), comm, more)
        for c in cells
        for k in range(setup.refine + 1)
    ]
    references, memory = benchmark.references(values), _peak_memory(comm)
    result = {
        "benchmark": benchmark.name,
        "parameters": {
            "cell": setup.cell,
            "elements": elements,
            "refine": setup.refine,
            "iterative": setup.iterative,
            **values,
        },
        "quantities": _quantities(levels, references),
        "reference": {name: [vars(r) for r in refs] for name, refs in references.items()},
        "levels": [{k: v for k, v in level.items() if k != "body"} for level in levels],
        "table": [*_table(benchmark, levels, references), *_cost(levels, memory)],
        "timing": {"wall_s": sum(level["wall_s"] for level in levels), "peak_memory_gib": memory},
        "environment": environment(comm),
    }
    write_result(out, result, comm)
    if comm.rank == 0:
        _draw(benchmark, levels, references, Path(out))
    comm.barrier()
    return result


def _solve(
    benchmark: Benchmark,
    values: Mapping[str, float],
    mesh: tuple[str, int],
    comm: MPI.Comm,
    more: tuple[object, ...] = (),
) -> dict[str, object]:
    begin = time.perf_counter()
    answer = benchmark.solve(values, *mesh, comm, *more)
    wall = comm.allreduce(time.perf_counter() - begin, op=MPI.MAX)
    return {
        "cell": mesh[0],
        "elements": mesh[1],
        "unknowns": answer.unknowns,
        "values": dict(answer.values),
        "wall_s": wall,
        "body": answer.body,
    }


def _series(levels: Sequence[Mapping], cell: str, name: str) -> list[float]:
    return [level["values"][name] for level in levels if level["cell"] == cell]


def _kinds(levels: Sequence[Mapping]) -> list[str]:
    return list(dict.fromkeys(level["cell"] for level in levels))


def _exact(references: Mapping[str, Sequence[Reference]], name: str) -> float | None:
    return next((r.value for r in references.get(name, ()) if r.exact), None)


def _quantities(
    levels: Sequence[Mapping], references: Mapping[str, Sequence[Reference]]
) -> dict[str, object]:
    """Return the finest values, their order and their extrapolation, by kind of cell."""
    found: dict[str, object] = {}
    for cell in _kinds(levels):
        entry: dict[str, object] = {}
        for name in levels[0]["values"]:
            series = _series(levels, cell, name)
            entry[name] = series[-1]
            entry[f"{name}_order"] = observed_order(series, _exact(references, name))
            entry[f"{name}_extrapolated"] = extrapolated(series)
        found[cell] = entry
    return found


def _table(
    benchmark: Benchmark, levels: Sequence[Mapping], references: Mapping[str, Sequence[Reference]]
) -> list[dict[str, object]]:
    lines = []
    for name in levels[0]["values"]:
        unit, label = benchmark.units.get(name, ("", name))
        known = list(references.get(name, ()))
        for level in levels:
            value, mesh = level["values"][name], f"{level['cell']}, {level['elements']}"
            last = level is [one for one in levels if one["cell"] == level["cell"]][-1]
            first, *more = known or [Reference()]
            lines.append(_compare(f"{label} ({mesh})", value, first, unit))
            if last:
                lines += [_compare("", value, reference, unit) for reference in more]
                lines += _order_rows(levels, level["cell"], name, (label, unit, _exact(references, name)))
    return lines


def _cost(levels: Sequence[Mapping], memory: float) -> list[dict[str, object]]:
    """Return what the finest mesh of each kind of cell took."""
    lines = []
    for cell in _kinds(levels):
        finest = [level for level in levels if level["cell"] == cell][-1]
        label = f"wall time, {cell}, {finest['unknowns']:,} unknowns"
        lines.append(row(label, finest["wall_s"], source="measured", unit="s"))
    return [*lines, row("peak memory, all ranks", memory, source="measured", unit="GiB")]


def _peak_memory(comm: MPI.Comm) -> float:
    """Return the largest resident size of all processes together [GiB] (collective)."""
    return comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) / 2**20


def _compare(label: str, value: float, reference: Reference, unit: str) -> dict[str, object]:
    if reference.band is None:
        return row(label, value, reference.value, reference.source, unit=unit)
    low, high = reference.band
    inside = "inside" if low <= value <= high else "OUTSIDE"
    line = row(label, value, f"{low:g} ... {high:g}", f"{inside}: {reference.source}", unit=unit)
    return {**line, "inside": low <= value <= high}


def _order_rows(
    levels: Sequence[Mapping], cell: str, name: str, about: tuple[str, str, float | None]
) -> list[dict[str, object]]:
    label, unit, exact = about
    series = _series(levels, cell, name)
    order, limit = observed_order(series, exact), extrapolated(series)
    lines = []
    if order is not None:
        source = "from errors" if exact is not None else "from successive differences"
        lines.append(row(f"observed order, {cell}", order, source=source))
    if limit is not None and exact is None:
        lines.append(row(f"{label}, extrapolated, {cell}", limit, source="Richardson", unit=unit))
    return lines


def _draw(
    benchmark: Benchmark,
    levels: Sequence[Mapping],
    references: Mapping[str, Sequence[Reference]],
    out: Path,
) -> None:
    """Draw the finest body of each kind of cell, and how the answers converge."""
    for cell in _kinds(levels):
        finest = [level for level in levels if level["cell"] == cell][-1]
        if finest["body"] is not None:
            caption = f"{cell}, {finest['unknowns']:,} unknowns"
            deformed(out / f"deformed_{cell}.png", finest["body"], title=benchmark.title, caption=caption)
            write_body(out / f"solid_{cell}.vtu", finest["body"])
    if len(levels) > len(_kinds(levels)):
        panels = []
        for name in levels[0]["values"]:
            unit, label = benchmark.units.get(name, ("", name))
            lines = {
                cell: (
                    [lv["unknowns"] for lv in levels if lv["cell"] == cell],
                    _series(levels, cell, name),
                )
                for cell in _kinds(levels)
            }
            known = [(r.value, r.band, r.source) for r in references.get(name, ())]
            panels.append(Convergence(label=f"{label} [{unit or '-'}]", lines=lines, known=known))
        convergence(out / "convergence.png", panels, title=benchmark.title)
