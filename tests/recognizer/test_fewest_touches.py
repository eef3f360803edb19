"""Lower bound on touches, and hypotheses that need not be told apart."""

import math
from itertools import combinations

import numpy as np
import pytest

from palpate.base.geometry import Floats, ObjectModel
from palpate.recognizer import Catalogue, Goals, Recognition, fewest_touches, near_equal, plan_grip, recognise
from palpate.recognizer.fewest_touches import smallest_cover_bound
from support.campaign.sampling import sample
from support.oracles.plans import GOALS, RESOLUTION, ring
from support.oracles.shapely_touches import Placed, flat, grip

L_SHAPE = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 40), (0, 40)]
LONGER = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 40.6), (0, 40.6)]


def smallest_cover(covers: Floats) -> int:
    """By trying all sets."""
    wanted = covers.any(axis=0)
    for size in range(len(covers) + 1):
        for rows in combinations(range(len(covers)), size):
            if (covers[list(rows)].any(axis=0) >= wanted).all():
                return size
    raise AssertionError("all rows together cover what any covers")


@pytest.mark.parametrize("seed", sample(range(200), range(20)))
def test_no_set_that_covers_is_smaller_than_the_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    covers = rng.random((rng.integers(1, 9), rng.integers(1, 12))) < rng.uniform(0.1, 0.7)
    least = smallest_cover(covers)
    bound = smallest_cover_bound(covers)
    assert bound <= least
    assert (bound == 0) == (least == 0)
    assert bound >= least / (1 + math.log(covers.shape[1]))  # Chvátal: greedy is no further off


def left_by(models: list[ObjectModel], fingers: int, bound_mm: float = 1.5) -> Recognition:
    contacts = grip(
        Placed(models[0], 0.0, 0.0, 0.0),
        np.random.default_rng(1),
        fingers=fingers,
        bound=bound_mm,
        half_range=math.radians(10.0),
    )
    return recognise(Catalogue(models), [item for item in contacts if item.touched])


def test_what_is_placed_finely_needs_no_more_touches() -> None:
    found = left_by([flat("one", L_SHAPE)], fingers=8, bound_mm=0.02)
    assert GOALS.are_met_by(found.hypotheses[0].search_bounds)
    assert fewest_touches(found, ring(), RESOLUTION, GOALS, 0) == 0


def test_touches_of_a_grip_that_is_enough_are_no_fewer_than_the_bound() -> None:
    found = left_by([flat("one", L_SHAPE), flat("other", [(0, 0), (50, 0), (50, 30), (0, 30)])], fingers=3)
    most = max(
        fewest_touches(found, ring(), RESOLUTION, GOALS, number) for number in range(len(found.hypotheses))
    )
    assert most >= 1
    made = plan_grip(found, ring(), RESOLUTION, GOALS, fingers=3)
    assert made is not None
    assert most <= len(made.indices) or made.remaining > 0.0


def test_states_of_one_object_that_agree_within_the_goals_are_near_equal() -> None:
    one, longer = flat("one", L_SHAPE), flat("one", [(x + 5.0, y) for x, y in LONGER])
    (state,) = longer.states
    both = ObjectModel("one", (*one.states, type(state)("longer", state.sections)))
    found = left_by([both], fingers=5)
    states = {item.state_index for item in found.hypotheses}
    assert states == {0, 1}
    assert near_equal(found.hypotheses, Goals(6.0, math.radians(3.0))).all()
    assert not near_equal(found.hypotheses, Goals(4.0, math.radians(3.0))).all()


def test_different_objects_are_never_near_equal() -> None:
    found = left_by([flat("one", L_SHAPE), flat("longer", LONGER)], fingers=5)
    of = np.array([item.state_index for item in found.hypotheses])
    assert set(of.tolist()) == {0, 1}
    assert not near_equal(found.hypotheses, Goals(50.0, math.pi))[of == 0][:, of == 1].any()
