"""The stress of a structure or of a static equilibrium, whatever its elements are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from valvefsi.solid.elements.shell_elasticity import ShellElasticity
from valvefsi.solid.shell_stress import ShellStress
from valvefsi.solid.statics import SolidShell
from valvefsi.solid.stress import Stress, stress_of_solution

if TYPE_CHECKING:
    from valvefsi.solid.materials import Material
    from valvefsi.solid.statics import StaticSolution
    from valvefsi.solid.statics.formulations import Formulation
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Mesh


def stress_of_structure(structure: Structure, **options: Any) -> Stress:
    """Return the stress of a structure at the position its `force` was last called with (collective).

    Args:
        structure: The structure.
        options: As of `Stress`; of solid-shell elements only ``fibre`` is read.
    """
    elasticity = structure.elasticity
    if isinstance(elasticity, ShellElasticity):
        return ShellStress(elasticity, options.get("fibre"))
    return Stress(elasticity.position, structure.material, of_position=True, kappa=structure.kappa, **options)


def stress_of_equilibrium(
    solution: StaticSolution, mesh: Mesh, material: Material, formulation: Formulation | SolidShell
) -> Stress:
    """Return the stress of a static solution (collective).

    Args:
        solution: The solution; with elements other than solid shells one of a formulation with a pressure.
        mesh: The ``SolidMesh`` that was solved on.
        material: Its material.
        formulation: What it was solved with.
    """
    if not isinstance(formulation, SolidShell):
        return stress_of_solution(solution, material, fibres=mesh.fibres)
    space = solution.displacement.function_space
    elements = formulation.elements(mesh, space, material)
    owned = space.dofmap.index_map.size_local
    u = solution.displacement.x.array.reshape(-1, 3)[:owned]
    elements.set_position(space.tabulate_dof_coordinates()[:owned] + u)
    return ShellStress(elements)
