"""The aortic test section: areas against closed forms and quadrature, distances of points, the stent's outline."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from valvefsi.errors import CaseError
from valvefsi.geometry.aortic_section import SPACING, AorticSection, closing_plate, joined
from valvefsi.geometry.leaflets import pericardial
from valvefsi.geometry.stent import FormulaEdge, stent_height, stent_wall

TUBE = AorticSection(inlet_radius=1.2, outlet_radius=1.2, sinus_depth=0.0)


def test_a_tube_has_the_area_of_a_cylinder():
    surface = TUBE.housing(0.1, (-1.0, 3.0))
    assert surface.areas.sum() == pytest.approx(2.0 * math.pi * 1.2 * 4.0, rel=1e-9)
    assert np.hypot(*surface.points[:, :2].T) == pytest.approx(1.2, rel=1e-12)
    assert surface.points[:, 2].min() == -1.0
    assert surface.points[:, 2].max() == 3.0


def test_the_housing_has_the_area_of_its_formula():
    section = AorticSection()
    n, m = 1200, 1500
    phi = 2.0 * math.pi * (np.arange(n) + 0.5) / n
    s = (np.arange(m) + 0.5) / m * section.sinus_height
    P, Z = np.meshgrid(phi, s + section.annulus, indexing="ij")
    r, e = section.radius(P, Z), 1e-6
    around = (section.radius(P + e, Z) - section.radius(P - e, Z)) / (2 * e)
    up = (section.radius(P, Z + e) - section.radius(P, Z - e)) / (2 * e)
    exact = np.sqrt(r**2 * (1 + up**2) + around**2).sum() * (2 * math.pi / n) * (section.sinus_height / m)
    surface = section.housing(0.05, (section.annulus, section.annulus + section.sinus_height))
    assert surface.areas.sum() == pytest.approx(exact, rel=2e-4)


def test_its_deepest_point_lies_behind_the_middle_of_a_leaflet():
    section = AorticSection()
    half = section.annulus + 0.5 * section.sinus_height
    behind, post = section.radius(np.array([0.0, math.pi / 3.0]), np.full(2, half))
    base = 0.5 * (section.inlet_radius + section.outlet_radius)
    assert behind == pytest.approx(base + section.sinus_depth)
    assert post == pytest.approx(base)
    assert section.widest >= behind


@pytest.mark.parametrize("h", [0.1, 0.07])
def test_no_place_of_the_housing_is_far_from_a_point(h):
    section = AorticSection()
    points = section.housing(h, (-1.0, 3.0)).points
    rng = np.random.default_rng(1)
    phi, z = rng.uniform(0, 2 * math.pi, 20000), rng.uniform(-1.0, 3.0, 20000)
    r = section.radius(phi, z)
    there = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    distance, _ = cKDTree(points).query(there)
    # Half the diagonal of a patch whose edges are at most the spacing, with a little skew.
    assert distance.max() < 1.1 * SPACING * h * math.sqrt(0.5)


def test_the_stent_ends_where_the_leaflets_are_attached():
    valve = pericardial()
    u = np.linspace(-1.0, 1.0, 41)
    line = valve.attachment(u)
    phi = np.arctan2(line[:, 1], line[:, 0])
    assert stent_height(valve, phi)[1:-1] == pytest.approx(line[1:-1, 2], abs=1e-9)
    turned = stent_height(valve, phi + 2.0 * math.pi / 3.0)
    assert turned[1:-1] == pytest.approx(line[1:-1, 2], abs=1e-9)
    assert stent_height(valve, np.array([math.pi / 3.0])) == pytest.approx(valve.height)  # a post


def test_the_area_of_the_stent_is_that_under_its_outline():
    valve = pericardial()
    phi = 2.0 * math.pi * (np.arange(6000) + 0.5) / 6000
    exact = valve.radius * (stent_height(valve, phi) + 0.2).mean() * 2.0 * math.pi
    surface = stent_wall(FormulaEdge(valve, 0.0), -0.2, lambda phi: np.full_like(phi, valve.radius), 0.02)
    assert surface.areas.sum() == pytest.approx(exact, rel=5e-3)
    assert surface.points[:, 2].max() == pytest.approx(valve.height)


def test_a_plug_has_the_area_of_a_disk_and_surfaces_join():
    disk = closing_plate(1.2, 0.5, 0.1)
    assert disk.areas.sum() == pytest.approx(math.pi * 1.2**2, rel=1e-12)
    both = joined(TUBE.housing(0.2, (0.0, 1.0)), disk)
    assert len(both.points) == len(both.areas)
    assert both.points[-1, 2] == 0.5


@pytest.mark.parametrize(
    ("key", "value"), [("inlet_radius", 0.0), ("sinus_height", -1.0), ("sinus_depth", -0.1)]
)
def test_a_dimension_that_cannot_be_is_refused(key, value):
    with pytest.raises(CaseError, match=key):
        AorticSection(**{key: value})
