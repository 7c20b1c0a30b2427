"""A material of one's own, as a user writes it beside a case."""

from __future__ import annotations

GENT = """
from dataclasses import dataclass
import ufl
from valvefsi.solid.materials.parameters import parameter

@dataclass(frozen=True, kw_only=True)
class Gent:
    mu: float = parameter("dyn/cm^2", above=0.0)
    limit: float = parameter("1", above=0.0)

    @property
    def shear_modulus(self):
        return self.mu

    def energy(self, kinematics):
        return -self.mu * self.limit / 2 * ufl.ln(1 - (kinematics.I1_bar - 3) / self.limit)
"""
