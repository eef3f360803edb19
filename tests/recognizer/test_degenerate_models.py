"""Objects of odd shapes get an honest answer: no exception, no warning, no hang, the truth kept."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from plain_square import SQUARE, SQUARE_RING, STRAIGHT, sections, three_sides
from shapely_bench import Placed, flat, grip, holding_truth, place, touch

from palpate.base.geometry import ObjectModel, Polygon
from palpate.recognizer import Catalogue, Contact, Finger, recognise


def circle(vertices: int, radius: float = 40.0) -> np.ndarray:
    angle = 2 * math.pi * np.arange(vertices) / vertices
    wave = radius + 6 * np.sin(3 * angle) + 2 * np.cos(7 * angle)
    return wave[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


def through_the_middle(placed: Placed, rng: np.random.Generator, radius: float) -> Contact:
    """A finger that cannot miss, however thin the object is."""
    direction = rng.uniform(-math.pi, math.pi)
    heading = np.array([math.cos(direction), math.sin(direction)])
    return touch(
        placed.shape,
        rng,
        radius=radius,
        bound=0.3,
        half_range=math.radians(10),
        direction=direction,
        start=shapely.get_coordinates(placed.shape.representative_point())[0] - 140 * heading,
        reach=280.0,
        name="through",
    )


@pytest.mark.parametrize(
    "model",
    [
        flat("needle", [(0, 0), (80, 0), (80, 1e-3)]),
        flat("sliver", [(0, 0), (80, 0), (80, 1e-6), (0, 1e-6)]),
        flat("spike", [(-20, -20), (20, -20), (20, 0), (60, 1e-4), (20, 1e-3), (20, 20), (-20, 20)]),
        flat("slit", [(-20, -20), (20, -20), (20, 20), (1e-4, 20), (0, -19), (-1e-4, 20), (-20, 20)]),
        flat("collinear", [(-20, -20), (-5, -20), (0, -20), (20, -20), (20, 3), (20, 20), (-20, 20)]),
        flat("repeated", [(-20, -20), (-20, -20), (20, -20), (20, 20), (20, 20), (-20, 20)]),
        flat("tiny", [(0, 0), (1e-2, 0), (0, 1e-2)]),
        flat("far away", np.array([(-20, -20), (20, -20), (20, 20), (-20, 20)]) + 5000.0),
    ],
    ids=lambda model: model.name,
)
@pytest.mark.parametrize("radius", [0.0, 5.0])
def test_odd_outlines_are_found(model: ObjectModel, radius: float) -> None:
    rng = np.random.default_rng(5)
    catalogue = Catalogue([model, SQUARE])
    for _ in range(8):
        placed = place(model, rng, spread=1.0)
        if model.name == "far away":
            cos, sin = math.cos(placed.theta), math.sin(placed.theta)
            placed = Placed(model, -5000 * (cos - sin), -5000 * (sin + cos), placed.theta)
        contacts = grip(placed, rng, fingers=4, radius=radius, aim=0.02)
        contacts.append(through_the_middle(placed, rng, radius))
        assert contacts[-1].touched
        assert holding_truth(recognise(catalogue, contacts), placed) is not None


def test_an_outline_of_hundreds_of_vertices() -> None:
    rng = np.random.default_rng(6)
    model = flat("cam", circle(400))
    placed = place(model, rng)
    found = recognise(Catalogue([model, SQUARE]), grip(placed, rng, half_range=math.radians(10)))
    assert holding_truth(found, placed) is not None


@pytest.mark.parametrize("radius", [0.0, 5.0])
def test_a_hole_too_small_for_anything_changes_nothing(radius: float) -> None:
    model = sections("pierced", Polygon(SQUARE_RING, (np.array([(0, 0), (1e-7, 0), (0, 1e-7)]),)))
    placed = Placed(model, 3.0, 4.0, 0.5)
    contacts = grip(placed, np.random.default_rng(70), fingers=4, radius=radius)
    assert holding_truth(recognise(Catalogue([model]), contacts), placed) is not None


@pytest.mark.parametrize("radius", [0.0, 5.0])
@pytest.mark.parametrize("theta", [0.0, math.pi / 4])
def test_edges_without_length(radius: float, theta: float) -> None:
    ring = [*[(-20, -20)] * 3, (20, -20), (20, -20 + 1e-8), (20, 20), (20 - 1e-9, 20), (-20, 20)]
    model = flat("doubled", ring)
    placed = Placed(model, 3.0, 4.0, theta)
    contacts = grip(placed, np.random.default_rng(72), fingers=4, radius=radius, bound=0.0)
    assert holding_truth(recognise(Catalogue([model]), contacts), placed) is not None


@pytest.mark.parametrize("radius", [0.0, 5.0])
@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-6])
def test_needles_are_found_along_their_side(radius: float, width: float) -> None:
    model = flat("needle", [(0, 0), (80, 0), (80, width)])
    catalogue = Catalogue([model, SQUARE])
    placed = Placed(model, -40.0, 0.0, 0.0)
    finger = Finger(radius, 10.0)
    contacts = [Contact(f"f{x}", finger, True, (x, -100.0), (x, -radius), 0.1) for x in (-20.0, 5.0, 30.0)]
    assert holding_truth(recognise(catalogue, contacts), placed) is not None


HALVES = (
    Polygon(np.array([(-20.0, -20.0), (0.0, -20.0), (0.0, 20.0), (-20.0, 20.0)])),
    Polygon(np.array([(0.0, -20.0), (20.0, -20.0), (20.0, 20.0), (0.0, 20.0)])),
)
SECTIONS = {
    "side by side": HALVES,
    "side by side, shifted": (
        HALVES[0],
        Polygon(np.array([(0.0, -12.0), (20.0, -12.0), (20.0, 28.0), (0.0, 28.0)])),
    ),
    "corner to corner": (
        Polygon(np.array([(-20.0, -20.0), (0.0, -20.0), (0.0, 0.0), (-20.0, 0.0)])),
        Polygon(np.array([(0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0)])),
    ),
    "overlapping": (
        Polygon(np.array([(-20.0, -20.0), (5.0, -20.0), (5.0, 20.0), (-20.0, 20.0)])),
        Polygon(np.array([(-5.0, -18.0), (20.0, -18.0), (20.0, 22.0), (-5.0, 22.0)])),
    ),
    "crossing": (
        Polygon(np.array([(-20.0, -5.0), (20.0, -5.0), (20.0, 5.0), (-20.0, 5.0)])),
        Polygon(np.array([(-5.0, -20.0), (5.0, -20.0), (5.0, 20.0), (-5.0, 20.0)])),
    ),
    "one in the other": (
        Polygon(np.array([(-20.0, -20.0), (20.0, -20.0), (20.0, 20.0), (-20.0, 20.0)])),
        Polygon(np.array([(-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)])),
    ),
}


@pytest.mark.parametrize("radius", [0.0, 5.0])
@pytest.mark.parametrize("which", SECTIONS)
def test_sections_of_polygons_that_touch_or_overlap(which: str, radius: float) -> None:
    rng = np.random.default_rng(73)
    model = sections(which, *SECTIONS[which])
    catalogue = Catalogue([model, flat("plate", [(-25, -15), (25, -15), (25, 15)])])
    for trial in range(4):
        placed = place(model, rng)
        contacts = grip(placed, rng, fingers=4, radius=radius, bound=0.1 * trial, at_bound=bool(trial % 2))
        assert any(contact.touched for contact in contacts)
        assert holding_truth(recognise(catalogue, contacts), placed) is not None


def test_a_tolerance_as_large_as_the_object() -> None:
    found = recognise(Catalogue([replace(SQUARE, tolerance_mm=40.0)]), three_sides())
    assert holding_truth(found, STRAIGHT) is not None
