"""Where every value of a case is from: its file, a file that this includes, the command line, a preset, the default.

A run keeps it in ``provenance.json`` beside its results, with the hashes of all files that went in and the versions and
the machine of each time that it was called.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valvefsi.case.circuit_tables import CircuitTable
from valvefsi.case.includes import read_toml
from valvefsi.case.material_tables import Material
from valvefsi.case.table import Table
from valvefsi.case.values import FILES
from valvefsi.errors import raise_together
from valvefsi.io.folder import sha256, write_text

if TYPE_CHECKING:
    from mpi4py import MPI

    from valvefsi.case.models import Case

PROVENANCE = "provenance.json"
COMMAND_LINE, DEFAULT, UNKNOWN = "--set", "default", "not recorded"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A value of a case.

    Attributes:
        path: Its path, items of lists by name where they have one.
        value: The value, CGS.
        unit: Its unit, "" for what has none.
        meaning: What the key is for.
        origin: Where it is from.
    """

    path: str
    value: object
    unit: str
    meaning: str
    origin: str


def shown_path(loc: Sequence[object], raw: Mapping[str, object]) -> str:
    """Return a path of keys with the names of list items where they have one."""
    place: Any = raw
    parts = []
    for part in loc:
        try:
            place = place[part]
        except (KeyError, IndexError, TypeError):
            place = None
        name = place.get("name") if isinstance(part, int) and isinstance(place, dict) else None
        parts.append(str(name if isinstance(name, str) else part))
    return ".".join(parts)


def origins_of(
    raw: Mapping[str, object], file: Path | None, tables: Mapping[str, object], changed: Sequence[str]
) -> dict[str, str]:
    """Return where each value that was given is from, by its path.

    Args:
        raw: The case as TOML gives it, with its ``include`` keys; none of them is wrong.
        file: File it is from.
        tables: The same, included files in their places.
        changed: Paths of what was set on the command line, as `apply_overrides` gives them.
    """
    found = {shown_path(loc, tables): text for loc, text in _sources(raw, file, ()).items()}
    for path in changed:
        named = shown_path([int(part) if part.isdigit() else part for part in path.split(".")], tables)
        found = {key: text for key, text in found.items() if not f"{key}.".startswith(f"{named}.")}
        found[named] = COMMAND_LINE
    return found


def _sources(raw: object, file: Path | None, key: tuple[str | int, ...]) -> dict[tuple[str | int, ...], str]:
    """Return the file of each value below a key, by its place."""
    if isinstance(raw, list) and any(isinstance(item, Mapping) for item in raw):
        raw = dict(enumerate(raw))
    if not isinstance(raw, Mapping):
        return {key: file.name if file is not None else "given"}
    found: dict[tuple[str | int, ...], str] = {}
    if isinstance(raw.get("include"), str):
        path = (file.parent if file else Path()) / raw["include"]
        found = _sources(read_toml(path), path, key)
    for name, value in raw.items():
        if name != "include":
            place = (*key, name)
            found = {loc: text for loc, text in found.items() if loc[: len(place)] != place}
            found |= _sources(value, file, place)
    return found


def included_files(raw: object, file: Path | None) -> list[Path]:
    """Return the files that a case includes, in order, each once."""
    found: list[Path] = []
    if isinstance(raw, list):
        found = [path for item in raw for path in included_files(item, file)]
    elif isinstance(raw, Mapping):
        found = [path for item in raw.values() for path in included_files(item, file)]
        if isinstance(raw.get("include"), str):
            path = (file.parent if file else Path()) / raw["include"]
            found += [path, *included_files(read_toml(path), path)]
    return list(dict.fromkeys(found))


def entries_of(case: Case, origins: Mapping[str, str] | None) -> list[Entry]:
    """Return every value of a case with unit, meaning and origin.

    Args:
        case: The case.
        origins: Where the values that were given are from, by path; None where that was not recorded.
    """
    return list(_entries(case, "", origins))


def _entries(table: Table, path: str, origins: Mapping[str, str] | None) -> Iterator[Entry]:
    """Yield the values of a table, then those of the tables in it."""
    inner: list[tuple[str, Table]] = []
    for key, field in type(table).model_fields.items():
        value, place = getattr(table, key), f"{path}.{key}".lstrip(".")
        if isinstance(value, Table):
            inner.append((place, value))
        elif isinstance(value, tuple) and value and isinstance(value[0], Table):
            inner += [(f"{place}.{getattr(item, 'name', '') or k}", item) for k, item in enumerate(value)]
        elif not (key == "parameters" and isinstance(table, Material | CircuitTable)):
            default = None if field.is_required() else field.get_default(call_default_factory=True)
            origin = _origin(place, origins, is_default=not field.is_required() and value == default)
            about = str(field.description or "")
            yield Entry(path=place, value=value, unit=table.unit(key) or "", meaning=about, origin=origin)
    if isinstance(table, Material | CircuitTable):
        preset = getattr(table, "preset", None)
        for key, value in table.parameters.items():
            place = f"{path}.{key}"
            origin = _origin(place, origins, preset=preset)
            about = f"Parameter of {table.model}"
            yield Entry(path=place, value=value, unit=table.unit(key) or "", meaning=about, origin=origin)
    for place, item in inner:
        yield from _entries(item, place, origins)


def _origin(
    path: str, origins: Mapping[str, str] | None, *, is_default: bool = False, preset: str | None = None
) -> str:
    """Return where a value is from; the file of a whole table or list is that of what is in it."""
    if origins is None:
        return "the default, or given like it" if is_default else UNKNOWN
    near = [key for key in origins if f"{path}.".startswith(f"{key}.") or f"{key}.".startswith(f"{path}.")]
    if near:
        return origins[max(near, key=len)]
    return f"preset {preset}" if preset else DEFAULT


def write_provenance(case: Case, out: Path, comm: MPI.Comm, *, resume: bool) -> None:
    """Write ``provenance.json`` into the folder of a run: origins, hashes of what went in, and this call.

    Args:
        case: The case.
        out: Folder of the run.
        comm: Communicator of the run.
        resume: Whether the run goes on; calls before this one are kept then.

    Note:
        Collective.
    """
    from valvefsi.runtime.environment import environment, machine

    here, error = environment(comm) | {"machine": machine(), "command": sys.argv[1:]}, None
    try:
        if comm.rank == 0:
            known = read_provenance(out) if resume else {}
            said = {
                "origins": known.get("origins") or case.origins,
                "inputs": known.get("inputs") or inputs_of(case),
                "calls": [*known.get("calls", ()), here],
            }
            write_text(Path(out) / PROVENANCE, json.dumps(said, indent=1) + "\n")
    except OSError as failure:
        error = failure
    raise_together(comm, error)


def inputs_of(case: Case) -> list[dict[str, str]]:
    """Return name, part and SHA-256 of each file that a case is made of, those that are there."""
    found = [("case file", case.file)] if case.file is not None else []
    if case.file is not None:
        found += [("included file", path) for path in included_files(read_toml(case.file), case.file)]
    for entry in entries_of(case, None):
        own = str(entry.value).rpartition(":")[0] if ".py:" in str(entry.value) else ""
        if isinstance(entry.value, str) and (own or entry.path.rpartition(".")[2] in FILES) and entry.value:
            found.append((entry.path, Path(own or entry.value)))
    return [
        {"part": part, "file": path.name, "sha256": sha256(path)}
        for part, path in dict.fromkeys(found)
        if path is not None and path.is_file()
    ]


def read_provenance(out: Path) -> dict[str, Any]:
    """Return what a run has kept of its origins, empty where it has kept nothing or that is damaged."""
    path = Path(out) / PROVENANCE
    try:
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}
