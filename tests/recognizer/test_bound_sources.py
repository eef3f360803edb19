"""What each source of an answer's bounds costs, against recognitions in which that source is really gone."""

import math

import numpy as np
import pytest

from palpate.base.vocabulary import BoundSource
from palpate.recognizer import (
    Catalogue,
    Contact,
    MeasuredContact,
    Motion,
    Recognition,
    recognise,
    widths_without_source,
)
from support.oracles.plans import felt_along, ring
from support.oracles.shapely_touches import SHIPPED_OBJECTS, outlines, place

DENT_MM, BOUND_MM = 0.1, 0.25
SHIFT_MM, TURN_RAD = 0.2, math.radians(0.4)


def touches(seed: int, bound_mm: float) -> tuple[Catalogue, list[Contact]]:
    """Twelve touches of a part from all sides; what they declare does not change what they meet."""
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % len(models)], np.random.default_rng(seed))
    rng = np.random.default_rng([seed, 1])
    contacts = [
        felt_along(item, f"f{k}", placed, rng, bound=1e-3, path_bound=0.5, half_range=math.radians(8.0))
        for k, item in enumerate(ring(24).approaches[::6])
    ]
    wide = [Contact(**(vars_of(item) | {"position_bound_mm": bound_mm})) for item in contacts if item.touched]
    return Catalogue([placed.model]), wide


def vars_of(item: Contact) -> dict[str, object]:
    names = (
        "name",
        "finger",
        "touched",
        "start_mm",
        "end_mm",
        "position_bound_mm",
        "normal",
        "path_bound_mm",
    )
    return {name: getattr(item, name) for name in names}


def moved(catalogue: Catalogue, contacts: list[Contact], shift_mm: float, turn_rad: float) -> Recognition:
    """What is known of the part after it may have moved, and been touched no more."""
    count = len(catalogue.states)
    motion = Motion(np.full(count, shift_mm), np.full(count, turn_rad))
    return recognise(catalogue, contacts).move(motion)


@pytest.mark.parametrize("seed", range(6))
def test_a_source_costs_what_its_absence_saves(seed: int) -> None:
    catalogue, contacts = touches(seed, BOUND_MM)
    found = moved(catalogue, contacts, SHIFT_MM, TURN_RAD).hypotheses
    assert len(found) == 1
    assert not found[0].state.state.is_round
    measured = [MeasuredContact(item, DENT_MM, SHIFT_MM, TURN_RAD) for item in contacts]
    without = widths_without_source(catalogue, found[0], measured)
    assert BoundSource.TOLERANCE not in without
    still = recognise(catalogue, contacts).hypotheses[0].bounds
    finer = moved(*touches(seed, BOUND_MM - DENT_MM), SHIFT_MM, TURN_RAD).hypotheses[0].bounds
    for source, bounds in ((BoundSource.MOTION, still), (BoundSource.DENTS, finer)):
        assert without[source].position_mm == pytest.approx(bounds.position_half_mm, rel=1 / 3)
        assert without[source].orientation_rad == pytest.approx(bounds.orientation_half_rad, rel=1 / 3)


def test_a_part_that_contacts_do_not_bound_has_no_sources() -> None:
    catalogue, contacts = touches(0, BOUND_MM)
    found = recognise(catalogue, contacts).hypotheses[0]
    assert widths_without_source(catalogue, found, []) == {}
    one = [MeasuredContact(contacts[0], DENT_MM, 0.0, 0.0)]
    assert widths_without_source(catalogue, found, one) == {}
