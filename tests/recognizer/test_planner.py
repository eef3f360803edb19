"""Predicted stops, decisive grips and the verdict "indistinguishable", against brute force."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, grip, outlines, place, stop

from palpate.recognizer import Approach, Candidate, Catalogue, Recognition, Resolution, plan_grip, recognise
from palpate.recognizer.contact import Finger
from palpate.recognizer.hypotheses import Hypothesis
from palpate.recognizer.model import ObjectModel
from palpate.recognizer.planner import predict, separable

RESOLUTION = Resolution(1.0, math.radians(15))
FINGER = Finger(5.0, 10.0)
L_SHAPE = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 40), (0, 40)]


def ring_of_candidates(count: int = 24, bound: float = 0.3) -> list[Candidate]:
    return [
        Candidate(
            k % 3,
            Approach(
                FINGER,
                (140 * math.cos(at), 140 * math.sin(at)),
                at + math.pi + aim,
                280.0,
                bound,
            ),
        )
        for k, at in enumerate(2 * math.pi * np.arange(count) / count)
        for aim in (-0.12, 0.0, 0.12)
    ]


def model_of(models: list[ObjectModel], item: Hypothesis) -> ObjectModel:
    return next(model for model in models if model.name == item.state.object_name)


def sampled_poses(
    recognition: Recognition, item: Hypothesis, model: ObjectModel, rng: np.random.Generator, count: int
) -> list[Placed]:
    """Configurations in the hypothesis's cells: corners and mixtures of corners."""
    poses = []
    for row in rng.integers(0, len(item.cells), count):
        corners = item.cells.polygon[row]
        weight = rng.dirichlet(np.full(len(corners), 0.3))
        position = weight @ corners
        theta = rng.choice([item.cells.lo[row], item.cells.hi[row], item.cells.middle[row]])
        turn = np.array([[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]])
        x, y = recognition.anchor_mm + turn @ (position - item.state.origin_mm)
        poses.append(Placed(model, float(x), float(y), float(theta)))
    return poses


def travel_of(placed: Placed, approach: Approach) -> float:
    start = np.asarray(approach.start_mm)
    radius = approach.finger.tip_radius_mm
    return stop(placed.shape, start, approach.direction_rad, radius, approach.travel_mm)


@pytest.mark.parametrize("seed", range(6))
def test_predictions_enclose_simulated_stops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed], rng)
    found = recognise(Catalogue(models), grip(placed, rng))
    assert found.hypotheses
    candidates = [ring_of_candidates()[k] for k in rng.integers(0, 72, 6)]
    for candidate in candidates:
        predictions = predict(found, candidate.approach)
        assert len(predictions) == len(found.hypotheses)
        for item, prediction in zip(found.hypotheses, predictions, strict=True):
            for pose in sampled_poses(found, item, model_of(models, item), rng, 8):
                travel = travel_of(pose, candidate.approach)
                assert prediction.earliest_mm - 1e-6 <= travel <= prediction.latest_mm + 1e-6


@pytest.mark.parametrize("seed", range(10))
def test_decisive_grips_decide(seed: int) -> None:
    """No outcome that one hypothesis of a decisive grip allows is allowed by another."""
    rng = np.random.default_rng(50 + seed)
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % 6], rng)
    found = recognise(Catalogue(models), grip(placed, rng))
    candidates = ring_of_candidates()
    finger = np.array([candidate.finger_index for candidate in candidates])
    chosen = plan_grip(found, candidates, finger[:, None] != finger, RESOLUTION)
    if chosen is None or len(found.hypotheses) < 2:
        return
    assert 0.0 <= chosen.confusion <= 1.0
    assert len({item.finger_index for item in chosen.candidates}) == len(chosen.candidates)
    travels = [
        np.array(
            [
                [travel_of(pose, item.approach) for item in chosen.candidates]
                for pose in sampled_poses(found, hypothesis, model_of(models, hypothesis), rng, 10)
            ]
        )
        for hypothesis in found.hypotheses
    ]
    if not chosen.decisive:
        return
    for a in range(len(travels)):
        for b in range(a):
            apart = (travels[a].max(axis=0) < travels[b].min(axis=0)) | (
                travels[b].max(axis=0) < travels[a].min(axis=0)
            )
            assert apart.any()


def test_a_planned_grip_resolves_what_it_says() -> None:
    rng = np.random.default_rng(77)
    models = outlines(SHIPPED_OBJECTS)
    decisive = 0
    for trial in range(12):
        placed = place(models[trial % 6], rng)
        found = recognise(Catalogue(models), grip(placed, rng, half_range=math.radians(20)))
        candidates = ring_of_candidates()
        finger = np.array([candidate.finger_index for candidate in candidates])
        chosen = plan_grip(found, candidates, finger[:, None] != finger, RESOLUTION)
        decisive += bool(chosen and chosen.decisive and len(found.hypotheses) > 1)
    assert decisive >= 2


def hypotheses_for(models: list[ObjectModel], placed: Placed) -> Recognition:
    return recognise(Catalogue(models), grip(placed, np.random.default_rng(4), fingers=4, bound=0.1))


def test_exact_twins_cannot_be_told_apart() -> None:
    models = [flat("one", L_SHAPE), flat("other", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert not separable(found, ring_of_candidates(), RESOLUTION)


def test_a_twin_turned_in_its_file_is_still_a_twin() -> None:
    ring = np.array(L_SHAPE, dtype=float) @ np.array([[0.0, 1.0], [-1.0, 0.0]]) + (100.0, -30.0)
    models = [flat("one", L_SHAPE), flat("other", ring)]
    found = hypotheses_for(models, Placed(models[0], 3.0, 4.0, 0.7))
    assert {item.state.object_name for item in found.hypotheses} == {"one", "other"}
    assert not separable(found, ring_of_candidates(), RESOLUTION)


def test_a_symmetric_copy_is_one_hypothesis() -> None:
    square = flat("square", [(0, 0), (40, 0), (40, 40), (0, 40)])
    found = hypotheses_for([square], Placed(square, -20.0, -20.0, 0.0))
    assert len(found.hypotheses) == 1
    assert found.hypotheses[0].state.symmetry_order == 4
    assert not separable(found, ring_of_candidates(), RESOLUTION)


def test_a_longer_brother_can_be_told_apart() -> None:
    longer = [(0, 0), (50, 0), (50, 20), (20, 20), (20, 46), (0, 46)]
    models = [flat("one", L_SHAPE), flat("longer", longer)]
    placed = Placed(models[0], 0.0, 0.0, 0.0)
    rng = np.random.default_rng(1)
    contacts = [replace(c, normal=None) for c in grip(placed, rng, fingers=2, bound=0.5, half_range=None)]
    found = recognise(Catalogue(models), [contact for contact in contacts if contact.touched])
    assert len(found.hypotheses) > 1
    assert separable(found, ring_of_candidates(), RESOLUTION)


def test_no_candidates_give_no_grip() -> None:
    models = [flat("one", L_SHAPE)]
    found = hypotheses_for(models, Placed(models[0], 0.0, 0.0, 0.0))
    assert plan_grip(found, [], np.ones((0, 0), dtype=bool), RESOLUTION) is None
    assert not separable(found, [], RESOLUTION)
