"""Tables that stand in files of their own: ``material = { include = "material.toml" }``."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from valvefsi.errors import CaseError
from valvefsi.types import Unchecked

DEPTH = 8
"""Deepest chain of files that include one another."""


LARGEST = 10_000_000
"""Bytes above which a file is no case file."""


def read_toml(path: Path) -> dict[str, object]:
    """Read a TOML file.

    Raises:
        CaseError: It is missing, no plain file, too large, or not TOML.
    """
    try:
        if path.exists() and not path.is_file():
            raise CaseError("this is not a file", file=path)
        if path.stat().st_size > LARGEST:
            raise CaseError(f"expected at most {LARGEST} bytes", file=path)
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CaseError(f"cannot read this file: {error.strerror}", file=path) from None
    except UnicodeDecodeError:
        raise CaseError("cannot read this file: it is not text in UTF-8", file=path) from None
    except RecursionError:
        raise CaseError("not TOML: nested too deeply", file=path) from None
    except ValueError as error:  # a number with too many digits is none of TOML's own errors
        raise CaseError(f"not TOML: {error}", file=path) from None


def resolve_includes(raw: Any, file: Path | None, key: str = "", depth: int = 0) -> Any:
    """Put the contents of included files in their places, keys beside ``include`` over them.

    Args:
        raw: Tables as TOML gives them.
        file: File they are from; paths are relative to its folder.
        key: Where ``raw`` stands, for messages.
        depth: How many files deep.

    Returns:
        The tables without any ``include``.

    Raises:
        CaseError: An included file is missing, not TOML, or part of a circle.
    """
    if isinstance(raw, list):
        return [resolve_includes(item, file, f"{key}.{k}", depth) for k, item in enumerate(raw)]
    if not isinstance(raw, Mapping):
        return raw
    own = {
        name: resolve_includes(v, file, f"{key}.{name}", depth)
        for name, v in raw.items()
        if name != "include"
    }
    if "include" not in raw:
        return own
    path = _path(raw["include"], file, f"{key}.include".lstrip("."))
    if depth == DEPTH:
        raise CaseError("files include one another in a circle", file=file, key=f"{key}.include".lstrip("."))
    found = resolve_includes(read_toml(path), path, key, depth + 1)
    return {**_placed(found, path.parent), **own}


def _placed(raw: Any, folder: Path) -> Any:
    """Return an included table, the paths of its files as seen from outside."""
    if isinstance(raw, list):
        return [_placed(item, folder) for item in raw]
    if not isinstance(raw, Mapping):
        return raw
    inside = {key: _placed(value, folder) for key, value in raw.items()}
    if isinstance(raw.get("file"), str):
        inside["file"] = str(folder.resolve() / raw["file"])
    if isinstance(raw.get("model"), str) and ".py:" in raw["model"]:
        inside["model"] = str(folder.resolve() / raw["model"])
    return inside


def _path(name: Unchecked, file: Path | None, key: str) -> Path:
    if not isinstance(name, str):
        raise CaseError("expected the path of a TOML file", file=file, key=key, value=name)
    path = (file.parent if file else Path()) / name
    if not path.is_file():
        names = [item.name for item in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        near = difflib.get_close_matches(path.name, names, n=1, cutoff=0.0)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        raise CaseError(f"no such file{hint}", file=file, key=key, value=name)
    return path
