"""Fibre fields of a case."""

from __future__ import annotations

from collections.abc import Sequence

from valvefsi.case.material_tables import Fibre
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.solid.materials import fibres


def add_fibres(mesh: SolidMesh, given: Sequence[Fibre], key: str) -> SolidMesh:
    """Return a mesh with its fibre fields.

    Args:
        mesh: The mesh.
        given: What the case says of them.
        key: Place of the solid in the case, for messages.

    Raises:
        CaseError: A field cannot be made on this mesh.

    Note:
        Collective.
    """
    made = {}
    for fibre in given:
        try:
            made[fibre.name] = RULES[fibre.rule](mesh, fibre)
        except CaseError as error:
            place = f"{key}.fibre.{fibre.name}" + (
                f".{error.key}" if error.key not in (None, "fibre") else ""
            )
            raise CaseError(error.reason, file=error.file, key=place, value=error.value) from None
    return mesh.with_fibres(**made)


RULES = {
    "constant": lambda mesh, fibre: fibres.constant(mesh, fibre.direction),
    "circumferential": lambda mesh, fibre: fibres.circumferential(
        mesh, axis=fibre.axis, through=fibre.through, angle=fibre.angle
    ),
    "blend": lambda mesh, fibre: fibres.blend(mesh, fibre.angles, axis=fibre.axis),
    "data": lambda mesh, fibre: fibres.read_fibres(mesh, fibre.file, fibre.data),
}
"""How each rule makes its field."""
