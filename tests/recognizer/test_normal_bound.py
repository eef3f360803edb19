"""Outlines coarser than the parts: where fingers can rest on the part is covered by the model's edges.

The part is a smooth curve drawn by many edges, the model a chain through a few of its vertices, with what was
measured between the two as tolerances of places and normals.
"""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from offset_cover import places_of_rest, uncovered
from sampling import sample
from shapely_bench import flat

from palpate.base.geometry import ObjectModel
from palpate.recognizer import Catalogue, Finger

RADII_MM = (0.02, 1.0, 5.0)
FINE = 1200


def curve(seed: int) -> np.ndarray:
    """A smooth closed curve (n, 2), dented by waves."""
    rng = np.random.default_rng([41, seed])
    angle = np.linspace(0, 2 * np.pi, FINE, endpoint=False)
    reach = np.full(FINE, rng.uniform(15, 30))
    for wave in range(2, 7):
        reach += rng.normal() * 4 / wave * np.cos(wave * angle + rng.uniform(0, 6))
    return np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])


def coarse_model(fine: np.ndarray, every: int) -> ObjectModel:
    """A chain through some of the curve's vertices, with its tolerances as they are measured."""
    model = fine[::every]
    there = np.roll(model, -1, axis=0) - model
    turn = np.arctan2(there[:, 1], there[:, 0])
    leg = np.roll(fine, -1, axis=0) - fine
    off = np.arctan2(leg[:, 1], leg[:, 0]) - np.repeat(turn, every)
    lines = shapely.linestrings(np.stack([model, model + there], axis=1))
    away = shapely.distance(np.repeat(lines, every), shapely.points(fine))
    turns = np.abs((off + np.pi) % (2 * np.pi) - np.pi)
    coarse = flat("coarse", model.tolist())
    return replace(coarse, tolerance_mm=float(away.max()) + 1e-6, normal_bound_rad=float(turns.max()) + 1e-9)


@pytest.mark.parametrize("every", [5, 20])
@pytest.mark.parametrize("seed", sample(range(20), [0, 1]))
def test_normals_within_what_is_stated_are_covered(seed: int, every: int) -> None:
    fine = curve(seed)
    model = coarse_model(fine, every)
    assert model.normal_bound_rad is not None
    assert model.normal_bound_rad < 0.2
    catalogue = Catalogue([model])
    section = flat("fine", fine.tolist()).states[0].sections[0]
    for radius in RADII_MM:
        edges = catalogue.edges(Finger(radius, 10.0))
        centre, normal = places_of_rest(section, radius, 1, np.random.default_rng(seed))
        assert len(centre) > FINE
        assert not uncovered(edges, 0, centre - catalogue.states[0].origin_mm, normal).any()


def test_a_fine_outline_of_which_normals_are_known_has_no_more_edges_than_an_exact_one() -> None:
    fine = curve(3)
    exact = flat("exact", fine.tolist())
    stated = replace(exact, tolerance_mm=0.05, normal_bound_rad=0.03)
    counts = [len(Catalogue([item]).edges(Finger(5.0, 10.0)).state) for item in (exact, stated)]
    assert counts[0] < 300
    assert counts[1] < 2.5 * counts[0]
    spans = [float(np.max(Catalogue([item]).edges(Finger(5.0, 10.0)).span)) for item in (exact, stated)]
    assert spans[1] < spans[0] + 0.1
