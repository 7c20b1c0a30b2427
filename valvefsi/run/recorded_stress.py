"""Stress and strain of the solids that a run leaves behind, written with its frames: ParaView series, peaks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from valvefsi.io.history import History, read_history
from valvefsi.io.paraview import BodySeries
from valvefsi.solid.peaks import AT_POINTS, Peaks, columns_of, parts_of

if TYPE_CHECKING:
    from valvefsi.fsi import Model, State
    from valvefsi.io.series import Frames
    from valvefsi.run.recording import Output
    from valvefsi.solid.stress import Stress
    from valvefsi.solid.structure import Structure
    from valvefsi.types import Array

KILOPASCAL = 1.0e4
"""[dyn/cm^2]"""
PEAKS = "leaflets.csv"


class StressRecorder:
    """Writes the stresses that were asked for, and the peaks in each leaflet of a valve.

    Args:
        model: The model.
        output: What to write, see `valvefsi.run.recording.Output`.
        resume: State that the run goes on from, None for a new run.
        frames: Times of its frames so far [s].

    Note:
        Collective.
    """

    def __init__(self, model: Model, output: Output, resume: State | None, frames: Frames) -> None:
        self.model, self.asked = model, output.stress
        self.series: list[tuple[int, BodySeries, Stress]] = []
        self.peaks: Peaks | None = None
        folder, comm = output.directory / "paraview", model.grid.comm
        kept = frames if resume else None
        if output.stress:
            for number, body in enumerate(model.bodies):
                if body.solid is not None:
                    series = BodySeries(folder, f"{body.name}_stress", comm, frames=kept)
                    self.series.append((number, series, _stress(body.solid)))
        if output.orifice is not None:
            self._open_peaks(output, output.orifice.body, resume)

    def _open_peaks(self, output: Output, valve: int, resume: State | None) -> None:
        self.valve = valve
        solid = self._solid(valve)
        parts = parts_of(solid.mesh)
        stress = _stress(solid, quadrature_degree=solid.discretisation.force_degree)
        same = [s for number, _, s in self.series if number == valve and s.degree == stress.degree]
        self.peaks = Peaks(same[0] if same else stress, parts)
        columns = ["step", "t_s", *map(_named, columns_of(list(parts)))]
        step = resume.step if resume else None
        self.table = History(output.directory / PEAKS, columns, self.model.grid.comm, step)

    def _solid(self, number: int) -> Structure:
        solid = self.model.bodies[number].solid
        if solid is None:
            raise ValueError(f"{self.model.bodies[number].name} has no stress")
        return solid

    def write(self, state: State) -> None:
        """Write the stress of a state. Collective."""
        shared: dict[str, Array] | None = None
        for number, series, stress in self.series:
            self._solid(number).jacobian(state.bodies[number]["chi"])  # puts it where it is now
            asked = [q for q in self.asked if q != "fibre_stretch" or stress.has_fibre]
            together = self.peaks is not None and stress is self.peaks.stress
            values = stress.at_points(*stress.projected(*asked).union(AT_POINTS if together else ()))
            series.write(state.t, stress.gather(*asked, values=values))
            shared = values if together else shared
        if self.peaks is not None:
            self._solid(self.valve).jacobian(state.bodies[self.valve]["chi"])
            peaks = self.peaks.now(shared)
            row = {_named(name): value / _unit(name) for name, value in peaks.items()}
            self.table.append({"step": state.step, "t_s": state.t} | row)


def _stress(solid: Structure, **options: Any) -> Stress:
    from valvefsi.solid.structure_stress import stress_of_structure  # compiles a form for each solid

    fibres = solid.mesh.fibres
    options |= {"fibres": fibres, "fibre": next(iter(fibres))} if fibres else {}
    return stress_of_structure(solid, **options)


def _unit(name: str) -> float:
    return KILOPASCAL if "von_mises" in name else 1.0


def _named(name: str) -> str:
    return f"{name}_kPa" if "von_mises" in name else name


def leaflet_peaks(folder: Path) -> dict[str, dict[str, dict[str, float]]]:
    """Return the largest values of a run's frames and their times, by leaflet and column; empty without any."""
    path = Path(folder) / PEAKS
    if not path.is_file():
        return {}
    table = read_history(path)
    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, column in table.items():
        if name in ("step", "t_s") or not column:
            continue
        measure = next(m for m in ("green_strain", "von_mises") if f"_{m}_" in name)
        part, rest = name.split(f"_{measure}_", 1)
        k = max(range(len(column)), key=column.__getitem__)
        found.setdefault(part, {})[f"{measure}_{rest}"] = {"value": column[k], "t_s": table["t_s"][k]}
    return found
