"""Contradictions: touches made again on what lies still and on what was moved, whatever it is."""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from palpate.base.vocabulary import ContradictionCause, IdentificationVerdict
from palpate.config import load_rig
from palpate.recognizer import Catalogue, Contact, FingerApproach, NormalRange
from palpate.rig.identification.contradiction import RepeatedTouches
from palpate.rig.identification.identify import search
from palpate.rig.identification.outcome import Identification
from palpate.rig.motion.guarded_approach import GripPhase
from palpate.rig.motion.touch import Touch
from palpate.rig.reach.approaches import reach_of
from support.benches.rigs import firm_rig
from support.campaign.sampling import sample
from support.oracles.plans import SimulatedTouches, contact_along, normal_at, ring, travel_of
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, flat, outlines, place_within, unit

RIG = load_rig(firm_rig())
REACH = reach_of(RIG)
SIX = outlines(SHIPPED_OBJECTS)
CATALOGUE = Catalogue(SIX)
BOUND_MM, HALF_RAD = 0.3, math.radians(10.0)


def touched(placed: Placed, error_mm: Sequence[float] = (0.0, 0.0, 0.0)) -> list[Contact]:
    """Three touches from three sides, each off along its way, with their normals to within 10°."""
    found = []
    for item, error in zip(ring(3).approaches[1::3], error_mm, strict=True):
        travel = travel_of(placed, item)
        assert math.isfinite(travel)
        normal = normal_at(placed, item, travel)
        contact = contact_along(item, travel + error)
        found.append(replace(contact, normal=NormalRange(normal - HALF_RAD, normal + HALF_RAD)))
    return found


@pytest.mark.parametrize("seed", range(6))
def test_what_lies_still_is_met_again_where_it_was(seed: int) -> None:
    placed = replace(place_within(SIX[seed], np.random.default_rng(seed)), x=0.0, y=0.0)
    off = (BOUND_MM, -BOUND_MM, BOUND_MM)
    again = RepeatedTouches(touched(placed, off), touched(placed, [-error for error in off]))
    assert again.displaced == 0
    assert len(again.hits) == 3
    assert again.apart_mm == pytest.approx(2 * BOUND_MM)
    assert again.hidden_mm >= again.apart_mm


@pytest.mark.parametrize("seed", range(6))
def test_a_part_that_was_moved_far_comes_out_otherwise(seed: int) -> None:
    rng = np.random.default_rng([seed, 1])
    placed = replace(place_within(SIX[seed], rng), x=0.0, y=0.0)
    x, y = 6.0 * unit(float(rng.uniform(-math.pi, math.pi)))
    again = RepeatedTouches(touched(placed), touched(replace(placed, x=float(x), y=float(y), theta=0.9)))
    assert again.displaced >= 1
    assert again.apart_mm > 2 * BOUND_MM


def test_a_touch_that_meets_nothing_again_is_infinitely_far() -> None:
    first = touched(Placed(SIX[0], 0.0, 0.0, 0.0))
    again = RepeatedTouches(first, [replace(first[0], touched=False), *first[1:]])
    assert (again.displaced, again.apart_mm, len(again.hits)) == (1, math.inf, 2)
    assert RepeatedTouches(first[:0], first[:0]).hidden_mm == math.inf


def searched(seed: int, placed: Placed, moved_mm: float) -> Identification:
    """A search for what is moved on by as much before every grip but the first."""
    rng = np.random.default_rng([seed, 2])
    x_mm, y_mm = moved_mm * unit(float(rng.uniform(-math.pi, math.pi)))
    touches = SimulatedTouches(REACH, placed, rng)

    def carried(grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None]) -> Sequence[Touch]:
        found = touches(grip, tell)
        at = touches.placed
        touches.placed = replace(at, x=at.x + float(x_mm), y=at.y + float(y_mm))
        return found

    return search(RIG, REACH, carried, CATALOGUE, seed=seed)


def altered(seed: int) -> Placed:
    """A part of the catalogue, a corner of which is 4 mm elsewhere."""
    rng = np.random.default_rng([seed, 3])
    ring = np.array(SIX[seed % 6].states[0].sections[0].polygons[0].outer)
    ring[int(rng.integers(len(ring)))] += 4.0 * unit(float(rng.uniform(-math.pi, math.pi)))
    return place_within(flat("altered", ring), rng)


def test_what_lies_still_is_never_said_to_move() -> None:
    """Parts of which a corner was moved fit by one grip or the other, and contradict themselves."""
    ends: Counter[IdentificationVerdict] = Counter()
    causes: Counter[ContradictionCause] = Counter()
    for seed in range(18):
        result = searched(seed, altered(seed), 0.0)
        ends[result.outcome] += 1
        causes.update(item.cause for item in result.contradictions)
        if result.outcome is IdentificationVerdict.UNKNOWN:
            assert result.recognition is not None
            assert not result.recognition.hypotheses
            assert result.stranger_probability is None
    assert not ends[IdentificationVerdict.MOVING], ends
    assert not causes[ContradictionCause.MOVED], causes
    assert causes[ContradictionCause.NOT_IN_CATALOGUE] >= 1


@pytest.mark.parametrize("moved_mm", sample([0.3, 1.0, 5.0], [5.0]))
def test_a_part_of_the_catalogue_that_moves_is_never_said_not_to_be_in_it(moved_mm: float) -> None:
    shown = moving = 0
    for seed in range(10):
        placed = place_within(SIX[seed % 6], np.random.default_rng([seed, 4]))
        result = searched(seed, placed, moved_mm)
        causes = [item.cause for item in result.contradictions]
        assert ContradictionCause.NOT_IN_CATALOGUE not in causes
        shown += ContradictionCause.MOVED in causes
        moving += result.outcome is IdentificationVerdict.MOVING
    assert moving >= (7 if moved_mm > 2.0 else 0)
    assert shown >= moving


def test_touches_are_made_again_on_the_same_ways() -> None:
    made: list[Sequence[FingerApproach]] = []
    touches = SimulatedTouches(REACH, altered(0), np.random.default_rng(5))
    seen = 0
    for seed in range(12):
        made.clear()
        touches.placed = altered(seed)

        def carried(grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None]) -> Sequence[Touch]:
            made.append(grip)
            return touches(grip, tell)

        result = search(RIG, REACH, carried, CATALOGUE, seed=seed)
        for item in result.contradictions:
            if item.repeated_in is None:
                continue
            ways = [[(way.start_mm, way.direction_rad) for way in grip] for grip in made]
            assert ways[item.repeated_in - 1] in ways[: item.grip - 1]
            seen += 1
    assert seen >= 3
