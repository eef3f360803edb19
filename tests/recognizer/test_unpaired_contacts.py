"""Contacts that would only multiply interpretations are not paired; the truth stays, and they still count."""

import math
from dataclasses import replace

import numpy as np
import pytest
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, grip, holding_truth, outlines, place

from palpate.base.vocabulary import LEAST_BUDGET
from palpate.recognizer import (
    STANDARD_BUDGET,
    Budget,
    Catalogue,
    Contact,
    Motion,
    Recognition,
    recognise,
)

SMALL = Budget(50_000)
"""Suffices for 100 interpretations of a further contact, if these are more than there were."""


def round_part(seed: int) -> tuple[Catalogue, Placed, list[Contact]]:
    """A coin of many facets, and eight touches of it."""
    rng = np.random.default_rng([31, seed])
    angle = np.arange(40) * 2 * math.pi / 40
    model = replace(flat("coin", 18.0 * np.column_stack([np.cos(angle), np.sin(angle)])), tolerance_mm=0.1)
    placed = place(model, rng)
    contacts = [
        contact
        for _ in range(4)
        for contact in grip(placed, rng, fingers=2, bound=0.3, half_range=0.2, aim=0.05, at_bound=True)
        if contact.touched
    ]
    return Catalogue([model]), placed, contacts


def in_steps(catalogue: Catalogue, contacts: list[Contact], budget: Budget = STANDARD_BUDGET) -> Recognition:
    found = recognise(catalogue, contacts[:3], budget=budget)
    for contact in contacts[3:]:
        found = found.extend([contact])
    return found


@pytest.mark.parametrize("seed", range(4))
def test_a_round_part_keeps_its_truth_however_often_it_is_touched(seed: int) -> None:
    catalogue, placed, contacts = round_part(seed)
    found = in_steps(catalogue, contacts, SMALL)
    assert found.unpaired
    assert found.interpretations.edges.shape[1] == len(contacts) - len(found.unpaired)
    assert len(found.levels) == len(contacts) - len(found.unpaired)
    item = holding_truth(found, placed)
    assert item is not None
    assert item.verified
    at_once = recognise(catalogue, contacts)
    assert holding_truth(at_once, placed) is not None


@pytest.mark.parametrize("seed", sample(range(12), range(4)))
def test_without_pairings_nothing_is_left_out_that_is_there_with_them(seed: int) -> None:
    rng = np.random.default_rng([32, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % 6], rng)
    contacts = [c for c in grip(placed, rng, fingers=6, bound=0.5, half_range=0.3, aim=0.3) if c.touched]
    catalogue = Catalogue(models)
    paired = in_steps(catalogue, contacts)
    loose = in_steps(catalogue, contacts, Budget(LEAST_BUDGET))
    assert holding_truth(loose, placed) is not None
    for item in paired.hypotheses:
        if item.verified:
            assert any(
                other.state_index == item.state_index
                and other.bounds.x_mm[0] <= item.configuration.x_mm <= other.bounds.x_mm[1]
                and other.bounds.y_mm[0] <= item.configuration.y_mm <= other.bounds.y_mm[1]
                for other in loose.hypotheses
            )


def test_an_unpaired_contact_rules_out_what_does_not_satisfy_it() -> None:
    catalogue, _, contacts = round_part(0)
    found = in_steps(catalogue, contacts, SMALL)
    last = contacts[-1]
    away = (
        last.end_mm[0] + 30.0 * math.cos(last.direction_rad),
        last.end_mm[1] + 30.0 * math.sin(last.direction_rad),
    )
    assert not found.extend([replace(last, end_mm=away)]).hypotheses


def test_a_motion_widens_unpaired_contacts_too() -> None:
    catalogue, placed, contacts = round_part(1)
    found = in_steps(catalogue, contacts, SMALL)
    motion = Motion(np.array([0.2]), np.array([0.01]))
    moved = found.moved(motion)
    assert moved.unpaired == found.unpaired
    assert holding_truth(moved, placed) is not None
