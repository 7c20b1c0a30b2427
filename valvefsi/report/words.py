"""What numbers and files are called, and what they mean: definitions come from where the numbers are made."""

from __future__ import annotations

import inspect
import re

from valvefsi.post.valve_numbers import CycleNumbers

PICTURES = {
    "valve.png": "Pressures before and after the valve, flow through it and its open area over the run.",
    "leaflets.png": "The leaflets from downstream at moments of the cycle; what is dark is open.",
    "free_edges.png": "The free edges of the leaflets from downstream, and the way of their middles over time.",
    "histories.png": "Displacements of the probes and volume change of the solids over the run.",
    "energy.png": "The terms of the balance of energy over the run.",
    "flow.png": "The flow at the end of the run, with the solids coloured by their change of volume.",
    "profiles.png": "Profiles along lines through the flow.",
    "fit.png": "The data with the fitted curve, and their difference.",
    "comparison.png": "Waveforms of both over one cycle, each with their difference under it.",
    "verification.png": "Numbers over the spacing with the uncertainty of the finest; differences of waveforms.",
    "sample.png": "Sobol indices of each output, and the output of every sample over the input that counts most.",
    "sweep.png": "Numbers of the members against the first key that varies.",
}
"""What is seen in pictures of a name."""
FITTED_PROFILES = "Least cost over all other parameters against each parameter, with the 95 % threshold."
PEAKS = {
    "green_strain_p99": "largest principal Green strain, exceeded in 1 % of the leaflet's volume [-]",
    "green_strain_max": "largest principal Green strain at any point [-]",
    "von_mises_p99_kPa": "von Mises stress, exceeded in 1 % of the leaflet's volume [kPa]",
    "von_mises_max_kPa": "largest von Mises stress at any point [kPa]",
}
"""Columns of ``leaflets.csv``."""
TERMS = {
    "kinetic": "change of the kinetic energy of the fluid",
    "pressures": "work of the pressures on the sides of the box",
    "inflow": "kinetic energy that comes in with the fluid, less what leaves",
    "viscosity": "loss to the viscosity of the fluid",
    "scheme": "loss to the advection scheme, its numerical dissipation",
    "bodies": "work of the bodies on the fluid",
    "residual": "what is left: of integration in time, of sides and their backflow",
    "residual_percent": "the residual over the work that comes in, |pressures| + |inflow|",
}
"""Terms of the balance of energy, see `valvefsi.run.energy`."""
POWERS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
ITEM = re.compile(r"^ {4,}(\w+): (.+?)(?=^ {4,}\w+: |\Z)", re.M | re.S)


def pretty(unit: str) -> str:
    """Return a unit with raised powers."""
    return re.sub(r"\^(-?\d+)", lambda match: match[1].translate(POWERS), unit).replace("*", " ")


def definitions() -> dict[str, str]:
    """Return the definitions of a valve's numbers, by name, from where they are computed."""
    text = inspect.getdoc(CycleNumbers) or ""
    items = ITEM.findall(text.partition("Attributes:\n")[2])
    named = re.compile("|".join(name for name, _ in items if "_" in name))
    found = {}
    for name, said in items:
        words = re.sub(r" ?\[[^]]*\]\.?$", "", " ".join(said.replace("``", "").split())).rstrip(".")
        found[name] = named.sub(lambda match: match[0].replace("_", " "), words)
    return found


def defined(name: str, known: dict[str, str]) -> tuple[str, str, str]:
    """Return words, unit and definition of a valve's number, from its name with a unit at the end.

    Args:
        name: The name, as ``summary.json`` has it.
        known: Definitions, see `definitions`.
    """
    key = max((key for key in known if name == key or name.startswith(f"{key}_")), key=len, default=name)
    unit = name[len(key) + 1 :].replace("_per_", "/").replace("percent", "%").replace("cm2", "cm^2")
    return key.replace("_", " "), pretty(unit), known.get(key, "")
