"""What a run averages and where it looks: running averages (S26, S27) and profiles along lines (Figures S10 to S13)."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from valvefsi.fsi import State
from valvefsi.grid import Array, MacGrid
from valvefsi.io.folder import replacing
from valvefsi.io.paraview import FluidSeries
from valvefsi.post import diagnostics
from valvefsi.post.diagnostics import Averages


class AverageSeries(FluidSeries):
    """Writes mean velocity, mean pressure and turbulence kinetic energy."""

    fields = (("mean_velocity", 3), ("mean_pressure", 1), ("turbulence_kinetic_energy", 1))


@dataclass(frozen=True, kw_only=True)
class Line:
    """A line along which a profile is read off.

    Attributes:
        start: Its first point, ``(2,)`` or ``(3,)`` [cm].
        end: Its last point [cm].
        points: Number of points.
    """

    start: tuple[float, ...]
    end: tuple[float, ...]
    points: int = 101


class Statistics:
    """Averages and profiles of a run.

    Args:
        grid: The grid.
        start: Time from which on the flow is averaged, None for no averages [s].
        lines: Lines by name.
    """

    def __init__(
        self, grid: MacGrid, *, start: float | None = None, lines: Mapping[str, Line] | None = None
    ) -> None:
        self.grid, self.lines = grid, dict(lines or {})
        self.averages = None if start is None else Averages(grid, start)

    def add(self, state: State) -> None:
        """Add a state to the averages. Collective."""
        if self.averages is not None:
            self.averages.add(state.t, state.u, state.p)

    def fields(self) -> dict[str, Array]:
        """The arrays of a checkpoint, ``(n0, n1, n2)`` each; they share memory with the averages."""
        if self.averages is None:
            return {}
        return {f"average_{name}": array for name, array in self.averages.fields().items()}

    def meta(self) -> dict[str, float | None]:
        """The numbers of a checkpoint."""
        return {} if self.averages is None else self.averages.meta()

    def restore(self, fields: Mapping[str, Array], meta: dict[str, float | None]) -> None:
        """Go on from what `fields` and `meta` were."""
        if self.averages is not None:
            self.averages.restore({name.removeprefix("average_"): a for name, a in fields.items()}, meta)

    def write(self, state: State, directory: Path, box: Sequence[Sequence[float]]) -> None:
        """Write the averages as a ParaView series and profiles as tables, ``profiles/NAME.csv``.

        Args:
            state: The last state.
            directory: Folder of the run.
            box: Where the cells are, as `FluidSeries` takes it.

        Note:
            Collective.
        """
        grid, averages = self.grid, self.averages
        if averages is not None and averages.time > 0.0:
            folder = directory / "paraview"
            series = AverageSeries(folder, "averages", grid.comm, grid.cells, grid.start, grid.size, box)
            series.write(state.t, averages.mean, averages.pressure, averages.kinetic_energy_of_turbulence)
        for name, line in self.lines.items():
            columns = self.profile(state, line)
            if grid.comm.rank == 0:
                folder = directory / "profiles"
                folder.mkdir(parents=True, exist_ok=True)
                with replacing(folder / f"{name}.csv") as path, path.open("w", newline="") as file:
                    writer = csv.writer(file)
                    writer.writerow(columns)
                    writer.writerows(zip(*columns.values(), strict=True))
        grid.comm.barrier()

    def profile(self, state: State, line: Line) -> dict[str, Array]:
        """Return the columns of a profile by name, the distance along the line first. Collective."""
        grid = self.grid
        at = diagnostics.line(line.start, line.end, line.points)
        columns = {"s_cm": np.linalg.norm(at - at[0], axis=1)}
        columns |= {f"{axis}_cm": at[:, d] for d, axis in enumerate("xyz"[: grid.dim])}
        u = diagnostics.sample_velocity(grid, state.u, at)
        columns |= {f"u_{axis}_cm_per_s": u[:, d] for d, axis in enumerate("xyz"[: grid.dim])}
        columns["p_dyn_per_cm2"] = diagnostics.sample_cells(grid, state.p[grid.owned], at)
        averages = self.averages
        if averages is not None and averages.time > 0.0:
            for d, axis in enumerate("xyz"[: grid.dim]):
                values = np.ascontiguousarray(averages.mean[..., d])
                columns[f"mean_u_{axis}_cm_per_s"] = diagnostics.sample_cells(grid, values, at)
            columns["mean_p_dyn_per_cm2"] = diagnostics.sample_cells(grid, averages.pressure, at)
            tke = averages.kinetic_energy_of_turbulence
            columns["tke_cm2_per_s2"] = diagnostics.sample_cells(grid, tke, at)
        return columns
