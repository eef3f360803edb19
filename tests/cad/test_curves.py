"""Chords of curves keep what they state: seen by sampling the curves densely, with others' evaluators."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.cad.curves import (
    MAX_CHORD_TURN_RAD,
    Arc,
    Bezier,
    DrawnCurve,
    bezier,
    bulge_curve,
    chords,
    control_hull,
    spline,
    transform_curve,
)

numbers = st.floats(-20, 20).map(lambda value: round(value, 3))
points = st.tuples(numbers, numbers)
tolerances = st.sampled_from([0.3, 0.05, 0.004])


def at(curve: DrawnCurve, share: Floats) -> Floats:
    """Points of a curve by its definition; `share` from 0 to 1."""
    if isinstance(curve, Arc):
        t = curve.start_rad + share * curve.sweep_rad
        return curve.centre + np.outer(np.cos(t), curve.axes[0]) + np.outer(np.sin(t), curve.axes[1])
    n = len(curve.points) - 1
    basis = np.array([math.comb(n, k) * share**k * (1 - share) ** (n - k) for k in range(n + 1)]).T
    weighted = basis * curve.weights
    return (weighted / weighted.sum(axis=1, keepdims=True)) @ curve.points


def check(curve: DrawnCurve, curve_mm: float) -> Floats:
    """The chords' ends are on the curve, in order, and it is within the stated deviation of them."""
    found, off = chords(curve, curve_mm)
    assert 0 <= off <= curve_mm * (1 + 1e-12)
    dense = at(curve, np.linspace(0, 1, 20 * len(found) + 1))
    drawn = shapely.LineString(found) if len(found) > 1 else shapely.Point(found[0])
    assert shapely.distance(shapely.points(dense), drawn).max() <= off + 1e-9
    spacing = np.hypot(*np.diff(dense, axis=0).T).max()
    assert shapely.distance(shapely.points(found), shapely.LineString(dense)).max() <= spacing**2 + 1e-9
    assert np.allclose(found[[0, -1]], at(curve, np.array([0.0, 1.0])), atol=1e-9)
    return found


@given(
    centre=points,
    axes=st.tuples(points, points),
    start=st.floats(-7, 7),
    sweep=st.floats(-2 * math.pi, 2 * math.pi).filter(lambda value: abs(value) > 0.01),
    curve_mm=tolerances,
)
@settings(max_examples=30, deadline=None)
def test_arcs_of_any_affine_circle(
    centre: tuple[float, float],
    axes: tuple[tuple[float, float], tuple[float, float]],
    start: float,
    sweep: float,
    curve_mm: float,
) -> None:
    check(Arc(np.array(centre), np.array(axes), start, sweep), curve_mm)


@given(control=st.lists(points, min_size=3, max_size=6), curve_mm=tolerances, data=st.data())
@settings(max_examples=30, deadline=None)
def test_bezier_curves_with_and_without_weights(
    control: list[tuple[float, float]], curve_mm: float, data: st.DataObject
) -> None:
    given_points = np.array(control)
    check(bezier(given_points), curve_mm)
    weights = data.draw(
        st.lists(st.sampled_from([0.2, 1.0, 3.0]), min_size=len(control), max_size=len(control))
    )
    check(Bezier(given_points, np.array(weights)), curve_mm)


@given(control=st.lists(points, min_size=3, max_size=5), curve_mm=tolerances)
@settings(max_examples=40, deadline=None)
def test_normals_differ_by_no_more_than_the_deviation_allows(
    control: list[tuple[float, float]], curve_mm: float
) -> None:
    """asin(4 · deviation / length of the chord), as a `CrossSection` promises."""
    curve = bezier(np.array(control))
    found, off = chords(curve, curve_mm)
    dense = at(curve, np.linspace(0, 1, 4001))
    steps = np.diff(dense, axis=0)
    middle = (dense[1:] + dense[:-1]) / 2
    edges = np.diff(found, axis=0)
    lengths = np.hypot(*edges.T)
    # The chord that each step of the curve belongs to, by where the chords' ends are on it.
    ends = np.array([np.hypot(*(dense - point).T).argmin() for point in found])
    assume(np.all(np.diff(ends) >= 2))
    for k in range(len(edges)):
        own = slice(ends[k] + 1, ends[k + 1] - 1)
        if 4 * off >= lengths[k] or len(middle[own]) == 0:
            continue
        cross = np.abs(steps[own] @ np.array([-edges[k, 1], edges[k, 0]])) / lengths[k]
        length = np.hypot(*steps[own].T)
        moving = length > 1e-6
        assert np.all(cross[moving] <= length[moving] * (4 * off / lengths[k]) + 1e-5)


@pytest.mark.parametrize(("radius", "curve_mm"), [(0.5, 0.01), (20.0, 0.01), (300.0, 0.05), (5.0, 4.0)])
def test_circle_has_as_few_chords_as_allowed(radius: float, curve_mm: float) -> None:
    circle = Arc(np.zeros(2), radius * np.eye(2), 0.3, 2 * math.pi)
    found = check(circle, curve_mm)
    assert np.array_equal(found[0], found[-1])
    count = len(found) - 1
    needed = max(math.pi / math.acos(1 - min(curve_mm / radius, 1)), 2 * math.pi / MAX_CHORD_TURN_RAD)
    assert needed - 1e-6 <= count < needed + 1
    _, off = chords(circle, curve_mm)
    assert off == pytest.approx(radius * (1 - math.cos(math.pi / count)), rel=1e-9)


def test_flat_ellipse_turns_gently() -> None:
    found = check(Arc(np.zeros(2), np.array([[40.0, 0.0], [0.0, 2.0]]), 0.0, 2 * math.pi), 0.05)
    steps = np.diff(found, axis=0)
    directions = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    assert np.abs(np.diff(directions)).max() <= 2 * MAX_CHORD_TURN_RAD
    assert directions[-1] - directions[0] > 2 * math.pi - 2 * MAX_CHORD_TURN_RAD


def test_bulge_is_the_arc_of_the_reference() -> None:
    """tan(sweep / 4): 1 is a half circle, counter-clockwise from start to end."""
    half = bulge_curve(np.array([0.0, 0.0]), np.array([10.0, 0.0]), 1.0)
    assert np.allclose(at(half, np.array([0.0, 0.5, 1.0])), [[0, 0], [5, -5], [10, 0]])
    quarter = bulge_curve(np.array([10.0, 0.0]), np.array([0.0, 10.0]), math.tan(math.pi / 8))
    assert np.allclose(np.hypot(*at(quarter, np.linspace(0, 1, 9)).T), 10.0)
    back = bulge_curve(np.array([0.0, 10.0]), np.array([10.0, 0.0]), -math.tan(math.pi / 8))
    assert np.allclose(np.hypot(*at(back, np.linspace(0, 1, 9)).T), 10.0)


@pytest.mark.parametrize("value", [9e-8, -9e-8, 1.1e-7])
def test_hardly_bulged_edge_has_the_height_that_it_says(value: float) -> None:
    curve = bulge_curve(np.array([100.0, 200.0]), np.array([100.0, 300.0]), value)
    assert at(curve, np.array([0.5]))[0] == pytest.approx([100.0 + value * 50.0, 250.0], abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), degree=st.integers(1, 5), clamped=st.booleans())
@settings(max_examples=40, deadline=None)
def test_spline_falls_into_its_bezier_curves(seed: int, degree: int, clamped: bool) -> None:
    """Against scipy's evaluation of weighted B-splines, with repeated inner knots and open ends."""
    rng = np.random.default_rng(seed)
    count = degree + 1 + int(rng.integers(0, 6))
    control, weights = rng.normal(size=(count, 2)), rng.uniform(0.3, 3.0, count)
    knots = np.sort(rng.integers(1, 6, count + degree + 1).astype(float))
    if clamped:
        knots[: degree + 1], knots[count:] = 0.0, 7.0
    # A knot that is there more often tears the curve.
    assume(np.all(knots[degree + 1 :] > knots[: -degree - 1]))
    spans = np.unique(knots[degree : count + 1])
    assume(len(spans) > 1)
    other = BSpline(knots, np.column_stack([control * weights[:, None], weights]), degree)
    found = spline(degree, control, weights, knots)
    assert len(found) == len(spans) - 1
    for curve, lo, hi in zip(found, spans[:-1], spans[1:], strict=True):
        share = np.linspace(0, 1, 7)[1:-1]
        value = other(lo + share * (hi - lo))
        assert np.allclose(at(curve, share), value[:, :2] / value[:, 2:], atol=1e-9)


def test_mapped_curve_is_the_curve_of_the_mapped_points() -> None:
    matrix, shift = np.array([[2.0, 0.5], [-1.0, 3.0]]), np.array([4.0, -7.0])
    share = np.linspace(0, 1, 11)
    for curve in (
        Arc(np.array([1.0, 2.0]), np.array([[3.0, 1.0], [0.0, 2.0]]), 0.4, -3.0),
        Bezier(np.array([[0.0, 0.0], [4.0, 1.0], [2.0, 5.0]]), np.array([1.0, 2.0, 1.0])),
    ):
        assert np.allclose(
            at(transform_curve(curve, matrix, shift), share), at(curve, share) @ matrix.T + shift
        )
        assert (
            shapely.MultiPoint(control_hull(curve))
            .convex_hull.buffer(1e-9)
            .covers(shapely.MultiPoint(at(curve, share)))
        )


@pytest.mark.parametrize("curve_mm", [0.0, -1.0, math.nan])
def test_no_tolerance(curve_mm: float) -> None:
    with pytest.raises(InputError, match="more than 0 mm"):
        chords(bezier(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])), curve_mm)
