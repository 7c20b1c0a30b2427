"""Lumped weights of the nodes: the share of a tagged surface, or of the body, that each node carries."""

from __future__ import annotations

from typing import TYPE_CHECKING

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem, la

from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from valvefsi.types import Array, Mesh


def lumped_weights(
    space: fem.FunctionSpace, mesh: Mesh, names: Sequence[str] | None, *, positive: bool = True
) -> tuple[Array, float]:
    """Integrate the shape functions over tagged facets or cells.

    Degree 1, or ``positive`` off: w_k = integral phi_k, consistent with a constant traction. Degree 2: the
    diagonal of the mass matrix scaled to the same total (Hinton, Rock and Zienkiewicz 1976), because integral
    phi_k is zero or negative at the vertices of simplices.

    Args:
        space: Vector Lagrange space of the solid.
        mesh: A ``SolidMesh``.
        names: Tags, all of facets or all of cells; None for the whole body.
        positive: Whether the weights must be positive.

    Returns:
        Weights of the owned nodes ``(n,)`` and their total over all ranks: an area or a volume, in two
        dimensions a length or an area.

    Raises:
        CaseError: A tag is unknown, or no cell or outer facet carries it.

    Note:
        Collective.
    """
    dm = _measure(space, mesh, names)
    comm, degree = space.mesh.comm, space.ufl_element().degree
    weights = _row_sums(space, dm)
    total = comm.allreduce(weights.sum())
    if not total > 0:
        raise CaseError(
            "no cell or outer facet has this tag", file=mesh.source, key="on", value=list(names or ())
        )
    if positive and degree > 1:
        weights = _mass_diagonal(space, dm)
        weights *= total / comm.allreduce(weights.sum())
    return weights, float(total)


def surface_area(space: fem.FunctionSpace) -> float:
    """Return the area of all outer facets, in two dimensions their length [cm^2, cm] (collective)."""
    degree = 2 * space.ufl_element().degree
    ds = ufl.Measure("ds", domain=space.mesh, metadata={"quadrature_degree": degree})
    return float(space.mesh.comm.allreduce(_row_sums(space, ds).sum()))


def _measure(space: fem.FunctionSpace, mesh: Mesh, names: Sequence[str] | None) -> ufl.Measure:
    """Return the UFL measure of the tagged facets or cells."""
    degree = 2 * space.ufl_element().degree
    if names is None:
        return ufl.Measure("dx", domain=space.mesh, metadata={"quadrature_degree": degree})
    dims, tags = zip(*(mesh.tag(name) for name in names), strict=True)
    if len(set(dims)) > 1:
        raise CaseError("expected only cells or only facets", key="on", value=list(names or ()))
    cells = dims[0] == space.mesh.topology.dim
    data = mesh.cell_tags if cells else mesh.facet_tags
    measure = ufl.Measure(
        "dx" if cells else "ds",
        domain=space.mesh,
        subdomain_data=data,
        metadata={"quadrature_degree": degree},
    )
    return measure(tuple(tags))


def _row_sums(space: fem.FunctionSpace, dm: ufl.Measure) -> Array:
    """Assemble integral phi_k of the owned nodes, from the first component of the vector space."""
    form = compat.compile_form(ufl.TestFunction(space)[0] * dm)
    vector = la.vector(space.dofmap.index_map, space.dofmap.index_map_bs)
    vector.array[:] = 0.0
    fem.assemble_vector(vector.array, form)
    vector.scatter_reverse(la.InsertMode.add)
    return _first_component(vector.array, space)


def _mass_diagonal(space: fem.FunctionSpace, dm: ufl.Measure) -> Array:
    """Assemble the diagonal of the mass matrix, integral phi_k^2, of the owned nodes."""
    form = compat.compile_form(ufl.TrialFunction(space)[0] * ufl.TestFunction(space)[0] * dm)
    matrix = fem.assemble_matrix(form)
    matrix.scatter_reverse()
    return _first_component(matrix.to_scipy().diagonal(), space)


def _first_component(array: Array, space: fem.FunctionSpace) -> Array:
    """Take the first component of the owned nodes."""
    dim = space.dofmap.index_map_bs
    return array[: space.dofmap.index_map.size_local * dim : dim].copy()
