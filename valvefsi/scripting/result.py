"""What a run left in its folder, for Python and notebooks: history, summary, pictures, fields."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from valvefsi.case.overrides import nearest
from valvefsi.case.reading import nearest_file
from valvefsi.errors import CaseError, SurroundingsError
from valvefsi.io.grid_files import nearest_time
from valvefsi.io.history import read_history
from valvefsi.post.columns import COLUMNS, ending, units_of_run
from valvefsi.post.plots.base import Series, ShownFigure, history_figure, typeset
from valvefsi.run.pictures import usual_panels
from valvefsi.runtime.installing import how_to_add, pip_command

if TYPE_CHECKING:
    from valvefsi.types import Array


class History(Mapping[str, "Array"]):
    """The columns of ``history.csv`` by name, each a numpy array over the rows, ``(n,)``.

    Args:
        columns: Values by name; a name ends with its unit, as in ``t_s`` and ``p_z_lower_mmHg``.

    Attributes:
        units: Unit of each column by its name, "" of a pure number.
    """

    def __init__(self, columns: Mapping[str, Array]) -> None:
        self._columns = dict(columns)
        ends = {name: ending(name) for name in columns}
        self.units = {name: COLUMNS[end][0] if end else "" for name, end in ends.items()}

    def __getitem__(self, name: str) -> Array:
        """Return a column.

        Raises:
            KeyError: There is none of this name; names the nearest.
        """
        if name not in self._columns:
            raise KeyError(f"no such column {name!r}{nearest(name, list(self._columns))}")
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        rows = len(next(iter(self._columns.values()), ()))
        return f"History of {rows} rows: {', '.join(self._columns)}"

    def to_pandas(self) -> Any:
        """Return the history as a ``pandas.DataFrame``, its units in ``attrs["units"]``.

        Raises:
            SurroundingsError: pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise SurroundingsError(f"pandas is not installed: {pip_command()} install pandas") from None
        frame = pandas.DataFrame(self._columns)
        frame.attrs["units"] = self.units
        return frame


class Result:
    """A run in its folder, finished or on its way: what was there when it was first asked for.

    Args:
        folder: The folder.

    Attributes:
        folder: The folder.

    Raises:
        CaseError: The folder holds no run.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not (self.folder / "history.csv").is_file():
            there = self.folder.is_dir()
            what = "there is no run here, history.csv is missing" if there else "no such folder"
            raise CaseError(f"{what}{'' if there else nearest_file(self.folder, '', 0.5)}", file=self.folder)

    @cached_property
    def history(self) -> History:
        """The columns of the history by name."""
        read = read_history(self.folder / "history.csv")
        return History({name: np.array(values) for name, values in read.items()})

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The tables of ``summary.json``: last row, timing, numbers of a valve; empty of a run that has not ended."""
        path = self.folder / "summary.json"
        try:
            summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError) as error:
            raise CaseError(f"cannot be read: {error}", file=path) from None
        return summary

    @property
    def series(self) -> list[str]:
        """Names of what the run has written fields of: "fluid", its solids."""
        return sorted(path.stem for path in (self.folder / "paraview").glob("*.pvd"))

    def plot(self, *columns: str, title: str = "") -> ShownFigure:
        """Draw the history.

        Args:
            columns: Columns to draw, those with the same unit in one panel; those of ``histories.png`` when left out.
            title: Heading.

        Returns:
            A matplotlib figure, which a notebook shows and ``savefig`` writes.

        Raises:
            CaseError: There is no such column.
        """
        for name in columns:
            if name not in self.history:
                reason = f"no such column{nearest(name, list(self.history))}"
                raise CaseError(reason, file=self.folder / "history.csv", key="columns", value=name)
        panels = self._panels(columns) if columns else usual_panels(self.history, units_of_run(self.folder))
        return history_figure(self.history["t_s"], panels, title=title or self.folder.resolve().name)

    def _panels(self, columns: tuple[str, ...] | list[str]) -> list[Series]:
        """Return a panel for each unit."""
        units = units_of_run(self.folder)
        by_unit: dict[str, list[str]] = {}
        for name in columns:
            by_unit.setdefault(units.of(name).unit, []).append(name)
        panels = []
        for unit, names in by_unit.items():
            label = f"[{unit or '-'}]" if len(names) > 1 else units.of(names[0]).label
            lines = {units.of(name).words: units.of(name).factor * self.history[name] for name in names}
            panels.append(Series(label=typeset(label), lines=lines))
        return panels

    def fields(self, t: float | None = None, of: str = "fluid") -> Any:
        """Return the fields that the run has written nearest to a time.

        Args:
            t: The time; the last one when left out [s].
            of: "fluid" (velocity [cm/s] and pressure [dyn/cm^2] in the cells), or the name of a solid (its deformed
                mesh with displacement [cm] and J).

        Returns:
            A pyvista mesh, lengths in cm; ``mesh.field_data["t_s"]`` holds its time.

        Raises:
            CaseError: The run has written no such fields.
            SurroundingsError: pyvista is not installed.
        """
        if of not in self.series:
            reason = (
                f"no such fields{nearest(of, self.series)}" if self.series else "no fields; see output.frames"
            )
            raise CaseError(reason, file=self.folder, key="of", value=of)
        found, path = nearest_time(self.folder / "paraview" / f"{of}.pvd", t)
        try:
            import pyvista
        except ImportError:
            raise SurroundingsError(f"pyvista is not installed: {how_to_add('plot')}") from None
        mesh = pyvista.read(path)
        mesh.field_data["t_s"] = [found]
        return mesh

    def __repr__(self) -> str:
        t = self.history["t_s"]
        until = f"{len(t)} rows to t = {t[-1]:.6g} s" if len(t) else "no rows yet"
        return f"run in {self.folder}: {until}; history, summary, plot(), fields(t)"
