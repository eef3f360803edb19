"""Pads in the recogniser: where faces stop, by shapely, and whether plans for them keep what they promise."""

import math
import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from palpate.base.tips import TipShape
from palpate.config import RigFile
from palpate.recognizer import (
    Approach,
    Catalogue,
    Contact,
    Finger,
    FingerApproach,
    plan_grip,
    predict,
    recognise,
    recognised_shift_mm,
    twins,
    used_approaches,
)
from palpate.recognizer.pad_face import face_offsets_mm, face_points
from palpate.recognizer.touch_model import touch_outcomes, witness_poses
from palpate.rig.conversion import goals_of
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.exploration import exploring_grip
from palpate.rig.reach.approaches import Reach, reach_of
from support.campaign.sampling import sample
from support.commands.repository import ROOT
from support.oracles.decisive_grips import came_from, poses_in
from support.oracles.pads import face_stop_mm, pad_contacts, seen_along
from support.oracles.plans import model_of, ring, some_recognition
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, outlines, place_within, placed_as

_MOST_HYPOTHESES = 40
_BOUND_MM, _PITCH_MM = 0.18, 0.2


def pad(half_mm: float) -> Finger:
    return Finger(half_mm, 10.0, shape=TipShape.PAD)


def with_pad(approach: FingerApproach, half_mm: float, bound_mm: float) -> FingerApproach:
    return replace(approach, finger=pad(half_mm), position_bound_mm=bound_mm)


def test_points_of_a_face_reach_from_edge_to_edge() -> None:
    assert face_offsets_mm(5.0).tolist() == [-5.0, -2.5, 0.0, 2.5, 5.0]
    assert face_offsets_mm(1.0).tolist() == [-1.0, 0.0, 1.0]
    points = face_points(Approach(pad(2.0), (10.0, 0.0), math.pi, 50.0, 0.1))
    assert [point.finger for point in points] == [Finger(0.0, 10.0)] * 3
    assert np.array([point.start_mm for point in points]) == pytest.approx(
        np.array([(10, 2), (10, 0), (10, -2)])
    ), "left of a way to the left is below"


@pytest.mark.parametrize("seed", sample(range(24), range(8)))
def test_predictions_enclose_where_faces_stop(seed: int) -> None:
    rng = np.random.default_rng([83, seed])
    models, found = some_recognition(seed)
    half, bound = float(rng.choice([1.0, 5.0, 12.0])), float(rng.choice([0.0, 0.4]))
    approaches = [with_pad(ring().approaches[k], half, bound) for k in rng.integers(0, 72, 6)]
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, approaches)
    stopped = 0
    for number, item in enumerate(found.hypotheses):
        for pose in poses_in(found, item, model_of(models, item), rng, 6):
            for row, approach in enumerate(approaches):
                around = float(rng.uniform(-math.pi, math.pi))
                start = np.array(approach.start_mm) + bound * np.array([math.cos(around), math.sin(around)])
                travel = face_stop_mm(pose.shape, start, approach.direction_rad, half)
                travel = travel if travel <= approach.travel_mm else math.inf
                said = predictions.of(row, number)
                assert said.earliest_mm - 1e-6 <= travel <= said.latest_mm + 1e-6
                if math.isfinite(travel):
                    stopped += 1
                    assert travel <= said.furthest_mm + 1e-6
                    assert said.normal_rad is not None
                    assert said.normal_rad[1] - said.normal_rad[0] == pytest.approx(2 * math.pi)
    assert stopped > 20


def test_outcomes_are_where_faces_stop() -> None:
    rng = np.random.default_rng(84)
    _, found = some_recognition(2, half_deg=40.0)
    approaches = [with_pad(item, 6.0, 0.1) for item in ring().approaches]
    poses = witness_poses(found.hypotheses).cells
    outcome = touch_outcomes(found.catalogue, poses, found.anchor_mm, approaches)
    hits = 0
    for number, item in list(enumerate(found.hypotheses))[:6]:
        shape = placed_as(item).shape
        for row in rng.integers(0, len(approaches), 25).tolist():
            way = approaches[row]
            travel = face_stop_mm(shape, np.array(way.start_mm), way.direction_rad, 6.0)
            left = seen_along(shape, np.array(way.start_mm), way.direction_rad).bounds
            margin = min(left[3] + 6.0, 6.0 - left[1])
            assert outcome.margin[row, number] == pytest.approx(margin, abs=0.05)
            if abs(margin) < 1e-3:
                continue
            assert outcome.hit[row, number] == (travel <= way.travel_mm)
            if outcome.hit[row, number]:
                hits += 1
                assert outcome.travel[row, number] == pytest.approx(travel, abs=1e-6)
    assert hits > 10


def test_a_pad_has_used_an_approach_if_its_whole_face_went_there() -> None:
    candidates = [with_pad(item, 5.0, 0.1) for item in ring().approaches]

    def along(approach: Approach, shift_mm: float = 0.0) -> list[Contact]:
        moved = replace(approach, start_mm=(approach.start_mm[0], approach.start_mm[1] + shift_mm))
        ways = []
        for point in face_points(moved):
            (x, y), angle = point.start_mm, point.direction_rad
            end = x + 90 * math.cos(angle), y + 90 * math.sin(angle)
            ways.append(Contact("f", point.finger, False, point.start_mm, end, 0.1))
        return ways

    assert np.flatnonzero(used_approaches(along(candidates[7]), candidates)).tolist() == [7]
    sideways = next(item for item in candidates if abs(math.sin(item.direction_rad)) < 0.1)
    number = candidates.index(sideways)
    assert not used_approaches(along(sideways, 2.5), candidates)[number], "half of its points did"
    assert not used_approaches(along(sideways)[1:], candidates)[number], "one end did not"


def test_sections_are_asked_for_by_points_only() -> None:
    with pytest.raises(ValueError, match="points of a pad's face"):
        Catalogue([flat("square", [(0, 0), (20, 0), (20, 20), (0, 20)])]).outlines(pad(5.0))


@cache
def pad_rig() -> RigFile:
    return RigFile.model_validate(tomllib.loads((ROOT / "examples" / "pad-rig.toml").read_text("utf-8")))


@cache
def reach() -> Reach:
    """Of the example's pads, with finer bounds, so that more plans are decisive."""
    found = reach_of(pad_rig())
    return replace(
        found, approaches=tuple(replace(item, position_bound_mm=_BOUND_MM) for item in found.approaches)
    )


@cache
def catalogue() -> Catalogue:
    return Catalogue(outlines(SHIPPED_OBJECTS))


@pytest.mark.parametrize("seed", sample(range(60), range(6)))
def test_decisive_grips_of_pads_decide(seed: int) -> None:
    """Carried out for every hypothesis, anywhere in its region, they leave one class."""
    rng = np.random.default_rng([86, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place_within(models[int(rng.integers(len(models)))], rng)
    contacts = pad_contacts(placed, exploring_grip(reach(), []), rng, _PITCH_MM)
    if not any(contact.touched for contact in contacts):
        return
    found = recognise(catalogue(), contacts)
    if not 2 <= len(found.hypotheses) <= _MOST_HYPOTHESES:
        return
    resolution = resolution_of(pad_rig())
    used = used_approaches(contacts, reach().approaches)
    grip = plan_grip(found, reach(), resolution, goals_of(pad_rig()), used)
    if grip is None or not grip.decisive:
        return
    same = twins(found, reach(), resolution)
    named = {model.name: model for model in models}
    for number, item in enumerate(found.hypotheses):
        for pose in poses_in(found, item, named[item.state.object_name], rng, 2):
            after = found.extend(pad_contacts(pose, grip.limited_approaches, rng, _PITCH_MM))
            # Places in regions may contradict earlier contacts, so that nothing need be left.
            for other, old in enumerate(found.hypotheses):
                if same[number, other]:
                    continue
                assert not any(came_from(left, old) for left in after.hypotheses), "it decides"


@pytest.mark.parametrize("seed", sample(range(60), range(10)))
def test_a_shift_that_touches_leave_possible_is_no_detectable_one(seed: int) -> None:
    """The part is shifted before its last grip: what that grip is said to show is never less than that."""
    rng = np.random.default_rng([87, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place_within(models[int(rng.integers(len(models)))], rng)
    contacts = pad_contacts(placed, exploring_grip(reach(), []), rng, _PITCH_MM)
    if sum(contact.touched for contact in contacts) < 3:
        return
    found = recognise(catalogue(), contacts)
    far, around = float(rng.choice([0.0, 0.5, 3.0, 10.0])), float(rng.uniform(-math.pi, math.pi))
    shifted = replace(placed, x=placed.x + far * math.cos(around), y=placed.y + far * math.sin(around))
    again = [reach().approaches[k] for k in rng.integers(0, len(reach().approaches), 3).tolist()]
    assert recognised_shift_mm(found, pad_contacts(shifted, again, rng, _PITCH_MM)) >= far
