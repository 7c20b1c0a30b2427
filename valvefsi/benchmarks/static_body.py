"""From a static solution to what the benchmarks keep of it: its size, and a body to draw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from valvefsi.benchmarks.static_study import Answer
from valvefsi.io.solid_body import Body
from valvefsi.solid.stress import LABELS, stress_of_solution

if TYPE_CHECKING:
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics import StaticSolution
    from valvefsi.solid.stress import Stress


def answer_of(
    solution: StaticSolution,
    material: Material,
    values: Mapping[str, float],
    *,
    shown: str = "von_mises",
    **fibres: object,
) -> Answer:
    """Return the answer of one mesh, with the body and all its stresses; ``fibres`` as of `Stress` (collective)."""
    body = body_of(stress_of_solution(solution, material, **fibres), shown=shown)
    spaces = (solution.displacement.function_space, solution.pressure.function_space)
    unknowns = sum(s.dofmap.index_map.size_global * s.dofmap.index_map_bs for s in spaces)
    return Answer(values=values, unknowns=unknowns, body=body)


def body_of(stress: Stress, *, shown: str = "von_mises") -> Body | None:
    """Return the deformed body with every quantity at its nodes on rank 0, None elsewhere (collective)."""
    gathered = stress.gather()
    if gathered is None:
        return None
    points, cells, fields, reference = gathered
    return Body(points=points, cells=cells, values=fields, reference=reference, shown=LABELS[shown])
