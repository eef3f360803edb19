"""Paving: states with rough walls, whose configurations are divided instead of paired edge by edge."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import shapely

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Contact, Finger, Recognition, recognise
from support.campaign.sampling import sample
from support.oracles.shapely_touches import Placed, flat, holding_truth, place, touch, unit

TRUTHS = [
    flat("ell", [(-25, -20), (30, -20), (30, 0), (-3, 0), (-3, 25), (-25, 25)]),
    flat("wedge", [(-30, -20), (32, -12), (-8, 30)]),
    flat("bar", [(-35, -9), (35, -9), (35, 9), (-35, 9)]),
]


def rough(model: ObjectModel, rng: np.random.Generator) -> ObjectModel:
    """The model as if it had been learned: its outline every 6 mm, off by up to 0.8 mm."""
    ring = shapely.Polygon(model.states[0].sections[0].polygons[0].outer).exterior
    count = round(ring.length / 6)
    places = shapely.line_interpolate_point(ring, np.arange(count) / count, normalized=True)
    points = shapely.get_coordinates(places) + rng.uniform(-0.8, 0.8, (count, 2))
    outline = shapely.Polygon(points).exterior
    off = shapely.hausdorff_distance(outline, ring, densify=0.01)
    learned = flat(model.name, points)
    return replace(learned, tolerance_mm=1.05 * off + 0.05, normal_bound_rad=math.pi)


def grips(placed: Placed, rng: np.random.Generator) -> Iterator[list[Contact]]:
    """Grips of three, each touch as far off as its bounds allow."""
    while True:
        contacts, first = [], rng.uniform(0, 2 * math.pi)
        for number in range(3):
            start = 130 * unit(first + 2 * math.pi * number / 3)
            way = np.array(placed.shape.centroid.coords[0]) + rng.uniform(-20, 20, 2) - start
            contacts.append(
                touch(
                    placed.shape,
                    rng,
                    radius=5.0,
                    bound=0.3,
                    half_range=math.radians(9),
                    direction=math.atan2(way[1], way[0]),
                    start=start,
                    reach=260.0,
                    at_bound=True,
                    name=f"f{number}",
                )
            )
        yield contacts


def extended(catalogue: Catalogue, placed: Placed, rng: np.random.Generator, count: int) -> list[Recognition]:
    """Recognitions after each of some grips."""
    found: list[Recognition] = []
    for contacts in (item for item, _ in zip(grips(placed, rng), range(count), strict=False)):
        found.append(recognise(catalogue, contacts) if not found else found[-1].extend(contacts))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("seed", sample(range(6), [1]))
def test_the_truth_is_kept_and_placed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    catalogue = Catalogue([rough(model, rng) for model in TRUTHS])
    placed = place(TRUTHS[seed % len(TRUTHS)], rng)
    every = extended(catalogue, placed, rng, 7)
    assert every[0].constraints.is_paved
    assert all(holding_truth(item, placed) is not None for item in every)
    last = every[-1].hypotheses
    assert {item.state.object_name for item in last} == {placed.model.name}
    assert max(item.bounds.position_half_mm for item in last) < 8.0


def test_exact_states_are_paired_as_ever() -> None:
    finger = Finger(5.0, 10.0)
    assert not Catalogue(TRUTHS).edges(finger).is_rough.any()
    slightly = [replace(model, tolerance_mm=0.2) for model in TRUTHS]
    assert not Catalogue(slightly).edges(finger).is_rough.any()
    both = Catalogue([TRUTHS[0], rough(TRUTHS[1], np.random.default_rng(0))])
    assert both.edges(finger).is_rough.tolist() == [False, True]


def test_pairing_begins_once_no_rough_state_is_left() -> None:
    rng = np.random.default_rng(3)
    catalogue = Catalogue([TRUTHS[0], rough(TRUTHS[2], rng)])
    placed = place(TRUTHS[0], rng)
    every = extended(catalogue, placed, rng, 5)
    assert every[0].constraints.is_paved
    assert len(every[-1].constraints.touched) > 1
    assert all(holding_truth(item, placed) is not None for item in every)
    assert [item.state.object_name for item in every[-1].hypotheses] == ["ell"]
