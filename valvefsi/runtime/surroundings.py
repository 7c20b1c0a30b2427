"""What a process finds around it."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from valvefsi.errors import SurroundingsError

LAUNCHER = ("PMI_", "PMIX_", "HYDI_", "HYDRA_", "OMPI_COMM_", "OMPI_UNIVERSE", "MPI_LOCAL")
"""Variables by which a launcher of ranks tells a process that it is one."""

RANK_VARIABLES = ("PMI_RANK", "OMPI_COMM_WORLD_RANK", "PMIX_RANK", "MPI_RANKID")


def launched_rank() -> int:
    """Return this process' rank without starting MPI, from what the launcher says."""
    values = (os.environ.get(name, "") for name in RANK_VARIABLES)
    return next((int(value) for value in values if value.isdigit()), 0)


def without_launcher() -> dict[str, str]:
    """Return the variables for a process that is no rank of this one's launch."""
    return {name: value for name, value in os.environ.items() if not name.startswith(LAUNCHER)}


def on_ranks(words: Sequence[str], ranks: int) -> list[str]:
    """Return the command that runs another on so many ranks.

    Raises:
        SurroundingsError: There is no mpirun beside the interpreter or on the path.
    """
    if ranks == 1:
        return list(words)
    places = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    mpirun = shutil.which("mpirun", path=places)
    if mpirun is None:
        raise SurroundingsError("there is no mpirun beside the interpreter or on the path: one rank only")
    return [mpirun, "-n", str(ranks), *words]
