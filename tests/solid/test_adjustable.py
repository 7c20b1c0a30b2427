"""Energies whose numbers are constants: one form for all of them, and the same energy."""

from __future__ import annotations

import pytest

from valvefsi.runtime import dolfinx_compat as compat

# isort: split
import ufl
from dolfinx import fem

from valvefsi.geometry.shapes import box
from valvefsi.solid.materials import HolzapfelOgden, Volumetric
from valvefsi.solid.materials.constants import adjustable
from valvefsi.solid.materials.fibre_reinforced import HGO, FibreFamily
from valvefsi.solid.materials.kinematics import Kinematics


def hgo(c10=100.0, k1=50.0, kappa=0.1):
    family = FibreFamily(k1=k1, k2=3.0, kappa=kappa, fibre=(1.0, 1.0, 0.0))
    return HGO(c10=c10, c01=2.0, families=(family,), width=0.01)


@pytest.fixture
def kinematics(comm):
    """A cube that is pulled and sheared."""
    mesh = box(comm, elements=(1, 1, 1)).mesh
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (3,))))
    u.interpolate(lambda x: [0.2 * x[0], 0.1 * x[0] - 0.05 * x[1], -0.1 * x[2]])
    return Kinematics(ufl.variable(ufl.Identity(3) + ufl.grad(u)))


def form(energy, kinematics):
    return energy.energy(kinematics) * ufl.dx(degree=2)


def test_numbers_alone_make_no_other_form(kinematics):
    one, other = (form(adjustable(m), kinematics).signature() for m in (hgo(), hgo(120.0, 60.0, 0.2)))
    assert one == other
    assert one != form(adjustable(hgo(kappa=0.0)), kinematics).signature(), (
        "a number that is 0 stands in the code"
    )
    assert form(hgo(), kinematics).signature() != form(hgo(120.0), kinematics).signature()
    volumes = [form(adjustable(Volumetric(kappa=k)), kinematics).signature() for k in (1.0, 2.0)]
    assert volumes[0] == volumes[1]


def test_the_energy_is_the_same(kinematics, comm):
    plain, made = (
        fem.assemble_scalar(compat.compile_form(form(m, kinematics))) for m in (hgo(), adjustable(hgo()))
    )
    assert made == pytest.approx(plain, rel=1e-13)
    assert comm.allreduce(plain) > 0


def test_an_energy_that_decides_by_its_numbers_keeps_them(kinematics):
    material = HolzapfelOgden(a=1.0, b=2.0, a_f=3.0, b_f=4.0)
    assert form(adjustable(material), kinematics).signature() == form(material, kinematics).signature()
    assert adjustable(material).shear_modulus == 1.0
