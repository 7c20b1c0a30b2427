"""Statics: the deformation under given loads, exactly or nearly incompressible."""

from valvefsi.solid.statics.contact import Contact, contact_area
from valvefsi.solid.statics.formulations import EqualOrder, NearlyIncompressible, TaylorHood
from valvefsi.solid.statics.problem import (
    TAYLOR_HOOD,
    LoadStep,
    SolverOptions,
    StaticSolution,
    evaluate_at,
    solve,
)
from valvefsi.solid.statics.shell import SolidShell
from valvefsi.solid.statics.supports import Fixed, Symmetry, rotation

__all__ = [
    "TAYLOR_HOOD",
    "Contact",
    "EqualOrder",
    "Fixed",
    "LoadStep",
    "NearlyIncompressible",
    "SolidShell",
    "SolverOptions",
    "StaticSolution",
    "Symmetry",
    "TaylorHood",
    "contact_area",
    "evaluate_at",
    "rotation",
    "solve",
]
