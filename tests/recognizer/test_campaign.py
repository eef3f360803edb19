"""The campaign of recognition, and budgets of time."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from palpate.base.errors import InputError
from palpate.base.vocabulary import DEFAULT_BUDGET, LEAST_BUDGET
from palpate.recognizer import Budget, Catalogue, Contact, Recognition, recognise
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.numpy_pairing import matching_edges
from palpate.rig.identification.result import unfinished_out
from support.campaign.objects import FAMILIES, KINDS, catalogue_of, objects_of
from support.campaign.sampling import sample
from support.campaign.trials import Trial, asked, drawn, holding_cell, looks_alike, outcome
from support.commands.repository import needs_shared_outlines
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
)

# ----------------------------------------------------------------------------------------------------
# No truth is lost in seeded grips of every kind. More of them: benchmarks/bench_completeness.py.

GRIPS = 40
AT_HAND = tuple(name for name in FAMILIES if name != "parts")


def campaign_part(part: int, families: tuple[str, ...]) -> list[Trial]:
    return [drawn(seed, families) for seed in range(part * GRIPS, (part + 1) * GRIPS)]


def lost(trials: list[Trial]) -> list[int]:
    found = []
    for trial in trials:
        result = outcome(trial, asked(trial))
        if not (result.in_bounds and result.in_cells):
            found.append(trial.seed)
    return found


@pytest.mark.parametrize("part", sample(range(6), [2]))
def test_own_and_shipped_models(part: int) -> None:
    assert lost(campaign_part(part, AT_HAND)) == []


@needs_shared_outlines
@pytest.mark.parametrize("part", sample(range(6), [3]))
def test_with_cut_parts(part: int) -> None:
    assert lost(campaign_part(part, FAMILIES)) == []


def test_a_trial_depends_on_its_seed_alone() -> None:
    once = drawn(17, AT_HAND)
    drawn(18, AT_HAND)
    again = drawn(17, AT_HAND)
    assert once.steps == again.steps
    assert (once.placed.x, once.placed.y, once.placed.theta) == (
        again.placed.x,
        again.placed.y,
        again.placed.theta,
    )
    assert drawn(18, AT_HAND).steps != once.steps


def assert_true(contact: Contact, trial: Trial) -> None:
    """That the object is as far from the tip as the contact says, and the path as free."""
    radius, bound = contact.finger.tip_radius_mm, contact.position_bound_mm
    shape = trial.placed.shape_at(contact.finger.height_mm)
    path = shapely.LineString([contact.start_mm, contact.end_mm])
    assert shapely.distance(shape, path) >= radius - contact.free_path_bound_mm - 1e-6
    assert contact.free_path_bound_mm == pytest.approx(bound + trial.setting.further_mm)
    if contact.touched:
        away = shapely.distance(shape.boundary, shapely.Point(contact.end_mm))
        assert abs(away - radius) <= bound + 1e-6


def test_contacts_are_within_their_bounds() -> None:
    for trial in campaign_part(0, AT_HAND):
        for step in trial.steps:
            for contact in step:
                assert_true(contact, trial)


def test_another_configuration_is_in_no_cell() -> None:
    """The question asked of every answer is one that can be answered with no."""
    trial = next(
        trial
        for trial in (drawn(seed, ("memo",)) for seed in range(200))
        if trial.setting.bound_mm == 0.1 and trial.setting.touches >= 4
    )
    answer, model, placed = asked(trial)[-1], trial.model, trial.placed
    assert holding_cell(answer, model, placed) is not None
    assert holding_cell(answer, model, replace(placed, x=placed.x + 2.0)) is None
    assert holding_cell(answer, model, replace(placed, theta=placed.theta + 0.1)) is None


def test_what_looks_alike_is_for_the_judge_to_say() -> None:
    angle = 2 * math.pi * np.arange(900) / 900
    oval = flat("oval", np.column_stack([20.0 * np.cos(angle), 19.95 * np.sin(angle)]))
    assert looks_alike(oval, np.zeros(2), math.pi)
    assert not looks_alike(oval, np.zeros(2), math.pi / 2)
    assert not looks_alike(oval, np.zeros(2), math.radians(4))


def test_all_kinds_of_trial_are_drawn() -> None:
    trials = [trial for part in range(5) for trial in campaign_part(part, AT_HAND)]
    settings = [trial.setting for trial in trials]
    contacts = [contact for trial in trials for step in trial.steps for contact in step]
    assert {setting.kind for setting in settings} == {"memo", "own", "loose", *KINDS}
    assert {setting.touches for setting in settings} == {1, 2, 3, 4, 5, 6}
    assert {contact.finger.tip_radius_mm for contact in contacts} > {0.0, 1.0, 5.0, 8.0}
    assert {contact.position_bound_mm for contact in contacts} == {0.0, 0.01, 0.1, 0.3, 1.0, 2.0}
    assert {contact.touched for contact in contacts} == {True, False}
    assert {setting.at_bound for setting in settings} == {True, False}
    assert {setting.further_mm for setting in settings} == {0.0, 0.5, 2.0, 5.0}
    assert {setting.tolerance_mm for setting in settings} == {0.0, 0.05, 0.25}
    normals = [contact.normal for contact in contacts if contact.touched]
    assert None in normals
    assert any(item is not None and item.lo_rad == item.hi_rad for item in normals)
    assert any(item is not None and item.lo_rad > math.pi for item in normals)
    assert any(len(trial.steps) > 1 for trial in trials)


def test_own_objects_are_symmetric_or_not_as_meant() -> None:
    orders = {state.object_name: state.symmetry_order for state in catalogue_of("own").states}
    assert orders == {"stepped": 1, "islands": 1, "frame": 1, "comb": 1, "square": 4}
    assert {model.name for model in objects_of("own")} == set(orders)


# ----------------------------------------------------------------------------------------------------
# A budget in units of work: the truth stays with the smallest, and what is unfinished is said.


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
    normals = contact.outward_normals()
    assert normals is not None
    asked = catalogue, (states, np.zeros(10), np.full(10, 6.0)), contact.finger, normals, anywhere
    with pytest.raises(BudgetSpentError):
        matching_edges(*asked, 10)
    assert len(matching_edges(*asked, 100_000)[0]) > 10


def test_a_budget_below_the_least_is_refused() -> None:
    with pytest.raises(InputError, match=r"9999 units of work is too small: at least 10000"):
        Budget(LEAST_BUDGET - 1)
