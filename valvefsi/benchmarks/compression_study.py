"""Grid study of the compressed block (Lee2020, E.1): Figure S4 c and d, stabilised and not.

Every run is the one that `compression` makes of the same options; grid and mesh are refined together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpi4py import MPI

from valvefsi.benchmarks import compression
from valvefsi.benchmarks.immersed import Numerics, Problem, late_mean, late_size
from valvefsi.benchmarks.immersed_study import Setup, Study, run_study
from valvefsi.case import Case
from valvefsi.case.build import build
from valvefsi.case.overrides import split_override
from valvefsi.errors import CaseError
from valvefsi.run.simulation import Progress, Simulation

GRID = 16
"""Cells along the box, and elements along the block, of the coarsest grid unless given."""
BOX, LENGTH = 40.0, 20.0
"""Edge of the box and length of the block [cm]."""


@dataclass(frozen=True, kw_only=True)
class Series:
    """What is run.

    Attributes:
        elements: Elements along the block's 20 cm with the coarsest grid; None for as many as cells along the box.
        grid: Cells along each edge of the box, the coarsest grid; None for `GRID`.
        refine: Number of finer grids, each twice as fine as the one before.
        kernel: Name of the regularised delta function.
        nu_stab: Numerical Poisson ratio of the stabilised runs; None for runs without stabilisation only.
        overrides: ``key=value``, a name in `compression.PARAMETERS` or a dotted key of the case.
    """

    elements: int | None = None
    grid: int | None = None
    refine: int = 2
    kernel: str = "bspline3"
    nu_stab: float | None = 0.4
    overrides: Sequence[str] = ()


def run(
    series: Series,
    *,
    out: Path,
    comm: MPI.Comm = MPI.COMM_WORLD,
    progress: Callable[[str], Progress | None] | None = None,
) -> dict[str, object]:
    """Run the study; see `immersed_study.run_study`.

    Raises:
        CaseError: An override cannot be used, or the ends of the load would fall between nodes.

    Note:
        Collective.
    """
    grid = series.grid or GRID
    elements = series.elements or grid
    if elements % 4:
        message = "expected a multiple of 4, so that the ends of the load are on nodes"
        raise CaseError(message, key="--elements", value=elements)
    ratio = LENGTH / elements * grid / BOX
    numerics = Numerics(grid=grid, ratio=ratio, kernel=series.kernel, nu_stab=series.nu_stab)
    setup = Setup(
        numerics=numerics,
        stabilised="both" if series.nu_stab is not None else "off",
        refine=series.refine,
        overrides=[text for text in series.overrides if "." not in split_override(text)[0]],
    )
    return run_study(study(series.overrides), setup, out=out, comm=comm, progress=progress)


def study(overrides: Sequence[str]) -> Study:
    """Return the study; the dotted keys of a case among the overrides become parameters that have one value."""
    parameters = dict(compression.PARAMETERS)
    for text in overrides:
        key = split_override(text)[0]
        if "." in key:
            value = text.partition("=")[2].strip()
            parameters[key] = (value, (value,))
    if "damping" not in {split_override(text)[0] for text in overrides}:  # it follows c1, as in `compression`
        parameters.pop("damping")
    return Study(
        problem=PROBLEM,
        parameters=parameters,
        main=("u_y_top_centre_cm", "u_y of the top centre", "cm"),
        change=("block_area_change_percent", "area change"),
        reference=lambda values, numerics, comm: (
            mixed(values, numerics, comm),
            "mixed u-p statics, finest mesh",
        ),
        column="u_y_top_centre_cm",
        title="Compressed block (E.1), immersed",
        more=elsewhere,
        mixed=mixed,
    )


def elements_of(numerics: Numerics) -> int:
    """Elements along the block's 20 cm."""
    return round(LENGTH * numerics.grid / (numerics.ratio * BOX))


def simulation(numerics: Numerics, values: Mapping[str, object], folder: Path, comm: MPI.Comm) -> Simulation:
    """Return the simulation of one block (collective)."""
    return build(case_of(numerics, values), folder, comm)


def case_of(numerics: Numerics, values: Mapping[str, object]) -> Case:
    """Return the case of one block."""
    setup = compression.Setup(
        elements=elements_of(numerics),
        grid=numerics.grid,
        kernel=numerics.kernel,
        nu_stab=numerics.nu_stab,
        overrides=[f"{key}={value}" for key, value in values.items()],
    )
    return compression.compression_case(setup)


def mixed(values: Mapping[str, object], numerics: Numerics, comm: MPI.Comm) -> float:
    """Return the displacement of the same block, exactly incompressible, on the same mesh (collective)."""
    case = case_of(numerics, values)
    return compression.static_reference(build(case, Path(), comm), case)["u_y_top_centre_cm"]


def elsewhere(values: Mapping[str, object]) -> list[tuple[float | str, str]]:
    """Return the converged value, where the parameters are the published ones."""
    same = all(values[key] == compression.PARAMETERS[key][0] for key in ("traction", "c1"))
    known = compression.LITERATURE["u_y_top_centre_cm"]
    return [(known, "mixed elements, converged")] if same else []


def quantities(history: Mapping[str, np.ndarray], values: Mapping[str, object]) -> dict[str, float]:
    """Return the means over the end of a run, those of the single run, and the size of the change of area."""
    late = history["t_s"] >= (1.0 - compression.AVERAGED) * history["t_s"][-1]
    return {
        "u_y_top_centre_cm": late_mean(history, "u_y_top_centre_cm"),
        "change_percent": late_size(history, "block_area_change_percent"),
        "largest_change_percent": float(np.abs(history["block_area_change_percent"]).max()),
        "area_change_percent": late_mean(history, "block_area_change_percent"),
        "J_min": float(history["block_J_min"][late].min()),
        "J_max": float(history["block_J_max"][late].max()),
    }


PROBLEM = Problem(name="compression", simulation=simulation, quantities=quantities)
