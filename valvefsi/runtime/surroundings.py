"""What a process finds around it."""

from __future__ import annotations

import os

LAUNCHER = ("PMI_", "PMIX_", "HYDI_", "HYDRA_", "OMPI_COMM_", "OMPI_UNIVERSE", "MPI_LOCAL")
"""Variables by which a launcher of ranks tells a process that it is one."""


def without_launcher() -> dict[str, str]:
    """Return the variables for a process that is no rank of this one's launch."""
    return {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER)}
