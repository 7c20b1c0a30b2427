"""Energies that the tests of materials share, compiled once, and states to try them in."""

from __future__ import annotations

import functools
import math

import numpy as np

from tests.solid.pointwise import Pointwise
from valvefsi.solid.materials import (
    HGO,
    Fung,
    HolzapfelOgden,
    LeeSacks,
    MayNewmanYin,
    MooneyRivlin,
    NeoHookean,
    SaintVenantKirchhoff,
    Volumetric,
)
from valvefsi.solid.materials.fibre_reinforced import FibreFamily

FAMILIES = (
    FibreFamily(k1=4.0, k2=1.5, kappa=0.1, fibre=25.0),
    FibreFamily(k1=2.0, k2=0.5, kappa=0.0, fibre=-60.0),
)
ISOTROPIC = [
    NeoHookean(c1=80.194),
    MooneyRivlin(c1=3.0, c2=5.0),
    LeeSacks(c0=6.0, c1=2.0, c2=0.7),
    HGO(c10=3.0, c01=0.8),
    SaintVenantKirchhoff(mu=4.0, lam=3.0),
]
VOLUMETRIC = [Volumetric(kappa=374.24, form=form) for form in Volumetric.FORMS]
HOLZAPFEL_OGDEN = HolzapfelOgden(
    a=2.0, b=0.9, a_f=3.0, b_f=1.2, a_s=1.0, b_s=0.8, a_fs=0.7, b_fs=1.1, fibre=30.0, sheet=120.0
)
FUNG = Fung(
    c=2.0, a1=2.0, a2=1.0, a3=0.4, a4=3.0, a5=1.5, a6=0.2, a7=-0.3, a8=2.0, a9=1.0, fibre=20, sheet=110
)
WITH_FIBRES = [
    HGO(c10=3.0, c01=0.8, families=FAMILIES[:1]),
    HGO(c10=3.0, c01=0.8, families=FAMILIES),
    HOLZAPFEL_OGDEN,
    MayNewmanYin(c0=5.0, c1=0.8, c2=3.0, fibre=40.0),
    FUNG,
    HGO(c10=3.0, c01=0.8, families=[FibreFamily(k1=4.0, k2=1.5, kappa=0.1, lam_max=1.04, fibre=25.0)]),
]
MATERIAL_LIST = ISOTROPIC + WITH_FIBRES
ENERGIES = MATERIAL_LIST + VOLUMETRIC


def name(energy):
    extra = len(energy.families) if isinstance(energy, HGO) else getattr(energy, "form", "")
    return f"{type(energy).__name__}{extra}"


@functools.cache
def pointwise(energy, dim=3):
    """Return the compiled energy; all tests share it."""
    return Pointwise(energy, dim)


def random_gradients(dim, count=4):
    rng = np.random.default_rng(7)
    return [np.eye(dim) + 0.35 * rng.uniform(-1, 1, (dim, dim)) for _ in range(count)]


def random_rotation(dim):
    Q, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(dim, dim)))
    return Q if np.linalg.det(Q) > 0 else Q[:, ::-1]


def central_difference(function, F, step=1e-5):
    shape = np.shape(function(F))
    difference = np.zeros((*shape, *F.shape))
    for i, j in np.ndindex(F.shape):
        change = np.zeros_like(F)
        change[i, j] = step
        difference[..., i, j] = (function(F + change) - function(F - change)) / (2 * step)
    return difference


def along(degrees):
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])


def planar(material, l1, l2):
    F = np.diag([l1, l2, 1 / (l1 * l2)])
    cauchy = pointwise(material)(F)[1] @ F.T
    return np.diag(cauchy)[:2] - cauchy[2, 2]
