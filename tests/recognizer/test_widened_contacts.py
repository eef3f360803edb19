"""Contacts that motions have widened: the tree begins anew with narrow ones, and the truth is kept."""

import math
from dataclasses import replace

import numpy as np
import pytest

from palpate.base.geometry import Circle, ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import LEAST_BUDGET
from palpate.recognizer import Budget, Catalogue, Motion, Recognition, narrow_first, recognise
from palpate.recognizer.contact import Contact
from palpate.recognizer.interpretation_tree import first_level, second_level
from palpate.recognizer.interpretations import Query
from support.campaign.sampling import sample
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    turned,
    unit,
    until_touched,
)

GRIPS = 8
SHIFT_MM, TURN_RAD = 1.0, 0.02


def regular(name: str, corners: int, radius_mm: float) -> ObjectModel:
    angles = 2 * np.pi * np.arange(corners) / corners
    return flat(name, radius_mm * np.column_stack([np.cos(angles), np.sin(angles)]))


def can(radius_mm: float) -> ObjectModel:
    """A round part."""
    outline = regular("can", 240, radius_mm).states[0].sections[0].polygons[0]
    round_ = Polygon(outline.outer, curves=(Circle((0.0, 0.0), radius_mm),))
    return ObjectModel("can", (State("flat", (Section((0.0, 20.0), (round_,)),)),))


MODELS = [*outlines(SHIPPED_OBJECTS), regular("square", 4, 35.0), regular("hexagon", 6, 30.0), can(28.0)]
CATALOGUE = Catalogue(MODELS)


def pushed(placed: Placed, rng: np.random.Generator) -> Placed:
    """The part after a motion at its bound: in any direction, turned either way."""
    centre = CATALOGUE.origins_mm[MODELS.index(placed.model)]
    at = placed.on_table(centre) + SHIFT_MM * unit(rng.uniform(0, 2 * math.pi))
    theta = placed.theta + TURN_RAD * rng.choice([-1.0, 1.0])
    x, y = at - turned(centre, theta)
    return replace(placed, x=float(x), y=float(y), theta=theta)


def three_touches(placed: Placed, rng: np.random.Generator) -> list[Contact]:
    return until_touched(grip, placed, rng, fingers=4, bound=0.1, aim=0.3)


def followed(model: ObjectModel, rng: np.random.Generator) -> tuple[Recognition, Placed]:
    """What is known after some grips, each of which moved the part before; the truth was kept throughout."""
    count = len(CATALOGUE.states)
    motion = Motion(np.full(count, SHIFT_MM), np.full(count, TURN_RAD))
    placed = place(model, rng)
    found = recognise(CATALOGUE, three_touches(placed, rng), budget=Budget(LEAST_BUDGET))
    for number in range(1, GRIPS):
        placed, left = pushed(placed, rng), set(found.hypotheses.state.tolist())
        found = found.extend(three_touches(placed, rng), motion)
        assert set(found.hypotheses.state.tolist()) <= left, "a state that was ruled out came back"
        assert holding_truth(found, placed) is not None, (model.name, number)
    return found, placed


@pytest.mark.parametrize("seed", sample(range(12), [5]))
@pytest.mark.parametrize("model", MODELS, ids=lambda item: item.name)
def test_a_part_that_moves_in_every_grip_is_followed(model: ObjectModel, seed: int) -> None:
    """No contact is unpaired that is half as wide as those at the root; bounds follow the last grips."""
    found, placed = followed(model, np.random.default_rng([61, seed]))
    truth = holding_truth(found, placed)
    assert truth is not None
    bounds = [item.position_bound_mm for item in found.contacts if item.touched]
    assert max(bounds) > (GRIPS - 2) * SHIFT_MM
    root = [item.position_bound_mm for item in found.constraints.touched[:3]]
    unpaired = [item.position_bound_mm for item in found.unpaired_contacts]
    assert max(root) <= 2 * min(unpaired, default=math.inf)
    assert truth.bounds.position_half_mm < max(bounds) / 2


def test_contacts_stay_in_their_order_where_nothing_has_moved() -> None:
    rng = np.random.default_rng(7)
    placed = place(MODELS[0], rng)
    rough = [item for item in grip(placed, rng, fingers=5, bound=1.0) if item.touched]
    fine = [item for item in grip(placed, rng, fingers=5, bound=0.05) if item.touched]
    found = recognise(CATALOGUE, rough).extend(fine)
    assert found.contacts == (*rough, *fine)
    assert holding_truth(found, placed) is not None


def test_narrow_contacts_come_first_and_misses_last() -> None:
    rng = np.random.default_rng(3)
    placed = place(MODELS[0], rng)
    some = [replace(item, position_bound_mm=1.0 / (1 + k)) for k, item in enumerate(grip(placed, rng))]
    miss = replace(some[0], touched=False, position_bound_mm=0.01, normal=None)
    order = narrow_first([miss, *some])
    assert order == [*sorted(some, key=lambda item: item.position_bound_mm), miss]


def test_of_the_first_contact_only_edges_of_interpretations_are_paired() -> None:
    """The second level with some of the first level's interpretations: all of these, no others."""
    rng = np.random.default_rng(11)
    contacts = [item for item in grip(place(MODELS[3], rng), rng, fingers=4) if item.touched][:2]
    query = Query(CATALOGUE, contacts, np.zeros(2))
    nodes, _ = first_level(CATALOGUE, contacts[0])
    everything, _ = second_level(query, nodes)
    states = range(len(CATALOGUE.states))
    for left in [[state] for state in states] + [[item for item in states if item != out] for out in states]:
        some, _ = second_level(query, nodes.select(np.flatnonzero(np.isin(nodes.state, left))))
        own = everything.select(np.flatnonzero(np.isin(everything.state, left)))
        np.testing.assert_array_equal(some.edges, own.edges)
        np.testing.assert_array_equal(some.lo, own.lo)
