"""Parts that no catalogue holds, and deviations."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import erf

from palpate.base.geometry import Floats
from palpate.recognizer import (
    Approach,
    Catalogue,
    Confirmation,
    Contact,
    Goals,
    Recognition,
    StrangerEvidence,
    confirmation_grip,
    extend_to_confirm,
    plan_grip,
    predict,
    recognise,
    stranger_terms,
)
from palpate.recognizer.evidence import KINDS, STRANGER_KINDS, StrangerTerms, candidate_touches
from palpate.recognizer.outline_deviations import Deviations, OutlinePlaces, OutlineTouches, agreement
from palpate.recognizer.outline_features import Features, feature_agreement
from support.oracles.plans import RESOLUTION, contact_along, ring, some_recognition, travel_of
from support.oracles.shapely_touches import SHIPPED_OBJECTS, flat, grip, outlines, place

# ----------------------------------------------------------------------------------------------------
# What touches say of strangers: the law of products, what says much and what little, and checks by it.

NONE = StrangerEvidence.none()


def terms_of(found: Recognition, approaches: Sequence[Approach]) -> StrangerTerms:
    """Of some approaches, after what was found."""
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, approaches)
    halves = np.full(len(approaches), RESOLUTION.normal_half_rad)
    return stranger_terms(found, approaches, halves, predictions)


def unique(seed: int) -> Recognition:
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    contacts = grip(place(models[seed % 6], rng), rng, fingers=7, half_range=math.radians(8))
    found = recognise(Catalogue(models), contacts)
    assert len(found.hypotheses) == 1
    return found


def test_what_was_stated_of_each_touch_multiplies_to_the_whole() -> None:
    _, found = some_recognition(2)
    passing = terms_of(found, ring().approaches[3:63:18]).with_any()
    assert passing.shape == (4, KINDS)
    assert np.all((passing > 0) & (passing < 1))
    evidence, product = NONE, 1.0
    for row in passing:
        product *= float(evidence.different_kinds @ row)
        evidence = evidence.after(row[None])
    assert NONE.probability == pytest.approx(1.0)
    assert evidence.probability == pytest.approx(product)
    assert NONE.after(passing).probability == pytest.approx(product)


def test_kinds_that_hardly_agree_give_way_to_those_like_a_part() -> None:
    passing = terms_of(unique(1), ring().approaches[5:60:22]).with_any()
    share = [float(NONE.after(passing[:n]).different_kinds[0]) for n in range(4)]
    assert all(after < before for before, after in pairwise(share))


def test_many_hypotheses_let_more_strangers_pass_than_one() -> None:
    """One touch of the same kind everywhere, predicted in one place by one or in many by many."""
    passing = np.full((1, 2, 1), 0.2)
    clear = np.ones(2)
    one = StrangerTerms(passing, np.array([1.0]), 1).with_any(clear)
    many = StrangerTerms(np.repeat(passing, 16, axis=2), np.array([25.0]), 40).with_any(clear)
    same = StrangerTerms(np.repeat(passing, 16, axis=2), np.array([1.0]), 40).with_any(clear)
    assert one == pytest.approx(0.2)
    assert np.all(many > 0.4)
    assert same == pytest.approx(0.2)


def test_a_path_that_passes_by_says_less_than_one_that_meets_the_part() -> None:
    found = unique(2)
    met = ring().approaches[1:60:12]
    beside = [replace(met[0], start_mm=(140.0, 150.0), direction_rad=math.pi)]
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, beside)
    assert np.isinf(predictions.earliest).all()
    missed, hit = terms_of(found, beside).with_any(), terms_of(found, met).with_any()
    assert missed[0, 0] > hit[:, 0].max()
    assert missed[0, 1:] == pytest.approx(1.0, abs=1e-3)


def test_a_second_touch_beside_the_first_says_less_than_one_far_away() -> None:
    """A long bar of which one end was touched: its other end may be anything."""
    models = [flat("bar", [(0, 0), (100, 0), (100, 24), (0, 24)])]
    rng = np.random.default_rng(3)
    placed = place(models[0], rng, 0.0)
    approaches = ring(96).approaches
    travels = [travel_of(placed, item) for item in approaches]
    ends = np.array(
        [contact_along(item, min(way, 200.0)).end_mm for item, way in zip(approaches, travels, strict=True)]
    )
    left = placed.on_table(np.array([0.0, 12.0]))
    own = np.linalg.norm(ends - left, axis=1) < 45.0
    known: list[Contact] = [
        contact_along(approaches[k], travels[k])
        for k in np.flatnonzero(own & np.isfinite(travels))[::6].tolist()
    ]
    found = recognise(Catalogue(models), known)
    assert len(known) >= 4
    predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, approaches)
    sure = np.flatnonzero(np.isfinite(predictions.latest[:, 0]))
    some = [approaches[k] for k in sure.tolist()]
    touches = candidate_touches(found, some, RESOLUTION.normal_half_rad, predictions.select(sure))
    agreeing = touches.agreement([])[0]
    away = np.linalg.norm(ends[sure] - left, axis=1)
    assert agreeing[away < 25.0].mean() > 1.5 * agreeing[away > 70.0].mean()
    # Once a far one has agreed, another beside it says less than before.
    far = int(np.argmax(away))
    beside = np.linalg.norm(ends[sure] - ends[sure][far], axis=1) < 8.0
    beside[far] = False
    assert np.all(touches.agreement([far])[0, beside] >= agreeing[beside] - 1e-9)


def test_checks_go_on_until_strangers_are_improbable_enough() -> None:
    for seed in range(4):
        found = unique(seed)
        counts = []
        for probability in (0.5, 0.01, 1e-9):
            chosen = confirmation_grip(found, ring(), RESOLUTION, Confirmation(2, 50.0, NONE, probability))
            assert chosen is not None
            counts.append(len(chosen.approaches))
        assert counts[0] == 2
        assert counts == sorted(counts)
        assert counts[-1] == 3  # fingers that there are


def test_a_check_goes_where_strangers_agree_least() -> None:
    for seed in range(4):
        found = unique(seed)
        chosen = confirmation_grip(found, ring(), RESOLUTION, Confirmation(2, 50.0, NONE, 0.5))
        assert chosen is not None
        every = [item for item in ring().approaches if item not in found.contacts]
        predictions = predict(found.catalogue, found.hypotheses, found.anchor_mm, every)
        sure = np.flatnonzero(np.isfinite(predictions.latest[:, 0]))
        some = [every[k] for k in sure.tolist()]
        touches = candidate_touches(found, some, RESOLUTION.normal_half_rad, predictions.select(sure))
        agreeing = NONE.different_kinds @ touches.agreement([])
        first = next(k for k, item in enumerate(some) if item.start_mm == chosen.approaches[0].start_mm
                     and item.direction_rad == chosen.approaches[0].direction_rad)  # fmt: skip
        assert agreeing[first] <= np.quantile(agreeing, 0.35)


def test_a_grip_that_places_the_part_confirms_it_too_where_further_fingers_can() -> None:
    joined = 0
    for seed in range(6):
        found = unique(seed)
        goals = Goals(0.01, 1e-4)  # so fine that there is something to place
        planned = plan_grip(found, ring(), RESOLUTION, goals, fingers=1)
        assert planned is not None
        for probability in (0.9, 0.05, 1e-12):
            wanted = Confirmation(2, math.inf, NONE, probability)
            both = extend_to_confirm(planned, found, ring(), RESOLUTION, wanted)
            if both is None:
                continue
            assert both.indices[: len(planned.indices)] == planned.indices
            assert both.remaining == planned.remaining
            fingers = [item.finger_index for item in both.approaches]
            assert len(set(fingers)) == len(fingers)
            # As stated anew, of all touches of the grip that surely meet the part.
            sure = np.flatnonzero(np.isfinite(both.predictions.latest[:, 0])).tolist()
            some = [both.approaches[k] for k in sure]
            touches = candidate_touches(
                found, some, RESOLUTION.normal_half_rad, both.predictions.select(np.array(sure))
            )
            evidence = NONE
            for k in range(len(some)):
                evidence = evidence.after(touches.agreement(list(range(k)))[:, k][None])
            assert evidence.probability <= probability + 1e-9
            joined += len(both.approaches) > len(planned.approaches)
        assert both is None  # no three touches say so much
    assert joined >= 3


# ----------------------------------------------------------------------------------------------------
# Deviations along outlines against brute force: paths that are drawn, aligned and judged one by one.

RADIUS_MM = 30.0
LENGTH_MM = 2 * math.pi * RADIUS_MM
SMOOTH = Deviations(np.array([3.0]), np.array([15.0]), np.array([0.0]))


def on_circle(angles: Floats) -> OutlinePlaces:
    """Places on a circle: one outline."""
    normal = np.stack([np.cos(angles), np.sin(angles)], axis=-1)[None]
    some = np.zeros((1, len(angles)))
    return OutlinePlaces(
        RADIUS_MM * normal, normal, RADIUS_MM * angles[None], some.astype(int), some + LENGTH_MM, some
    )


def touches(places: OutlinePlaces, window_mm: float, normal_rad: float = math.inf) -> OutlineTouches:
    """Places that are known to 0.1 mm once they have agreed; of normals nothing is known."""
    some = np.ones(places.along.shape)
    return OutlineTouches(
        places,
        window_mm * some,
        window_mm * some,
        normal_rad * some,
        0.1 * some,
        0.01 * some,
        0.1 * some,
        30.0 * some,
    )


def test_a_touch_agrees_as_often_as_drawn_outlines_say() -> None:
    """The fourth touch: its deviation from the circle through the first three, which a motion puts in place.

    On a circle turns are free, so two touches place it, and the third is the first that says something.
    """
    angles = np.array([0.2, 1.1, 2.9, 3.6])
    found = agreement(touches(on_circle(angles), 2.0), SMOOTH)[0, 0]
    chord = 2 * RADIUS_MM * np.sin((angles[:, None] - angles) / 2)
    covariance = 9.0 * np.exp(-((chord / 15.0) ** 2) / 2)
    rng = np.random.default_rng(0)
    drawn = rng.multivariate_normal(np.zeros(4), covariance, 200_000)
    motion = np.column_stack([np.cos(angles), np.sin(angles)])
    for last in (2, 3):
        # Given that all before agree, in the best place: least squares by hand, weighted for their noise.
        before = motion[:last]
        prior = covariance[:last, :last] + 1e4 * before @ before.T + 0.01 * np.eye(last)
        cross = covariance[last, :last] + 1e4 * motion[last] @ before.T
        weights = np.linalg.solve(prior, cross)
        shift = rng.normal(0, 100, (len(drawn), 2))
        noisy = drawn - shift @ motion.T
        residual = noisy[:, last] - (noisy[:, :last] + rng.normal(0, 0.1, (len(drawn), last))) @ weights
        share = np.mean(np.abs(residual + rng.normal(0, 0.1, len(drawn))) < 2.0)
        assert found[last] == pytest.approx(share, abs=0.005)
    assert found[:2] == pytest.approx(0.0, abs=0.03)  # anything may lie anywhere


def test_what_is_near_a_touch_says_less_than_what_is_far() -> None:
    base = np.array([0.0, 2.0, 4.0])
    shares = [
        float(agreement(touches(on_circle(np.append(base, 2.0 + away)), 0.5), SMOOTH)[0, 0, 3])
        for away in (0.03, 0.2, 0.6, 1.0)
    ]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.95
    assert shares[-1] < 0.3


def test_a_part_of_another_size_agrees_where_size_does_not_show() -> None:
    """A circle with two places touched may be scaled; opposite ones tell, once its middle is known."""
    sized = Deviations(np.array([0.01]), np.array([20.0]), np.array([0.1]))
    angles = np.array([0.0, math.pi / 2, math.pi])
    found = agreement(touches(on_circle(angles), 0.5), sized)[0, 0, 2]
    # The third touch fits if the diameter does, which varies by 6 mm: one side has set the middle.
    assert found == pytest.approx(erf(0.5 / (2 * 3.0) / math.sqrt(2)), abs=0.01)


def test_normals_turn_as_displacements_grow() -> None:
    """A normal's deviation is known from two displacements beside it, and the sooner the nearer they are."""
    angles = np.array([0.0, 2.0, 4.0, 1.0 - 0.02, 1.0 + 0.02, 1.0])
    near = agreement(touches(on_circle(angles), 50.0, 0.2), SMOOTH)[0, 0, 5]
    alone = agreement(touches(on_circle(angles[[0, 1, 2, 5]]), 50.0, 0.2), SMOOTH)[0, 0, 3]
    assert alone < near


# ----------------------------------------------------------------------------------------------------
# One altered feature against counts of the stretches that earlier touches leave.

DEEP = Features(np.array([0.06, 0.12, 0.3]), np.array([2.5, 4.0]))


def known(places: OutlinePlaces, count: int, window_mm: float = 0.5) -> OutlineTouches:
    """The first `count` touches have agreed, whatever they met; the others agree within a window."""
    some = touches(places, window_mm)
    first = np.arange(places.along.shape[1]) < count
    return replace(
        some,
        inward_mm=np.where(first, np.inf, some.inward_mm),
        outward_mm=np.where(first, np.inf, some.outward_mm),
    )


@pytest.mark.parametrize("new", [1.0, 2.0, 3.0])
def test_a_touch_agrees_where_no_stretch_that_is_left_reaches(new: float) -> None:
    """Touched all along one half: of the stretches that no touch was on, some are on the new one."""
    half = np.linspace(3.3, 2 * math.pi - 0.2, 25)
    angles = np.append(half, new)
    found = feature_agreement(known(on_circle(angles), len(half)), DEEP)[:, 0, -1]
    middles = 2 * math.pi * np.arange(48) / 48
    for share, agreeing in zip(DEEP.share.tolist(), found.tolist(), strict=True):
        away = np.abs((angles[:, None] - middles + math.pi) % (2 * math.pi) - math.pi)
        on = away <= share * math.pi
        left = ~on[:-1].any(axis=0)
        assert agreeing == pytest.approx(1 - np.mean(on[-1, left]), abs=0.02)


def test_a_stretch_is_passed_by_less_and_less_often_the_longer_it_is() -> None:
    angles = np.array([0.1, 1.2, 2.4, 3.3, 4.5, 5.6, 0.7, 1.8, 2.9])
    passed = feature_agreement(known(on_circle(angles), 3), DEEP)[:, 0].prod(axis=1)
    assert passed[0] > passed[1] > passed[2]
    assert passed[2] < 0.3 < passed[0]


def test_three_touches_say_nothing_of_a_feature() -> None:
    """A motion explains what any three are off by, as far as it goes."""
    found = feature_agreement(known(on_circle(np.array([0.3, 2.2, 4.4])), 3), DEEP)
    assert found == pytest.approx(1.0)


def test_what_differs_in_one_feature_is_stated_apart_from_what_differs_widely() -> None:
    """Touches that agree speak against what is unlike all parts; of one feature they say much less."""
    for seed in range(4):
        passing = terms_of(unique(seed), ring().approaches[5:60:11]).with_any()
        after = NONE.after(passing)
        assert after.probability < 0.05
        assert after.altered_probability > 4 * after.probability
        assert NONE.altered_probability == pytest.approx(1.0)
        assert after.altered_kinds.sum() == pytest.approx(1.0)
        assert after.altered_kinds[len(STRANGER_KINDS.scale) :].sum() > 0.8
