"""``valvefsi bench``: published benchmarks, studies, and the speed of this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valvefsi.benchmarks.registry import ENTRIES, markdown
from valvefsi.cli.bench_command import add
from valvefsi.cli.options import HELP, Style, not_a_folder
from valvefsi.cli.tables import WIDE, print_table, terminal

bench = typer.Typer(help="Run a published benchmark and compare.", **HELP)
for _entry in ENTRIES:
    add(bench, _entry)


@bench.command("table", rich_help_panel="Results")
def table(
    folders: Annotated[
        list[Path] | None, typer.Argument(metavar="[DIR]...", help="Folders of results, with all in them.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Also what is compared with nothing.")] = False,
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE.md", help="The table; a picture lies beside it.", callback=not_a_folder
        ),
    ] = Path("results/benchmarks.md"),
    style: Style = "screen",
) -> None:
    """Gather results of benchmarks: computed, reference, difference, source, grid, ranks, date, time."""
    from valvefsi.io.folder import write_text
    from valvefsi.post.plots.comparison import differences
    from valvefsi.post.plots.paper import paper
    from valvefsi.verification.collection import COLUMNS, collect
    from valvefsi.verification.collection import markdown as as_table

    lines = collect(folders or [Path("results")], everything=everything)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, as_table(lines))
    rows = [
        (line.benchmark, line.label(), line.difference_percent)
        for line in lines
        if line.difference_percent is not None
    ]
    with paper(style == "paper"):
        picture = differences(out.with_suffix(".png"), rows, title="Benchmarks against their references")
    numbers = ("computed", "reference", "off", "ranks", "time")
    columns = {name: "right" if name in numbers else "left" for name in COLUMNS}
    console = terminal(WIDE + 60)
    print_table(console, "benchmarks", columns, [line.cells() for line in lines])
    console.print(f"table in {out}, picture in {picture}", highlight=False, soft_wrap=True, markup=False)


@bench.command("list", rich_help_panel="Results")
def commands() -> None:
    """Print the benchmarks as tables in Markdown, for documents."""
    typer.echo(markdown(), nl=False)
