"""No truth is lost in seeded grips of every kind. More of them: `make campaign`, benchmarks/campaign.py."""

import math

import numpy as np
import pytest
import shapely
from campaign_checks import asked, holding_cell, outcome
from campaign_objects import FAMILIES, catalogue_of, objects_of
from campaign_trials import Trial, drawn
from sampling import sample
from shapely_bench import Placed
from shapely_contacts import edges_of
from shared_files import needs_shared_outlines

from palpate.recognizer import Contact

SEED = 705
PARTS_OF_TEST, GRIPS = 12, 60


def campaign_part(part: int, families: tuple[str, ...]) -> list[Trial]:
    return [drawn(SEED, index, families) for index in range(part * GRIPS, (part + 1) * GRIPS)]


def lost(trials: list[Trial]) -> list[Trial]:
    found = []
    for trial in trials:
        result = outcome(trial, asked(trial))
        if not (result.in_bounds and result.in_cells):
            found.append(trial)
    return found


@pytest.mark.parametrize("part", sample(range(PARTS_OF_TEST // 2), [1]))
def test_own_and_shipped_models(part: int) -> None:
    assert lost(campaign_part(part, ("memo", "own", "loose"))) == []


@needs_shared_outlines
@pytest.mark.parametrize(
    "part",
    sample(range(PARTS_OF_TEST // 2, PARTS_OF_TEST), [7]),
)
def test_with_cut_parts(part: int) -> None:
    assert lost(campaign_part(part, FAMILIES)) == []


def test_a_trial_depends_on_its_index_alone() -> None:
    families = ("memo", "own", "loose")
    once = drawn(SEED, 17, families)
    drawn(SEED, 18, families)
    again = drawn(SEED, 17, families)
    assert once.steps == again.steps
    assert (once.placed.x, once.placed.y, once.placed.theta) == (
        again.placed.x,
        again.placed.y,
        again.placed.theta,
    )
    assert drawn(SEED, 18, families).steps != once.steps


def assert_true(contact: Contact, placed: Placed) -> None:
    """That the object is as far from the tip as the contact says, and the path as free."""
    radius, bound = contact.finger.tip_radius_mm, contact.position_bound_mm
    shape = placed.shape_at(contact.finger.height_mm)
    path = shapely.LineString([contact.start_mm, contact.end_mm])
    assert shapely.distance(shape, path) >= radius - bound - 1e-6
    if not contact.touched:
        return
    away = shapely.distance(shape.boundary, shapely.Point(contact.end_mm))
    assert abs(away - radius) <= bound + 1e-6
    if contact.normal is not None:
        begin, end = edges_of(shape)
        along = end - begin
        against = np.array([along[:, 1], -along[:, 0]]).T @ (np.subtract(contact.end_mm, contact.start_mm))
        assert np.any(against < 0)
        assert 0 < contact.normal.hi_rad - contact.normal.lo_rad <= 2 * math.pi + 1e-9


def test_contacts_are_within_their_bounds() -> None:
    for trial in campaign_part(0, ("memo", "own", "loose")):
        for step in trial.steps:
            for contact in step:
                assert_true(contact, trial.placed)


def test_another_configuration_is_in_no_cell() -> None:
    """The question asked of every answer is one that can be answered with no."""
    trial = next(
        trial
        for trial in campaign_part(0, ("memo",))
        if trial.setting.bound_mm == 0.1 and trial.setting.touches >= 4
    )
    answer = asked(trial)[-1]
    placed = trial.placed
    assert holding_cell(answer, placed) is not None
    assert holding_cell(answer, Placed(placed.model, placed.x + 2.0, placed.y, placed.theta)) is None
    assert holding_cell(answer, Placed(placed.model, placed.x, placed.y, placed.theta + 0.1)) is None


def test_all_kinds_of_trial_are_drawn() -> None:
    families = ("memo", "own", "loose")
    trials = [trial for part in range(3) for trial in campaign_part(part, families)]
    settings = [trial.setting for trial in trials]
    contacts = [contact for trial in trials for step in trial.steps for contact in step]
    assert {setting.family for setting in settings} == set(families)
    assert {setting.touches for setting in settings} == {1, 2, 3, 4, 5, 6}
    assert {contact.finger.tip_radius_mm for contact in contacts} == {0.0, 1.0, 5.0, 8.0}
    assert {contact.position_bound_mm for contact in contacts} == {0.0, 0.01, 0.1, 0.3, 1.0, 2.0}
    assert {contact.touched for contact in contacts} == {True, False}
    assert any(contact.normal is None for contact in contacts if contact.touched)
    assert any(len(trial.steps) > 1 for trial in trials)


def test_own_objects_are_symmetric_or_not_as_meant() -> None:
    orders = {state.object_name: state.symmetry_order for state in catalogue_of("own").states}
    assert orders == {"stepped": 1, "islands": 1, "frame": 1, "comb": 1, "square": 4}
    assert {model.name for model in objects_of("own")} == set(orders)
