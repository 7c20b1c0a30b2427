"""What the columns of a history are called and measured in, on screens and in tables and pictures."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

from valvefsi.units import MMHG

COLUMNS = {
    "dyn_per_cm2": ("dyn/cm^2", 1.0 / MMHG, "mmHg"),
    "cm3_per_s": ("cm^3/s", 1.0, "ml/s"),
    "erg_per_s": ("erg/s", 1e-4, "mW"),
    "dyn_per_cm": ("dyn/cm", 1.0, "mN/m"),
    "l_per_min": ("l/min", 1.0, "l/min"),
    "ml_per_s": ("ml/s", 1.0, "ml/s"),
    "cm_per_s": ("cm/s", 1.0, "cm/s"),
    "ml_s": ("ml/s", 1.0, "ml/s"),
    "percent": ("%", 1.0, "%"),
    "mmHg": ("mmHg", 1.0, "mmHg"),
    "cm2": ("cm^2", 1.0, "cm^2"),
    "cm3": ("cm^3", 1.0, "ml"),
    "dyn": ("dyn", 1e-2, "mN"),
    "erg": ("erg", 1e-4, "mJ"),
    "cm": ("cm", 10.0, "mm"),
    "mm": ("mm", 1.0, "mm"),
    "kPa": ("kPa", 1.0, "kPa"),
    "Pa_s": ("Pa*s", 1.0, "Pa*s"),
    "Pa": ("Pa", 1.0, "Pa"),
    "Hz": ("Hz", 1.0, "Hz"),
    "mJ": ("mJ", 1.0, "mJ"),
    "ml": ("ml", 1.0, "ml"),
    "ms": ("ms", 1.0, "ms"),
    "s": ("s", 1.0, "s"),
}
"""How the name of a column of a history ends: its unit, and factor and unit that a lab uses."""
OF_A_DEPTH = ("cm3_per_s", "erg_per_s", "l_per_min", "ml_per_s", "ml_s", "cm3", "dyn", "erg", "ml")
"""What is of a centimetre of depth in two dimensions."""
WORDS = {
    "pdva": "PDVA",
    "courant": "Courant number",
    "von_mises": "von Mises stress",
    "green_strain": "Green strain",
    "reynolds": "Reynolds number",
    "_J_min": " J, smallest at a point",
    "_J_max": " J, largest at a point",
}
"""Parts of names that are not said as they stand."""


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """How the values of a column are shown.

    Attributes:
        words: What it is called.
        unit: The unit it is shown in, "" of a pure number.
        factor: How many of these one of the column's is.
    """

    words: str
    unit: str
    factor: float

    @property
    def label(self) -> str:
        """Name and unit at an axis, powers as in cm^2."""
        words = re.sub(r"^u ([xyz])\b", r"$u_\1$", self.words)
        return f"{words} [{self.unit or '-'}]"

    @property
    def heading(self) -> str:
        """Name and unit over a column of a table."""
        return f"{self.words} [{self.unit}]" if self.unit else self.words


@dataclass(frozen=True, kw_only=True)
class Units:
    """The units that a run is shown in.

    Attributes:
        system: "lab" (mm, mmHg, ml/s, mJ) or "cgs".
        dim: Dimensions of the run; in two, flows, forces and energies are of a centimetre of depth.
    """

    system: str = "lab"
    dim: int = 3

    def of(self, column: str) -> Quantity:
        """Return how a column is shown.

        Args:
            column: Its name, whose end names its unit.
        """
        end = ending(column)
        unit, factor, lab = COLUMNS[end] if end else ("", 1.0, "")
        words = column.removesuffix(f"_{end}") if end else column
        for part, said in WORDS.items():
            words = words.replace(part, said)
        unit, factor = (lab, factor) if self.system == "lab" else (unit, 1.0)
        words = re.sub(r"_p(\d\d)$", r", \1th percentile", words)
        words = re.sub(r"^p(\d\d)$", r"\1th percentile", words)
        depth = " per cm" if self.dim == 2 and end in OF_A_DEPTH else ""
        return Quantity(words=words.replace("_", " "), unit=unit + depth, factor=factor)


LAB = Units()
"""Those of a lab, in space."""


def name_of(path: str) -> str:
    """Return what a number of a summary is called by its path: the last of it that says what it is, and of what.

    ``valve.leaflets.leaflet_1.von_mises_p99_kPa.value`` is ``leaflet_1_von_mises_p99_kPa``, ``last.u_x_tip_cm`` is
    ``u_x_tip_cm``.
    """
    *parts, last = path.split(".")
    if last != "value" or not parts:
        return last
    return "_".join(parts[-2:] if len(parts) > 2 else parts[-1:])


def ending(name: str) -> str | None:
    """Return the end of a column's name that says its unit, a key of `COLUMNS`; None of a pure number."""
    return next((end for end in COLUMNS if name.endswith(f"_{end}")), None)


def units_of_run(folder: Path) -> Units:
    """Return the units that the case in the folder of a run asks for; a lab's in space where there is none."""
    try:
        case = tomllib.loads((Path(folder) / "case.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return LAB
    dim = len(case.get("grid", {}).get("lower", ())) or 3
    return Units(system=case.get("output", {}).get("units", "lab"), dim=dim)
