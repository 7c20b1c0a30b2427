"""A study of uncertain inputs as files: ``sample.json``, ``samples.csv``, ``sample.md`` and a picture."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi import __version__
from valvefsi.case.sample_tables import SampleStudy
from valvefsi.errors import CaseError
from valvefsi.io.folder import write_text
from valvefsi.post.columns import Units, name_of
from valvefsi.studies.members import Values
from valvefsi.studies.sampling import Sampling
from valvefsi.types import Array

DRAWN = 6
"""Outputs that are drawn."""


def check_samples(sampling: Sampling, folder: Path) -> None:
    """Refuse a folder that holds the samples of another study.

    Args:
        sampling: The samples that are to be written there.
        folder: The folder.

    Raises:
        CaseError: There are others.
    """
    path = folder / "samples.csv"
    if not path.is_file():
        return
    with path.open(encoding="utf-8", newline="") as file:
        kept = [row[3 : 3 + len(sampling.inputs.names)] for row in list(csv.reader(file))[1:]]
    try:
        old = np.array(kept, dtype=float)
    except ValueError:  # of another number of inputs, or damaged
        old = np.empty((0, 0))
    if old.shape != sampling.values.shape or not np.allclose(old, sampling.values, rtol=1e-6, atol=0.0):
        raise CaseError(
            "this folder holds other samples: --overwrite replaces them, another --out keeps them", file=path
        )


def write_samples(
    sampling: Sampling,
    outputs: Mapping[str, Array],
    failures: Mapping[int, str],
    result: Values,
    folder: Path,
) -> None:
    """Write the tables of a study with the samples themselves; one that failed or lacks a value has its row and reason.

    Args:
        sampling: The samples.
        outputs: Outputs by name, ``(num_samples,)`` each.
        failures: Why samples failed, by their number.
        result: What `valvefsi.studies.sampling.analyse` found.
        folder: Where to.
    """
    folder.mkdir(parents=True, exist_ok=True)
    inputs, text = sampling.inputs, io.StringIO()
    analysed = {row["output"]: outputs[row["output"]] for row in result["outputs"]}
    reasons = [failures.get(k) or _no_value(analysed, k) for k in range(len(sampling.values))]
    labels = [f"{name} [{unit or '-'}]" for name, unit in zip(inputs.names, inputs.units, strict=True)]
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["sample", "state", "reason", *labels, *outputs])
    for k, row in enumerate(sampling.values):
        numbers = [None if np.isnan(values[k]) else float(values[k]) for values in outputs.values()]
        state = "failed" if k in failures else "done"
        table.writerow([k, state, reasons[k], *map(float, row), *numbers])
    write_text(folder / "samples.csv", text.getvalue())
    study = sampling.study
    about = {
        "study": str(study.file),
        "case": study.case,
        "target": study.target,
        "version": __version__,
        "title": study.title,
        "changes": list(study.changes),
        "inputs": [
            {"name": name, "key": key, "unit": unit, "from": _origin(study, name)}
            for name, key, unit in zip(inputs.names, inputs.keys, inputs.units, strict=True)
        ],
    }
    members = _members(sampling, analysed, failures, reasons)
    write_text(folder / "sample.json", json.dumps(about | result | {"members": members}, indent=2) + "\n")
    write_text(folder / "sample.md", _page(study.title or Path(study.case).stem, result))


def _origin(study: SampleStudy, name: str) -> str:
    """Return where the values of an input come from, in words."""
    for one in study.input:
        if one.name == name:
            ends = {key: getattr(one, key) for key in ("mean", "std", "low", "high")}
            said = ", ".join(f"{key} {value}" for key, value in ends.items() if value is not None)
            return f"{one.distribution}: {said}"
    fits = (fit for fit in study.fit if name in (fit.name, *(f"{fit.name}.{key}" for key in fit.keys)))
    return next((f"{fit.take} of {fit.file}" for fit in fits), "not recorded")


def _no_value(outputs: Mapping[str, Array], number: int) -> str:
    """Return which outputs a sample does not have, "" for none."""
    names = [name for name, values in outputs.items() if not np.isfinite(values[number])]
    return f"no value of {', '.join(names)}" if names else ""


def _members(
    sampling: Sampling, outputs: Mapping[str, Array], failures: Mapping[int, str], reasons: Sequence[str]
) -> Values:
    """Return the samples themselves by columns: how each ended, its inputs, the outputs given."""
    count = len(sampling.values)
    return {
        "sample": list(range(count)),
        "state": ["failed" if k in failures else "done" for k in range(count)],
        "reason": list(reasons),
        "inputs": {
            name: [float(value) for value in sampling.values[:, k]]
            for k, name in enumerate(sampling.inputs.names)
        },
        "outputs": {
            name: [float(value) if np.isfinite(value) else None for value in values]
            for name, values in outputs.items()
        },
    }


def _page(title: str, result: Values) -> str:
    lines = [f"# {title}", "", *(f"- {note}" for note in result["notes"])]
    lines += [f"- FAILED: sample {k}: {why}" for k, why in result["failed"].items()]
    head = ["output", "mean", "std", "95 %", "samples", "how"]
    lines += ["", "| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    for row in result["outputs"]:
        interval = f"{row['low']:.5g} to {row['high']:.5g}" if "low" in row else "-"
        cells = [row["output"], _short(row["mean"]), _short(row["std"]), interval, str(row["count"])]
        lines.append("| " + " | ".join([*cells, row["text"]]) + " |")
    lines += ["", "| output | input | first order | 95 % | total | 95 % |", "|---|---|---|---|---|---|"]
    for row in result["outputs"]:
        for one in row["indices"]:
            cells = [row["output"], one["group"]]
            for kind in ("first", "total"):
                low, high = one[f"{kind}_interval"]
                cells += [f"{one[kind]:.3f}", f"{low:.3f} to {high:.3f}"]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _short(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def draw_samples(sampling: Sampling, outputs: Mapping[str, Array], result: Values, path: Path) -> Path | None:
    """Draw the outputs that have indices.

    Returns:
        The path, None where no output has any.
    """
    from valvefsi.post.plots.sensitivity import SensitivityPanel, sensitivity_picture

    panels = []
    for row in [row for row in result["outputs"] if row["indices"]][:DRAWN]:
        indices = row["indices"]
        strongest = max(indices, key=lambda one: one["total"])["group"]
        y = outputs[row["output"]]
        column = _strongest_input(sampling, strongest, y)
        unit = sampling.inputs.units[column]
        name = sampling.inputs.names[column]
        shown = Units().of(name_of(row["output"]))
        panels.append(
            SensitivityPanel(
                name=shown.label.removesuffix(" [-]"),
                groups=[one["group"] for one in indices],
                first=_column(indices, "first"),
                first_interval=_column(indices, "first_interval"),
                total=_column(indices, "total"),
                total_interval=_column(indices, "total_interval"),
                x=sampling.values[:, column],
                x_label=f"{name} [{unit}]" if unit else name,
                y=shown.factor * y,
                interval=(
                    shown.factor * row["low"],
                    shown.factor * row["median"],
                    shown.factor * row["high"],
                ),
                text=_told(row),
            )
        )
    if not panels:
        return None
    failed = len(result["failed"])
    caption = f"{result['samples']} samples" + (f", {failed} failed and left out" if failed else "")
    return sensitivity_picture(
        path, panels, title=sampling.study.title or "uncertain inputs", caption=caption
    )


def _told(row: Mapping[str, Any]) -> str:
    """Return how the indices of an output were found, short."""
    if "degree" not in row:
        return str(row["text"])
    missed = 100 * row["surrogate_relative_error"]
    return f"chaos of degree {row['degree']}, misses {missed:.2g} % of the variance"


def _strongest_input(sampling: Sampling, group: str, y: Array) -> int:
    """Return the number of the input of a group that goes most with an output."""
    names = next(one.names for one in sampling.inputs.groups if one.name == group)
    columns = [sampling.inputs.names.index(name) for name in names]
    done = np.isfinite(y)
    goes = [abs(np.corrcoef(sampling.values[done, k], y[done])[0, 1]) for k in columns]
    return columns[int(np.argmax(goes))]


def _column(rows: Sequence[Mapping[str, Any]], name: str) -> Array:
    return np.array([row[name] for row in rows], dtype=float)
