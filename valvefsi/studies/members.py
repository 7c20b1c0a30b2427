"""The members of a study: which case each runs, what its folder holds, whether that may be gone on with.

The folder of a member is that of an ordinary run, with two files more: ``member.json``, written before the run starts
(overrides, every value of its case) and again when it has ended (how), and ``run.log``, what the run printed.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from mpi4py import MPI

from valvefsi.case.models import Case
from valvefsi.case.reading import load_case
from valvefsi.case.resuming import FREE
from valvefsi.case.values import values_by_path
from valvefsi.errors import CaseError
from valvefsi.io.checkpoint import list_checkpoints, newest_meta
from valvefsi.io.folder import write_text
from valvefsi.run.schedule import check_end
from valvefsi.types import Scalar

RECORD, LOG, SUMMARY = "member.json", "run.log", "summary.json"
Values = dict[str, Any]
Standing = Literal["new", "begun", "done"]
"""What a folder holds of a member: nothing to go on from, a checkpoint, the whole run."""


@dataclass(frozen=True)
class Member:
    """One run of a study.

    Attributes:
        name: Name of its folder, which is all that tells it from the other members.
        overrides: What it changes in the case, texts ``a.b=value``.
        ranks: Ranks that it runs on.
    """

    name: str
    overrides: tuple[str, ...] = ()
    ranks: int = 1

    def __post_init__(self) -> None:
        """Check the name."""
        if self.name != Path(self.name).name or self.name in ("", ".", ".."):
            raise ValueError(f"name: expected the name of a folder, found {self.name!r}")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How a member ended.

    Attributes:
        member: The member.
        folder: Its folder.
        state: ``"done"``; ``"kept"``, done before with the same inputs; ``"failed"``.
        message: Why it failed.
        wall_s: Wall-clock time that it took here [s].
    """

    member: Member
    folder: Path
    state: Literal["done", "kept", "failed"]
    message: str = ""
    wall_s: float = 0.0

    @property
    def log(self) -> Path:
        """What it printed."""
        return self.folder / LOG

    @property
    def summary(self) -> Values:
        """Its ``summary.json``, empty where it failed."""
        return {} if self.state == "failed" else read_json(self.folder / SUMMARY)


def read_cases(case: Path, members: Sequence[Member], *, trust: bool = False) -> dict[str, Case]:
    """Return the case of every member by its name, each checked.

    Args:
        case: The case file.
        members: The members.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: Two members have one name, or the case of one is wrong: says which, key and value.
    """
    cases: dict[str, Case] = {}
    for member in members:
        if member.name in cases:
            raise CaseError("two members have this name", file=case, key="member", value=member.name)
        try:
            cases[member.name] = load_case(case, member.overrides, trust=trust)
        except CaseError as error:
            place = f"member {member.name}"
            place = place if error.file == "--set" else f"{error.file}, {place}"
            raise CaseError(error.reason, file=place, key=error.key, value=error.value) from None
    return cases


def inputs_of(case: Case) -> Values:
    """Return every value of a case by its path, files by what they hold, as they are read back from JSON."""
    values: Values = json.loads(json.dumps(values_by_path(case)))
    return values


def read_json(path: Path) -> Values:
    """Return what a JSON file holds, empty where there is none or it is damaged."""
    with contextlib.suppress(OSError, ValueError):
        found = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return found
    return {}


def write_record(folder: Path, member: Member, inputs: Mapping[str, Any], **how: Scalar) -> None:
    """Write ``member.json``: what a member is, and how it ended."""
    record = {"member": member.name, "overrides": list(member.overrides), **how, "inputs": dict(inputs)}
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / RECORD, json.dumps(record, indent=1) + "\n")


def standing(folder: Path, member: Member, case: Case) -> Standing:
    """Return what the folder of a member holds of it.

    What is no part of a state, such as the end of the run, may have changed: the run goes on from its checkpoint.

    Args:
        folder: The folder of the member.
        member: The member.
        case: Its case.

    Raises:
        CaseError: It holds another run: of another case, or of no study; or one that is past the end asked for.
    """
    held = [name for name in (SUMMARY, "history.csv") if (folder / name).exists()]
    held += [path.name for path in list_checkpoints(folder / "checkpoints")]
    record = read_json(folder / RECORD)
    if not held:
        return "new"
    if not isinstance(record.get("inputs"), dict):
        raise CaseError(
            f"this folder holds a run that is no member of a study ({held[0]}); --overwrite replaces it, another "
            "--out keeps it",
            file=folder,
        )
    old, new = record["inputs"], inputs_of(case)
    changed = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    fixed = [key for key in changed if not FREE.fullmatch(key)]
    if fixed:
        before, after = (
            "not there" if value.get(fixed[0]) is None else repr(value[fixed[0]]) for value in (old, new)
        )
        more = f" (and {len(fixed) - 1} more)" if len(fixed) > 1 else ""
        message = f"member {member.name} was run where this was {before}, it is {after}{more}"
        raise CaseError(
            f"{message}; --overwrite replaces the study, another --out keeps it", file=folder, key=fixed[0]
        )
    if not changed and read_json(folder / SUMMARY):
        return "done"
    meta = newest_meta(folder / "checkpoints", MPI.COMM_SELF)
    if not meta:
        return "new"
    check_end(meta["t"], meta["dt"], case.time.t_end, folder)
    return "begun"


def collected(case: Path, members: Sequence[Member], folder: Path, *, trust: bool = False) -> list[Outcome]:
    """Return how members stand that other processes have run; one that is not done counts as failed, with the reason.

    Args:
        case: The case file.
        members: The members.
        folder: Folder of the study.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: A folder holds something else.
    """
    found: list[Outcome] = []
    for member, own in zip(members, read_cases(case, members, trust=trust).values(), strict=True):
        place = Path(folder) / member.name
        if standing(place, member, own) == "done":
            found.append(Outcome(member=member, folder=place, state="kept"))
            continue
        record = read_json(place / RECORD)
        said = {"running": "it has not ended", "stopped": "it was stopped, its checkpoint is there"}
        said["done"] = f"it has ended, but its {SUMMARY} is not there or damaged"
        why = record.get("message") or said.get(record.get("state", ""), "it has not been run")
        found.append(Outcome(member=member, folder=place, state="failed", message=str(why)))
    return found
