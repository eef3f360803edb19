"""Rough outlines within a tolerance: the band about the model holds every contact that they allow.

The model's edges are too short to say anything of normals; shapely says which contacts there are.
"""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from palpate.base.geometry import Polygon, Section
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.tip_clearance import clearance_depths_mm, clearance_tilts_rad
from palpate.recognizer.tolerance_band import PairingEdges, ToleranceBand, pairing_edges


def wavy(rng: np.random.Generator, step_mm: float) -> np.ndarray:
    count = int(2 * np.pi * 18 / step_mm)
    a = 2 * np.pi * np.arange(count) / count
    radius = 15 + rng.uniform(0, 3) * np.sin(3 * a + 1) + rng.uniform(0, 1) * np.cos(7 * a)
    return radius[:, None] * np.column_stack([np.cos(a), np.sin(a)])


def notched(rng: np.random.Generator, step_mm: float) -> np.ndarray:
    """A block with a notch, sides cut in short edges."""
    half = rng.uniform(1.0, 8.0)
    corners = [(-15, -8), (15, -8), (15, 10), (half, 10), (half - 0.5, 4), (-half, 4), (-half, 10), (-15, 10)]
    return cut(np.array(corners, dtype=float), step_mm)


def cut(ring: np.ndarray, step_mm: float) -> np.ndarray:
    return shapely.get_coordinates(shapely.segmentize(shapely.Polygon(ring), step_mm))[:-1]


def rough(ring: np.ndarray, off_mm: float, rng: np.random.Generator) -> np.ndarray:
    """The ring with points between its vertices, displaced by up to the tolerance to either side of it.

    Near sharp corners they stay, so that the ring does not cross itself.
    """
    points = cut(ring, off_mm / 2)
    across = np.roll(points, 1, axis=0) - np.roll(points, -1, axis=0)
    outward = np.column_stack([-across[:, 1], across[:, 0]]) / np.hypot(*across.T)[:, None]
    size = off_mm * rng.choice([-1.0, 1.0], len(points)) * rng.uniform(size=len(points)) ** 0.3
    leg = np.roll(points, -1, axis=0) - points
    bend = wrap_angle(np.diff(np.arctan2(*leg.T[::-1]), prepend=math.atan2(*leg[-1][::-1])))
    corners = points[np.abs(bend) > math.radians(30)]
    if len(corners):
        near = np.hypot(*(points[:, None] - corners).transpose(2, 0, 1)).min(axis=1)
        size = np.where(near < 2 * off_mm, 0.0, size)
    return points + size[:, None] * outward


def contacts(ring: np.ndarray, radius: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Centres of a tip (k, 2) that touches the ring without entering it, and its normals (k,) there."""
    leg = np.roll(ring, -1, axis=0) - ring
    face = np.arctan2(-leg[:, 0], leg[:, 1])
    bend = wrap_angle(face - np.roll(face, 1))
    at, share = np.repeat(np.arange(len(ring)), 4), rng.uniform(size=4 * len(ring))
    foot = np.concatenate([ring[at] + share[:, None] * leg[at], ring[at]])
    normal = np.concatenate([face[at], face[at] - share * np.maximum(bend[at], 0.0)])
    centre = foot + radius * np.column_stack([np.cos(normal), np.sin(normal)])
    solid = shapely.Polygon(ring)
    shapely.prepare(solid)
    points = shapely.points(centre)
    clear = (shapely.distance(points, solid.exterior) >= radius - 1e-9) & ~shapely.contains(solid, points)
    return centre[clear], normal[clear]


def is_held(band: PairingEdges, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Which contacts some edge of the band holds, with its slack and its range of normals."""
    edges = band.edges
    rel = centre[:, None] - edges.start
    along = np.sum(rel * edges.direction, axis=2)
    inward = edges.direction[:, 0] * rel[..., 1] - edges.direction[:, 1] * rel[..., 0]
    face = np.arctan2(-edges.direction[:, 0], edges.direction[:, 1])
    held = (along >= -band.along - 1e-6) & (along <= edges.length + band.along + 1e-6)
    held &= (inward <= band.inward + 1e-6) & (inward >= -band.outward - 1e-6)
    held &= np.abs(wrap_angle(normal[:, None] - face)) <= edges.span + 1e-9
    return held.any(axis=1)


@pytest.mark.parametrize("shape", [wavy, notched])
@given(
    seed=st.integers(0, 2**32 - 1),
    radius=st.sampled_from([0.3, 1.0, 3.0, 5.0]),
    off=st.sampled_from([0.1, 0.2, 0.5]),
    length=st.floats(0.5, 3.9),
)
@settings(max_examples=8, deadline=None, derandomize=True)
def test_band_holds_every_contact_of_rough_outlines(
    shape: object, seed: int, radius: float, off: float, length: float
) -> None:
    rng = np.random.default_rng(seed)
    ring = shape(rng, length * off)
    true = rough(ring, 0.999 * off, rng)
    assume(shapely.Polygon(true).is_valid)
    band = pairing_edges(Section((0.0, 10.0), (Polygon(ring, ()),)), radius, ToleranceBand(off), 0.1)
    centre, normal = contacts(true, radius, rng)
    assert len(centre) > 20
    assert is_held(band, centre, normal).all()


def test_a_flat_side_leaves_what_the_closed_form_says() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start = np.column_stack([-np.arange(-5.0, 5.0, 0.1), np.zeros(100)])
    tilt = clearance_tilts_rad(side, start, start - np.array([0.1, 0.0]), 5.0, 0.1)
    exact = math.acos(1 - 2 * 0.1 / 5.0)
    assert np.all(tilt >= exact - 1e-9)
    assert np.all(tilt <= 1.1 * exact + math.radians(0.5))


def test_a_small_tip_may_have_any_normal() -> None:
    side = shapely.box(-30, -20, 30, 0)
    tilt = clearance_tilts_rad(side, np.array([[0.1, 0.0]]), np.array([[0.0, 0.0]]), 0.2, 0.1)
    assert tilt.tolist() == [math.pi]


def test_a_tip_on_a_flat_side_is_no_deeper_than_the_tolerance() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start = np.column_stack([-np.arange(-5.0, 5.0, 0.5), np.full(20, 5.0)])
    some = np.ones(20)
    depth = clearance_depths_mm(side, start, start - np.array([0.5, 0.0]), 1.5 * some, 0.3 * some, 4.9)
    assert np.all(depth >= 0.1)
    assert np.all(depth <= 0.12)


def test_hardly_any_tolerance_or_clearance_takes_no_more_points() -> None:
    side = shapely.box(-30, -20, 30, 0)
    start, end = np.array([[1e-9, 0.0]]), np.array([[0.0, 0.0]])
    assert clearance_tilts_rad(side, start, end, 5.0, 1e-12)[0] > 0
    some = np.ones(1)
    assert clearance_depths_mm(side, start, end, some, 0.1 * some, 1e-9).tolist() == [0.1]
