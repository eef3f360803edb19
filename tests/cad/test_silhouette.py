"""Silhouettes of resting solids, beside hulls of points and outlines that prisms have."""

import numpy as np
import pytest
import shapely
import trimesh
from scipy.spatial.transform import Rotation
from solids import ELL, prism

from palpate.cad.parts import Solid, StableState
from palpate.cad.resting_surface import silhouette


def resting(mesh, rotation):
    vertices = np.asarray(mesh.vertices, dtype=float)
    offset = np.array([0.0, 0.0, -(vertices @ rotation[2]).min()])
    state = StableState("a", rotation, offset, 1.0, 0.5, np.zeros((3, 2)))
    return (
        Solid("part", vertices, np.asarray(mesh.faces, dtype=np.int64)),
        state,
        vertices @ rotation.T + offset,
    )


def area(rings):
    whole = shapely.Polygon()
    for ring in rings:
        whole = whole.symmetric_difference(shapely.Polygon(ring))
    return whole


@pytest.mark.parametrize("seed", range(5))
def test_of_a_convex_solid_it_is_the_hull_of_its_points(seed):
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.normal(size=(400, 3)) * [30, 12, 8])
    solid, state, points = resting(mesh, Rotation.random(random_state=seed).as_matrix())
    wide, deep = np.ptp(points[:, :2], axis=0)
    hull = shapely.MultiPoint(points[:, [0, 2]] if wide >= deep else points[:, [1, 2]]).convex_hull
    seen = area(silhouette(solid, state))
    size = max(np.ptp(points, axis=0))
    assert shapely.hausdorff_distance(seen, hull) < 0.015 * size
    assert seen.bounds[1] == pytest.approx(0.0, abs=0.01 * size)


def test_an_angle_profile_shows_its_legs_and_a_tube_its_hole():
    upright = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # the outline is seen from the side
    solid, state, _ = resting(prism(ELL, 20.0), upright)
    seen = area(silhouette(solid, state))
    assert shapely.hausdorff_distance(seen, shapely.affinity.translate(ELL, 0, 0)) < 1.0
    ring = shapely.Point(0, 0).buffer(12).difference(shapely.Point(0, 0).buffer(8))
    solid, state, _ = resting(prism(ring, 20.0), upright)
    rings = silhouette(solid, state)
    assert len(rings) == 2
    assert area(rings).area == pytest.approx(ring.area, rel=0.05)
