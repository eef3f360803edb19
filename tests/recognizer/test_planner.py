"""Predictions and plans against touches simulated by shapely."""

import math
from dataclasses import replace

import numpy as np
import pytest
from decisive_grips import poses_in
from exact_pockets import exact_pockets, hold
from reach_ring import FINGER, GOALS, RESOLUTION, Ring, model_of, normal_at, ring, some_recognition, travel_of
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, grip, outlines, place

from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import Strategy
from palpate.recognizer import (
    Catalogue,
    Recognition,
    confirmation_grip,
    next_grip,
    plan_grip,
    predict,
    recognise,
    twins,
)
from palpate.recognizer.touch_model import similarity, touch_outcomes, witness_poses

L_SHAPE = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 40), (0, 40)]


@pytest.mark.parametrize("seed", range(8))
def test_predictions_enclose_simulated_stops_and_normals(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models, found = some_recognition(seed)
    assert found.hypotheses
    approaches = [ring().approaches[k] for k in rng.integers(0, 72, 6)]
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, approaches)
    stopped = 0
    for number, item in enumerate(found.hypotheses):
        for pose in poses_in(found, item, model_of(models, item), rng, 8):
            for row, approach in enumerate(approaches):
                foretold = predictions.of(row, number)
                travel = travel_of(pose, approach)
                assert foretold.earliest_mm - 1e-6 <= travel <= foretold.latest_mm + 1e-6
                if math.isfinite(travel):
                    stopped += 1
                    assert travel <= foretold.furthest_mm + 1e-6
                    assert foretold.normal_rad is not None
                    lo, hi = foretold.normal_rad
                    past = (normal_at(pose, approach, travel) - lo + 1e-4) % (2 * math.pi)
                    assert past <= hi - lo + 2e-4
    assert stopped > 20


def test_a_prediction_that_ends_is_in_the_exact_pockets_of_its_edge() -> None:
    """Where one edge must be met, the approach is in the exact pocket of the point met (memo §3.2)."""
    checked = 0
    for seed in range(12):
        models, found = some_recognition(seed)
        edges = found.catalogue.outlines(FINGER)
        for number, item in enumerate(found.hypotheses):
            own = item.configuration
            pose = Placed(model_of(models, item), own.x_mm, own.y_mm, own.theta_rad)
            for approach in ring(12).approaches:
                foretold = predict(found.catalogue, found.hypotheses, found.anchor_mm, [approach]).of(
                    0, number
                )
                if foretold.latest_mm - foretold.earliest_mm > 4.0:
                    continue
                travel = travel_of(pose, approach)
                centre = np.asarray(approach.start_mm) + travel * np.array(
                    [math.cos(approach.direction_rad), math.sin(approach.direction_rad)]
                )
                turn = np.array(
                    [
                        [math.cos(own.theta_rad), math.sin(own.theta_rad)],
                        [-math.sin(own.theta_rad), math.cos(own.theta_rad)],
                    ]
                )
                seen = turn @ (centre - [own.x_mm, own.y_mm]) - item.state.origin_mm
                block = np.arange(edges.first[item.state_index], edges.first[item.state_index + 1])
                gap = np.abs(np.sum((seen - edges.start[block]) * edges.normal[block], axis=1))
                along = np.sum((seen - edges.start[block]) * edges.direction[block], axis=1)
                on = block[(gap < 0.15) & (along > 0.5) & (along < edges.length[block] - 0.5)]
                if len(on) != 1:
                    continue
                pockets = exact_pockets(edges, on, seen[None], 0.0)
                heading = approach.direction_rad - own.theta_rad
                assert hold(pockets, np.array([0]), np.array([heading])).all()
                checked += 1
    assert checked > 50


def test_felt_agrees_with_simulated_stops() -> None:
    rng = np.random.default_rng(3)
    models, found = some_recognition(2, half_deg=40.0)
    approaches = ring().approaches
    outcome = touch_outcomes(
        found.catalogue, witness_poses(found.hypotheses).cells, found.anchor_mm, approaches
    )
    hits = 0
    for number, item in list(enumerate(found.hypotheses))[:5]:
        own = item.configuration
        pose = Placed(model_of(models, item), own.x_mm, own.y_mm, own.theta_rad)
        for row in rng.integers(0, len(approaches), 25):
            travel = travel_of(pose, approaches[row])
            margin = abs(float(outcome.margin[row, number]))
            if margin < 1.0:
                continue  # a graze: facets decide whether it hits
            assert outcome.hit[row, number] == math.isfinite(travel)
            if math.isfinite(travel):
                hits += 1
                assert outcome.travel[row, number] == pytest.approx(travel, abs=1.0)
    assert hits > 10


def test_likeness_is_one_for_equal_poses_and_small_for_perceptible_ones() -> None:
    _, found = some_recognition(1, half_deg=40.0)
    poses = witness_poses(found.hypotheses)
    approaches = ring().approaches
    outcome = touch_outcomes(found.catalogue, poses.cells, found.anchor_mm, approaches)
    rows = np.arange(len(approaches))
    same = np.arange(len(found.hypotheses))
    assert np.all(similarity(outcome, same, same, RESOLUTION, rows) == 1.0)
    first, second = np.triu_indices(len(same), 1)
    alike = similarity(outcome, first, second, RESOLUTION, rows)
    both = outcome.hit[:, first] & outcome.hit[:, second]
    clear = np.minimum(outcome.facing[:, first], outcome.facing[:, second]) * np.abs(
        outcome.travel[:, first] - outcome.travel[:, second]
    )
    assert np.all(alike[both & (clear > RESOLUTION.distance_mm)] < math.exp(-1))
    assert np.any(both & (clear > RESOLUTION.distance_mm))


def test_a_plan_promises_what_its_predictions_say() -> None:
    decisive = planned = 0
    for seed in range(30):
        _, found = some_recognition(seed, half_deg=20.0)
        chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
        if chosen is None or len(found.hypotheses) < 2:
            continue
        planned += 1
        assert 0.0 <= chosen.remaining <= 1.0
        fingers = [item.finger_index for item in chosen.approaches]
        assert len(set(fingers)) == len(fingers) <= 3
        for row, (candidate, travel) in enumerate(zip(chosen.approaches, chosen.travels_mm, strict=True)):
            furthest = max(item.furthest_mm for item in chosen.predictions.of_approach(row))
            assert min(furthest, candidate.travel_mm) <= travel <= candidate.travel_mm
        apart = chosen.predictions.apart(RESOLUTION.normal_half_rad)
        np.fill_diagonal(apart, val=True)
        assert chosen.decisive == bool((apart | twins(found, ring(), RESOLUTION)).all())
        decisive += chosen.decisive
    assert planned >= 15
    assert 5 <= decisive < planned


def test_where_contacts_may_be_spurious_nothing_is_decisive() -> None:
    rng = np.random.default_rng(3)
    models = outlines(SHIPPED_OBJECTS)
    contacts = grip(place(models[0], rng), rng, fingers=5)
    found = recognise(Catalogue(models), contacts, max_spurious=1)
    chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
    assert chosen is not None
    assert not chosen.decisive


def hypotheses_for(models: list[ObjectModel], placed: Placed) -> Recognition:
    return recognise(Catalogue(models), grip(placed, np.random.default_rng(4), fingers=4, bound=0.1))


def all_twins(found: Recognition, reachable: Ring) -> bool:
    return bool(twins(found, reachable, RESOLUTION).all())


def test_exact_twins_cannot_be_told_apart() -> None:
    models = [flat("one", L_SHAPE), flat("other", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert all_twins(found, ring())


def test_a_grip_that_leaves_only_twins_is_decisive() -> None:
    """One class is left whatever happens, though two objects are."""
    models = [flat("one", L_SHAPE), flat("other", L_SHAPE)]
    decisive = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        placed = Placed(models[0], 0.0, 0.0, rng.uniform(-3.0, 3.0))
        found = recognise(Catalogue(models), grip(placed, rng, half_range=math.radians(25)))
        chosen = plan_grip(found, ring(), RESOLUTION, GOALS)
        if chosen is None or all_twins(found, ring()):
            continue
        apart = chosen.predictions.apart(RESOLUTION.normal_half_rad)
        np.fill_diagonal(apart, val=True)
        assert not apart.all()
        assert chosen.decisive == bool((apart | twins(found, ring(), RESOLUTION)).all())
        decisive += chosen.decisive
    assert decisive >= 2


def test_a_twin_turned_in_its_file_is_still_a_twin() -> None:
    outline = np.array(L_SHAPE, dtype=float) @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + (100.0, -30.0)
    models = [flat("one", L_SHAPE), flat("other", outline)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert all_twins(found, ring())


def test_a_symmetric_copy_is_one_hypothesis() -> None:
    square = flat("square", [(0, 0), (40, 0), (40, 40), (0, 40)])
    found = hypotheses_for([square], Placed(square, -20.0, -20.0, 0.0))
    assert len(found.hypotheses) == 1
    assert found.hypotheses[0].state.symmetry_order == 4
    assert all_twins(found, ring())


def test_a_longer_brother_can_be_told_apart_until_all_approaches_are_used() -> None:
    longer = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 46), (0, 46)]
    models = [flat("one", L_SHAPE), flat("longer", longer)]
    placed = Placed(models[0], 0.0, 0.0, 0.0)
    rng = np.random.default_rng(1)
    contacts = [replace(c, normal=None) for c in grip(placed, rng, fingers=2, bound=0.5, half_range=None)]
    found = recognise(Catalogue(models), [contact for contact in contacts if contact.touched])
    assert len(found.hypotheses) > 1
    assert not all_twins(found, ring())
    every = np.ones(len(ring().approaches), dtype=bool)
    assert twins(found, ring(), RESOLUTION, every).all()
    assert plan_grip(found, ring(), RESOLUTION, GOALS, every) is None


def test_no_candidates_give_no_grip() -> None:
    models = [flat("one", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 0.0, 0.0, 0.0))
    nothing = Ring([])
    for strategy in Strategy:
        rng = np.random.default_rng(0)
        assert next_grip(strategy, found, nothing, RESOLUTION, GOALS, rng) is None
    assert confirmation_grip(found, nothing, RESOLUTION, 2) is None
    assert all_twins(found, nothing)
