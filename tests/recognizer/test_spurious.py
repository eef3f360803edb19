"""The promise with spurious contacts: with at most max_spurious of them, the truth is in the answer."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, Recognition, recognise
from palpate.recognizer.model_test import half_planes
from support.campaign.sampling import sample
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, grip, holding_truth, outlines, place

KINDS = ("moved", "normal", "on the way")


@cache
def shipped() -> Catalogue:
    return Catalogue(outlines(SHIPPED_OBJECTS))


def nonsense(contact: Contact, kind: str, rng: np.random.Generator) -> Contact:
    """The contact with its position moved by 5 to 40 mm, with a wrong normal, or stopped on its way."""
    if kind == "moved":
        angle, away = rng.uniform(-math.pi, math.pi), rng.uniform(5, 40)
        x, y = contact.end_mm
        return replace(contact, end_mm=(x + away * math.cos(angle), y + away * math.sin(angle)))
    if kind == "normal":
        assert contact.normal is not None
        turn = float(rng.choice([-1, 1]) * rng.uniform(0.5, 1.2))
        normal = NormalRange(contact.normal.lo_rad + turn, contact.normal.hi_rad + turn)
        return replace(contact, normal=normal)
    share = rng.uniform(0.2, 0.8)
    start, end = np.array(contact.start_mm), np.array(contact.end_mm)
    x, y = (start + share * (end - start)).tolist()
    return replace(contact, end_mm=(x, y))


def spoilt(
    seed: int, fingers: int, bad: int = 1, kind: str | None = None
) -> tuple[Placed, list[Contact], list[int]]:
    """A grip that touches with all fingers, with some contacts replaced by nonsense; and which these are."""
    rng = np.random.default_rng(seed)
    models = outlines(SHIPPED_OBJECTS)
    while True:
        placed = place(models[seed % 6], rng)
        contacts = grip(placed, rng, fingers=fingers, at_bound=bool(seed % 2))
        if all(contact.touched for contact in contacts):
            break
    which = [int(k) for k in rng.choice(fingers, bad, replace=False)]
    for k in which:
        contacts[k] = nonsense(contacts[k], kind or KINDS[seed % 3], rng)
    return placed, contacts, which


def subsets(contacts: Sequence[Contact], max_spurious: int) -> list[list[Contact]]:
    """The contacts without any `max_spurious` or fewer of the touched ones."""
    touched = [k for k, contact in enumerate(contacts) if contact.touched]
    return [
        [contact for k, contact in enumerate(contacts) if k not in left_out]
        for count in range(max_spurious + 1)
        for left_out in combinations(touched, count)
    ]


def witnesses(found: Recognition) -> list[Placed]:
    """The configurations that satisfy everything, as placed objects."""
    models = {model.name: model for model in outlines(SHIPPED_OBJECTS)}
    return [
        Placed(models[item.state.object_name], at.x_mm, at.y_mm, at.theta_rad)
        for item in found.hypotheses
        if item.verified
        for at in [item.configuration]
    ]


@pytest.mark.parametrize("seed", range(36))
def test_one_spurious_contact(seed: int) -> None:
    placed, contacts, _ = spoilt(seed, 4 + seed // 3 % 2)
    assert holding_truth(recognise(shipped(), contacts, 1), placed) is not None, placed


@pytest.mark.parametrize("seed", range(12))
def test_two_spurious_contacts(seed: int) -> None:
    placed, contacts, _ = spoilt(100 + seed, 5, bad=2, kind=KINDS[seed // 2 % 3])
    assert holding_truth(recognise(shipped(), contacts, 2), placed) is not None, placed


def test_without_the_null_branch_nonsense_loses_the_truth() -> None:
    lost = 0
    for seed in range(18):
        placed, contacts, _ = spoilt(seed, 4, kind="moved")
        lost += holding_truth(recognise(shipped(), contacts), placed) is None
    assert lost >= 15


@pytest.mark.parametrize("seed", range(12))
def test_equals_brute_force(seed: int) -> None:
    """The same as recognising every subset of the contacts on its own, and all of them together."""
    _, contacts, _ = spoilt(200 + seed, 4)
    found = recognise(shipped(), contacts, 1)
    parts = [recognise(shipped(), part) for part in subsets(contacts, 1)]
    for part in parts:
        for placed in witnesses(part):
            assert holding_truth(found, placed) is not None
    for placed in witnesses(found):
        assert any(holding_truth(part, placed) for part in parts)
    verified = {item.state_index for part in parts for item in part.hypotheses if item.verified}
    assert verified <= {item.state_index for item in found.hypotheses}
    certain = {item.state_index for item in found.hypotheses if item.verified}
    assert certain <= {item.state_index for part in parts for item in part.hypotheses}


@pytest.mark.parametrize("seed", range(12))
def test_names_the_spurious_contact(seed: int) -> None:
    _, contacts, (bad,) = spoilt(300 + seed, 5, kind="moved")
    found = recognise(shipped(), contacts, 1)
    fitting = [k for k in range(5) if recognise(shipped(), contacts[:k] + contacts[k + 1 :]).hypotheses]
    assert bad in fitting
    assert not recognise(shipped(), contacts).hypotheses
    assert {item.spurious for item in found.hypotheses} == {(contacts[k].name,) for k in fitting}
    for item in found.hypotheses:
        (name,) = item.spurious
        null = [contact.name for contact in contacts].index(name)
        assert all(row.count(None) == 1 for row in item.features)
        assert item.features[0][null] is None or len(item.features) > 1


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_called_spurious_without_need(seed: int) -> None:
    rng = np.random.default_rng(400 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed], rng)
    contacts = grip(placed, rng, fingers=5, at_bound=True)
    allowed = recognise(shipped(), contacts, 1)
    item = holding_truth(allowed, placed)
    assert item is not None
    assert item.spurious == ()
    assert None not in item.features[0]
    first = allowed.hypotheses[0]
    assert first.spurious == ()
    # The null branches of true contacts only add configurations.
    for exact in witnesses(recognise(shipped(), contacts)):
        assert holding_truth(allowed, exact) is not None


@pytest.mark.parametrize("cut", [2, 3, 4])
@pytest.mark.parametrize("seed", range(4))
def test_extending_equals_at_once(seed: int, cut: int) -> None:
    placed, contacts, _ = spoilt(500 + seed, 5, kind="moved")
    at_once = recognise(shipped(), contacts, 1)
    stepwise = recognise(shipped(), contacts[:cut], 1).extend(contacts[cut:])
    assert stepwise.max_spurious == 1
    assert stepwise.contacts == at_once.contacts
    assert holding_truth(stepwise, placed) is not None
    for one, two in ((at_once, stepwise), (stepwise, at_once)):
        for exact in witnesses(one):
            assert holding_truth(two, exact) is not None


@pytest.mark.parametrize("seed", sample(range(2), [0]))
def test_the_first_contacts_may_all_be_spurious(seed: int) -> None:
    rng = np.random.default_rng(600 + seed)
    placed, contacts, _ = spoilt(600 + seed, 6, bad=0)
    contacts = [nonsense(contact, "moved", rng) for contact in contacts[:3]] + contacts[3:]
    found = recognise(shipped(), contacts, 3)
    assert holding_truth(found, placed) is not None
    later = recognise(shipped(), contacts[:4], 3).extend(contacts[4:])
    assert holding_truth(later, placed) is not None


def test_a_contact_above_every_object_can_only_be_spurious() -> None:
    placed, contacts, _ = spoilt(700, 4, bad=0)
    for k in range(4):
        felt = list(contacts)
        felt[k] = replace(felt[k], finger=Finger(5.0, 100.0))
        assert recognise(shipped(), felt).verdict is RecognitionVerdict.NONE
        item = holding_truth(recognise(shipped(), felt, 1), placed)
        assert item is not None
        assert item.spurious == (felt[k].name,)


def test_a_miss_is_never_spurious() -> None:
    placed, contacts, _ = spoilt(701, 4, bad=0)
    # Every line through the centroid of a connected shape meets it.
    height = placed.shape.centroid.y
    through = Contact("m", Finger(5.0, 10.0), False, (-200.0, height), (200.0, height), 0.3)
    for max_spurious in (0, 1):
        found = recognise(shipped(), [*contacts, through], max_spurious)
        assert holding_truth(found, placed) is None


def test_null_edges_constrain_nothing() -> None:
    _, contacts, _ = spoilt(702, 3, bad=0)
    edges = shipped().edges(contacts[0].finger)
    edge = np.array([-1, 5, -1])
    g, coefficients = half_planes(edges, edge, contacts[0], np.zeros(2))
    only_g, only = half_planes(edges, edge[1:2], contacts[0], np.zeros(2))
    np.testing.assert_array_equal(g[1], only_g[0])
    np.testing.assert_array_equal(coefficients[1], only[0])
    for row in (0, 2):
        assert np.all(coefficients[row] == (1e5, 0.0, 0.0))
        np.testing.assert_allclose(np.sum(g[row], axis=0), 0.0)


@pytest.mark.parametrize("max_spurious", [-1, 3, 4])
def test_one_contact_at_least_is_not_spurious(max_spurious: int) -> None:
    _, contacts, _ = spoilt(703, 3, bad=0)
    with pytest.raises(InputError, match="from 0 to 2"):
        recognise(shipped(), contacts, max_spurious)
