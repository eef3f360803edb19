"""The closed-form model test against linear programming and against dense sampling."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from shapely_bench import SHIPPED_OBJECTS, grip, outlines, place
from triples import PAIR_TRIPLES, TRIPLE_TRIPLES, arc_hull, triple_arcs

from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.model_test import half_planes, sinusoid_maximum, three_contact_hull, two_contact_hull

ANGLE = st.floats(-math.pi, math.pi)
COEFFICIENT = st.floats(-5, 5).map(lambda value: round(value, 3))


def excess(g: np.ndarray, limit: np.ndarray) -> float:
    """By how much (mm) the half-planes g·s ≤ limit must be widened to have a point in common."""
    rows = np.column_stack([g, -np.ones(len(g))])
    solved = linprog([0, 0, 1], A_ub=rows, b_ub=limit, bounds=[(None, None)] * 3, method="highs")
    assert solved.status == 0
    return float(solved.fun)


@pytest.mark.parametrize("fingers", [2, 3, 4])
def test_triples_agree_with_linear_programming(fingers: int) -> None:
    rng = np.random.default_rng(20 + fingers)
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    feasible = 0
    for trial in range(60):
        model = outlines(SHIPPED_OBJECTS)[trial % 6]
        placed = place(model, rng)
        contacts = [c for c in grip(placed, rng, fingers=fingers, bound=1.0, half_range=None) if c.touched]
        if len(contacts) < 2:
            continue
        anchor = np.zeros(2)
        edges = catalogue.edges(contacts[0].finger)
        state = next(k for k, s in enumerate(catalogue.states) if s.object_name == model.name)
        pick = rng.integers(edges.first[state], edges.first[state + 1], len(contacts))
        theta = rng.uniform(-math.pi, math.pi)
        if trial % 2:  # the edges nearest to the truth, so that about half of the cases are feasible
            theta = placed.theta + rng.normal(0, 0.02)
            turn = np.array([[math.cos(theta), math.sin(theta)], [-math.sin(theta), math.cos(theta)]])
            origin = catalogue.states[state].origin_mm
            middles = (edges.start + edges.end) / 2
            for k, contact in enumerate(contacts):
                local = turn @ (np.array(contact.end_mm) - (placed.x, placed.y)) - origin
                block = slice(edges.first[state], edges.first[state + 1])
                pick[k] = edges.first[state] + np.argmin(np.linalg.norm(middles[block] - local, axis=1))
        planes = [half_planes(edges, pick[k : k + 1], c, anchor) for k, c in enumerate(contacts)]
        wave = np.array([1.0, math.cos(theta), math.sin(theta)])
        short = excess(
            np.concatenate([plane[0][0] for plane in planes]),
            np.concatenate([plane[1][0] @ wave for plane in planes]),
        )
        allowed = True
        for size, triples in ((2, PAIR_TRIPLES), (3, TRIPLE_TRIPLES)):
            for group in itertools.combinations(range(len(contacts)), size):
                g = np.concatenate([planes[k][0] for k in group], axis=1)
                coefficients = np.concatenate([planes[k][1] for k in group], axis=1)
                arcs = triple_arcs(g, coefficients, triples)[0] @ wave
                allowed &= bool(np.all(arcs >= 0))
                if np.min(np.abs(arcs)) > 1e-6:
                    at = np.array([theta])
                    paired = [pick[k : k + 1] for k in group]
                    some = [contacts[k] for k in group]
                    if size == 2:
                        lo, hi = two_contact_hull(catalogue, np.column_stack(paired), some, at, at)
                    else:
                        lo, hi = three_contact_hull(catalogue, np.column_stack(paired), some, anchor, at, at)
                    assert bool(lo[0] <= hi[0]) == bool(np.all(arcs >= 0))
        if abs(short) > 1e-6:
            assert allowed == (short < 0)
        feasible += short < 0
    assert feasible >= 5


@given(ANGLE, st.floats(0, 2 * math.pi), st.lists(st.tuples(*[COEFFICIENT] * 3), min_size=1, max_size=4))
def test_hull_holds_every_allowed_orientation(lo: float, width: float, conditions: list) -> None:
    rows = np.array(conditions)
    begin, end = arc_hull(np.array([lo]), np.array([lo + width]), rows[None])
    theta = np.linspace(lo, lo + width, 2001)
    value = rows[:, 0] + rows[:, 1] * np.cos(theta[:, None]) + rows[:, 2] * np.sin(theta[:, None])
    allowed = theta[np.all(value >= 1e-9, axis=1)]
    if len(allowed):
        assert begin[0] <= allowed[0] + 1e-12
        assert end[0] >= allowed[-1] - 1e-12
    if begin[0] <= end[0]:
        assert begin[0] >= lo - 1e-12
        assert end[0] <= lo + width + 1e-12


@given(ANGLE, st.floats(0.01, 2 * math.pi), st.tuples(*[COEFFICIENT] * 3))
def test_hull_of_one_condition_is_tight(lo: float, width: float, condition: tuple) -> None:
    begin, end = arc_hull(np.array([lo]), np.array([lo + width]), np.array([[condition]]))
    if begin[0] <= end[0]:
        for theta in (begin[0], end[0]):
            value = condition[0] + condition[1] * math.cos(theta) + condition[2] * math.sin(theta)
            assert value >= -1e-6


@given(ANGLE, st.floats(0, 2 * math.pi), st.tuples(*[COEFFICIENT] * 2))
def test_largest_is_the_maximum(lo: float, width: float, wave: tuple) -> None:
    a, b = wave
    found = float(sinusoid_maximum(np.array(a), np.array(b), np.array(lo), np.array(lo + width)))
    theta = np.linspace(lo, lo + width, 4001)
    sampled = float(np.max(a * np.cos(theta) + b * np.sin(theta)))
    assert found >= sampled - 1e-9
    if width < math.pi:  # over half a turn and more the amplitude stands for it
        assert found <= sampled + 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_eight_waves_are_the_triples_of_three_contacts(seed: int) -> None:
    """Two-sided conditions leave no more than the arcs taken one by one; single θ are compared above."""
    rng = np.random.default_rng(seed)
    catalogue = Catalogue(outlines(SHIPPED_OBJECTS))
    placed = place(outlines(SHIPPED_OBJECTS)[seed], rng)
    contacts = [
        c for c in grip(placed, rng, bound=0.5, half_range=None, radius=5.0 * (seed % 2)) if c.touched
    ]
    assert len(contacts) == 3
    edges, anchor = catalogue.edges(contacts[0].finger), np.zeros(2)
    paired = rng.integers(edges.first[seed], edges.first[seed + 1], (3000, 3))
    lo = rng.uniform(-7, 7, 3000)
    hi = lo + 2 * math.pi * rng.uniform(size=3000) ** 3
    first, last = three_contact_hull(catalogue, paired, contacts, anchor, lo, hi)
    planes = [half_planes(edges, paired[:, k], contact, anchor) for k, contact in enumerate(contacts)]
    g = np.concatenate([plane[0] for plane in planes], axis=1)
    coefficients = np.concatenate([plane[1] for plane in planes], axis=1)
    conditions = triple_arcs(g, coefficients, TRIPLE_TRIPLES)
    begin, end = arc_hull(lo, hi, conditions)
    left = np.flatnonzero(first <= last)
    assert len(left) > 10
    assert np.all(first[left] >= begin[left] - 1e-9)
    assert np.all(last[left] <= end[left] + 1e-9)
