"""Directions relative to a leaflet's own: fields of the mesh, what a fit writes, what is refused on a valve."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest

from tests.case.test_case_valve import COARSE, DEMO
from valvefsi.case import load_case
from valvefsi.case.fibres import add_fibres
from valvefsi.case.material_tables import Material
from valvefsi.case.meshes import valve_mesh
from valvefsi.case.valve_tables import ValveShape
from valvefsi.errors import CaseError

HGO = {"model": "hgo", "c10": "1 kPa", "c01": 8.0}


def material_of(*directions):
    families = [{"k1": "20 kPa", "k2": 50.0, "fibre": direction} for direction in directions]
    return Material(**HGO, families=families)


def in_toml(*directions):
    families = ", ".join(f"{{ k1 = '20 kPa', k2 = 50.0, fibre = {direction} }}" for direction in directions)
    return f"solid.leaflets.material={{ model = 'hgo', c10 = '1 kPa', c01 = 8.0, families = [{families}] }}"


def vectors(mesh, name):
    return mesh.fibres[name].x.array.reshape(-1, 3)


def test_an_angle_from_circumferential_is_that_of_the_valves_own_families(comm):
    mesh = valve_mesh(ValveShape(type="pericardial"), 0.3, comm)
    material = material_of("45 deg from circumferential", "-45.0 deg from circumferential")
    mesh = add_fibres(mesh, (), "solid.leaflets", material)
    names = [family["fibre"] for family in material.parameters["families"]]
    for name, own in zip(names, ("fibre_1", "fibre_2"), strict=True):  # made of the angles by the mesh itself
        assert np.abs(vectors(mesh, name) - vectors(mesh, own)).max() < 1e-12


def test_an_angle_turns_with_the_leaflets_and_lies_in_their_surface(comm):
    mesh = valve_mesh(ValveShape(type="porcine"), 0.3, comm)
    mesh = add_fibres(mesh, (), "solid.leaflets", material_of("30 deg from circumferential"))
    a, around, up = (
        vectors(mesh, name) for name in ("30.0 deg from circumferential", "circumferential", "radial")
    )
    assert np.einsum("ni,ni->n", a, around) == pytest.approx(math.cos(math.pi / 6), abs=1e-12)
    assert np.einsum("ni,ni->n", a, up) == pytest.approx(0.5, abs=1e-12)
    X = mesh.fibres["radial"].function_space.tabulate_dof_coordinates()[: len(a)]
    X, a = (np.concatenate(comm.allgather(part)) for part in (X, a))
    c, d = -0.5, math.sqrt(0.75)
    turn = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]])  # to the next leaflet
    nearest = np.linalg.norm((X @ turn.T)[:, None] - X[None], axis=2)
    assert nearest.min(axis=1).max() < 1e-9
    assert np.abs(a @ turn.T - a[nearest.argmin(axis=1)]).max() < 1e-9


def test_a_direction_in_space_is_refused_on_three_leaflets_with_the_way_out():
    for direction, offered in (
        ("45.8", "45.8 deg from circumferential"),
        ("[1, 0, 0]", "45 deg"),
        ("0", "0 deg"),
    ):
        with pytest.raises(CaseError, match=rf"material\.families\.1\.fibre = .*{offered}.*fibre_1"):
            load_case(DEMO, [*COARSE, in_toml("'fibre_1'", direction)])
    fixed = "solid.leaflets.fibre=[{ name = 'along_x', rule = 'constant', direction = [1, 0, 0] }]"
    with pytest.raises(CaseError, match="'along_x': one direction in space"):
        load_case(DEMO, [*COARSE, fixed, in_toml("'along_x'")])
    assert load_case(DEMO, [*COARSE, in_toml("'fibre_1'", "'-30 deg from circumferential'")])


def test_a_mesh_without_the_leaflets_directions_says_which_fields_it_lacks(comm):
    from valvefsi.geometry.shapes import box

    mesh = box(comm, size=(1.0, 1.0, 1.0), elements=(1, 1, 1))
    with pytest.raises(
        CaseError, match=r"material\.families\.0\.fibre = .*fibre field circumferential and radial"
    ):
        add_fibres(mesh, (), "solid.strip", material_of("20 deg from circumferential"))


def test_what_a_fit_writes_is_a_valves_material(comm):
    from tests.fitting.biaxial_synthetic import records_of
    from valvefsi.fitting.biaxial import fit_biaxial
    from valvefsi.fitting.planar_hgo import HGO as Planar

    data = records_of(Planar(), [1.5, 5.0, 0.12, 25.0, 20.0, 8.0], shear=0.15)
    mesh = valve_mesh(ValveShape(), 0.3, comm)
    for axis1, angle in (("circumferential", 25.0), ("radial", 65.0)):
        fitted = fit_biaxial(data, "hgo", axis1=axis1, starts=4, profiles=False, draws=0)
        material = Material(**tomllib.loads(fitted.material_toml()))
        (family,) = material.parameters["families"]
        degrees, _, rest = family["fibre"].partition(" ")
        assert float(degrees) == pytest.approx(angle, abs=1e-4)
        assert rest == "deg from circumferential"
        found = vectors(add_fibres(mesh, (), "", material), family["fibre"])
        turn = np.einsum("ni,ni->n", found, vectors(mesh, "circumferential"))
        assert turn == pytest.approx(math.cos(math.radians(angle)), abs=1e-5)
