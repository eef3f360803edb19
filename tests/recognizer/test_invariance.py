"""What must not matter does not: where the table's origin is, which way outlines run, who touched first."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue, NormalRange, Recognition, recognise
from palpate.recognizer.contact import Contact, Finger
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, grip, holding_truth, outlines, place

FEW = settings(max_examples=12)


@cache
def models() -> tuple[ObjectModel, ...]:
    return tuple(outlines(SHIPPED_OBJECTS)[1:4])


@cache
def catalogue() -> Catalogue:
    return Catalogue(models())


def scene(seed: int) -> list[Contact]:
    rng = np.random.default_rng(seed)
    return grip(place(models()[seed % 3], rng, spread=5.0), rng, fingers=4)


def turned(point: tuple[float, float], angle: float, shift: tuple[float, float]) -> tuple[float, float]:
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * point[0] - sin * point[1] + shift[0], sin * point[0] + cos * point[1] + shift[1]


def moved(contact: Contact, angle: float, shift: tuple[float, float]) -> Contact:
    normal = contact.normal
    return replace(
        contact,
        start_mm=turned(contact.start_mm, angle, shift),
        end_mm=turned(contact.end_mm, angle, shift),
        normal=NormalRange(normal.lo_rad + angle, normal.hi_rad + angle) if normal else None,
    )


def summary(found: Recognition) -> list[tuple[str, int]]:
    return sorted((item.state.object_name, len(item.features)) for item in found.hypotheses)


@FEW
@given(st.integers(0, 50), st.floats(-7, 7), st.tuples(st.floats(-500, 500), st.floats(-500, 500)))
def test_moving_the_table_moves_the_answer(seed: int, angle: float, shift: tuple[float, float]) -> None:
    contacts = scene(seed)
    before = recognise(catalogue(), contacts)
    after = recognise(catalogue(), [moved(contact, angle, shift) for contact in contacts])
    assert summary(before) == summary(after)
    for item in before.hypotheses:
        where = item.configuration
        x, y = turned((where.x_mm, where.y_mm), angle, shift)
        apart = [
            max(
                abs(x - other.configuration.x_mm),
                abs(y - other.configuration.y_mm),
                50
                * abs(
                    (where.theta_rad + angle - other.configuration.theta_rad + math.pi) % (2 * math.pi)
                    - math.pi
                ),
            )
            for other in after.hypotheses
            if other.state_index == item.state_index
        ]
        assert min(apart) < 1e-3


@FEW
@given(st.integers(0, 50))
def test_outlines_may_run_either_way(seed: int) -> None:
    reversed_models = [
        flat(item.name, item.states[0].sections[0].polygons[0].outer[::-1].copy()) for item in models()
    ]
    before, after = recognise(catalogue(), scene(seed)), recognise(Catalogue(reversed_models), scene(seed))
    assert summary(before) == summary(after)
    for one, other in zip(before.hypotheses, after.hypotheses, strict=True):
        assert one.weight == pytest.approx(other.weight, rel=1e-5)


@FEW
@given(st.integers(0, 50), st.integers(1, 30))
def test_edges_may_be_numbered_from_anywhere(seed: int, first: int) -> None:
    """Other first vertices and another order of the objects: the same answer under other numbers."""
    counts = {item.name: len(item.states[0].sections[0].polygons[0].outer) for item in models()}
    renumbered = [
        flat(item.name, np.roll(item.states[0].sections[0].polygons[0].outer, -first, axis=0))
        for item in reversed(models())
    ]
    before, after = recognise(catalogue(), scene(seed)), recognise(Catalogue(renumbered), scene(seed))
    assert summary(before) == summary(after)
    others = list(after.hypotheses)
    for one in before.hypotheses:
        name = one.state.object_name
        near = [item for item in others if item.state.object_name == name]
        same = min(near, key=lambda item: abs(item.bounds.theta_rad[0] - one.bounds.theta_rad[0]))
        assert np.allclose(one.bounds.x_mm + one.bounds.y_mm, same.bounds.x_mm + same.bounds.y_mm, atol=1e-6)

        def number(feature: int | None, name: str = name) -> int | None:
            if feature is None:
                return None
            at = feature if feature >= 0 else -1 - feature
            moved_to = (at - first) % counts[name]
            return moved_to if feature >= 0 else -1 - moved_to

        assert sorted(tuple(number(k) for k in row) for row in one.features) == sorted(same.features)


@FEW
@given(st.integers(0, 50), st.randoms(use_true_random=False))
def test_order_of_contacts_loses_nothing(seed: int, shuffler: object) -> None:
    rng = np.random.default_rng(seed)
    placed = place(models()[seed % 3], rng, spread=5.0)
    contacts = grip(placed, rng, fingers=4)
    shuffled = list(contacts)
    shuffler.shuffle(shuffled)
    before, after = recognise(catalogue(), contacts), recognise(catalogue(), shuffled)
    assert holding_truth(before, placed) is not None
    assert holding_truth(after, placed) is not None
    checked = {item.state_index for item in before.hypotheses if item.verified}
    assert checked <= {item.state_index for item in after.hypotheses}


@FEW
@given(st.integers(0, 50), st.sampled_from([0.5, 2.0]))
def test_scaling_everything_scales_the_answer(seed: int, factor: float) -> None:
    def scaled(item: ObjectModel) -> ObjectModel:
        section = item.states[0].sections[0]
        ring = Polygon(section.polygons[0].outer * factor)
        return ObjectModel(item.name, (State("flat", (Section((0.0, 20.0), (ring,)),)),))

    contacts = [
        replace(
            contact,
            finger=Finger(contact.finger.tip_radius_mm * factor, contact.finger.height_mm),
            start_mm=(contact.start_mm[0] * factor, contact.start_mm[1] * factor),
            end_mm=(contact.end_mm[0] * factor, contact.end_mm[1] * factor),
            position_bound_mm=contact.position_bound_mm * factor,
        )
        for contact in scene(seed)
    ]
    before = recognise(catalogue(), scene(seed))
    larger = Catalogue([scaled(item) for item in models()], facet_error_mm=0.1 * factor)
    after = recognise(larger, contacts)
    assert summary(before) == summary(after)
    for one, other in zip(before.hypotheses, after.hypotheses, strict=True):
        assert other.bounds.x_mm[0] == pytest.approx(one.bounds.x_mm[0] * factor, abs=1e-2)
        assert other.bounds.theta_rad == pytest.approx(one.bounds.theta_rad, abs=1e-4)
