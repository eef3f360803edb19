"""A part that moves between grips, or within one, by no more than its bound is never lost."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sampling import sample
from shapely_bench import (
    MOST_DRAWS,
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    turned,
    unit,
    until_touched,
)
from shared_files import SHARED_OUTLINES, needs_shared_outlines

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, Motion, contact_after_motion, contact_in_motion, recognise

MOTIONS = ((0.0, 0.02), (0.1, 0.005), (0.4, 0.03), (1.5, 0.0))
"""Shift in mm and turn in rad."""


@cache
def shipped() -> Catalogue:
    return Catalogue(outlines(SHIPPED_OBJECTS))


def by_at_most(catalogue: Catalogue, shift_mm: float, turn_rad: float) -> Motion:
    count = len(catalogue.states)
    return Motion(np.full(count, shift_mm), np.full(count, turn_rad))


def state_of(catalogue: Catalogue, placed: Placed) -> int:
    return [item.object_name for item in catalogue.states].index(placed.model.name)


def pushed(placed: Placed, centre: np.ndarray, shift_mm: float, turn_rad: float, bearing: float) -> Placed:
    """The part turned about its centroid, which is shifted."""
    at = placed.on_table(centre) + shift_mm * unit(bearing)
    theta = placed.theta + turn_rad
    x, y = at - turned(centre, theta)
    return replace(placed, x=float(x), y=float(y), theta=theta)


def pushed_by(catalogue: Catalogue, placed: Placed, motion: Motion, rng: np.random.Generator) -> Placed:
    """The part after a motion: at its bound in both ways most of the time, in any direction."""
    row = state_of(catalogue, placed)
    share, turn = (1.0, rng.choice([-1.0, 1.0])) if rng.random() < 0.7 else (rng.random(), rng.uniform(-1, 1))
    return pushed(
        placed,
        catalogue.origins_mm[row],
        share * float(motion.shift_mm[row]),
        turn * float(motion.turn_rad[row]),
        rng.uniform(0, 2 * math.pi),
    )


def assert_followed(
    catalogue: Catalogue, model: ObjectModel, rng: np.random.Generator, note: object, **how: object
) -> None:
    """Three grips with a motion before each but the first: the part is where the bounds say, every time."""
    motion = by_at_most(catalogue, *MOTIONS[rng.integers(len(MOTIONS))])
    placed = place(model, rng)

    def draw(where: Placed) -> list[Contact]:
        return grip(where, rng, **how)  # type: ignore[arg-type]

    found = recognise(catalogue, until_touched(draw, placed))
    for number in range(2):
        placed = pushed_by(catalogue, placed, motion, rng)
        moved = found.moved(motion)
        assert holding_truth(moved, placed) is not None, (note, number, "moved")
        found = found.extend(draw(placed), motion)
        assert holding_truth(found, placed) is not None, (note, number)


@pytest.mark.parametrize("seed", sample(range(20), range(0, 20, 4)))
def test_shipped_parts_that_move_between_grips(seed: int) -> None:
    rng = np.random.default_rng([20, seed])
    models = outlines(SHIPPED_OBJECTS)
    for trial in range(4):
        half = (None, math.radians(2), math.radians(10), math.radians(30))[int(rng.integers(4))]
        fingers = 4 if half is None else int(rng.integers(2, 5))
        assert_followed(
            shipped(),
            models[int(rng.integers(len(models)))],
            rng,
            (seed, trial),
            fingers=fingers,
            radius=float(rng.choice([0.0, 2.0, 5.0])) if half is None else 5.0,
            bound=float(rng.choice([0.0, 0.05, 0.3])),
            half_range=half,
            at_bound=bool(trial % 2),
            aim=0.3,
        )


@needs_shared_outlines
@pytest.mark.parametrize("seed", sample(range(6), [1, 4]))
def test_cut_parts_that_move_between_grips(seed: int) -> None:
    models = outlines(SHARED_OUTLINES)
    catalogue = Catalogue(models)
    rng = np.random.default_rng([21, seed])
    for trial in range(6):
        model = models[int(rng.integers(len(models)))]
        assert_followed(catalogue, model, rng, (seed, trial), fingers=3, bound=0.2, at_bound=bool(trial % 2))


@pytest.mark.parametrize("seed", sample(range(20), range(0, 20, 4)))
def test_free_ways_of_a_part_that_moved_while_fingers_travelled(seed: int) -> None:
    """Half of the fingers go past, or up to, the part before it is pushed; the others meet it afterwards."""
    rng = np.random.default_rng([22, seed])
    models = outlines(SHIPPED_OBJECTS)
    motion = by_at_most(shipped(), 1.0, 0.02)
    for trial in range(6):
        before = place(models[int(rng.integers(len(models)))], rng)
        after = pushed_by(shipped(), before, motion, rng)
        for _ in range(MOST_DRAWS):
            contacts = [item for item in grip(after, rng, fingers=4, aim=0.1) if item.touched]
            misses = [item for item in grip(before, rng, fingers=6, aim=0.6) if not item.touched]
            if len(contacts) >= 2 and misses:
                break
        felt = [contact_in_motion(motion, shipped(), item, np.arange(6)) for item in (*misses, *contacts)]
        assert holding_truth(recognise(shipped(), felt), after) is not None, (seed, trial)


def test_without_motion_nothing_changes() -> None:
    rng = np.random.default_rng(23)
    placed = place(outlines(SHIPPED_OBJECTS)[2], rng)
    still = Motion.none(shipped())
    found = recognise(shipped(), until_touched(grip, placed, rng))
    further = grip(placed, rng)
    assert found.moved(still) is found
    one, other = found.extend(further, still), found.extend(further)
    assert [item.bounds for item in one.hypotheses] == [item.bounds for item in other.hypotheses]
    assert np.array_equal(one.cells.polygon, other.cells.polygon)
    assert contact_in_motion(still, shipped(), further[0], np.arange(6)) is further[0]


def test_a_carried_contact_holds_at_the_bound_of_the_motion() -> None:
    """The farthest corner of a part that is shifted and turned by just its bounds is within the new bound."""
    corner = flat("corner", [(-30, -10), (30, -10), (30, 10), (-30, 10)])
    catalogue = Catalogue([corner])
    contact = Contact(
        "f", grip(Placed(corner, 0, 0, 0), np.random.default_rng(0))[0].finger, True, (140, 20), (35, 10), 0.0
    )
    motion = by_at_most(catalogue, 0.3, 0.01)
    carried = contact_after_motion(motion, catalogue, contact, np.array([0]))
    moved = turned(np.array(contact.end_mm), 0.01) + 0.3 * unit(math.atan2(36.4, -10))
    assert 0.3 < math.dist(moved, contact.end_mm) <= carried.position_bound_mm < 0.3 + 0.01 * 37
    assert carried.turn_bound_rad == 0.01
    twice = contact_after_motion(motion + motion, catalogue, contact, np.array([0]))
    assert twice.position_bound_mm == pytest.approx(2 * carried.position_bound_mm)
