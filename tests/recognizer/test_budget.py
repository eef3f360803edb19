"""A budget in units of work: the truth stays with the smallest, and what is unfinished is said."""

import numpy as np
import pytest
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, Placed, grip, holding_truth, outlines, place

from palpate.base.errors import InputError
from palpate.base.vocabulary import DEFAULT_BUDGET, LEAST_BUDGET
from palpate.recognizer import Budget, Catalogue, Contact, Recognition, recognise
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.interpretation_tree import matching_edges
from palpate.rig.identification.result import unfinished_out


def touches(seed: int, half_range: float | None, fingers: int = 3) -> tuple[Catalogue, Placed, list[Contact]]:
    rng = np.random.default_rng([705, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % len(models)], rng)
    while True:
        contacts = grip(placed, rng, fingers=fingers, bound=1.0, half_range=half_range, aim=0.2)
        if sum(contact.touched for contact in contacts) >= 3:
            return Catalogue(models), placed, contacts


def said(found: Recognition) -> list[tuple[object, ...]]:
    return [(item.state_index, item.configuration, item.bounds, item.verified) for item in found.hypotheses]


@pytest.mark.parametrize("half_range", [0.1, None])
@pytest.mark.parametrize("seed", sample(range(6), range(3)))
def test_the_truth_stays_whatever_the_budget(seed: int, half_range: float | None) -> None:
    catalogue, placed, contacts = touches(seed, half_range)
    for units in (LEAST_BUDGET, 30_000, 200_000, DEFAULT_BUDGET):
        assert holding_truth(recognise(catalogue, contacts, budget=Budget(units)), placed) is not None


@pytest.mark.parametrize("seed", sample(range(6), range(3)))
def test_a_budget_that_suffices_says_nothing_of_it(seed: int) -> None:
    catalogue, _, contacts = touches(seed, 0.1)
    found = recognise(catalogue, contacts)
    assert (found.unpaired_contacts, found.has_coarse_cells, unfinished_out(found)) == ((), False, None)


@pytest.mark.parametrize("seed", range(3))
def test_a_budget_that_is_spent_says_what_is_unfinished(seed: int) -> None:
    """Without normals three touches leave far more than the least budget allows."""
    catalogue, _, contacts = touches(seed, None)
    found = recognise(catalogue, contacts, budget=Budget(LEAST_BUDGET))
    told = unfinished_out(found)
    assert told is not None
    assert told.budget == LEAST_BUDGET
    assert told.unpaired == tuple(contact.name for contact in found.unpaired_contacts)
    assert told.unpaired or told.coarse
    assert len(found.levels) == sum(contact.touched for contact in contacts) - len(told.unpaired)
    for item in found.hypotheses:
        assert all(len(row) == sum(contact.touched for contact in contacts) for row in item.features)


@pytest.mark.parametrize("seed", range(4))
def test_what_is_verified_with_a_large_budget_is_in_the_bounds_of_a_small_one(seed: int) -> None:
    catalogue, _, contacts = touches(seed, None)
    small = recognise(catalogue, contacts, budget=Budget(LEAST_BUDGET)).hypotheses
    for item in recognise(catalogue, contacts).hypotheses:
        at = item.configuration
        assert not item.verified or any(
            other.state_index == item.state_index
            and other.bounds.x_mm[0] <= at.x_mm <= other.bounds.x_mm[1]
            and other.bounds.y_mm[0] <= at.y_mm <= other.bounds.y_mm[1]
            for other in small
        )


@pytest.mark.parametrize("seed", range(4))
def test_a_larger_budget_narrows_bounds(seed: int) -> None:
    catalogue, placed, contacts = touches(seed, 0.1, fingers=5)
    narrow, wide = (
        holding_truth(recognise(catalogue, contacts, budget=Budget(units)), placed)
        for units in (20 * DEFAULT_BUDGET, LEAST_BUDGET)
    )
    assert narrow is not None
    assert wide is not None
    assert narrow.bounds.position_half_mm <= wide.bounds.position_half_mm + 1e-6
    assert narrow.bounds.orientation_half_rad <= wide.bounds.orientation_half_rad + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_the_same_budget_gives_the_same_answer(seed: int) -> None:
    catalogue, _, contacts = touches(seed, None)
    again, _, _ = touches(seed, None)
    found = [recognise(some, contacts, budget=Budget(40_000)) for some in (catalogue, again)]
    assert said(found[0]) == said(found[1])


@pytest.mark.parametrize("seed", range(4))
def test_spurious_contacts_may_be_unpaired_too(seed: int) -> None:
    catalogue, placed, contacts = touches(seed, None, fingers=4)
    found = recognise(catalogue, contacts, max_spurious=1, budget=Budget(LEAST_BUDGET))
    assert found.unpaired
    assert holding_truth(found, placed) is not None


def test_a_query_of_more_edges_than_allowed_is_not_made() -> None:
    catalogue, _, contacts = touches(0, 0.1)
    states = np.zeros(10, dtype=np.int64)

    def anywhere(query: np.ndarray, *_: object) -> np.ndarray:
        return np.ones(len(query), dtype=bool)

    contact = next(item for item in contacts if item.touched)
    lo, hi = np.zeros(10), np.full(10, 6.0)
    with pytest.raises(BudgetSpentError):
        matching_edges(catalogue, states, lo, hi, contact, anywhere, 10)
    assert len(matching_edges(catalogue, states, lo, hi, contact, anywhere, 100_000)[0]) > 10


def test_a_budget_below_the_least_is_refused() -> None:
    with pytest.raises(InputError, match=r"9999 units of work is too small: at least 10000"):
        Budget(LEAST_BUDGET - 1)
