"""Patches of points: how large they are, where they stop."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from valvefsi.geometry.aortic_section import AorticSection, closing_plate
from valvefsi.geometry.patches import APART, SEAM, SINGLE, patch_labels

H = 0.1
TUBE = AorticSection(inlet_radius=0.8, outlet_radius=0.8, sinus_depth=0.0).housing(H, (0.0, 2.0))
DISK = closing_plate(0.8, 1.0, H)


def test_a_patch_is_about_two_spacings_across():
    labels = patch_labels([TUBE], H)
    areas = np.bincount(labels, TUBE.areas)
    assert labels.min() == 0
    # A dense packing of middles that are APART h from one another, and one as loose as a point between three allows.
    tight, loose = math.sqrt(3.0) / 2.0, 1.5 * math.sqrt(3.0)
    assert tight * (APART * H) ** 2 < areas.mean() < loose * (APART * H) ** 2
    for k in range(labels.max() + 1):
        points = TUBE.points[labels == k]
        assert np.linalg.norm(points - points.mean(axis=0), axis=1).max() < (APART + 0.5) * H


def test_points_near_another_surface_a_seam_or_an_end_are_single():
    labels = patch_labels([TUBE, DISK], H, (0.0, 2.0), np.array([[0.8, 0.0, 1.6]]))
    tube, disk = labels[: len(TUBE.points)], labels[len(TUBE.points) :]
    z = TUBE.points[:, 2]
    line = cKDTree(DISK.points).query(TUBE.points)[0]
    near = (z < SEAM * H) | (2.0 - z < SEAM * H) | (line < SEAM * H)
    near |= np.linalg.norm(TUBE.points - [0.8, 0.0, 1.6], axis=1) < SEAM * H
    np.testing.assert_array_equal(tube == SINGLE, near)
    rim = np.hypot(*DISK.points[:, :2].T) > 0.8 - 0.9 * SEAM * H
    assert (disk[rim] == SINGLE).all()
    assert (disk[~rim] != SINGLE).any()
    assert not set(tube[tube != SINGLE]) & set(disk[disk != SINGLE])
