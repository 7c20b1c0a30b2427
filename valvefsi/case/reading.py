"""From a TOML file to a case, or to one line that says what is wrong with it."""

from __future__ import annotations

import difflib
import re
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from valvefsi.case.checks import check_case
from valvefsi.case.circuit_tables import circuit_schemas
from valvefsi.case.includes import read_toml, resolve_includes
from valvefsi.case.materials import material_schemas
from valvefsi.case.models import Case
from valvefsi.case.origins import origins_of, shown_path
from valvefsi.case.overrides import Override, apply_overrides, nearest
from valvefsi.case.trust import load_own_materials
from valvefsi.case.values import written_values
from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

MESSAGES = {
    "missing": "this key is required",
    "greater_than": "expected a number greater than {gt:g}",
    "greater_than_equal": "expected a number of at least {ge:g}",
    "less_than": "expected a number less than {lt:g}",
    "less_than_equal": "expected a number of at most {le:g}",
    "int_type": "expected a whole number",
    "int_from_float": "expected a whole number",
    "int_parsing": "expected a whole number",
    "float_type": "expected a number",
    "float_parsing": "expected a number",
    "finite_number": "expected a finite number",
    "string_type": "expected a string",
    "string_pattern_mismatch": "expected a letter, then letters, digits or _",
    "tuple_type": "expected a list",
    "too_short": "expected at least {min_length} entry",
    "model_type": "expected a table",
}


def load_case(path: str | Path, overrides: Sequence[Override] = (), *, trust: bool = False) -> Case:
    """Read a case file.

    Args:
        path: The TOML file.
        overrides: Texts ``a.b=value``, or pairs of a path and a value, that replace or add values.
        trust: Whether Python files of materials may be run.

    Returns:
        The case, checked, in CGS.

    Raises:
        CaseError: One line with file, key, value and the nearest valid choice.
    """
    path = Path(path)
    if not path.exists():
        raise CaseError(f"no such case file{nearest_file(path, '.toml', 0.5)}", file=path)
    return parse_case(read_toml(path), overrides, file=path, trust=trust)


def parse_case(
    raw: Mapping[str, object],
    overrides: Sequence[Override] = (),
    *,
    aliases: Mapping[str, str] | None = None,
    file: Path | None = None,
    trust: bool = False,
) -> Case:
    """Make a case of tables, see `load_case`.

    Args:
        raw: The tables as TOML gives them.
        overrides: Texts ``a.b=value``.
        aliases: Short names of keys that overrides may use.
        file: File for messages; mesh files are relative to its folder.
        trust: Whether Python files of materials may be run.

    Raises:
        CaseError: Something is wrong with it.
    """
    try:
        tables: dict[str, object] = resolve_includes(deepcopy(dict(raw)), file)
    except RecursionError:
        raise CaseError("tables are nested too deeply", file=file) from None
    changed = apply_overrides(tables, overrides, aliases)
    _find_files(tables, file, changed)
    load_own_materials(tables, file, trust)
    try:
        case = Case.model_validate(tables)
    except ValidationError as error:
        raise one_line(error, tables, file, changed) from None
    case._file, case._trust = file, trust
    case._origins = origins_of(raw, file, tables, changed)
    case._written = written_values(tables)
    try:
        check_case(case)
    except CaseError as error:
        loc = [int(part) if part.isdigit() else part for part in str(error.key).split(".")]
        source = _source(str(error.key), file, changed)
        raise CaseError(error.reason, file=source, key=shown_path(loc, tables), value=error.value) from None
    return case


def case_schema() -> dict[str, object]:
    """Return the JSON schema of case files."""
    schema = Case.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    material = schema["$defs"]["Material"]
    schema["$defs"]["Material"] = {
        "description": material.get("description", ""),
        "oneOf": material_schemas(),
    }
    circuit = schema["$defs"]["CircuitTable"]
    schema["$defs"]["CircuitTable"] = {"description": circuit["description"], "oneOf": circuit_schemas()}
    return schema


def _find_files(raw: dict[str, object], file: Path | None, changed: Sequence[str]) -> None:
    """Make the paths of files of meshes, fibres, pumps and tables absolute; refuse one that does not exist."""
    fluid = raw.get("fluid")
    sides = fluid.get("sides") if isinstance(fluid, dict) else None
    for name in sides if isinstance(sides, dict) else ():
        _find_file(raw, ("fluid", "sides", name), file, changed, entry="table")
    circuits = raw.get("circuit")
    for number, circuit in enumerate(circuits if isinstance(circuits, list) else ()):
        if isinstance(circuit, dict):
            _find_file(raw, ("circuit", number, "pump"), file, changed)
    _find_file(raw, ("housing",), file, changed)
    _find_run(raw, file)
    solids = raw.get("solid")
    for number, solid in enumerate(solids if isinstance(solids, list) else ()):
        if not isinstance(solid, dict):
            continue
        _find_file(raw, ("solid", number, "mesh"), file, changed)
        fibres = solid.get("fibre")
        for which in range(len(fibres) if isinstance(fibres, list) else 0):
            _find_file(raw, ("solid", number, "fibre", which), file, changed)


def _find_file(
    raw: dict[str, object],
    place: tuple[str | int, ...],
    file: Path | None,
    changed: Sequence[str],
    entry: str = "file",
) -> None:
    """Make the path under ``entry`` of one table absolute; refuse one that does not exist."""
    table: Any = raw
    for part in place:
        table = table.get(part) if isinstance(table, dict) else table[part]
    if not isinstance(table, dict) or not isinstance(table.get(entry), str):
        return
    if entry == "table" and not table[entry]:  # its default, no table
        return
    path = (file.parent if file else Path()) / table[entry]
    if not path.is_file():
        key = (*place, entry)
        source = _source(".".join(map(str, key)), file, changed)
        kind, suffix = ("mesh ", ".msh") if "mesh" in place else ("", path.suffix)
        message = f"no such {kind}file{nearest_file(path, suffix)}"
        raise CaseError(message, file=source, key=shown_path(key, raw), value=table[entry])
    table[entry] = str(path.resolve())


def _find_run(raw: dict[str, object], file: Path | None) -> None:
    """Make the folder of the run to begin from absolute; whether it holds one is asked where a run begins."""
    start = raw.get("start")
    if isinstance(start, dict) and isinstance(start.get("run"), str) and start["run"]:
        start["run"] = str(((file.parent if file else Path()) / start["run"]).resolve())


def nearest_file(path: Path, suffix: str, cutoff: float = 0.0) -> str:
    """Return a hint at the file with the nearest name in the folder of ``path``."""
    folder = path.parent
    if not folder.is_dir():
        return f"; there is no folder {folder}"
    names = sorted(item.name for item in folder.iterdir() if item.suffix == suffix)
    near = difflib.get_close_matches(path.name, names, n=1, cutoff=cutoff)
    none = "" if names else f"; the folder holds no {suffix} file"
    return f"; did you mean {near[0]!r}?" if near else none


def one_line(
    error: ValidationError, raw: Mapping[str, object], file: Path | None, changed: Sequence[str]
) -> CaseError:
    """Return the first error of a validation as one line.

    Args:
        error: What pydantic found.
        raw: The tables that were read.
        file: File they are from.
        changed: Paths of what was set on the command line, as `apply_overrides` gives them.
    """
    found = error.errors(include_url=False)
    first = next((item for item in found if item["type"] == "case"), found[0])
    context = first.get("ctx") or {}
    loc = list(first["loc"])
    value = first["input"] if first["type"] != "missing" else None
    if first["type"] == "case":
        extra = context.get("key")
        loc += [int(part) if part.isdigit() else part for part in extra.split(".")] if extra else []
        value = context.get("value") if extra else value
    if isinstance(value, dict):
        value = None
    message = first["msg"]
    if first["type"] == "literal_error":
        choices = re.findall(r"'([^']*)'|(\d+)", context["expected"])
        message = _choices(value, ["".join(choice) for choice in choices])
    elif first["type"] in MESSAGES:
        message = MESSAGES[first["type"]].format(**context)
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    source = _source(".".join(map(str, loc)), file, changed)
    return CaseError(" ".join(f"{message}{more}".split()), file=source, key=shown_path(loc, raw), value=value)


def _choices(value: Unchecked, choices: Sequence[str]) -> str:
    """Return the nearest of the valid choices and the list of them."""
    near = nearest(value, choices)
    listed = ", ".join(choices)
    return f"expected one of {listed}{near}" if "mean" in near else f"expected one of {listed}"


def _source(key: str, file: Path | None, changed: Sequence[str]) -> Path | str | None:
    """Return where a value was given: on the command line or in the file."""
    related = (f"{c}.".startswith(f"{key}.") or key.startswith(f"{c}.") for c in changed)
    return "--set" if any(related) else file
