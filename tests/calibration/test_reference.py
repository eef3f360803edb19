"""Distances from references against shapely, their normals and rooms, and what is refused as a plate."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from palpate.base.geometry import Floats
from palpate.calibration.finger_step import plan_placements
from palpate.calibration.reference import Reference, ReferenceDisc, ReferencePlate

FEW = settings(max_examples=40, deadline=None)
STEP_MM = 1e-5


@st.composite
def plates(draw: st.DrawFn) -> ReferencePlate:
    """Hulls of random points, with faces long enough to be touched; either way round."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    hull = shapely.MultiPoint(rng.uniform(-50, 50, (int(rng.integers(3, 12)), 2))).convex_hull
    assume(isinstance(hull, shapely.Polygon))
    corners = np.array(hull.exterior.coords)[:-1]
    assume(np.hypot(*(np.roll(corners, -1, axis=0) - corners).T).min() > 2.0)
    return ReferencePlate("plate", corners[:: draw(st.sampled_from([1, -1]))])


def points(seed: int) -> Floats:
    return np.random.default_rng(seed).uniform(-70, 70, (30, 2))


def regular(count: int, radius_mm: float = 30.0) -> Floats:
    angle = 2 * math.pi * np.arange(count) / count
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


@FEW
@given(plates(), st.integers(0, 2**32 - 1))
def test_distances_from_a_plate_are_shapely_s(plate: ReferencePlate, seed: int) -> None:
    shape, at = shapely.Polygon(plate.corners_mm), points(seed)
    distance, normal, room = plate.distance_mm(at)
    rim = shapely.distance(shape.exterior, shapely.points(at))
    inside = shapely.contains(shape, shapely.points(at))
    assert distance == pytest.approx(np.where(inside, -rim, rim), abs=1e-9)
    # Going back along the normal by the distance ends on the rim, at its nearest point.
    foot = at - distance[:, None] * normal
    assert shapely.distance(shape.exterior, shapely.points(foot)) == pytest.approx(0.0, abs=1e-9)
    ends = np.stack([plate.corners_mm, np.roll(plate.corners_mm, -1, axis=0)], axis=1)
    face = shapely.distance(shapely.linestrings(ends)[:, None], shapely.points(foot)).argmin(axis=0)
    to_ends = np.linalg.norm(ends[face] - foot[:, None, :], axis=2)
    assert room == pytest.approx(to_ends.min(axis=1), abs=1e-6)
    assert np.hypot(*normal.T) == pytest.approx(1.0)
    assert np.hypot(*plate.corners_mm.T).max() == pytest.approx(plate.radius_mm)
    assert (shape.centroid.x, shape.centroid.y) == pytest.approx((0.0, 0.0), abs=1e-9)


@FEW
@given(
    st.one_of(plates(), st.builds(ReferenceDisc, st.just("disc"), st.floats(5.0, 60.0))),
    st.integers(0, 2**32 - 1),
)
def test_normals_are_the_slopes_of_distances(reference: Reference, seed: int) -> None:
    at = points(seed)
    at = at[np.abs(reference.distance_mm(at)[0]) > 1e-3]
    _, normal, _ = reference.distance_mm(at)
    slope = np.empty_like(at)
    for axis, step in enumerate(STEP_MM * np.eye(2)):
        ahead, behind = reference.distance_mm(at + step)[0], reference.distance_mm(at - step)[0]
        slope[:, axis] = (ahead - behind) / (2 * STEP_MM)
    smooth = np.abs(np.hypot(*slope.T) - 1) < 1e-3  # inside a plate distances have ridges
    assert smooth.mean() > 0.9
    assert normal[smooth] == pytest.approx(slope[smooth], abs=2e-3)


def test_a_disc_is_round() -> None:
    disc = ReferenceDisc("disc", 25.0)
    distance, normal, room = disc.distance_mm(np.array([[30.0, 40.0], [0.0, -10.0]]))
    assert distance == pytest.approx([25.0, -15.0])
    assert normal == pytest.approx(np.array([[0.6, 0.8], [0.0, -1.0]]))
    assert np.isinf(room).all()
    assert disc.curvature_per_mm() == pytest.approx(0.04)


@pytest.mark.parametrize("count", [3, 4, 5, 6, 8])
def test_regular_plates_look_the_same_so_often(count: int) -> None:
    assert ReferencePlate("plate", regular(count) + np.array([7.0, -3.0])).repeats == count


def test_other_plates_repeat_less() -> None:
    assert (
        ReferencePlate("plate", np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 40.0], [0.0, 40.0]])).repeats == 2
    )
    assert ReferencePlate("plate", np.array([[0.0, 0.0], [60.0, 0.0], [0.0, 40.0]])).repeats == 1
    assert ReferencePlate("plate", regular(4) * [1.0, 0.9]).repeats == 2
    # A hexagon whose corners are cut in turns: three times a turn.
    radius = np.where(np.arange(6) % 2, 30.0, 27.0)[:, None]
    assert ReferencePlate("plate", regular(6, 1.0) * radius).repeats == 3


@pytest.mark.parametrize(
    "corners",
    [
        [[0, 0], [40, 0], [20, 10], [20, 40]],  # a notch
        [[0, 0], [20, 0], [40, 0], [40, 40], [0, 40]],  # a corner that is none
        [[0, 0], [40, 40], [40, 0], [0, 40]],  # a bow tie
        [[0, 0], [40, 0], [80, 0]],  # no area
    ],
)
def test_plates_that_are_not_convex_are_refused(corners: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="is not convex"):
        ReferencePlate("plate", np.array(corners))


def test_references_are_put_inside_the_workspace_and_apart() -> None:
    disc, plate = ReferenceDisc("disc", 25.0), ReferencePlate("plate", regular(4, 40 * math.sqrt(2)))
    placings = plan_placements(disc, plate, 125.0)
    assert [item.reference.name for item in placings] == ["disc"] * 3 + ["plate"] * 3
    for placing in placings:
        assert math.hypot(*placing.about_mm) + placing.reference.radius_mm <= 125.0
    bearings = [
        math.degrees(math.atan2(*placing.about_mm)) % 360 for placing in placings if any(placing.about_mm)
    ]
    assert np.diff(sorted(bearings)) == pytest.approx(60.0)
