"""Explanations: the step that rules an object out, a smallest conflict, objects that moved, suspects."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, State
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise
from palpate.recognizer.explanation import (
    ObjectExplanation,
    SearchTest,
    explain_object,
    grips_before_move,
    suspected_contacts,
)
from support.oracles.shapely_touches import SHIPPED_OBJECTS, Placed, flat, grip, outlines, place

RECTANGLE = flat("rectangle", [(-30, -12), (30, -12), (30, 12), (-30, 12)])
POINT = Finger(0.0, 10.0)


@cache
def catalogue() -> Catalogue:
    return Catalogue([*outlines(SHIPPED_OBJECTS), RECTANGLE])


@cache
def alone(name: str) -> Catalogue:
    return Catalogue([model for model in (*outlines(SHIPPED_OBJECTS), RECTANGLE) if model.name == name])


def touching(placed: Placed, rng: np.random.Generator, fingers: int, **how: float) -> list[Contact]:
    """A grip of which every finger touches."""
    while True:
        contacts = grip(placed, rng, fingers=fingers, **how)
        if all(contact.touched for contact in contacts):
            return contacts


def check_conflict(one: Catalogue, found: ObjectExplanation) -> None:
    """The conflict rules the object out, and no proper part of it does."""
    assert found.conflict
    assert not recognise(one, found.conflict).hypotheses
    for size in range(1, len(found.conflict)):
        for part in combinations(found.conflict, size):
            if any(contact.touched for contact in part):
                assert recognise(one, part).hypotheses, [contact.name for contact in part]


def check(one: Catalogue, found: ObjectExplanation, reason: SearchTest, contacts: Sequence[Contact]) -> None:
    """The object is ruled out, for `reason` and by a conflict; `one` is a catalogue of it alone."""
    last = found.refuting_step
    assert last is not None
    assert last.reason is reason
    assert all(step.left > 0 for step in found.steps[:-1])
    assert not found.hypotheses
    assert {id(contact) for contact in found.conflict} <= {id(contact) for contact in contacts}
    check_conflict(one, found)


def test_too_high_for_the_object() -> None:
    rng = np.random.default_rng(0)
    contacts = [
        replace(contact, finger=Finger(5.0, 50.0)) for contact in touching(place(RECTANGLE, rng), rng, 3)
    ]
    found = explain_object(catalogue(), contacts, "rectangle")
    check(alone("rectangle"), found, SearchTest.EDGES, contacts)
    assert len(found.steps) == 1
    assert len(found.conflict) == 1


def test_normals_that_the_object_does_not_have() -> None:
    """Two faces at half a right angle: a rectangle has none."""
    contacts = [
        Contact("a", POINT, True, (100.0, 0.0), (30.0, 0.0), 0.3, NormalRange(-0.1, 0.1)),
        Contact("b", POINT, True, (80.0, 80.0), (20.0, 20.0), 0.3, NormalRange(0.68, 0.88)),
    ]
    found = explain_object(catalogue(), contacts, "rectangle")
    check(alone("rectangle"), found, SearchTest.NORMAL, contacts)
    assert [step.reason for step in found.steps] == [SearchTest.EDGES, SearchTest.NORMAL]
    assert found.conflict == tuple(contacts)


def test_a_region_that_is_empty_though_all_threes_fit() -> None:
    """Two points a little further apart than a tapered part is wide, and a third that says how it is turned.

    The two fit if the part lies askew, to the left or to the right; the third says that it lies straight.
    """
    tapered = Catalogue([flat("taper", [(-30, -20), (30, -20), (26, 20), (-26, 20)])])
    down = NormalRange(-math.pi / 2 - 0.02, -math.pi / 2 + 0.02)
    contacts = [
        Contact("a", POINT, True, (-90.0, 0.0), (-30.75, 0.0), 0.1),
        Contact("b", POINT, True, (90.0, 0.0), (30.75, 0.0), 0.1),
        Contact("c", POINT, True, (0.0, -90.0), (0.0, -20.0), 40.0, down),
    ]
    found = explain_object(tapered, contacts, "taper")
    check(tapered, found, SearchTest.REGION, contacts)
    assert explain_object(tapered, contacts[:2], "taper").refuting_step is None


@pytest.mark.parametrize("seed", [30, 38, 62])
def test_a_miss_that_grazes_the_object(seed: int) -> None:
    """Not every cell is ruled out by a path that only just meets the object; finer cells are."""
    rng = np.random.default_rng(seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed // 2 % 6], rng)
    contacts = grip(placed, rng)
    at = rng.uniform(0, 2 * math.pi)
    ahead, aside = np.array([math.cos(at), math.sin(at)]), np.array([-math.sin(at), math.cos(at)])
    top = float(np.max(np.array(placed.shape.exterior.coords) @ aside)) + 5.0 - rng.uniform(0.0, 2.5)
    start, end = ((way * ahead + top * aside).tolist() for way in (-200.0, 200.0))
    contacts.append(Contact("m", contacts[0].finger, False, tuple(start), tuple(end), 0.3))
    found = explain_object(catalogue(), contacts, placed.model.name)
    check(alone(placed.model.name), found, SearchTest.FINER, contacts)
    assert found.conflict[-1].name == "m"


@pytest.mark.parametrize(
    ("reason", "seed", "name"),
    [
        (SearchTest.DISTANCE, 2, "grip"),
        (SearchTest.DISTANCE, 3, "gator"),
        (SearchTest.DISTANCE, 9, "hand"),
        (SearchTest.TWO, 1, "tr-1"),
        (SearchTest.TWO, 2, "tr-2"),
        (SearchTest.TWO, 3, "hand"),
        (SearchTest.PATH, 6, "grip"),
        (SearchTest.PATH, 26, "hand"),
        (SearchTest.DISTANCE, 10, "hand"),
        (SearchTest.THREE, 13, "hand"),
    ],
)
def test_another_object_was_touched(reason: SearchTest, seed: int, name: str) -> None:
    models = outlines(SHIPPED_OBJECTS)
    rng = np.random.default_rng(seed)
    placed = place(models[seed % 6], rng)
    contacts = grip(
        placed,
        rng,
        fingers=2 + seed % 4,
        half_range=math.radians(10) if seed % 5 else None,
        bound=(0.3, 0.05, 1.0)[seed % 3],
        aim=0.15 if seed % 2 else 0.4,
    )
    check(alone(name), explain_object(catalogue(), contacts, name), reason, contacts)
    true = explain_object(catalogue(), contacts, placed.model.name)
    assert true.refuting_step is None
    assert true.conflict == ()
    assert {item.state.object_name for item in true.hypotheses} == {placed.model.name}


def test_only_the_state_that_is_asked_for() -> None:
    """Of a part with a slim and a wide state the slim one is ruled out, the wide one and the part are not."""
    slim = flat("slim", [(-30, -6), (30, -6), (30, 6), (-30, 6)]).states[0]
    two = ObjectModel("two", (State("slim", slim.sections), State("wide", RECTANGLE.states[0].sections)))
    rng = np.random.default_rng(3)
    contacts = touching(place(RECTANGLE, rng), rng, 4)
    known = Catalogue([two])
    assert explain_object(known, contacts, "two", "slim").refuting_step is not None
    for state in ("wide", None):
        found = explain_object(known, contacts, "two", state)
        assert found.refuting_step is None
        assert {item.state.state.name for item in found.hypotheses} == {"wide"}


def test_names_that_are_not_in_the_catalogue() -> None:
    rng = np.random.default_rng(4)
    contacts = touching(place(RECTANGLE, rng), rng, 3)
    with pytest.raises(InputError, match='no object "rect" in the catalogue; there are: tr-1, '):
        explain_object(catalogue(), contacts, "rect")
    with pytest.raises(InputError, match='"rectangle" has no state "steep"; it has: flat'):
        explain_object(catalogue(), contacts, "rectangle", "steep")
    missed = [replace(contact, touched=False, normal=None) for contact in contacts]
    with pytest.raises(InputError, match="touched"):
        explain_object(catalogue(), missed, "rectangle")


def grips_before_and_after(seed: int, before: int, after: int) -> list[list[Contact]]:
    """Grips of an object that was pushed and turned in between."""
    rng = np.random.default_rng(seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    pushed = replace(placed, x=placed.x + 9.0, y=placed.y - 6.0, theta=placed.theta + 0.3)
    return [touching(where, rng, 3) for where in [placed] * before + [pushed] * after]


@pytest.mark.parametrize("seed", range(6))
def test_an_object_that_moved(seed: int) -> None:
    for before, after in ((1, 1), (2, 1), (1, 2)):
        grips = grips_before_and_after(seed, before, after)
        assert grips_before_move(catalogue(), grips) == before
        beside = [
            replace(contact, touched=False, normal=None, end_mm=contact.start_mm) for contact in grips[0]
        ]
        assert grips_before_move(catalogue(), [beside, *grips]) == before + 1, (
            "a grip without a touch says little"
        )


@pytest.mark.parametrize("seed", range(6))
def test_an_object_that_did_not_move(seed: int) -> None:
    assert grips_before_move(catalogue(), grips_before_and_after(seed, 3, 0)) is None
    assert grips_before_move(catalogue(), grips_before_and_after(seed, 1, 0)) is None
    high = Finger(5.0, 90.0)
    grips = grips_before_and_after(seed, 1, 1)
    grips[1] = [replace(contact, finger=high) for contact in grips[1]]
    assert grips_before_move(catalogue(), grips) is None, "the second grip fits nothing by itself"


@pytest.mark.parametrize("seed", range(8))
def test_suspects(seed: int) -> None:
    rng = np.random.default_rng(50 + seed)
    placed = place(outlines(SHIPPED_OBJECTS)[seed % 6], rng)
    contacts = touching(placed, rng, 5)
    bad = seed % 5
    x, y = contacts[bad].start_mm
    contacts[bad] = replace(contacts[bad], end_mm=(0.8 * x, 0.8 * y))
    assert not recognise(catalogue(), contacts).hypotheses
    named = suspected_contacts(catalogue(), contacts)
    assert any(contact is contacts[bad] for contact in named)
    for k, contact in enumerate(contacts):
        without = recognise(catalogue(), contacts[:k] + contacts[k + 1 :])
        assert bool(without.hypotheses) == any(contact is other for other in named)


def test_no_suspect_if_one_contact_would_be_left() -> None:
    """Alone, nearly every contact fits something."""
    rng = np.random.default_rng(60)
    one, two, three = touching(place(RECTANGLE, rng), rng, 3)
    high = replace(two, finger=Finger(5.0, 90.0))
    assert suspected_contacts(catalogue(), [high]) == ()
    assert suspected_contacts(catalogue(), [one, high]) == ()
    assert suspected_contacts(catalogue(), [one, high, three]) == (high,)
    assert suspected_contacts(catalogue(), [one, high, three], 1) == ()
