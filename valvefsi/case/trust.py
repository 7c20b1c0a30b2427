"""What a case may run: a material of one's own is Python, and its file is run only where the user says so."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from valvefsi.case.includes import read_toml
from valvefsi.case.overrides import nearest
from valvefsi.errors import CaseError

SETTINGS = ("trust",)
"""What the user's configuration file may hold."""


def configuration() -> Path:
    """Return the user's configuration file, which may name trusted folders: ``trust = ["/path"]``."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "valvefsi" / "config.toml"


def load_own_materials(raw: Mapping[str, object], file: Path | None, trust: bool) -> None:
    """Load the materials "FILE.py:CLASS" of a raw case, and put the whole path of the file in their places.

    Args:
        raw: The case as TOML gives it.
        file: The case file; paths are relative to its folder.
        trust: Whether the files may be run.

    Raises:
        CaseError: A file is missing, may not be run, or holds no such material.
    """
    solids = raw.get("solid")
    for number, solid in enumerate(solids if isinstance(solids, list) else ()):
        material = solid.get("material") if isinstance(solid, dict) else None
        model = material.get("model") if isinstance(material, dict) else None
        if not isinstance(material, dict) or not isinstance(model, str) or ":" not in model:
            continue
        name, _, kind = model.rpartition(":")
        key = f"solid.{solid.get('name', number)}.material.model"
        path = ((file.parent if file else Path()) / name).resolve()
        if path.suffix != ".py" or not path.is_file():
            raise CaseError(f"there is no Python file {path}", file=file, key=key, value=model)
        if not trust and not any(path.is_relative_to(folder) for folder in _trusted_folders()):
            message = (
                f"this would run {path}; allow it with --trust, or trust its folder in {configuration()}"
            )
            raise CaseError(message, file=file, key=key, value=model)
        from valvefsi.solid.materials import load_material

        try:
            material["model"] = load_material(path, kind)
        except CaseError as error:
            raise CaseError(error.reason, file=file, key=key, value=model) from None


def _trusted_folders() -> list[Path]:
    path = configuration()
    settings = read_toml(path) if path.is_file() else {}
    for key in settings:
        if key not in SETTINGS:
            raise CaseError(f"unknown key{nearest(key, SETTINGS)}", file=path, key=key)
    folders = settings.get("trust", [])
    if not isinstance(folders, list) or not all(isinstance(each, str) for each in folders):
        raise CaseError("expected a list of folders", file=path, key="trust", value=folders)
    paths = [Path(each).expanduser() for each in folders]
    relative = next(
        (each for each, whole in zip(folders, paths, strict=True) if not whole.is_absolute()), None
    )
    if relative is not None:
        raise CaseError(
            "expected whole paths: another folder is meant wherever one stands",
            file=path,
            key="trust",
            value=relative,
        )
    return [whole.resolve() for whole in paths]
