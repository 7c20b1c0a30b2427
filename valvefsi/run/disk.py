"""The disk that a run will need, and what is free."""

from __future__ import annotations

import math
import shutil
import warnings
from pathlib import Path

from valvefsi.fsi import Model
from valvefsi.run.recording import Output, chosen_cells

FRAME_BYTES, POINT_BYTES, ROW_BYTES, AVERAGES = 16, 200, 1000, 10
"""A cell of a frame, a point of a body in one (with its cells), a row of the history; arrays of averages."""


def disk_needed(model: Model, output: Output, steps: int) -> float:
    """Return the largest space that the files of a run can take [bytes]: frames without their compression.

    Args:
        model: The model.
        output: What is written.
        steps: Steps of the run.

    Note:
        Collective.
    """
    grid = model.grid
    points = sum(body.num_points for body in model.bodies)
    arrays = 1 + 2 * grid.dim + (AVERAGES if output.averages_from is not None else 0)
    checkpoint = 8 * (arrays * math.prod(grid.cells) + 9 * points)
    frame = POINT_BYTES * points + (
        FRAME_BYTES * math.prod(chosen_cells(grid, output).cells) if output.frames else 0
    )
    rows = 1 + steps // output.history_every
    return (output.keep_checkpoints + 1.0) * checkpoint + (output.frames + 1) * frame + ROW_BYTES * rows


def disk_free(folder: Path) -> float:
    """Return the space on the disk of a folder, or of the nearest one above it that is there [bytes]."""
    there = next(
        (path for path in (folder.absolute(), *folder.absolute().parents) if path.is_dir()), Path("/")
    )
    return float(shutil.disk_usage(there).free)


def warn_of_disk(model: Model, output: Output, steps: int) -> None:
    """Warn on rank 0 where the files of a run may not fit. Collective."""
    needed = disk_needed(model, output, steps)
    if model.grid.comm.rank == 0 and needed > (free := disk_free(output.directory)):
        warnings.warn(
            f"the run may need {needed / 1e9:.3g} GB of disk, {free / 1e9:.3g} GB are free at {output.directory}",
            stacklevel=2,
        )
