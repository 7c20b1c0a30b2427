"""Supports of a body in static equilibrium: prescribed displacements, rotations, planes of symmetry."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valvefsi.types import Array, Mesh


@dataclass(frozen=True, kw_only=True)
class Fixed:
    """Prescribed displacement of tagged facets.

    Args:
        on: Names of the facet tags.
        components: The axes it acts along, of "x", "y", "z"; empty for all of them.
        value: ``value(X, s)`` gives the displacement ``(n, 3)`` [cm] at reference positions ``(n, 3)`` and
            load factor s; None for zero. `rotation` makes one.
    """

    on: tuple[str, ...]
    components: tuple[str, ...] = ()
    value: Callable[[Array, float], Array] | None = None

    def __post_init__(self) -> None:
        if not self.on or not set(self.components) <= set("xyz"):
            message = 'expected tags, and components of "x", "y", "z"'
            raise CaseError(message, key="fixed", value=[self.on, self.components])


@dataclass(frozen=True, kw_only=True)
class Symmetry:
    """A plane of symmetry: no displacement along its normal, no shear on it.

    A plane at right angles to an axis is prescribed exactly; an oblique one is held by stiff springs along its
    normal, which give way by (traction on the plane)/(stiffness).

    Args:
        on: Names of facet tags that lie in one plane.
        stiffness: Of the springs [dyn/cm^3]; None takes 1e5 shear moduli per size of the body.
    """

    on: tuple[str, ...]
    stiffness: float | None = None

    def __post_init__(self) -> None:
        if not self.on or not (self.stiffness is None or 0 < self.stiffness < math.inf):
            message = "expected tags, and a positive stiffness"
            raise CaseError(message, key="symmetry", value=[self.on, self.stiffness])


def rotation(
    angle: float, *, axis: Sequence[float] = (0.0, 0.0, 1.0), through: Sequence[float] = (0.0, 0.0, 0.0)
) -> Callable[[Array, float], Array]:
    """Return the displacement of a rigid rotation, growing in proportion to the load factor, for `Fixed`.

    Args:
        angle: Angle at load factor 1, right-handed about the axis [rad]; more than a turn is allowed.
        axis: Direction of the axis, ``(3,)``.
        through: A point on the axis, ``(dim,)`` or ``(3,)`` [cm].
    """
    a = np.asarray(axis, dtype=np.float64)
    length = np.linalg.norm(a)
    if a.shape != (3,) or not 0 < length < np.inf or not math.isfinite(angle):
        raise CaseError(
            "expected a finite angle and an axis of 3 components", key="rotation", value=[angle, axis]
        )
    a = a / length
    point = np.zeros(3)
    point[: len(through)] = through

    def displacement(X: Array, s: float) -> Array:
        arm = X - point
        arm = arm - np.outer(arm @ a, a)
        turn = s * angle
        return (math.cos(turn) - 1) * arm + math.sin(turn) * np.cross(a, arm)

    return displacement


def facet_tags(mesh: Mesh, names: Sequence[str]) -> list[int]:
    """Return the numbers of facet tags; refuse tags of cells and tags that no facet carries (collective)."""
    tags = [mesh.tag(name) for name in names]
    if any(dim != mesh.mesh.topology.dim - 1 for dim, _ in tags):
        raise CaseError("expected tags of facets", file=mesh.source, key="on", value=list(names))
    for name, (_, tag) in zip(names, tags, strict=True):
        if mesh.mesh.comm.allreduce(len(_facets(mesh, tag))) == 0:
            raise CaseError("no facet carries this tag", file=mesh.source, key="on", value=name)
    return [tag for _, tag in tags]


def facets_of(mesh: Mesh, names: Sequence[str]) -> NDArray[np.int32]:
    """Return this rank's facets with any of the tags; refuse tags that no facet carries (collective)."""
    return np.concatenate([_facets(mesh, tag) for tag in facet_tags(mesh, names)])


def _facets(mesh: Mesh, tag: int) -> NDArray[np.int32]:
    """Return this rank's facets with a tag, ``(n,)``."""
    return np.zeros(0, dtype=np.int32) if mesh.facet_tags is None else mesh.facet_tags.find(tag)


class Prescribed:
    """Prescribed displacements in a space, as DOLFINx conditions that follow the load factor.

    Args:
        mesh: A ``SolidMesh``.
        space: Vector space of the displacement; a subspace of a mixed space too.
        supports: What is prescribed.

    Note:
        Collective.
    """

    def __init__(self, mesh: Mesh, space: fem.FunctionSpace, supports: Sequence[Fixed]) -> None:
        self._values: list[tuple[Callable[[Array, float], Array] | None, int, fem.Function]] = []
        self.conditions: list[fem.DirichletBC] = []
        for support in supports:
            self._fix(mesh, space, support)

    def _fix(self, mesh: Mesh, space: fem.FunctionSpace, support: Fixed) -> None:
        """Make the conditions of one support, one for each component."""
        domain = mesh.mesh
        facet_dim = domain.topology.dim - 1
        domain.topology.create_connectivity(facet_dim, facet_dim + 1)
        facets = facets_of(mesh, support.on)
        for axis in range(domain.geometry.dim):
            if support.components and "xyz"[axis] not in support.components:
                continue
            sub = space.sub(axis)
            collapsed, _ = sub.collapse()
            value = fem.Function(collapsed)
            dofs = fem.locate_dofs_topological((sub, collapsed), facet_dim, facets)
            self._values.append((support.value, axis, value))
            self.conditions.append(fem.dirichletbc(value, dofs, sub))

    def set_factor(self, s: float) -> None:
        """Set the load factor."""
        for function, axis, value in self._values:
            if function is not None:
                value.interpolate(lambda x, f=function, i=axis: np.asarray(f(x.T, s))[:, i])


def plane_normal(mesh: Mesh, names: Sequence[str]) -> Array:
    """Return the outer unit normal ``(3,)`` of flat facets; refuse facets that do not lie in one plane (collective)."""
    dim, domain = mesh.dim, mesh.mesh
    N = ufl.FacetNormal(domain)
    tags = tuple(facet_tags(mesh, names))
    ds = ufl.Measure("ds", domain=domain, subdomain_data=mesh.facet_tags, metadata={"quadrature_degree": 4})(
        tags
    )
    one = fem.Constant(domain, 1.0)
    forms = [compat.compile_form(part * ds) for part in (one, *(N[i] for i in range(dim)))]
    area, *sums = domain.comm.allreduce(np.array([fem.assemble_scalar(form) for form in forms]))
    normal = np.zeros(3)
    normal[:dim] = np.array(sums) / area
    if not abs(np.linalg.norm(normal) - 1) < 1e-8:
        raise CaseError("a plane of symmetry must be flat", file=mesh.source, key="on", value=list(names))
    return normal / np.linalg.norm(normal)
