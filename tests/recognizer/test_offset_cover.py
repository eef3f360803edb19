"""Edges, and pieces of the true boundary, cover all of the boundary of a grown section, judged by shapely."""

from functools import cache

import numpy as np
import pytest
import shapely
from offset_cover import places_of_rest, uncovered
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, flat, outlines
from shared_files import SHARED_OUTLINES, needs_shared_outlines

from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.config import load_objects
from palpate.recognizer import Catalogue, Finger
from palpate.recognizer.proximity import ALLOWANCE_MM, nearest_places
from palpate.recognizer.true_boundary import TrueBoundary

RADII_MM = (0.0, 0.05, 0.5, 2.0, 5.0, 8.0)
HEIGHT_MM = 10.0


def comb(seed: int) -> ObjectModel:
    """Teeth with notches, narrower and wider than tips, some of them pointed at the bottom."""
    rng = np.random.default_rng([21, seed])
    x, top = 0.0, []
    for _ in range(int(rng.integers(3, 8))):
        tooth, gap, depth = rng.uniform([2, 0.5, 3], [14, 18, 25])
        left, right = np.sort(rng.uniform(0, 1, 2)) * gap
        top += [
            (x, 30.0),
            (x + tooth, 30.0),
            (x + tooth + left, 30.0 - depth),
            (x + tooth + right, 30.0 - depth),
        ]
        x += tooth + gap
    return flat(f"comb {seed}", [(0.0, 0.0), (x + 5, 0.0), (x + 5, 30.0), (x, 30.0), *top[::-1]])


def star(seed: int) -> ObjectModel:
    rng = np.random.default_rng([22, seed])
    count = int(rng.integers(5, 60))
    angle, reach = np.sort(rng.uniform(0, 2 * np.pi, count)), rng.uniform(8, 35, count)
    return flat(f"star {seed}", np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]).tolist())


def smooth(seed: int) -> ObjectModel:
    """A finely drawn curve, rough by as little as rounding or by 0.1 mm: bends that are hardly any."""
    rng = np.random.default_rng([23, seed])
    angle = np.linspace(0, 2 * np.pi, int(rng.integers(100, 400)), endpoint=False)
    rough = 10 ** rng.uniform(-6, -1) * rng.normal(size=len(angle))
    reach = 25 + 3 * np.sin(rng.integers(2, 9) * angle) + rough
    return flat(f"smooth {seed}", np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]).tolist())


def pieces() -> ObjectModel:
    """A section of three polygons: two that overlap, one that touches, and a hole."""
    hole = np.array([[10.0, 8], [10, 22], [30, 22], [30, 8]])
    rings = (
        Polygon(np.array([[0.0, 0], [40, 0], [40, 30], [0, 30]]), (hole,)),
        Polygon(np.array([[35.0, 5], [70, 11], [66, 24], [35, 20]])),
        Polygon(np.array([[0.0, 30], [15, 30], [8, 48]])),
    )
    return ObjectModel("pieces", (State("flat", (Section((0.0, 20.0), rings),)),))


SLOT = flat("slot", [(0, 0), (60, 0), (60, 40), (38, 40), (38, 10), (22, 10), (22, 40), (0, 40)])
"""A tip of 8 mm just fits in."""


@cache
def drawn(count: int) -> list[ObjectModel]:
    made = [make(seed) for make in (comb, star, smooth) for seed in range(count)]
    return [item for item in made if shapely.Polygon(item.states[0].sections[0].polygons[0].outer).is_valid]


def unknown(boundary: TrueBoundary, row: int, centre: np.ndarray, normal: np.ndarray) -> int:
    """Of how many places (n,) the boundary that configurations are verified by knows nothing.

    Cells that cannot be verified are dropped, so that it may leave out none.
    """
    state, nothing = np.full(len(centre), row), np.zeros(len(centre))
    found = nearest_places(boundary, state, centre, normal, nothing, nothing)
    return int(np.count_nonzero(found.distance > ALLOWANCE_MM))


def lost(model: ObjectModel, each: int) -> dict[float, int]:
    """How many places at which a tip of each radius rests no edge covers, or no piece is at."""
    catalogue, found = Catalogue([model]), {}
    for radius in RADII_MM:
        edges = catalogue.edges(Finger(radius, HEIGHT_MM))
        for row, item in enumerate(catalogue.states):
            polygons = tuple(p for section in item.state.sections_at(HEIGHT_MM) for p in section.polygons)
            section = Section((HEIGHT_MM, HEIGHT_MM), polygons)
            centre, normal = places_of_rest(section, radius, each, np.random.default_rng(row))
            assert len(centre) > each
            seen = centre - item.origin_mm
            found[radius] = int(uncovered(edges, row, seen, normal).sum())
            found[radius] += unknown(catalogue.boundary(Finger(radius, HEIGHT_MM)), row, seen, normal)
    return found


@pytest.mark.parametrize("model", [*outlines(SHIPPED_OBJECTS), SLOT, pieces()], ids=lambda item: item.name)
def test_every_place_of_rest_is_on_an_edge(model: ObjectModel) -> None:
    assert not any(lost(model, 12).values())


@pytest.mark.parametrize("count", sample([60, 6], [6]))
def test_every_place_of_rest_on_drawn_outlines_is_on_an_edge(count: int) -> None:
    models = drawn(count)
    assert len(models) > count
    for model in models:
        assert not any(lost(model, 4).values()), model.name


@needs_shared_outlines
@pytest.mark.parametrize("each", sample([40, 3], [3]))
def test_every_place_of_rest_on_outlines_of_others_is_on_an_edge(each: int) -> None:
    models = load_objects(SHARED_OUTLINES).objects
    for model in models[:: 1 if each > 3 else 5]:
        assert not any(lost(model, each).values()), model.name
