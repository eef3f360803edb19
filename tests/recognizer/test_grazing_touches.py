"""Touches at the limits of what an approach says of the normal: paths along an edge, points on a vertex."""

import math

import numpy as np
import pytest
from exact_contacts import exact_contact
from shapely_bench import Placed, flat, holding_truth, place, turned, unit
from shapely_contacts import first_contact

from palpate.base.geometry import Floats
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise
from palpate.recognizer.approach import Approach
from palpate.recognizer.hypotheses import Hypotheses
from palpate.recognizer.memo_statistics import memo_counts
from palpate.recognizer.prediction import predict

KITE = flat("kite", [(-38, -9), (21, -31), (44, 6), (-5, 27)])
CATALOGUE = Catalogue([KITE])


def corners(placed: Placed) -> Floats:
    return np.array([placed.on_table(point) for point in KITE.states[0].sections[0].polygons[0].outer])


def normal_of(placed: Placed, edge: int) -> float:
    """Direction of the outward normal of an edge, counted from its first vertex."""
    points = corners(placed)
    along = points[(edge + 1) % len(points)] - points[edge]
    return math.atan2(-along[0], along[1])


def middles_touched(placed: Placed, radius: float) -> list[Contact]:
    """Two more touches, without errors, square onto the middles of the first and the third edge."""
    found = []
    points = corners(placed)
    for edge in (0, 2):
        normal = normal_of(placed, edge)
        end = (points[edge] + points[edge + 1 - 4]) / 2 + radius * unit(normal)
        start = end + 70.0 * unit(normal)
        found.append(exact_contact(f"middle {edge}", radius, start, end, normal, 0.02))
    return found


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("measured", [True, False])
def test_a_path_along_an_edge_that_is_off_by_more_than_its_end(seed: int, measured: bool) -> None:
    """The start is off by the path's bound, so that the path as stated leads away from the edge it met."""
    rng = np.random.default_rng(seed)
    placed, radius, off = place(KITE, rng), 4.0, float(rng.uniform(1.0, 3.0))
    edge, side = int(rng.integers(4)), float(rng.choice([-1.0, 1.0]))
    normal = normal_of(placed, edge)
    along = turned(unit(normal), side * math.pi / 2)
    heading = along * math.cos(0.004) - unit(normal) * math.sin(0.004)
    points = corners(placed)
    foot = (points[edge] + points[(edge + 1) % 4]) / 2 + radius * unit(normal)
    start = foot - 90.0 * heading
    travel = first_contact(placed.shape, start, heading, radius, 200.0)
    end = start + travel * heading
    stated = start - off * unit(normal)
    contact = Contact(
        "grazing",
        Finger(radius, 10.0),
        True,
        (float(stated[0]), float(stated[1])),
        (float(end[0]), float(end[1])),
        0.0,
        NormalRange(normal - 0.001, normal + 0.001) if measured else None,
        path_bound_mm=off,
    )
    assert travel < 100.0
    found = recognise(CATALOGUE, [contact, *middles_touched(placed, radius)])
    assert holding_truth(found, placed) is not None


def on_a_vertex(placed: Placed, vertex: int, half: float = 0.03) -> tuple[Contact, float]:
    """A point that comes square to the edge after a vertex, with the normal of the edge before it; how far
    that faces away from where the point came.
    """
    near, far = normal_of(placed, vertex), normal_of(placed, (vertex - 1) % 4)
    end = corners(placed)[vertex]
    heading = turned(unit(near + math.pi), 0.5)
    away = math.acos(np.clip(np.dot(unit(far), -heading), -1.0, 1.0)) - math.pi / 2
    return exact_contact(f"vertex {vertex}", 0.0, end - 80.0 * heading, end, far, half), away


@pytest.mark.parametrize("vertex", range(4))
@pytest.mark.parametrize("seed", range(3))
def test_a_point_on_a_vertex_has_the_normal_of_either_edge(vertex: int, seed: int) -> None:
    placed = place(KITE, np.random.default_rng(seed))
    contact, away = on_a_vertex(placed, vertex)
    assert away > 0.03
    contacts = [contact, *middles_touched(placed, 0.0)]
    for first in range(3):
        ordered = contacts[first:] + contacts[:first]
        assert holding_truth(recognise(CATALOGUE, ordered), placed) is not None
    late = recognise(CATALOGUE, contacts[1:]).extend(contacts[:1])
    assert holding_truth(late, placed) is not None
    assert memo_counts(CATALOGUE, contacts).model >= 1


def test_what_is_predicted_of_a_point_holds_the_normals_of_both_edges() -> None:
    placed = place(KITE, np.random.default_rng(5))
    contact, _ = on_a_vertex(placed, 1)
    known = recognise(CATALOGUE, [contact, *middles_touched(placed, 0.0)])
    path = Approach(contact.finger, contact.start_mm, contact.direction_rad, 200.0, 0.0)
    assert isinstance(known.hypotheses, Hypotheses)
    item = predict(CATALOGUE, known.hypotheses, known.anchor_mm, [path]).of(0, 0)
    assert item.normal_rad is not None
    lo, hi = item.normal_rad
    for edge in (0, 1):
        assert (normal_of(placed, edge) - lo) % (2 * math.pi) <= hi - lo + 1e-9
