"""What touches say of strangers: the law of products, what says much and what little, and checks by it."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from reach_ring import RESOLUTION, contact_along, ring, some_recognition, travel_of
from shapely_bench import SHIPPED_OBJECTS, flat, grip, outlines, place

from palpate.recognizer import (
    Approach,
    Catalogue,
    Confirmation,
    Contact,
    Recognition,
    StrangerEvidence,
    confirmation_grip,
    predict,
    recognise,
    stranger_terms,
)
from palpate.recognizer.evidence import STRANGER_KINDS, StrangerTerms, candidate_touches

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
    assert passing.shape == (4, len(STRANGER_KINDS.scale))
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
    share = [float(NONE.after(passing[:n]).kinds[0]) for n in range(4)]
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
            chosen = confirmation_grip(found, ring(), RESOLUTION, Confirmation(50.0, NONE, probability))
            assert chosen is not None
            counts.append(len(chosen.approaches))
        assert counts[0] == 2
        assert counts == sorted(counts)
        assert counts[-1] == 3  # fingers that there are


def test_a_check_goes_where_strangers_agree_least() -> None:
    for seed in range(4):
        found = unique(seed)
        chosen = confirmation_grip(found, ring(), RESOLUTION, Confirmation(50.0, NONE, 0.5))
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
