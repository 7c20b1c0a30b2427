"""Run the command line as ``python -m valvefsi``."""

from valvefsi.cli import main

if __name__ == "__main__":
    main()
