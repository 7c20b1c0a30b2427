"""How to add an optional part to this installation of valvefsi, in one command that works from any folder.

An installation in the environment satisfies ``valvefsi[EXTRA]`` by itself, from a wheel or from an index: pip fetches
what the extra needs and nothing else. From the sources the extras are those of their ``pyproject.toml``.
"""

from __future__ import annotations

import shlex
import shutil
import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1]


def source_tree(package: Path = PACKAGE) -> Path | None:
    """Return the folder of the sources that a package is run from, None where it is installed from a wheel."""
    folder = package.parent
    return folder if (folder / "pyproject.toml").is_file() else None


def pip_command() -> str:
    """Return how the pip of this Python is called: ``pip`` alone may be that of another."""
    beside = Path(sys.executable).with_name("pip")
    first = shutil.which("pip")
    return "pip" if first and Path(first) == beside else f"{shlex.quote(sys.executable)} -m pip"


def how_to_add(extra: str, package: Path = PACKAGE) -> str:
    """Return the command that adds an extra of ``pyproject.toml`` to this installation.

    Args:
        extra: Its name, such as "plot".
        package: Folder of the package.
    """
    source = source_tree(package)
    what = f"valvefsi[{extra}]" if source is None else f"{source}[{extra}]"
    return f"{pip_command()} install {'' if source is None else '-e '}{shlex.quote(what)}"


def how_to_set_up(package: Path = PACKAGE) -> str:
    """Return the command that installs what this installation needs, and names the libraries that the machine lacks."""
    source = source_tree(package)
    if source is None:
        return how_to_add("dolfinx", package)
    return f"make -C {shlex.quote(str(source))} setup"
