"""The written-out forces of solid-shell elements against those that DOLFINx assembles from the same energy."""

from __future__ import annotations

import numpy as np
import pytest

from valvefsi.geometry.shapes import box
from valvefsi.solid.materials import Fung, HolzapfelOgden, MooneyRivlin, NeoHookean, fibres
from valvefsi.solid.materials.cardiac import Guccione
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.structure import Discretisation, Structure

AXES = {"fibre": (0.8, 0.6, 0.0), "sheet": (-0.6, 0.8, 0.0)}
ROUNDED = FibreFamily(k1=24.0, k2=15.0, kappa=0.29, fibre="fibre")
STRAIGHT = FibreFamily(k1=2.0, k2=5.0, lam_max=1.02, fibre="fibre")


class Sum:
    """A material that sees the metric through each of the invariants, C and F."""

    shear_modulus = 3.0
    parts = (
        MooneyRivlin(c1=3.0, c2=2.0),
        HGO(c10=1.0, c01=22.6, families=(ROUNDED, STRAIGHT), width=1e-3),
        HolzapfelOgden(a=3.0, b=2.0, a_f=5.0, b_f=4.0, a_s=2.0, b_s=3.0, a_fs=1.0, b_fs=2.0, **AXES),
        Fung(c=3.0, a1=2.0, a2=1.0, a3=0.5, a4=1.0, a5=1.5, a8=2.0, a9=1.0, **AXES),
        Guccione(C=3.0, bf=8.0, bt=2.0, bfs=4.0, fibre="fibre"),
    )

    def energy(self, kinematics):
        return sum(part.energy(kinematics) for part in self.parts)


def warped(X):
    """A deformation that bends, twists, shears and thickens."""
    x, y, z = X.T
    return X + np.stack(
        [0.1 * y * z - 0.05 * x**2, 0.08 * x * y, 0.2 * x**2 + 0.1 * x * y + 0.02 * z], axis=1
    )


def along(X):
    """Fibres that turn along the strip."""
    return np.stack([np.cos(X[:, 0]), np.sin(X[:, 0]), 0 * X[:, 0]], axis=1)


@pytest.mark.parametrize("mirrored", [False, True], ids=["right-handed", "left-handed"])
@pytest.mark.parametrize("material", [NeoHookean(c1=3.0), Sum()], ids=["linear", "all"])
def test_written_out_forces_are_those_that_dolfinx_assembles_from_the_energy(comm, material, mirrored):
    mesh = box(comm, lower=(0.0, 0.0, -0.02), size=(1.0, 0.5, 0.04), elements=(4, 3, 1))
    X = mesh.mesh.geometry.x
    X[:] = warped(X) * [1.0, 1.0, -1.0 if mirrored else 1.0]
    mesh = mesh.with_fibres(fibre=fibres.from_function(mesh, along))
    options = Discretisation(element="solid_shell", kappa=400.0)
    solid = Structure(mesh, material, discretisation=options)
    elements = solid.elasticity
    elements.set_position(warped(solid.X))
    elements.cells.scale_bulk(0.7)
    forces, assembled = elements.cells.forces(), elements.cells.assembled()()
    assert not np.shares_memory(forces, assembled)
    assert np.abs(assembled).max() > 1e-4
    np.testing.assert_allclose(forces, assembled, rtol=0.0, atol=1e-12 * np.abs(assembled).max())
