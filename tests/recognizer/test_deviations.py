"""Deviations along outlines against brute force: paths that are drawn, aligned and judged one by one."""

import math

import numpy as np
import pytest
from scipy.special import erf

from palpate.base.geometry import Floats
from palpate.recognizer.outline_deviations import Deviations, OutlinePlaces, OutlineTouches, agreement

RADIUS_MM = 30.0
LENGTH_MM = 2 * math.pi * RADIUS_MM
SMOOTH = Deviations(np.array([3.0]), np.array([15.0]), np.array([0.0]))


def on_circle(angles: Floats) -> OutlinePlaces:
    """Places on a circle: one outline."""
    normal = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[None]
    some = np.zeros((1, len(angles)))
    return OutlinePlaces(
        RADIUS_MM * normal, normal, RADIUS_MM * angles[None], some.astype(int), some + LENGTH_MM, some
    )


def touches(places: OutlinePlaces, window_mm: float, normal_rad: float = math.inf) -> OutlineTouches:
    """Places that are known to 0.1 mm once they have agreed; of normals nothing is known."""
    some = np.ones(places.along.shape)
    return OutlineTouches(
        places,
        window_mm * some,
        window_mm * some,
        normal_rad * some,
        0.1 * some,
        0.01 * some,
        0.1 * some,
        30.0 * some,
    )


def test_a_touch_agrees_as_often_as_drawn_outlines_say() -> None:
    """The fourth touch: its deviation from the circle through the first three, which a motion puts in place.

    On a circle turns are free, so two touches place it, and the third is the first that says something.
    """
    angles = np.array([0.2, 1.1, 2.9, 3.6])
    found = agreement(touches(on_circle(angles), 2.0), SMOOTH)[0, 0]
    chord = 2 * RADIUS_MM * np.sin((angles[:, None] - angles) / 2)
    covariance = 9.0 * np.exp(-((chord / 15.0) ** 2) / 2)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(4), covariance, 200_000)
    motion = np.column_stack([np.cos(angles), np.sin(angles)])
    for last in (2, 3):
        # Given that all before agree, in the best place: least squares by hand, weighted for their noise.
        before = motion[:last]
        prior = covariance[:last, :last] + 1e4 * before @ before.T + 0.01 * np.eye(last)
        cross = covariance[last, :last] + 1e4 * motion[last] @ before.T
        weights = np.linalg.solve(prior, cross)
        shift = rng.normal(0, 100, (len(drawn), 2))
        noisy = drawn - shift @ motion.T
        residual = noisy[:, last] - (noisy[:, :last] + rng.normal(0, 0.1, (len(drawn), last))) @ weights
        share = np.mean(np.abs(residual + rng.normal(0, 0.1, len(drawn))) < 2.0)
        assert found[last] == pytest.approx(share, abs=0.005)
    assert found[:2] == pytest.approx(0.0, abs=0.03)  # anything may lie anywhere


def test_what_is_near_a_touch_says_less_than_what_is_far() -> None:
    base = np.array([0.0, 2.0, 4.0])
    shares = [
        float(agreement(touches(on_circle(np.append(base, 2.0 + away)), 0.5), SMOOTH)[0, 0, 3])
        for away in (0.03, 0.2, 0.6, 1.0)
    ]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.95
    assert shares[-1] < 0.3


def test_a_part_of_another_size_agrees_where_size_does_not_show() -> None:
    """A circle with two places touched may be scaled; opposite ones tell, once its middle is known."""
    sized = Deviations(np.array([0.01]), np.array([20.0]), np.array([0.1]))
    angles = np.array([0.0, math.pi / 2, math.pi])
    found = agreement(touches(on_circle(angles), 0.5), sized)[0, 0, 2]
    # The third touch fits if the diameter does, which varies by 6 mm: one side has set the middle.
    assert found == pytest.approx(erf(0.5 / (2 * 3.0) / math.sqrt(2)), abs=0.01)


def test_normals_turn_as_displacements_grow() -> None:
    """A normal's deviation is known from two displacements beside it, and the sooner the nearer they are."""
    angles = np.array([0.0, 2.0, 4.0, 1.0 - 0.02, 1.0 + 0.02, 1.0])
    near = agreement(touches(on_circle(angles), 50.0, 0.2), SMOOTH)[0, 0, 5]
    alone = agreement(touches(on_circle(angles[[0, 1, 2, 5]]), 50.0, 0.2), SMOOTH)[0, 0, 3]
    assert alone < near
