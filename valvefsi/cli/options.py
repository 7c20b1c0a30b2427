"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

HELP: dict[str, Any] = {"no_args_is_help": True, "context_settings": {"help_option_names": ["-h", "--help"]}}

Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Folder of the results.")]
Resume = Annotated[bool, typer.Option("--resume", help="Go on from the last checkpoint in the folder.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a run that the folder holds.")]
AllowChange = Annotated[
    bool,
    typer.Option("--allow-change", help="With --resume: go on though material, step or loads have changed."),
]
Plan = Annotated[bool, typer.Option("--plan", help="Print size, step limits and expected time; do not run.")]
Trust = Annotated[
    bool, typer.Option("--trust", help="Allow Python files that the case names (materials) to be run.")
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Set a value, such as time.t_end='2 s'. Repeatable."),
]
