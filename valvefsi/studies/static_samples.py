"""A solid of a case in static equilibrium at every sample of its inputs, such as a leaflet that is shut."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from valvefsi.case.models import Case
from valvefsi.case.reading import load_case
from valvefsi.case.statics import changed_model, solve_solid
from valvefsi.case.statics_tables import StaticsModel
from valvefsi.errors import CaseError, ConvergenceError
from valvefsi.studies.circuit_samples import Sampled
from valvefsi.studies.members import inputs_of
from valvefsi.studies.sampling import Sampling

ANSWERS = "answers.jsonl"
"""What samples have answered, a line each, in the order in which they ended."""
OWN = "statics."
"""What the keys of the study's own table begin with."""
Notify = Callable[[int, int, int], None]
"""Told how many samples are done and how many of them have failed, and how many there are."""


@dataclass(frozen=True, kw_only=True)
class StaticSample:
    """A sample that is solved.

    Attributes:
        number: Its number.
        case: Its case.
        model: What is in equilibrium.
    """

    number: int
    case: Case
    model: StaticsModel

    @property
    def mark(self) -> str:
        """What its answer is known by: a hash of all that it is made of."""
        text = json.dumps([inputs_of(self.case), self.model.model_dump(mode="json")], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def static_samples(sampling: Sampling, *, trust: bool = False) -> list[StaticSample]:
    """Return the samples of a study with ``target = "statics"``.

    Raises:
        CaseError: A sample's value cannot be used: says which sample.
    """
    study, found = sampling.study, []
    assert study.statics is not None  # or the study was refused
    for number in range(len(sampling.values)):
        texts = sampling.overrides(number)
        own = dict(text.removeprefix(OWN).split("=", 1) for text in texts if text.startswith(OWN))
        others = [text for text in texts if not text.startswith(OWN)]
        try:
            case = load_case(study.case, [*study.changes, *others], trust=trust)
            model = changed_model(study.statics, own, study.file)
        except CaseError as error:
            place = f"{error.file}, sample {number}"
            raise CaseError(error.reason, file=place, key=error.key, value=error.value) from None
        found.append(StaticSample(number=number, case=case, model=model))
    return found


def run_statics(
    samples: Sequence[StaticSample],
    folder: Path,
    *,
    jobs: int = 1,
    resume: bool = False,
    overwrite: bool = False,
    notify: Notify = lambda done, failed, total: None,
) -> Sampled:
    """Solve all samples; what has answered is kept in the folder at once.

    Args:
        samples: The samples.
        folder: Folder of the study.
        jobs: Samples that are solved at the same time, each in a process of its own where there are several.
        resume: Whether answers in the folder count, as far as they are of these very samples.
        overwrite: Whether they are thrown away.
        notify: Told how far it is.

    Raises:
        CaseError: The folder holds answers, and neither was asked for.
    """
    path = folder / ANSWERS
    if path.exists() and not resume and not overwrite:
        raise CaseError("this folder holds samples: --resume goes on, --overwrite solves anew", file=folder)
    folder.mkdir(parents=True, exist_ok=True)
    if overwrite:
        path.unlink(missing_ok=True)
    known = _answers(path)
    marks = {sample.number: sample.mark for sample in samples}
    found = {number: known[mark] for number, mark in marks.items() if mark in known}
    waiting = [sample for sample in samples if sample.number not in found]
    with path.open("a", encoding="utf-8") as file:
        notify(len(found), _failed(found), len(samples))
        for number, answer in _solved(waiting, jobs):
            found[number] = answer
            file.write(json.dumps({"mark": marks[number], **answer}) + "\n")
            file.flush()
            notify(len(found), _failed(found), len(samples))
    return _sampled([found[sample.number] for sample in samples])


def _solved(samples: Sequence[StaticSample], jobs: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Give the answers of samples as they come."""
    if jobs == 1:
        for sample in samples:
            yield sample.number, answer(sample)
        return
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        running = {pool.submit(answer, sample): sample.number for sample in samples}
        for done in as_completed(running):
            yield running[done], done.result()


def answer(sample: StaticSample) -> dict[str, Any]:
    """Return the outputs of a sample, or why there are none."""
    try:
        return {"outputs": solve_solid(sample.case, sample.model).numbers(), "failed": ""}
    except (CaseError, ConvergenceError) as error:
        return {"outputs": {}, "failed": str(error)}


def _answers(path: Path) -> dict[str, dict[str, Any]]:
    """Return the answers in a file by their marks; a line that was not written to its end is none."""
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            read = json.loads(line)
        except ValueError:
            continue
        found[read.pop("mark")] = read
    return found


def _failed(found: dict[int, dict[str, Any]]) -> int:
    return sum(bool(one["failed"]) for one in found.values())


def _sampled(answers: Sequence[dict[str, Any]]) -> Sampled:
    names = dict.fromkeys(name for one in answers for name in one["outputs"])
    return Sampled(
        outputs={name: np.array([one["outputs"].get(name, np.nan) for one in answers]) for name in names},
        failures={number: one["failed"] for number, one in enumerate(answers) if one["failed"]},
    )
