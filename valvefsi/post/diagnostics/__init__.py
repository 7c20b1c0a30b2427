"""Numbers and fields read off a state: energy, dissipation, vorticity, flow, mean pressure, averages, profiles."""

from valvefsi.post.diagnostics.averages import Averages
from valvefsi.post.diagnostics.control_volume import ControlVolume
from valvefsi.post.diagnostics.gradients import (
    dissipation,
    enstrophy,
    q_criterion,
    velocity_gradient,
    vorticity,
)
from valvefsi.post.diagnostics.lines import line, sample_cells, sample_velocity
from valvefsi.post.diagnostics.projected_area import projected_area
from valvefsi.post.diagnostics.sections import Section, flow, mean_pressure
from valvefsi.post.diagnostics.speeds import (
    cell_velocity,
    fastest_place,
    kinetic_energy,
    local_courant_rate,
    reynolds_number,
)

__all__ = [
    "Averages",
    "ControlVolume",
    "Section",
    "cell_velocity",
    "dissipation",
    "enstrophy",
    "fastest_place",
    "flow",
    "kinetic_energy",
    "line",
    "local_courant_rate",
    "mean_pressure",
    "projected_area",
    "q_criterion",
    "reynolds_number",
    "sample_cells",
    "sample_velocity",
    "velocity_gradient",
    "vorticity",
]
