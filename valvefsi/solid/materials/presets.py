"""Named parameter sets of materials, each with where it comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

LEAFLET_HGO = "modified HGO leaflet model of Lee et al. 2020 (J Thorac Cardiovasc Surg), eqs 4-5"


@dataclass(frozen=True, kw_only=True)
class Preset:
    """A material with its parameters and their provenance.

    Args:
        model: Name of the material in a case file.
        parameters: Its parameters in CGS, as a case file gives them.
        provenance: Where they come from; starts with "unverified" where nobody has checked them.
    """

    model: str
    parameters: Mapping[str, object]
    provenance: str

    @property
    def verified(self) -> bool:
        """Whether the numbers were read in the source named."""
        return not self.provenance.startswith("unverified")


ROUNDING = 1e-3
"""Width of the transition where dispersed fibres begin to bear: their stress would jump there, and a valve that is shut
holds many points at the jump, which the stable step pays with a factor of four. Outside the
corner it moves stresses above 30 kPa by 0.3 % at most [-]."""


def _family(k1: float, k2: float, kappa: float) -> dict[str, object]:
    return {"k1": k1, "k2": k2, "kappa": kappa, "fibre": "fibre"}


PRESETS: dict[str, Preset] = {
    "bovine_pericardium_hgo": Preset(
        model="hgo",
        parameters={
            "c10": 1.19e3,
            "c01": 22.59,
            "families": (_family(2.38e7, 149.8, 0.292),),
            "width": ROUNDING,
        },
        provenance=f"unverified: remembered constants of the {LEAFLET_HGO};"
        " C10 = 0.119 kPa, C01 = 22.59, k1 = 2.38 MPa, k2 = 149.8, kappa = 0.292",
    ),
    "porcine_leaflet_hgo": Preset(
        model="hgo",
        parameters={"c10": 1.21e4, "c01": 7.99, "families": (_family(2.426e5, 57.62, 0.0),)},
        provenance=f"unverified: remembered constants of the {LEAFLET_HGO};"
        " C10 = 1.21e4, k1 = 2.426e5 dyn/cm^2, C01 = 7.99, k2 = 57.62; the dispersion is not known, 0 is a guess",
    ),
    "bovine_pericardium_lee_sacks": Preset(
        model="lee_sacks",
        parameters={"c0": 676080.0, "c1": 132848.0, "c2": 38.1878},
        provenance="published: defaults of CouDALFISh for bovine pericardium, thickness 0.0386 cm",
    ),
}
"""Parameter sets by the name a case file uses. The fibres are those of the mesh field called "fibre"."""
