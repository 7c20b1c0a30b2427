"""Hyperelastic materials W(F, fibres), their parameters and presets, and fibre fields."""

from valvefsi.solid.materials.fibre_reinforced import HGO, Fung, HolzapfelOgden, MayNewmanYin
from valvefsi.solid.materials.laws import (
    MATERIALS,
    LeeSacks,
    Material,
    MooneyRivlin,
    NeoHookean,
    SaintVenantKirchhoff,
    Volumetric,
    find_material,
    kappa_stab,
    load_material,
    stabilisation,
)

__all__ = [
    "HGO",
    "MATERIALS",
    "Fung",
    "HolzapfelOgden",
    "LeeSacks",
    "Material",
    "MayNewmanYin",
    "MooneyRivlin",
    "NeoHookean",
    "SaintVenantKirchhoff",
    "Volumetric",
    "find_material",
    "kappa_stab",
    "load_material",
    "stabilisation",
]
