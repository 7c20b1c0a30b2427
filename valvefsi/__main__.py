"""Run the command line as ``python -m valvefsi``."""

import sys
from pathlib import Path

# Python puts the current folder first: a file there, such as pint.py, would stand for a library.
HERE, HOME = Path.cwd(), Path(__file__).resolve().parents[1]
if sys.path and Path(sys.path[0]).resolve() == HERE != HOME:
    del sys.path[0]

from valvefsi.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
