"""Round drawings: which are taken for circles, and how far they may be from these."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from shapely import affinity

from palpate.cad.parts import Drawing, Region
from palpate.rig.catalogue.round_outlines import round_drawing

ALLOWED_MM = 0.1
LARGEST_TURN_RAD = 0.3  # more, and a rough outline has any normal: no circle stands for it


def disc(radius, centre=(0.0, 0.0), corners=200, phase=0.0):
    angle = phase + np.linspace(0, 2 * np.pi, corners, endpoint=False)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)]) + centre


def largest_turn_rad(rings):
    """By how much an edge's normal is off the radial direction at one of its ends, at most."""
    worst = 0.0
    for ring in rings:
        about = ring - ring.mean(axis=0)
        leg = np.roll(about, -1, axis=0) - about
        for end in (about, about + leg):
            cos = np.abs(np.sum(leg * end, axis=1)) / np.hypot(*leg.T) / np.hypot(*end.T)
            worst = max(worst, float(np.arcsin(np.minimum(cos, 1.0)).max()))
    return worst


@given(
    st.floats(2.0, 200.0),
    st.lists(st.floats(0.1, 0.9), max_size=2, unique=True),
    st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    st.integers(10, 400),
    st.floats(0.0, 6.3),
    st.floats(0.0, 0.02),
)
def test_outlines_are_within_the_bound_of_the_circles(radius, shares, centre, corners, phase, rough):
    wobble = 1 + rough * np.cos(5 * np.arange(corners))[:, None] / radius
    rings = [(disc(radius * k, corners=corners, phase=phase) * wobble) + centre for k in (1.0, *shares)]
    found = round_drawing(
        Drawing("disc", Region(rings[0], tuple(ring[::-1] for ring in rings[1:]))), ALLOWED_MM
    )
    if found is None:
        sagitta = radius * (1 - math.cos(math.pi / corners))
        assert sagitta + rough > ALLOWED_MM / 2 or largest_turn_rad(rings) > LARGEST_TURN_RAD
        return
    assert found.off_mm <= ALLOWED_MM
    axis = shapely.Point(found.centre_mm)
    for ring, about in zip(rings, found.radii_mm, strict=True):
        outline = shapely.LinearRing(ring)
        assert axis.distance(outline) >= about - found.off_mm - 1e-9
        assert axis.hausdorff_distance(outline) <= about + found.off_mm + 1e-9


@pytest.mark.parametrize(
    "region",
    [
        Region(disc(1.0, corners=8)),
        Region(disc(30.0), (disc(5.0, (0.3, 0.0))[::-1],)),
        Region(disc(30.0) * [1.0, 1.01]),
        Region(disc(30.0)[:150]),
        Region(disc(30.0), (disc(5.0, (20.0, 0.0))[::-1],)),
        Region(disc(30.0), (disc(3.0, (10.0, 0.0))[::-1], disc(3.0, (-10.0, 0.0))[::-1])),
    ],
    ids=["octagon", "eccentric", "ellipse", "most of a disc", "bore beside the middle", "two bores"],
)
def test_what_is_nearly_round_is_not_round(region):
    assert round_drawing(Drawing("part", region), ALLOWED_MM) is None


def test_a_fine_star_of_the_size_of_the_tolerance_is_no_circle():
    spikes = disc(2.0) * np.where(np.arange(200) % 2, 0.97, 1.0)[:, None]
    assert shapely.Point(0, 0).hausdorff_distance(shapely.LinearRing(spikes)) == pytest.approx(2.0)
    assert round_drawing(Drawing("star", Region(spikes)), ALLOWED_MM) is None


def test_a_circle_is_known_by_its_outer_outline():
    one = round_drawing(Drawing("one", Region(disc(30.0, (5, 5)))), ALLOWED_MM)
    moved = affinity.translate(shapely.Polygon(disc(30.0, (5, 5))), 0.05).exterior.coords
    near = round_drawing(Drawing("near", Region(np.array(moved)[:-1])), ALLOWED_MM)
    small = round_drawing(Drawing("small", Region(disc(29.0, (5, 5)))), ALLOWED_MM)
    assert None not in (one, near, small)
    assert one.is_near(near, 0.2)
    assert not one.is_near(small, 0.2)
    assert one.bounds_mm == pytest.approx((-25, -25, 35, 35), abs=0.01)
