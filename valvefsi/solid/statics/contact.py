"""Contact with rigid planes: what keeps a closed leaflet on its own side of the plane where its neighbour begins."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem

from valvefsi.errors import CaseError
from valvefsi.solid.statics.supports import facet_tags

if TYPE_CHECKING:
    from ufl.core.expr import Expr

    from valvefsi.types import Mesh


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A rigid plane without friction that facets may touch, by a penalty.

        Pi = k/2 integral <n . x - c>_+^2 dA,    x = X + u, dA of the reference,

    so that a surface that bears a pressure P there has passed the plane by P/k.

    Args:
        on: Names of the facet tags that may touch it.
        normal: n, out of the side that the body stays on; its length does not matter, ``(dim,)``.
        offset: c, distance of the plane from the origin along n [cm].
        stiffness: k [dyn/cm^3].
    """

    on: tuple[str, ...]
    normal: tuple[float, ...]
    offset: float = 0.0
    stiffness: float

    def __post_init__(self) -> None:
        length = math.hypot(*self.normal)
        if not self.on or not 0 < length < math.inf or not 0 < self.stiffness < math.inf:
            message = "expected tags, a normal and a positive stiffness"
            raise CaseError(message, key="contact", value=[self.on, self.normal, self.stiffness])
        object.__setattr__(self, "normal", tuple(part / length for part in self.normal))

    def depth(self, mesh: Mesh, u: Expr) -> Expr:
        """Return how far the plane is passed, 0 where it is not touched [cm]."""
        x = ufl.SpatialCoordinate(mesh.mesh) + u
        return ufl.max_value(ufl.dot(ufl.as_vector(self.normal[: mesh.dim]), x) - self.offset, 0.0)


def contact_area(mesh: Mesh, u: fem.Function, planes: Sequence[Contact], degree: int = 5) -> float:
    """Return the reference area that has passed planes [cm^2]; counted at quadrature points (collective)."""
    total = 0.0
    for plane in planes:
        metadata = {"quadrature_degree": degree}
        ds = ufl.Measure("ds", domain=mesh.mesh, subdomain_data=mesh.facet_tags, metadata=metadata)
        touched = ufl.conditional(ufl.gt(plane.depth(mesh, u), 0.0), 1.0, 0.0)
        total += float(
            fem.assemble_scalar(compat.compile_form(touched * ds(tuple(facet_tags(mesh, plane.on)))))
        )
    return float(mesh.mesh.comm.allreduce(np.float64(total)))
