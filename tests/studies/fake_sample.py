"""Stands in for ``python -m valvefsi run`` where uncertain inputs are asked: ``u_cm`` is 100 viscosity^2 + density.

Where ``limit`` lies in the folder above, a larger viscosity fails. What began is written to ``events`` there.
"""

from __future__ import annotations

import itertools
import json
import sys
from pathlib import Path


def main() -> None:
    """Run."""
    words = sys.argv[1:]
    out = Path(words[words.index("--out") + 1])
    values = dict(text.split("=", 1) for flag, text in itertools.pairwise(words) if flag == "--set")
    viscosity, density = (float(values[f"fluid.{name}"].split()[0]) for name in ("viscosity", "density"))
    with (out.parent / "events").open("a") as file:
        file.write(f"{out.name}\n")
    limit = out.parent / "limit"
    if limit.exists() and viscosity > float(limit.read_text()):
        sys.exit("StabilityError: too thick")
    last = {"step": 1.0, "t_s": 1.0, "u_cm": 100 * viscosity**2 + density, "still_cm": 2.0}
    (out / "summary.json").write_text(json.dumps({"last": last, "timing": {"wall_s": 1.0}}))


if __name__ == "__main__":
    main()
