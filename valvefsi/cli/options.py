"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from valvefsi.errors import CaseError

HELP: dict[str, Any] = {"no_args_is_help": True, "context_settings": {"help_option_names": ["-h", "--help"]}}


def plain(text: str) -> str:
    """Return a help text whose brackets, such as a unit's, are shown: rich takes them for styles."""
    return text.replace("[", r"\[")


def read_seconds(text: str, key: str) -> float:
    """Return a time with a unit, or in s, as s."""
    from pydantic_core import PydanticCustomError

    from valvefsi.case.quantities import Quantity

    try:
        value = Quantity("s").parse(text if text.strip()[-1:].isalpha() else f"{text} s")
    except PydanticCustomError as error:
        raise CaseError(error.message(), key=key, value=text) from None
    if value < 0:
        raise CaseError("expected a time of 0 or more", key=key, value=text)
    return value


def folder_of_results(path: Path | None, key: str = "--out") -> Path | None:
    """Refuse a folder of results where a file stands, before any work."""
    if path is not None:
        there = next((p for p in (path, *path.parents) if p.exists()), path)
        if there.exists() and not there.is_dir():
            what = "this is a file" if there == path else f"{there} is a file"
            raise CaseError(f"{what}, expected a folder", key=key, value=str(path))
    return path


def _folder(path: Path | None) -> Path | None:
    return folder_of_results(path)


def not_a_folder(path: Path | None) -> Path | None:
    """Refuse a file of results where a folder stands, before any work."""
    if path is not None and path.is_dir():
        raise CaseError("this is a folder, expected the name of a file", key="--out", value=str(path))
    return path


MARKS = {"point": ".", "comma": ","}
"""Decimal marks by their names."""


def _decimal(text: str) -> str:
    """Refuse what is no decimal mark."""
    if text not in MARKS:
        raise CaseError(f"expected {' or '.join(MARKS)}", key="--decimal", value=text)
    return text


Decimal = Annotated[
    str,
    typer.Option(
        metavar="point|comma",
        callback=_decimal,
        help="Decimal mark of the record; with a comma, cells are parted by semicolons, tabs or blanks.",
    ),
]
Out = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder of the results.", callback=_folder),
]
CaseFile = Annotated[Path, typer.Argument(metavar="CASE.toml", help="The case file.")]
StudyFile = Annotated[Path, typer.Argument(metavar="STUDY.toml", help="The study.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in the folder.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a run that the folder holds.")]
AllowChange = Annotated[
    bool,
    typer.Option("--allow-change", help="With --resume: go on though material, step or loads have changed."),
]
Plan = Annotated[bool, typer.Option("--plan", help="Print size, step limits and expected time; do not run.")]
Anew = Annotated[bool, typer.Option("--overwrite", help="Run anew what the folder holds.")]
PlanMembers = Annotated[
    bool, typer.Option("--plan", help="Print steps and expected time of each member; do not run.")
]
Trust = Annotated[
    bool, typer.Option("--trust", help="Allow Python files that the case names (materials) to be run.")
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a value, such as time.t_end='2 s'. Repeatable."),
]
SetStudy = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a value of the study, not of its case. Repeatable."),
]
Style = Annotated[
    Literal["screen", "paper"],
    typer.Option(
        "--style",
        help="paper: vector PDF, 85 mm wide (174 where panels stand side by side), its numbers as NAME_data.csv.",
    ),
]
Bounds = Annotated[list[str] | None, typer.Option(metavar="K=A:B", help="Bounds of a parameter. Repeatable.")]
Starts = Annotated[int, typer.Option(min=1, max=4096, help="Number of starts.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of starts and bootstrap.")]


def _at_once(what: str) -> Any:
    """Return the option that says how many of a study's runs go on at the same time."""
    return typer.Option("--jobs", metavar="N", help=f"{what} that run at once; one a core if left out.")


JobsOfMembers = Annotated[int | None, _at_once("Members")]
JobsOfSamples = Annotated[int | None, _at_once("Samples")]
