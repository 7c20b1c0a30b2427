"""Fibre fields of a case."""

from __future__ import annotations

from collections.abc import Sequence

from valvefsi.case.material_tables import Fibre, Material
from valvefsi.case.materials import RELATIVE, directions_of, material_kind
from valvefsi.errors import CaseError
from valvefsi.geometry.mesh import SolidMesh
from valvefsi.solid.materials import fibres


def add_fibres(
    mesh: SolidMesh, given: Sequence[Fibre], key: str, material: Material | None = None
) -> SolidMesh:
    """Return a mesh with its fibre fields.

    Args:
        mesh: The mesh.
        given: What the case says of them.
        key: Place of the solid in the case, for messages.
        material: Material of the solid, whose directions relative to the leaflet's own become fields by their text.

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
    mesh = mesh.with_fibres(**made)
    own = directions_of(material_kind(material.model), material.parameters) if material else ()
    for place, direction in own:
        relative = RELATIVE.fullmatch(direction) if isinstance(direction, str) else None
        if relative:
            try:
                mesh = mesh.with_fibres(**{str(direction): fibres.turned(mesh, float(relative[1]))})
            except CaseError as error:
                raise CaseError(error.reason, key=f"{key}.material.{place}", value=direction) from None
    return mesh


RULES = {
    "constant": lambda mesh, fibre: fibres.constant(mesh, fibre.direction),
    "circumferential": lambda mesh, fibre: fibres.circumferential(
        mesh, axis=fibre.axis, through=fibre.through, angle=fibre.angle
    ),
    "blend": lambda mesh, fibre: fibres.blend(mesh, fibre.angles, axis=fibre.axis),
    "data": lambda mesh, fibre: fibres.read_fibres(mesh, fibre.file, fibre.data),
}
"""How each rule makes its field."""
