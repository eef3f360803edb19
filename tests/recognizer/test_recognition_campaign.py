"""No truth is lost in seeded grips of every kind. More of them: benchmarks/bench_completeness.py."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from campaign_checks import asked, holding_cell, looks_alike, outcome
from campaign_objects import FAMILIES, catalogue_of, objects_of
from campaign_outlines import KINDS
from campaign_trials import Trial, drawn
from sampling import sample
from shapely_bench import flat
from shared_files import needs_shared_outlines

from palpate.recognizer import Contact

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


@pytest.mark.parametrize("part", sample(range(6), [1]))
def test_own_and_shipped_models(part: int) -> None:
    assert lost(campaign_part(part, AT_HAND)) == []


@needs_shared_outlines
@pytest.mark.parametrize("part", sample(range(6), [0]))
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
