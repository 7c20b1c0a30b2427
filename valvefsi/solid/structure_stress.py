"""The stress of a structure, whatever its elements are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from valvefsi.solid.elements.shell_elasticity import ShellElasticity
from valvefsi.solid.shell_stress import ShellStress
from valvefsi.solid.stress import Stress

if TYPE_CHECKING:
    from valvefsi.solid.structure import Structure


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
