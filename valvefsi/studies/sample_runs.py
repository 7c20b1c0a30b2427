"""Samples as runs: the members of a study, an array of jobs, what the runs left."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from valvefsi.io.folder import write_text
from valvefsi.studies.circuit_samples import Sampled
from valvefsi.studies.grid_numbers import numbers_of
from valvefsi.studies.members import Member, Outcome
from valvefsi.studies.sampling import Sampling
from valvefsi.studies.sweep_picture import headlines

SCRIPT = "members.sh"


def sample_members(sampling: Sampling) -> list[Member]:
    """Return a member for every sample, ``s0000`` and so on."""
    changes = sampling.study.changes
    return [Member(f"s{k:04d}", (*changes, *sampling.overrides(k))) for k in range(len(sampling.values))]


def outputs_of_runs(outcomes: Sequence[Outcome]) -> Sampled:
    """Return the numbers of the runs: those worth a picture by their own name, then all by their path."""
    failures = {k: outcome.message for k, outcome in enumerate(outcomes) if outcome.state == "failed"}
    rows: list[Mapping[str, float]] = []
    for outcome in outcomes:
        summary = outcome.summary
        shown = {name: float(value) for name, value in headlines(summary).items() if isinstance(value, float)}
        rows.append({**shown, **numbers_of(summary)})
    names = dict.fromkeys(name for row in rows for name in row)
    outputs = {name: np.array([row.get(name, np.nan) for row in rows], dtype=float) for name in names}
    return Sampled(outputs=outputs, failures=failures)


def write_job_array(
    study: Path, folder: Path, count: int, at_once: int | None, options: Sequence[str]
) -> Path:
    """Write a script for ``sbatch`` that runs every sample as a task of one core.

    Args:
        study: The study's file.
        folder: Folder of the study.
        count: Number of samples.
        at_once: How many tasks may run at once, None for as many as there is room for.
        options: Further options of ``valvefsi sample``.

    Returns:
        The script.
    """
    limit = "" if at_once is None else f"%{at_once}"
    words = [sys.executable, "-m", "valvefsi", "sample", str(study.resolve()), "--out", str(folder.resolve())]
    lines = [
        "#!/bin/sh",
        f"#SBATCH --job-name={study.stem}",
        f"#SBATCH --array=0-{count - 1}{limit}",
        "#SBATCH --ntasks=1",
        "#SBATCH --cpus-per-task=1",
        f"#SBATCH --output={folder.resolve()}/array-%a.log",
        "#SBATCH --signal=B:TERM@120",
        "# Each task runs one sample, or goes on with it from its checkpoint when the script is submitted again.",
        "# Time and memory are the cluster's: add --time, --mem, --partition here or to sbatch.",
        "export OMP_NUM_THREADS=1",
        f'exec {shlex.join([*words, *options])} --member "$SLURM_ARRAY_TASK_ID"',
    ]
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / SCRIPT, "\n".join(lines) + "\n")
    (folder / SCRIPT).chmod(0o755)
    return folder / SCRIPT
