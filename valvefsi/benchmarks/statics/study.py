"""What the static benchmarks share: a series of meshes for each kind of cell, each twice as fine as the one before."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from mpi4py import MPI

from valvefsi.benchmarks.frame import Benchmark, Command, Job, Record, Report, Result, public
from valvefsi.benchmarks.options import Values, option
from valvefsi.benchmarks.results import Reference, Row, compared, order_row, row
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
class Series:
    """One quantity on the meshes of one kind of cell.

    Attributes:
        name: Name of the quantity.
        label: Its name in words.
        unit: Its unit, empty where nothing is said of it.
        cell: Kind of cell.
        records: Of its meshes, the coarsest first.
        references: What it is compared with.
        ordered: Whether the lines hold the observed order and the extrapolation.
    """

    name: str
    label: str
    unit: str
    cell: str
    records: Sequence[Record]
    references: Sequence[Reference]
    ordered: bool = True

    @property
    def values(self) -> list[float]:
        """The values."""
        return [record["values"][self.name] for record in self.records]

    @property
    def exact(self) -> float | None:
        """The reference that errors are taken against."""
        return next((reference.value for reference in self.references if reference.exact), None)

    def numbers(self) -> dict[str, float | None]:
        """Return the finest value, the order and the extrapolation."""
        values, name = self.values, self.name
        order, limit = observed_order(values, exact=self.exact), extrapolated(values)
        return {name: values[-1], f"{name}_order": order, f"{name}_extrapolated": limit}

    def rows(self) -> list[Row]:
        """Return the lines that compare, the observed order and the extrapolation."""
        first, *more = self.references or [Reference()]
        names = [f"{self.label} ({self.cell}, {record['elements']})" for record in self.records]
        lines = [compared(name, v, first, self.unit) for name, v in zip(names, self.values, strict=True)]
        lines += [compared("", self.values[-1], reference, self.unit) for reference in more]
        if not self.ordered:
            return lines
        exact, limit, name = self.exact, extrapolated(self.values), f"observed order, {self.cell}"
        source = "from errors" if exact is not None else "from successive differences"
        lines += order_row(name, self.values, exact=exact, source=source)
        if limit is not None and exact is None:
            name = f"{self.label}, extrapolated, {self.cell}"
            lines.append(row(name, limit, source="Richardson", unit=self.unit))
        return lines


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

    iterative: bool = option(False, "FGMRES with multigrid instead of a factorisation, for large meshes.")

    @abstractmethod
    def solve(self, mesh: Mesh, comm: MPI.Comm) -> Answer:
        """Return the answer on one mesh (collective)."""

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
        """Return the references by quantity; none where the parameters are not the published ones."""
        return {}

    def one(self, run: Mesh, job: Job) -> Record:
        answer = self.solve(run, job.comm)
        mesh = {"cell": run.cell, "elements": run.elements, "unknowns": answer.unknowns}
        return mesh | {"values": dict(answer.values), "_body": answer.body}

    def series(self, records: Sequence[Record], reference: References) -> list[Series]:
        """Return every quantity on every kind of cell."""
        return [
            Series(
                name=name,
                label=self.units.get(name, ("", name))[1],
                unit=self.units.get(name, ("", name))[0],
                cell=cell,
                records=[record for record in records if record["cell"] == cell],
                references=reference.get(name, ()),
                ordered=cell not in self.also,
            )
            for name in records[0]["values"]
            for cell in _finest(records)
        ]

    def report(self, records: Sequence[Record], reference: References) -> Report:
        series, quantities = self.series(records, reference), defaultdict[str, dict[str, float | None]](dict)
        for one in series:
            quantities[one.cell] |= one.numbers()
        options = {"cell": self.cell, "elements": self.elements or self.coarsest, "refine": self.refine}
        return Report(
            parameters=options | {"iterative": self.iterative} | self.values,
            quantities=quantities,
            reference={name: [vars(r) for r in refs] for name, refs in reference.items()},
            more={"levels": [public(record) for record in records]},
            table=[*(line for one in series for line in one.rows()), *_cost(records)],
        )

    def draw(self, records: Sequence[Record], reference: References, out: Path) -> None:
        for cell, finest in _finest(records).items():
            if finest.get("_body") is not None:
                caption = f"{cell}, {finest['unknowns']:,} unknowns"
                name = cell.replace(",", "").replace(" ", "_")
                deformed(out / f"deformed_{name}.png", finest["_body"], title=self.title, caption=caption)
                write_body(out / f"solid_{name}.vtu", finest["_body"])
        if self.refine:
            panels = []
            for name, parts in itertools.groupby(self.series(records, reference), lambda one: one.name):
                lines, compared_with = {}, [(r.value, r.band, r.source) for r in reference.get(name, ())]
                for one in parts:
                    lines[one.cell] = ([r["unknowns"] for r in one.records], one.values)
                label = f"{one.label} [{one.unit or '-'}]"
                panels.append(Convergence(label=label, lines=lines, known=compared_with))
            convergence(out / "convergence.png", panels, title=self.title)


@dataclass(frozen=True, kw_only=True)
class StaticParts(MeshOptions, Command):
    """Static benchmarks of one command, each in a folder of its own; their tables are put together.

    A kind of cell of one of them stands for its like in the others.
    """

    parts: ClassVar[Mapping[str, type[Static]]]

    def __post_init__(self) -> None:
        """Refuse what one of them refuses."""
        super().__post_init__()
        self.members()

    def selection(self) -> Mapping[str, type[Static]]:
        """Return the kinds of benchmark that are run."""
        return self.parts

    def title(self, part: str) -> str:
        """Return what stands before the lines of a part."""
        return part

    def members(self) -> dict[str, Static]:
        """Return the benchmarks by the name of their folder."""
        names = {cell: k for kind in self.parts.values() for k, cell in enumerate(kind.cells)}
        return {
            name: kind(
                cell=kind.cells[names[self.cell]] if self.cell in names else self.cell,
                refine=self.refine,
                elements=self.elements,
                overrides=self.overrides,
            )
            for name, kind in self.selection().items()
        }

    def execute(self, session: Job) -> Result:
        results = {
            part: one.run(out=session.folder / part, comm=session.comm, progress=session.announce)
            for part, one in self.members().items()
        }
        by_part = {
            key: {part: result[key] for part, result in results.items()}
            for key in ("parameters", "quantities", "reference")
        }
        *_, last = by_part["parameters"].values()
        report = Report(
            parameters=last | {"cell": self.cell} if self._share_parameters else by_part["parameters"],
            quantities=by_part["quantities"],
            reference=by_part["reference"],
            table=[
                {**line, "quantity": line["quantity"] and f"{self.title(part)}: {line['quantity']}"}
                for part, result in results.items()
                for line in result["table"]
            ],
            timing={"wall_s": sum(result["timing"]["wall_s"] for result in results.values())},
        )
        return self.written(report, session)

    @property
    def _share_parameters(self) -> bool:
        first, *others = (kind.parameters for kind in self.parts.values())
        return bool(first) and all(other is first for other in others)


def _finest(records: Sequence[Record]) -> dict[str, Record]:
    return {record["cell"]: record for record in records}


def _cost(records: Sequence[Record]) -> list[Row]:
    """Return what the finest mesh of each kind of cell took."""
    lines = [
        row(f"wall time, {cell}, {r['unknowns']:,} unknowns", r["wall_s"], source="measured", unit="s")
        for cell, r in _finest(records).items()
    ]
    memory = records[-1]["peak_memory_gib"]
    return [*lines, row("peak memory, all ranks", memory, source="measured", unit="GiB")]
