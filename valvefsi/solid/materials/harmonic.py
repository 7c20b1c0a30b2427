"""Harmonic fields on a solid: what fibre fields take depth and direction from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valvefsi.runtime import dolfinx_compat  # noqa: F401  (before ufl)

# isort: split
import ufl
from dolfinx import fem

from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.solid.newton import Newton

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from valvefsi.types import Mesh


def harmonic(mesh: Mesh, given: Sequence[tuple[Sequence[str], float]], key: str) -> fem.Function:
    """Solve Laplace's equation with values on tagged facets, and no flux through all others.

    Args:
        mesh: A ``SolidMesh``.
        given: Tags of facets and the value on them.
        key: Key of the tags, for messages.

    Returns:
        The field, continuous and linear in each element.

    Raises:
        CaseError: A tag is unknown or no facet carries it.

    Note:
        Collective. One linear solve by MUMPS.
    """
    domain = mesh.mesh
    space = fem.functionspace(domain, ("Lagrange", 1))
    phi, test = fem.Function(space), ufl.TestFunction(space)
    facet_dim = domain.topology.dim - 1
    domain.topology.create_connectivity(facet_dim, facet_dim + 1)
    conditions = []
    for tags, value in given:
        facets = np.unique(np.concatenate([_facets(mesh, name, facet_dim, key) for name in tags]))
        dofs = fem.locate_dofs_topological(space, facet_dim, facets)
        conditions.append(fem.dirichletbc(value, dofs, space))
    residual = ufl.inner(ufl.grad(phi), ufl.grad(test)) * ufl.dx(degree=2)
    with Newton(phi, residual, conditions) as newton:
        converged, _ = newton.solve()
    if not converged:
        listed = " and ".join(name for tags, _ in given for name in tags)
        raise ConvergenceError(f"fibres of {mesh.source}: no harmonic field from {listed}")
    return phi


def _facets(mesh: Mesh, name: str, facet_dim: int, key: str) -> NDArray[np.int32]:
    """Return this rank's facets with a tag."""
    dim, tag = mesh.tag(name)
    facets: NDArray[np.int32] = np.zeros(0, dtype=np.int32)
    if dim == facet_dim and mesh.facet_tags is not None:
        facets = mesh.facet_tags.find(tag)
    if mesh.mesh.comm.allreduce(len(facets)) == 0:
        raise CaseError("no facet carries this tag", file=mesh.source, key=key, value=name)
    return facets
