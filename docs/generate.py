"""Pages that are made from the package: tutorials of the demos, keys of a case, commands, modules."""

from __future__ import annotations

import json
import pkgutil
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
TITLES = {
    "fsi": "The coupled step",
    "bodies": "Immersed bodies",
    "circulation": "Circuits",
    "geometry": "Meshes",
    "run": "Runs",
    "scripting": "From Python",
    "post": "Numbers and pictures of a run",
    "io": "Files",
    "case": "Case files",
    "fitting": "Fits",
    "studies": "Studies: many steps or runs",
    "report": "Reports",
    "runtime": "Threads, memory, compiled loops",
    "types": "Types and protocols",
}
"""Headings of the parts of the package; the others have their name."""
HIDDEN = ("__init__", "__main__", "cli")


def everything(folder: Path) -> None:
    """Write all generated pages, after removing the old ones."""
    from credibility import credibility  # beside this file, which conf.py puts on the path

    shutil.rmtree(folder, ignore_errors=True)
    pages = {"case_keys.md": case_keys(), "study_keys.md": study_keys(), "commands.md": commands()}
    pages |= {"valve_numbers.md": valve_numbers()}
    pages["credibility.md"] = credibility()
    pages |= {f"tutorials/{path.stem}.md": tutorial(path) for path in sorted((ROOT / "demos").glob("*.py"))}
    pages |= {f"api/{name}.rst": modules(name) for name in parts_of_the_package()}
    for name, text in pages.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")


# Tutorials


def tutorial(path: Path) -> str:
    """Return a demo in the percent format as Markdown, with its picture at the end where there is one."""
    parts = [f"<!-- made from demos/{path.name} -->"]
    for heading, lines in cells(path.read_text(encoding="utf-8")):
        body = "\n".join(lines).strip("\n")
        if heading == "[markdown]":
            parts.append("\n".join(re.sub("^# ?", "", line) for line in body.splitlines()))
            continue
        parts += [f"## {heading}"] if heading else []
        parts += [f"```python\n{body}\n```"]
    if (PICTURES / f"{path.stem}.png").exists():
        parts.append(f"![What it draws](../../pictures/{path.stem}.png)")
    parts.append(f"The script is `demos/{path.name}`: `python demos/{path.name}`.")
    return "\n\n".join(parts) + "\n"


def cells(text: str) -> Iterator[tuple[str, list[str]]]:
    """Yield heading and lines of each cell."""
    heading, lines = None, []
    for line in text.splitlines():
        if line.startswith("# %%"):
            if heading is not None:
                yield heading, lines
            heading, lines = line[4:].strip(), []
        else:
            lines.append(line)
    yield heading or "", lines


# Keys of a case


def case_keys() -> str:
    """Return every table of a case file with its keys, units and defaults, and what materials and circuits take."""
    from valvefsi.case.models import Case

    parts = [
        "# Every key of a case",
        "`valvefsi case --defaults` prints the same as a commented case file, `valvefsi case --schema` as JSON schema. "
        "A number takes any unit of the right dimension; a plain number is CGS. An unknown key is refused, with the "
        "nearest known one.",
        "## The case",
        keys_of(Case),
    ]
    for path, kind in tables_in(Case, ()):
        parts += [f"## `{path}`", one_line(kind.__doc__), keys_of(kind)]
    return "\n\n".join([*parts, materials(), circuits()]) + "\n"


def study_keys() -> str:
    """Return every table of the files of studies with its keys, units and defaults."""
    from valvefsi.case.sample_tables import SampleStudy
    from valvefsi.case.study_tables import ValidationStudy

    parts = [
        "# Every key of a study",
        "Numbers and units are those of a case file; paths are relative to the study.",
    ]
    for command, study in (("validate", ValidationStudy), ("sample", SampleStudy)):
        parts += [f"## `valvefsi {command}`", one_line(study.__doc__), keys_of(study)]
        for path, kind in tables_in(study, ()):
            parts += [f"### `{path}` of `{command}`", one_line(kind.__doc__), keys_of(kind)]
    return "\n\n".join(parts) + "\n"


def tables_in(kind: type, path: tuple[str, ...]) -> Iterator[tuple[str, type]]:
    """Yield heading and model of every table below one, in the order of the file; sides of a box once."""
    seen: set[type] = set()
    for key, field in kind.model_fields.items():
        inner = table_of(field.annotation)
        if inner is None or inner in seen:
            continue
        seen.add(inner)
        name = ".".join((*path, "SIDE" if key == "x_lower" else key))
        yield f"[[{name}]]" if "tuple" in str(field.annotation) else f"[{name}]", inner
        yield from tables_in(inner, (*path, "SIDE" if key == "x_lower" else key))


def table_of(annotation: Any) -> type | None:
    """Return the table that an annotation holds, None where it holds none."""
    from valvefsi.case.table import Table

    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    return next((kind for kind in map(table_of, get_args(annotation)) if kind), None)


def keys_of(kind: type) -> str:
    """Return the keys of a table with unit, default and meaning."""
    from valvefsi.case.quantities import unit_of

    lines = []
    for key, field in kind.model_fields.items():
        inner = table_of(field.annotation) is not None
        unit, default = unit_of(field) or "", ""
        if field.is_required():
            default = "required"
        elif not inner and field.default is not None:
            default = f"`{json.dumps(field.default)}`"
        lines.append((f"`{key}`", unit, default, (field.description or "") + (" (table)" if inner else "")))
    return table(("key", "unit", "default", "meaning"), lines)


def materials() -> str:
    """Return the materials with their parameters, and the presets with where they come from."""
    from dataclasses import MISSING, fields

    from valvefsi.case.materials import material_units
    from valvefsi.solid.materials import MATERIALS, find_material
    from valvefsi.solid.materials.presets import PRESETS

    parts = [
        "## Materials",
        "The parameters of `material = { model = ... }`; your own class is `FILE.py:CLASS`.",
    ]
    for name in MATERIALS:
        kind = find_material(name)
        units = material_units(name)
        lines = []
        for field in fields(kind):
            need = field.default is MISSING and field.default_factory is MISSING
            lines.append(
                (
                    f"`{field.name}`",
                    units[field.name] or field.metadata.get("kind", ""),
                    "yes" if need else "",
                )
            )
        parts += [
            f"### `{name}`",
            one_line(kind.__doc__),
            table(("parameter", "unit or kind", "required"), lines),
        ]
    lines = [(f"`{name}`", f"`{preset.model}`", preset.provenance) for name, preset in PRESETS.items()]
    return "\n\n".join([*parts, "### Presets", table(("preset", "model", "provenance"), lines)])


def circuits() -> str:
    """Return the circuits with their parameters and states."""
    from dataclasses import fields

    from valvefsi.case.circuit_tables import KINDS, UNITS

    lines = []
    for name, kind in KINDS.items():
        parameters = ", ".join(f"`{field.name}` [{UNITS[field.name[0]]}]" for field in fields(kind))
        lines.append((f"`{name}`", one_line(kind.__doc__), parameters))
    return "\n\n".join(["## Circuits", table(("model", "what", "parameters"), lines)])


# Numbers of a valve


def valve_numbers() -> str:
    """Return every number of a valve in ``summary.json`` and what it means."""
    from valvefsi.case.valve_report import meanings

    head = (
        "# Numbers of a valve\n\n"
        "What `summary.json` says of a run with a valve, under `valve`. Its `definitions` say the same. Those of "
        "`cycles` are of each whole cycle; times count from its start, backward volumes are positive. "
        "`flutter`, `coaptation`, `places`, `shear` and `exposure` are of the last whole cycle (`window`; in steady "
        "flow of what is averaged), from the frames and `free_edges.csv`. `valvefsi numbers DIR` takes them again from "
        "a run that has ended."
    )
    lines = [(f"`{name}`", one_line(text.replace("``", "`"))) for name, text in meanings().items()]
    return f"{head}\n\n{table(('number', 'meaning'), lines)}\n"


# Commands


def commands() -> str:
    """Return every command with its arguments and options."""
    import typer

    from valvefsi.cli import app

    parts = ["# Commands", "`valvefsi COMMAND --help` prints the same."]
    for name, command in leaves(typer.main.get_command(app), "valvefsi"):
        lines = []
        for option in command.params:
            label = (
                ", ".join(option.opts)
                if option.param_type_name == "option"
                else option.metavar or option.name
            )
            if option.name == "help":
                continue
            help_text = (getattr(option, "help", None) or "").replace(r"\[", "[")
            default = (
                ""
                if option.default in (None, False, [], ()) or callable(option.default)
                else f"`{option.default}`"
            )
            lines.append((f"`{label}`", one_line(help_text), default))
        parts += [f"## `{name}`", one_line(command.help or "")]
        parts += [table(("option", "meaning", "default"), lines)] if lines else []
    return "\n\n".join(parts) + "\n"


def leaves(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield the name and the command of everything that can be run."""
    if not hasattr(command, "commands"):
        yield name, with_options(command, name.split()[-1])
        return
    for key, inner in command.commands.items():
        if inner.hidden:
            continue
        yield from leaves(inner, f"{name} {key}")


def with_options(command: Any, name: str) -> Any:
    """Return a command with its options; those of a benchmark are made when it is used, so they are made here."""
    import typer

    from valvefsi.benchmarks.registry import ENTRIES
    from valvefsi.cli.bench_command import command_of

    entry = next((entry for entry in ENTRIES if name in (entry.name, *entry.former)), None)
    if command.params or entry is None:
        return command
    app = typer.Typer(add_completion=False)
    app.command(help=entry.help)(command_of(entry.load()))
    return typer.main.get_command(app)


# Modules


def parts_of_the_package() -> list[str]:
    """Return the packages and modules right below ``valvefsi`` that have a page."""
    folder = ROOT / "valvefsi"
    names = [path.stem for path in folder.glob("*.py")] + [
        path.parent.name for path in folder.glob("*/__init__.py")
    ]
    return sorted(name for name in names if name not in HIDDEN)


def modules(name: str) -> str:
    """Return the page of one part of the package: all of its modules that are not private."""
    title = TITLES.get(name, name.capitalize())
    found = [f"valvefsi.{name}"]
    folder = ROOT / "valvefsi" / name
    if folder.is_dir():
        found += [
            m.name for m in pkgutil.walk_packages([str(folder)], f"valvefsi.{name}.") if "._" not in m.name
        ]
    parts = [title, "=" * len(title)]
    for module in found:
        only = ["   :no-members:"] if (ROOT / module.replace(".", "/")).is_dir() else []
        parts += ["", module, "-" * len(module), "", f".. automodule:: {module}", *only, ""]
    return "\n".join(parts)


NUMBERED = re.compile(r"\(?[0-9a-z][.)] ")
"""Start of an item of a numbered list."""


def set_formulas(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Make an indented block after a blank line a literal one (the formulas of the docstrings); keep |x| as it is."""
    new: list[str] = []
    formula = False
    for number, line in enumerate(lines):
        begins = line.startswith(" ") and not (lines[number - 1].strip() if number else "")
        if begins and new and not formula and not _in_field(new):
            new += ["::", ""]
            formula = True
        elif line.strip() and not line.startswith(" "):
            formula = False
        elif (
            line.startswith(" ")
            and not formula
            and new
            and new[-1][:1] not in ("", " ")
            and not _in_field(new)
        ):
            line = line.lstrip()  # a paragraph whose second line hangs
        new.append(line if formula else _escaped(line))
    lines[:] = new


def _escaped(line: str) -> str:
    """Return a line whose bars are no markup, outside of literals."""
    parts = line.split("``")
    return "``".join(part if n % 2 else part.replace("|", "\\|") for n, part in enumerate(parts))


def _in_field(lines: list[str]) -> bool:
    """Return whether the last lines belong to a field list, a directive or a block that was opened already."""
    for line in reversed(lines):
        if line.strip() and not line.startswith(" "):
            return line.startswith((":", "..", "*", "-")) or line.endswith("::") or bool(NUMBERED.match(line))
    return False


# Text


def table(head: tuple[str, ...], lines: list[tuple[str, ...]]) -> str:
    """Return a table in Markdown."""
    rows = [head, tuple("---" for _ in head), *lines]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)


def one_line(text: str) -> str:
    """Return the first paragraph of a text in one line."""
    return " ".join((text or "").strip().split("\n\n")[0].split())
