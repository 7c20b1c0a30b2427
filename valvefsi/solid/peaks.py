"""Largest strain and stress of the parts of a body, such as the leaflets of a valve."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from mpi4py import MPI
    from numpy.typing import NDArray

    from valvefsi.solid.stress import Stress
    from valvefsi.types import Array, Mesh

SHARE = 0.99
"""Part of the reference volume that does not exceed the percentile; the peak of a corner is no measure of a leaflet."""
AT_POINTS = ("principal_stretches", "von_mises")
"""Quantities that the peaks follow from."""
MEASURES = ("green_strain", "von_mises")
"""Largest principal Green strain [-], von Mises' equivalent of the Cauchy stress [dyn/cm^2]."""


def parts_of(mesh: Mesh) -> dict[str, NDArray[np.int32]]:
    """Return this rank's cells of each tag of cells of a ``SolidMesh``, by its name."""
    num_cells = mesh.mesh.topology.index_map(mesh.dim).size_local
    found = {}
    for name, (dim, tag) in sorted(mesh.names.items()):
        if dim == mesh.dim and mesh.cell_tags is not None:
            cells = mesh.cell_tags.find(tag)
            found[name] = cells[cells < num_cells]
    return found


def columns_of(parts: Sequence[str]) -> list[str]:
    """Return the names of what `Peaks.now` gives."""
    return [f"{part}_{measure}_{kind}" for part in parts for measure in MEASURES for kind in ("p99", "max")]


class Peaks:
    """Percentile and maximum over the quadrature points of each part, weighted by their reference volume.

        E_1 = (lambda_1^2 - 1)/2

    Args:
        stress: Stress of the body.
        parts: This rank's cells of each part by name.
    """

    def __init__(self, stress: Stress, parts: dict[str, NDArray[np.int32]]) -> None:
        self.stress, self.parts = stress, parts

    def now(self, values: Mapping[str, Array] | None = None) -> dict[str, float]:
        """Return the peaks of the present deformation by column, the same on all ranks. Collective.

        Args:
            values: `AT_POINTS` at the points now; evaluated here if left out.
        """
        values = self.stress.at_points(*AT_POINTS) if values is None else values
        of = {
            "green_strain": 0.5 * (values["principal_stretches"][..., 0] ** 2 - 1.0),
            "von_mises": values["von_mises"],
        }
        volume, comm, found = self.stress.point_volumes(), self.stress.mesh.comm, {}
        for part, cells in self.parts.items():
            weights = together(comm, volume[cells])
            for measure, array in of.items():
                x = together(comm, array[cells])
                found[f"{part}_{measure}_p99"] = percentile(x, weights)
                found[f"{part}_{measure}_max"] = float(x.max())
        return {name: found[name] for name in columns_of(list(self.parts))}


def percentile(values: Array, weights: Array, share: float = SHARE) -> float:
    """Return the smallest value that ``share`` of the weight does not exceed."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    at = np.searchsorted(total, share * total[-1] * (1.0 - 1e-12))
    return float(values[order][at])


def together(comm: MPI.Comm, array: Array) -> Array:
    """Return the values of all ranks, flat (collective)."""
    return np.concatenate(comm.allgather(np.ravel(array)))
