"""The memo's strategies, checks of an answer, and what speaks for it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from reach_ring import GOALS, RESOLUTION, contact_along, normal_at, ring, some_recognition, travel_of
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, grip, outlines, place, unit

from palpate.base.geometry import Floats, Ints
from palpate.base.vocabulary import Strategy
from palpate.recognizer import (
    Catalogue,
    Confirmation,
    Finger,
    StrangerEvidence,
    confirmation_grip,
    detectable_shift_mm,
    next_grip,
    recognise,
    used_approaches,
)
from palpate.recognizer.planner import fits_together, predict_approach
from palpate.recognizer.touch_model import push_hazard, sampled_poses, touch_outcomes


def wanted(shift_mm: float) -> Confirmation:
    return Confirmation(shift_mm, StrangerEvidence.none(), 1.0)


def test_used_candidates_are_those_along_a_path_and_no_others() -> None:
    candidates = ring().approaches
    for k in (0, 7, 40):
        used = used_approaches([contact_along(candidates[k], 90.0)], candidates)
        assert np.flatnonzero(used).tolist() == [k]
    other = replace(contact_along(candidates[7], 90.0), finger=Finger(4.0, 10.0))
    assert not used_approaches([other], candidates).any()
    assert not used_approaches([], candidates).any()


def test_the_strategies_choose_what_their_names_say() -> None:
    _, found = some_recognition(4, half_deg=20.0)
    reachable = ring(96)
    grips = {
        strategy: [
            next_grip(strategy, found, reachable, RESOLUTION, GOALS, np.random.default_rng(seed))
            for seed in range(3)
        ]
        for strategy in Strategy
    }
    for several in grips.values():
        for chosen in several:
            assert chosen is not None
            fingers = [item.finger_index for item in chosen.approaches]
            assert len(set(fingers)) == len(fingers)
    planned = grips[Strategy.PLANNED]
    assert planned[0] is not None
    assert all(item is not None and item.approaches == planned[0].approaches for item in planned)
    drawn = {item.approaches for item in grips[Strategy.RANDOM] if item is not None}
    assert len(drawn) > 1


def test_rotate_stays_beside_the_last_touch_of_each_finger() -> None:
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[3], np.random.default_rng(8))
    reachable = ring(72)
    first = [24, 75, 117]
    contacts = []
    for k in first:
        travel = travel_of(placed, reachable.approaches[k])
        assert math.isfinite(travel)
        contacts.append(contact_along(reachable.approaches[k], travel))
    found = recognise(Catalogue(models), contacts)
    chosen = next_grip(Strategy.ROTATE, found, reachable, RESOLUTION, GOALS, np.random.default_rng(0))
    assert chosen is not None
    assert len(chosen.approaches) == 3
    for candidate in chosen.approaches:
        angle, start = candidate.direction_rad, np.asarray(candidate.start_mm)
        asides = [
            abs(math.cos(angle) * (c.end_mm[1] - start[1]) - math.sin(angle) * (c.end_mm[0] - start[0]))
            for c in contacts
        ]
        assert 3.0 <= min(asides) < 12.0


def test_a_check_meets_the_answer_where_nothing_was_touched() -> None:
    for seed in range(6):
        rng = np.random.default_rng(seed)
        models = outlines(SHIPPED_OBJECTS)
        placed = place(models[seed], rng)
        found = recognise(Catalogue(models), grip(placed, rng, fingers=7, half_range=math.radians(8)))
        known = np.array([contact.end_mm for contact in found.contacts if contact.touched])
        counts = []
        for shift_mm in (50.0, 0.1):
            chosen = confirmation_grip(found, ring(), RESOLUTION, wanted(shift_mm))
            assert chosen is not None
            counts.append(len(chosen.approaches))
            for row, candidate in enumerate(chosen.approaches):
                assert math.isfinite(chosen.predictions.of(row, 0).latest_mm)
                travel = travel_of(placed, candidate)
                end = contact_along(candidate, travel).end_mm
                assert np.linalg.norm(known - end, axis=1).min() > 3.0
        assert counts == [2, 3]  # a smaller shift takes more touches to notice


def test_a_shift_goes_unnoticed_within_what_is_foretold_and_no_further() -> None:
    """A part with straight sides, shifted in every direction before two touches: brute force."""
    models = [flat("slab", [(0, 0), (60, 0), (60, 24), (0, 24)])]
    placed = Placed(models[0], -30.0, -12.0, 0.3)
    found = recognise(
        Catalogue(models), grip(placed, np.random.default_rng(2), fingers=7, half_range=math.radians(8))
    )
    chosen = confirmation_grip(found, ring(), RESOLUTION, wanted(50.0))
    assert chosen is not None
    approaches = chosen.approaches
    normals = np.array([normal_at(placed, item, travel_of(placed, item)) for item in approaches])
    limit = detectable_shift_mm(
        chosen.predictions, normals, np.array([item.direction_rad for item in approaches])
    )
    assert 1.0 < limit < 30.0
    hidden = 0
    for bearing in np.arange(0, 2 * math.pi, 0.1):
        for size in (0.2 * limit, limit * 1.001):
            moved = replace(
                placed,
                x=placed.x + size * math.cos(bearing),
                y=placed.y + size * math.sin(bearing),
            )
            agrees = all(
                chosen.predictions.of(row, 0).earliest_mm
                <= travel_of(moved, item)
                <= chosen.predictions.of(row, 0).latest_mm
                for row, item in enumerate(approaches)
            )
            assert not (agrees and size > limit)
            hidden += agrees
    assert hidden


def test_a_candidate_fits_only_beside_other_fingers() -> None:
    _, found = some_recognition(0)
    one, same, other = (predict_approach(found, ring(), k) for k in (0, 1, 3))
    assert fits_together(ring(), one, [])
    assert not fits_together(ring(), one, [same])
    assert fits_together(ring(), one, [other])


class Unsteady:
    """Limits of states that may only be pushed towards +x and +y of the object's frame."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        angle = np.radians(np.arange(360))
        row = np.where((np.cos(angle) > -0.4) & (np.sin(angle) > -0.4), np.inf, 0.0)
        return np.tile(row, (len(states), 1))

    def slide_shares(self, states: Ints) -> Floats:
        return np.zeros((len(states), 2))


class Light:
    """Limits of states that slide under a touch further than 10 mm off their middle."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        return np.full((len(states), 360), np.inf)

    def slide_shares(self, states: Ints) -> Floats:
        return np.tile([0.5, 0.05], (len(states), 1))


def test_the_hazard_of_sliding_grows_with_the_distance_from_the_middle() -> None:
    models = [flat("bar", [(0, 0), (80, 0), (80, 12), (70, 20), (0, 20)])]
    catalogue = Catalogue(models)
    rng = np.random.default_rng(5)
    placed = Placed(models[0], -40.0, -10.0, 0.4)
    found = recognise(catalogue, grip(placed, rng, fingers=6, half_range=math.radians(8)))
    poses, approaches = sampled_poses(found.hypotheses), ring().approaches
    outcome = touch_outcomes(catalogue, poses.cells, found.anchor_mm, approaches)
    hazard = push_hazard(Light(), approaches, poses, found.anchor_mm, outcome)
    rows = np.flatnonzero(outcome.hit.all(axis=1))
    off = []
    for row in rows.tolist():
        item = approaches[row]
        at = np.array(item.start_mm) + travel_of(placed, item) * unit(item.direction_rad)
        off.append(float(np.hypot(*(at - placed.on_table(catalogue.origins_mm[0])))))
    expected = 1 - 1 / np.maximum(0.5 + 0.05 * np.array(off), 1.0)
    assert hazard[rows] == pytest.approx(expected, abs=0.06)
    assert not hazard[~outcome.hit.any(axis=1)].any()


def test_approaches_that_may_tip_the_part_are_the_last_to_be_taken() -> None:
    """A block that can be touched from anywhere, and may be from two sides only."""
    models = [flat("block", [(0, 0), (50, 0), (50, 30), (38, 40), (0, 40)])]
    catalogue, limits = Catalogue(models), Unsteady()
    risky = {False: 0, True: 0}
    for seed in range(4):
        rng = np.random.default_rng(seed)
        placed = Placed(models[0], -20.0, -15.0, 0.4)
        found = recognise(catalogue, grip(placed, rng, fingers=6, half_range=math.radians(8)))
        for given in (False, True):
            some = limits if given else None
            for chosen in (
                next_grip(Strategy.PLANNED, found, ring(), RESOLUTION, GOALS, rng, limits=some),
                confirmation_grip(found, ring(), RESOLUTION, wanted(50.0), some),
            ):
                assert chosen is not None
                for item in chosen.approaches:
                    normal = normal_at(placed, item, travel_of(placed, item)) - placed.theta
                    risky[given] += math.cos(normal) > 0.4 or math.sin(normal) > 0.4
    assert risky[True] < risky[False] / 2, risky
