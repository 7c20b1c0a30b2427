"""Run the command line, as ``valvefsi`` and as ``python -m valvefsi``."""

import sys
from pathlib import Path

# Python puts the current folder first: a file there, such as pint.py, would stand for a library.
HERE, HOME = Path.cwd(), Path(__file__).resolve().parents[1]
if sys.path and Path(sys.path[0]).resolve() == HERE != HOME:
    del sys.path[0]

from valvefsi.runtime.signals import end_in_one_line  # noqa: E402


def main() -> None:
    """Run the command line; what ends it while it is imported is said too."""
    end_in_one_line()
    from valvefsi.cli import main

    main()


if __name__ == "__main__":
    main()
