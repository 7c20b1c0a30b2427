"""What the static benchmarks share: a series of meshes for each kind of cell, each twice as fine as the one before."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Job, Joined, Record, Report, Result, public
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import Reference, Row, compared, row
from valvefsi.case.overrides import nearest
from valvefsi.errors import CaseError
from valvefsi.io.solid_body import Body, write_body
from valvefsi.post.plots.convergence import Convergence, convergence
from valvefsi.post.plots.solid import deformed
from valvefsi.solid.statics import SolverOptions
from valvefsi.solid.stress import LABELS, stress_of_solution
from valvefsi.verification.convergence import extrapolated, observed_order

if TYPE_CHECKING:
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics import StaticSolution
    from valvefsi.solid.stress import Stress

SIMPLEX = {"triangle", "tetrahedron"}
References = Mapping[str, Sequence[Reference]]
"""What each quantity is compared with."""


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """One mesh of a series: kind of cell, and elements along the benchmark's shortest counted edge."""

    cell: str
    elements: int

    def __str__(self) -> str:
        return f"{self.cell}, {self.elements} elements"


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What one mesh gives: quantities by name (which ends in the unit, ``u_y_cm``), unknowns, the body on rank 0."""

    values: Mapping[str, float]
    unknowns: int
    body: Body | None = None


def answer_of(
    solution: StaticSolution, material: Material, values: Mapping[str, float], **fibres: Any
) -> Answer:
    """Return the answer of one mesh, with the body and all its stresses; ``fibres`` as of `Stress` (collective)."""
    spaces = (solution.displacement.function_space, solution.pressure.function_space)
    unknowns = sum(s.dofmap.index_map.size_global * s.dofmap.index_map_bs for s in spaces)
    body = body_of(stress_of_solution(solution, material, **fibres))
    return Answer(values=values, unknowns=unknowns, body=body)


def body_of(stress: Stress) -> Body | None:
    """Return the body with all its stresses on rank 0, None on the others (collective)."""
    gathered = stress.gather()
    if gathered is None:
        return None
    points, cells, fields, reference = gathered
    return Body(points=points, cells=cells, values=fields, reference=reference, shown=LABELS["von_mises"])


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """Options of all static benchmarks."""

    cell: str = option(
        "both", "Kind of cell: triangle, quadrilateral, tetrahedron, hexahedron, simplex or both."
    )
    refine: int = option(0, "Refine the mesh K times; gives the observed order.", least=0)
    elements: int | None = option(None, "Elements of the coarsest mesh.", least=1)


@dataclass(frozen=True, kw_only=True)
class Static(MeshOptions, Benchmark[Mesh, References]):
    """A static benchmark: it states its cells, its answer on one mesh and what this is compared with."""

    title: ClassVar[str]
    cells: ClassVar[tuple[str, ...]]
    also: ClassVar[tuple[str, ...]] = ()
    """Further kinds that "both" stands for, such as linear elements: the cell, and after a comma what they are."""
    coarsest: ClassVar[int] = 1
    units: ClassVar[Mapping[str, tuple[str, str]]] = {}
    """Unit and label of each quantity."""

    iterative: bool = field(default=False)

    @abstractmethod
    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        """Return the answer on one mesh (collective)."""

    def compared_with(self) -> References:
        """Return the references by quantity; none where the parameters are not the published ones."""
        return {}

    def check(self, values: Values) -> None:
        self.kinds()

    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of cell that are asked for."""
        if self.cell == "both":
            return self.cells + self.also
        simplex = next((cell for cell in self.cells if cell in SIMPLEX), "simplex")
        kind = simplex if self.cell == "simplex" else self.cell
        if kind not in self.cells:
            near = nearest(self.cell, ["both", "simplex", *self.cells])
            raise CaseError(f"no such cell here{near}", key="--cell", value=self.cell)
        return (kind,)

    @property
    def solver(self) -> SolverOptions:
        """How the equilibrium is sought: FGMRES with multigrid where asked for, else a factorisation."""
        return SolverOptions(solver="fieldsplit") if self.iterative else SolverOptions()

    def runs(self) -> list[Mesh]:
        first = self.elements or self.coarsest
        return [Mesh(cell=c, elements=first * 2**k) for c in self.kinds() for k in range(self.refine + 1)]

    def references(self, comm: MPI.Comm) -> References:
        return self.compared_with()

    def one(self, run: Mesh, job: Job) -> Record:
        answer = self.solve(run, job.comm)
        mesh = {"cell": run.cell, "elements": run.elements, "unknowns": answer.unknowns}
        return mesh | {"values": dict(answer.values), "_body": answer.body}

    def report(self, records: Sequence[Record], known: References) -> Report:
        chosen = {"cell": self.cell, "elements": self.elements or self.coarsest, "refine": self.refine}
        return Report(
            parameters=chosen | {"iterative": self.iterative} | self.values,
            quantities={cell: self._quantities(records, cell, known) for cell in _kinds(records)},
            reference={name: [vars(r) for r in refs] for name, refs in known.items()},
            more={"levels": [public(record) for record in records]},
            table=[*self._table(records, known), *_cost(records)],
        )

    def _quantities(self, records: Sequence[Record], cell: str, known: References) -> dict[str, float | None]:
        """Return the finest values of a kind of cell, their order and their extrapolation."""
        found: dict[str, float | None] = {}
        for name in records[0]["values"]:
            values = _series(records, cell, name)
            found[name] = values[-1]
            found[f"{name}_order"] = observed_order(values, exact=_exact(known, name))
            found[f"{name}_extrapolated"] = extrapolated(values)
        return found

    def _table(self, records: Sequence[Record], known: References) -> list[Row]:
        lines = []
        for name in records[0]["values"]:
            unit, label = self.units.get(name, ("", name))
            first, *more = known.get(name) or [Reference()]
            for cell in _kinds(records):
                for record in (record for record in records if record["cell"] == cell):
                    value = record["values"][name]
                    lines.append(compared(f"{label} ({cell}, {record['elements']})", value, first, unit))
                lines += [compared("", value, reference, unit) for reference in more]
                lines += self._orders(records, cell, name, _exact(known, name))
        return lines

    def _orders(self, records: Sequence[Record], cell: str, name: str, exact: float | None) -> list[Row]:
        unit, label = self.units.get(name, ("", name))
        if cell in self.also:
            return []
        values, lines = _series(records, cell, name), []
        order, limit = observed_order(values, exact=exact), extrapolated(values)
        if order is not None:
            source = "from errors" if exact is not None else "from successive differences"
            lines.append(row(f"observed order, {cell}", order, source=source))
        if limit is not None and exact is None:
            lines.append(row(f"{label}, extrapolated, {cell}", limit, source="Richardson", unit=unit))
        return lines

    def draw(self, records: Sequence[Record], known: References, out: Path) -> None:
        for cell, finest in _finest(records).items():
            if finest.get("_body") is not None:
                caption, name = (
                    f"{cell}, {finest['unknowns']:,} unknowns",
                    cell.replace(",", "").replace(" ", "_"),
                )
                deformed(out / f"deformed_{name}.png", finest["_body"], title=self.title, caption=caption)
                write_body(out / f"solid_{name}.vtu", finest["_body"])
        if self.refine:
            panels = [self._panel(records, name, known) for name in records[0]["values"]]
            convergence(out / "convergence.png", panels, title=self.title)

    def _panel(self, records: Sequence[Record], name: str, known: References) -> Convergence:
        unit, label = self.units.get(name, ("", name))
        lines = {
            cell: ([r["unknowns"] for r in records if r["cell"] == cell], _series(records, cell, name))
            for cell in _kinds(records)
        }
        shown = [(r.value, r.band, r.source) for r in known.get(name, ())]
        return Convergence(label=f"{label} [{unit or '-'}]", lines=lines, known=shown)


@dataclass(frozen=True, kw_only=True)
class StaticParts(MeshOptions, Joined):
    """Static benchmarks of one command; a kind of cell of one of them stands for its like in the others."""

    parts: ClassVar[Mapping[str, type[Static]]]

    def __post_init__(self) -> None:
        """Refuse what one of them refuses."""
        super().__post_init__()
        self.members()

    def members(self) -> dict[str, Static]:
        names = {cell: k for kind in self.parts.values() for k, cell in enumerate(kind.cells)}
        return {
            name: kind(
                cell=kind.cells[names[self.cell]] if self.cell in names else self.cell,
                refine=self.refine,
                elements=self.elements,
                overrides=self.overrides,
            )
            for name, kind in self.chosen().items()
        }

    def parameters_of(self, results: Mapping[str, Result]) -> dict[str, Any]:
        if len({id(kind.parameters) for kind in self.parts.values()}) > 1:
            return super().parameters_of(results)
        *_, last = results.values()
        return dict(last["parameters"]) | {"cell": self.cell}

    def chosen(self) -> Mapping[str, type[Static]]:
        """Return the kinds of benchmark that are run."""
        return self.parts


def _series(records: Sequence[Record], cell: str, name: str) -> list[float]:
    return [record["values"][name] for record in records if record["cell"] == cell]


def _kinds(records: Sequence[Record]) -> list[str]:
    return list(dict.fromkeys(record["cell"] for record in records))


def _finest(records: Sequence[Record]) -> dict[str, Record]:
    return {record["cell"]: record for record in records}


def _exact(known: References, name: str) -> float | None:
    return next((r.value for r in known.get(name, ()) if r.exact), None)


def _cost(records: Sequence[Record]) -> list[Row]:
    """Return what the finest mesh of each kind of cell took."""
    lines = [
        row(f"wall time, {cell}, {r['unknowns']:,} unknowns", r["wall_s"], source="measured", unit="s")
        for cell, r in _finest(records).items()
    ]
    memory = records[-1]["peak_memory_gib"]
    return [*lines, row("peak memory, all ranks", memory, source="measured", unit="GiB")]
