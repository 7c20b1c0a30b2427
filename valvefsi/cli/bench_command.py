"""Commands made of the options that benchmarks declare."""

from __future__ import annotations

import inspect
import types
import typing
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from valvefsi.benchmarks.registry import Entry
from valvefsi.cli.bench_progress import announced
from valvefsi.cli.options import HELP, Out, Overwrite, Plan, Resume, Style, plain
from valvefsi.cli.tables import show_result
from valvefsi.errors import CaseError

if TYPE_CHECKING:
    from valvefsi.benchmarks.frame import Command
    from valvefsi.benchmarks.options import Option

STUB = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}


def add(app: typer.Typer, entry: Entry) -> None:
    """Add a benchmark; its module is loaded, and its options are read, when the command is used."""
    for name in (entry.name, *entry.former):
        register = app.command(
            name,
            help=entry.help,
            hidden=name != entry.name,
            rich_help_panel=entry.group,
            context_settings=STUB,
        )
        register(_stub(entry, name))


def _stub(entry: Entry, name: str) -> Callable[[typer.Context], Any]:
    def stub(context: typer.Context) -> Any:
        if name != entry.name:
            warnings.warn(f"bench {name} is now called bench {entry.name}", stacklevel=1)
        app = typer.Typer(add_completion=False, **HELP | {"no_args_is_help": False})
        app.command(help=entry.help)(command_of(entry.load()))
        program = f"valvefsi bench {entry.name}"
        return typer.main.get_command(app).main(context.args, prog_name=program, standalone_mode=False)

    stub.__annotations__ = {"context": typer.Context}
    return stub


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How an option reads on the command line.

    Attributes:
        annotation: Type for typer.
        default: Default there.
        read: The option's value from what typer gives.
    """

    annotation: Any
    default: Any
    read: Callable[[Any], Any]


def kind_of(hint: Any, default: Any, chosen: Option, flag: str) -> Kind:
    """Return how an option of a type reads: several in a row by commas, repeated ones as a list, None as "off"."""
    if hint == Mapping[str, int] | None:
        return Kind(annotation=list[str] | None, default=None, read=lambda texts: _pairs(texts or (), flag))
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is tuple:
        text = (
            "all"
            if chosen.everything and tuple(chosen.choices or ()) == default
            else ",".join(map(str, default))
        )
        return Kind(annotation=str, default=text, read=lambda value: _several(value, inner[0], chosen, flag))
    if origin is not None and origin is not types.UnionType and issubclass(origin, Sequence):
        items = list[inner[0]] | None  # type: ignore[valid-type]
        return Kind(annotation=items, default=None, read=lambda values: tuple(values) if values else default)
    if hint == float | None:
        text = "off" if default is None else str(default)
        return Kind(
            annotation=str, default=text, read=lambda value: None if value == "off" else _number(value, flag)
        )
    return Kind(annotation=hint, default=default, read=lambda value: value)


def command_of(benchmark: type[Command]) -> Callable[..., None]:
    """Return the function of a command; its arguments are the benchmark's options, as typer wants them."""
    from valvefsi.benchmarks.options import flag_of, options_of

    hints, kinds = typing.get_type_hints(benchmark), {}
    arguments = [_argument("out", Out, None), _argument("style", Style, "screen")]
    for name, (item, chosen) in options_of(benchmark).items():
        flag = flag_of(name, chosen)
        kinds[name] = kind = kind_of(hints[name], item.default, chosen, flag)
        limits: dict[str, Any] = {}
        if kind.annotation in (int, float, int | None):
            limits = {"min": chosen.least, "max": chosen.most}
        info = typer.Option(flag, help=plain(chosen.help), metavar=chosen.metavar, **limits)
        arguments.append(_argument(name, Annotated[kind.annotation, info], kind.default))
    if benchmark.resumable:
        arguments.append(_argument("resume", Resume, False))
    if hasattr(benchmark, "plan"):
        arguments.append(_argument("plan", Plan, False))

    if hasattr(benchmark, "overwrite"):
        arguments.append(_argument("overwrite", Overwrite, False))

    def command(
        out: Path | None,
        style: str,
        resume: bool = False,
        plan: bool = False,
        overwrite: bool = False,
        **chosen: Any,
    ) -> None:
        one = benchmark(**{name: kinds[name].read(value) for name, value in chosen.items()})
        if overwrite:
            one = one.overwrite()  # type: ignore[attr-defined]
        from valvefsi.post.plots.paper import paper

        with paper(style == "paper"):
            execute(one, out, resume=resume, plan=plan)

    command.__signature__ = inspect.Signature(arguments)  # type: ignore[attr-defined]
    command.__annotations__ = {argument.name: argument.annotation for argument in arguments}
    return command


def execute(benchmark: Command, out: Path | None, *, resume: bool = False, plan: bool = False) -> None:
    """Run a benchmark, or plan it, and show its table."""
    from mpi4py import MPI

    comm, folder = MPI.COMM_WORLD, out or Path("results") / benchmark.folder
    if plan:
        show_result(benchmark.plan(folder, comm), comm)  # type: ignore[attr-defined]
        return
    with announced(comm) as progress:
        result = benchmark.run(out=folder, comm=comm, progress=progress, resume=resume)
    show_result(result, comm, folder)


def _argument(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _several(text: str, kind: type, chosen: Option, flag: str) -> tuple[Any, ...]:
    if chosen.everything and text == "all":
        return tuple(chosen.choices or ())
    parts = dict.fromkeys(part.strip() for part in text.split(",") if part.strip())
    return tuple(part if kind is str else _number(part, flag, kind) for part in parts)


def _pairs(texts: Sequence[str], flag: str) -> dict[str, int]:
    found = {}
    for text in texts:
        key, _, value = (part.strip() for part in text.partition("="))
        if not (key and value.isdigit()):
            raise CaseError("expected NAME=N with a whole number", key=flag, value=text)
        found[key] = int(value)
    return found


def _number(text: str, flag: str, kind: type = float) -> Any:
    try:
        return kind(text)
    except ValueError:
        words = "whole numbers such as 64,128" if kind is int else "a number"
        raise CaseError(f"expected {words}", key=flag, value=text) from None
