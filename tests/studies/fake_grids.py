"""Stands in for ``python -m valvefsi run`` where a study of grids is asked: answers of known order in h and dt.

``u_x_tip_cm`` is 3 + 0.7 h^2 + 0.2 dt, and 1 % more where the viscosity is 0.2; ``p_z_lower_mmHg`` is a wave of size
1 + h; ``shaky_cm`` changes sign from grid to grid and settles, ``worse_cm`` grows apart, ``fixed_cm`` stays.
``block_J_max`` and ``largest_at_s`` go with h, and are an extreme and a time.
A spacing that stands in ``broken`` of the folder above fails; what began is written to ``events`` there.
"""

from __future__ import annotations

import itertools
import json
import math
import sys
from pathlib import Path

ROWS, T_END = 40, 0.2


def main() -> None:
    """Run."""
    words = sys.argv[1:]
    out = Path(words[words.index("--out") + 1])
    values = dict(text.split("=", 1) for flag, text in itertools.pairwise(words) if flag == "--set")
    h, dt = float(values["grid.h"]), float(values.get("time.dt", "0.01 s").split()[0])
    with (out.parent / "events").open("a") as file:
        file.write(f"{out.name}\n")
    broken = out.parent / "broken"
    if broken.exists() and float(broken.read_text()) == h:
        sys.exit("ConvergenceError: it does not converge")
    lines = ["step,t_s,p_z_lower_mmHg,still_cm"]
    for step in range(ROWS + 1):
        t = T_END * step / ROWS
        lines.append(f"{step},{t!r},{math.sin(2 * math.pi * t) * (1.0 + h)!r},0.0")
    (out / "history.csv").write_text("\n".join(lines) + "\n")
    level = round(math.log2(0.25 / h))
    last = {
        "step": float(ROWS),
        "t_s": T_END,
        "u_x_tip_cm": (3.0 + 0.7 * h**2 + 0.2 * dt)
        * (1.01 if values.get("fluid.viscosity") == "0.2" else 1.0),
        "shaky_cm": 1.0 + (-0.5) ** level,
        "worse_cm": 2.0**level,
        "fixed_cm": 4.0,
        "kinetic_energy_erg": 2.0 + h,
        "block_J_max": 1.0 + h,
        "largest_at_s": 0.1 + h,
    }
    timing = {"steps": ROWS, "wall_s": 1.0}
    (out / "summary.json").write_text(json.dumps({"last": last, "timing": timing}))


if __name__ == "__main__":
    main()
