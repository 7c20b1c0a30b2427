"""Samples of uncertain inputs, and what the outputs of a model at them show: intervals and Sobol indices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from valvefsi.case.overrides import nearest
from valvefsi.case.sample_tables import SampleStudy
from valvefsi.errors import CaseError
from valvefsi.studies.members import Values
from valvefsi.studies.polynomial_chaos import Chaos, fit_chaos, latin_hypercube
from valvefsi.studies.sample_inputs import Inputs, inputs_of
from valvefsi.studies.sobol_design import (
    Indices,
    independent_points,
    saltelli_design,
    sobol_indices,
    whole_blocks,
)
from valvefsi.types import Array

PERCENTILES = (2.5, 50.0, 97.5)
DRAWS = 20_000
"""Points at which a surrogate is asked for the distribution of an output."""
SAME = 1e-9
"""Part of its size by which an output must vary."""
POOR = 0.1
"""Part of the variance that a surrogate may miss before it is said that it must not be trusted."""
LEAST_BLOCKS = 8
"""Whole blocks of Saltelli's design below which there are no indices."""
MOST = 8
"""Outputs that are analysed where none are named."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampling:
    """The samples of a study.

    Attributes:
        study: The study.
        inputs: Its inputs.
        u: Points of the unit cube, ``(num_samples, num_variates)``.
        values: The inputs there, ``(num_samples, num_inputs)``.
    """

    study: SampleStudy
    inputs: Inputs
    u: Array
    values: Array

    def overrides(self, number: int) -> tuple[str, ...]:
        """Return a sample as texts ``key=value`` for a run."""
        return tuple(
            f"{key}={float(value)!r} {unit}".rstrip()
            for key, unit, value in zip(self.inputs.keys, self.inputs.units, self.values[number], strict=True)
        )


def make_sampling(study: SampleStudy) -> Sampling:
    """Return the samples of a study.

    Raises:
        CaseError: A fit cannot be used, or the design not with the inputs.
        SurroundingsError: The design needs a library that is missing.
    """
    inputs, design = inputs_of(study), study.design
    if design.method == "sobol":
        u = saltelli_design(inputs.of_variates, design.size, design.seed)
        return Sampling(study=study, inputs=inputs, u=u, values=inputs.values(u))
    if "none" in inputs.germs:
        message = "no polynomial follows rows of a table of samples: take covariance or profile, or the design sobol"
        raise CaseError(message, file=study.file, key="design.method", value=design.method)
    need = int(np.ceil(1.5 * (len(inputs.germs) + 1)))
    if design.size < need:
        message = f"{len(inputs.germs)} variates need {need} runs or more for a polynomial of first degree"
        raise CaseError(message, file=study.file, key="design.size", value=design.size)
    u = latin_hypercube(len(inputs.germs), design.size, design.seed)
    return Sampling(study=study, inputs=inputs, u=u, values=inputs.values(u))


def analyse(sampling: Sampling, outputs: Mapping[str, Array], failures: Mapping[int, str]) -> Values:
    """Return what ``sample.json`` holds of the outputs.

    Args:
        sampling: The samples.
        outputs: Outputs by name, NaN where a sample has none, ``(num_samples,)`` each.
        failures: Why samples failed, by their number.
    """
    chosen, missing = chosen_outputs(sampling.study.outputs, outputs)
    count, inputs = len(sampling.u), sampling.inputs
    notes = [note for group in inputs.groups for note in group.notes]
    notes += [f"no sample has the output {name}" for name in missing]
    if failures:
        notes.append(
            f"{len(failures)} of {count} samples FAILED and are in no number: what is below holds for the others only"
        )
    notes += _without_value({name: outputs[name] for name in chosen}, count - len(failures))
    design = sampling.study.design
    return {
        "samples": count,
        "failed": {str(k): why for k, why in sorted(failures.items())},
        "design": {"method": design.method, "size": design.size, "seed": design.seed},
        "groups": {group.name: list(group.names) for group in inputs.groups},
        "notes": notes,
        "outputs": [{"output": name, **_of_output(sampling, outputs[name])} for name in chosen],
    }


def _without_value(outputs: Mapping[str, Array], ended: int) -> list[str]:
    """Return which outputs samples that have not failed do not have."""
    left = {name: ended - int(np.isfinite(values).sum()) for name, values in outputs.items()}
    return [
        f"NO VALUE of {name} in {gone} of {ended} samples that have not failed: its statistics hold for the others only"
        for name, gone in left.items()
        if gone > 0
    ]


def chosen_outputs(wanted: Sequence[str], outputs: Mapping[str, Array]) -> tuple[list[str], list[str]]:
    """Return which outputs are analysed, and which of the wanted ones no sample has.

    Args:
        wanted: Names, or ends of them after a point; empty for the first few that vary.
        outputs: Outputs by name.
    """
    if not wanted:
        return [name for name, values in outputs.items() if _varies(values)][:MOST], []
    found = {name: [full for full in outputs if full == name or full.endswith(f".{name}")] for name in wanted}
    chosen = [matches[-1] for matches in found.values() if matches]
    return chosen, [f"{name}{nearest(name, list(outputs))}" for name, matches in found.items() if not matches]


def _varies(values: Array) -> bool:
    known = values[np.isfinite(values)]
    return len(known) > 1 and bool(np.ptp(known) > SAME * np.abs(known).max())


def _of_output(sampling: Sampling, values: Array) -> Values:
    """Return distribution and indices of an output, by the design that its samples are of."""
    done = np.isfinite(values)
    if not _varies(values):
        known = values[done]
        value = float(known[0]) if len(known) else None
        return {
            "count": int(done.sum()),
            "mean": value,
            "std": 0.0,
            "text": "it does not vary" if len(known) else "no sample has a value",
            "indices": [],
        }
    if sampling.study.design.method == "sobol":
        return _by_blocks(sampling, values, done)
    return _by_chaos(sampling, values, done)


def _by_blocks(sampling: Sampling, values: Array, done: Any) -> Values:
    """Return what the runs of Saltelli's design show themselves."""
    of_variates, seed = sampling.inputs.of_variates, sampling.study.design.seed
    sample = values[independent_points(of_variates, len(values)) & done]
    found: Values = {"count": len(sample), **_distribution(sample)}
    whole = whole_blocks(of_variates, done)
    blocks = int(whole.sum()) // (len(set(of_variates)) + 2)
    if blocks < LEAST_BLOCKS:
        return found | {"text": f"{blocks} whole blocks of runs are too few for indices", "indices": []}
    indices = sobol_indices(of_variates, values[whole], seed)
    return found | {
        "text": f"Saltelli's design, indices of {int(whole.sum())} runs in {blocks} blocks",
        "indices": _rows(indices),
    }


def _by_chaos(sampling: Sampling, values: Array, done: Any) -> Values:
    """Return what a polynomial chaos of few runs shows, and its error."""
    inputs, design = sampling.inputs, sampling.study.design
    try:
        chaos = fit_chaos(sampling.u[done], values[done], inputs.germs, design.degree)
    except ValueError as error:
        return {"count": int(done.sum()), **_distribution(values[done]), "text": str(error), "indices": []}
    points = np.random.default_rng(design.seed + 1).random((DRAWS, len(inputs.germs)))
    poor = chaos.relative_error > POOR
    text = (
        f"polynomial chaos of degree {chaos.degree}, {int(done.sum())} runs; at left-out runs it misses "
        f"{100 * chaos.relative_error:.2g} % of the variance"
        + (": DO NOT TRUST these indices" if poor else "")
    )
    return {
        "count": int(done.sum()),
        **_distribution(chaos(points)),
        "mean": chaos.mean,
        "std": float(np.sqrt(chaos.variance)),
        "of_the_runs": _distribution(values[done]),
        "degree": chaos.degree,
        "surrogate_error": chaos.error,
        "surrogate_relative_error": chaos.relative_error,
        "text": text,
        "indices": _rows(_indices(chaos, inputs.of_variates)),
    }


def _indices(chaos: Chaos, of_variates: Sequence[str]) -> Indices:
    (first, about_first), (total, about_total) = (
        chaos.indices(of_variates, kind) for kind in ("first", "total")
    )
    return Indices(
        groups=tuple(dict.fromkeys(of_variates)),
        first=first,
        total=total,
        first_interval=about_first,
        total_interval=about_total,
    )


def _distribution(sample: Array) -> Values:
    """Return mean, deviation, median and 95 % interval of a sample."""
    low, median, high = np.percentile(sample, PERCENTILES)
    return {
        "mean": float(np.mean(sample)),
        "std": float(np.std(sample, ddof=1)),
        "median": float(median),
        "low": float(low),
        "high": float(high),
    }


def _rows(indices: Indices) -> list[Values]:
    return [
        {
            "group": group,
            "first": float(indices.first[k]),
            "first_interval": [float(end) for end in indices.first_interval[k]],
            "total": float(indices.total[k]),
            "total_interval": [float(end) for end in indices.total_interval[k]],
        }
        for k, group in enumerate(indices.groups)
    ]
