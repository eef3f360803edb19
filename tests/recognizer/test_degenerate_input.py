"""Odd input gets an honest answer or InputError: no other exception, no warning, no hang."""

import math
from dataclasses import replace

import numpy as np
import pytest
from shapely_bench import SHIPPED_OBJECTS, Placed, flat, grip, holding_truth, outlines, place

from palpate.errors import InputError
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, Verdict, recognise
from palpate.recognizer.model import ObjectModel

FINGER = Finger(5.0, 10.0)
SQUARE = flat("square", [(-20, -20), (20, -20), (20, 20), (-20, 20)])


def touching(name: str, start: tuple[float, float], end: tuple[float, float], bound: float = 0.3) -> Contact:
    return Contact(name, FINGER, True, start, end, bound)


def circle(vertices: int, radius: float = 40.0) -> np.ndarray:
    angle = 2 * math.pi * np.arange(vertices) / vertices
    wave = radius + 6 * np.sin(3 * angle) + 2 * np.cos(7 * angle)
    return wave[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])


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
    done = 0
    for _ in range(8):
        placed = place(model, rng, spread=1.0)
        if model.name == "far away":
            cos, sin = math.cos(placed.theta), math.sin(placed.theta)
            placed = Placed(model, -5000 * (cos - sin), -5000 * (sin + cos), placed.theta)
        contacts = grip(placed, rng, fingers=4, radius=radius, half_range=math.radians(10), aim=0.02)
        if any(contact.touched for contact in contacts):
            done += 1
            assert holding_truth(recognise(catalogue, contacts), placed) is not None
    assert done or radius == 0.0


def test_an_outline_of_hundreds_of_vertices() -> None:
    rng = np.random.default_rng(6)
    model = flat("cam", circle(400))
    placed = place(model, rng)
    found = recognise(Catalogue([model, SQUARE]), grip(placed, rng, half_range=math.radians(10)))
    assert holding_truth(found, placed) is not None


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(InputError, match="catalogue is empty"):
        Catalogue([])


def test_nothing_touched_is_refused() -> None:
    missed = Contact("f", FINGER, False, (-100.0, 90.0), (100.0, 90.0), 0.3)
    for contacts in ([], [missed], [missed, replace(missed, name="g")]):
        with pytest.raises(InputError, match="no finger touched"):
            recognise(Catalogue([SQUARE]), contacts)


def test_coincident_contacts_say_no_more_than_one() -> None:
    one = touching("f1", (-100.0, 0.0), (-25.0, 0.0))
    catalogue = Catalogue([SQUARE])
    for count in (1, 2, 3, 5):
        found = recognise(catalogue, [replace(one, name=f"f{k}") for k in range(count)])
        assert holding_truth(found, Placed(SQUARE, 0.0, 0.0, 0.0)) is not None


def test_contradicting_contacts_leave_nothing() -> None:
    contacts = [touching("a", (-100.0, 0.0), (-25.0, 0.0)), touching("b", (900.0, 0.0), (400.0, 0.0))]
    assert recognise(Catalogue([SQUARE]), contacts).verdict is Verdict.NONE


def test_a_normal_against_the_approach_leaves_nothing() -> None:
    wrong = replace(touching("a", (-100.0, 0.0), (-25.0, 0.0)), normal=NormalRange(-0.1, 0.1))
    found = recognise(Catalogue([SQUARE]), [wrong, touching("b", (100.0, 0.0), (25.0, 0.0))])
    assert found.verdict is Verdict.NONE
    assert found.extend([touching("c", (0.0, 100.0), (0.0, 25.0))]).verdict is Verdict.NONE


def test_a_finger_at_a_height_where_nothing_is() -> None:
    high = replace(touching("a", (-100.0, 0.0), (-25.0, 0.0)), finger=Finger(5.0, 80.0))
    assert recognise(Catalogue([SQUARE]), [high]).verdict is Verdict.NONE
    both = [touching("b", (100.0, 0.0), (25.0, 0.0)), high]
    assert recognise(Catalogue([SQUARE]), both).verdict is Verdict.NONE


def test_no_travel_at_all() -> None:
    still = touching("a", (-25.0, 0.0), (-25.0, 0.0))
    found = recognise(Catalogue([SQUARE]), [still, touching("b", (100.0, 1.0), (25.0, 1.0))])
    assert holding_truth(found, Placed(SQUARE, 0.0, 0.0, 0.0)) is not None


@pytest.mark.parametrize("bound", [0.0, 10.0])
def test_bounds_of_nothing_and_of_half_the_object(bound: float) -> None:
    contacts = [
        touching("a", (-100.0, 3.0), (-25.0, 3.0), bound),
        touching("b", (100.0, -4.0), (25.0, -4.0), bound),
        touching("c", (2.0, -100.0), (2.0, -25.0), bound),
    ]
    found = recognise(Catalogue([SQUARE]), contacts)
    assert holding_truth(found, Placed(SQUARE, 0.0, 0.0, 0.0)) is not None


def test_parallel_edges_leave_a_family_with_its_extent() -> None:
    left, right = NormalRange(math.pi - 0.02, math.pi + 0.02), NormalRange(-0.02, 0.02)
    contacts = [
        replace(touching("a", (-100.0, 3.0), (-25.0, 3.0), 0.01), normal=left),
        replace(touching("b", (100.0, 3.0), (25.0, 3.0), 0.01), normal=right),
    ]
    (found,) = recognise(Catalogue([SQUARE]), contacts).hypotheses
    assert found.slide is not None
    assert found.slide.direction_rad == pytest.approx(math.pi / 2, abs=0.03)
    lo, hi = found.slide.extent_mm
    # Contacts at y = 3 on edges from −20 to 20: anywhere from −17 to 23, and a little beyond by the corners.
    assert found.configuration.y_mm + lo == pytest.approx(-17.0, abs=1.0)
    assert found.configuration.y_mm + hi == pytest.approx(23.0, abs=1.0)
    assert found.bounds.y_mm[0] < -14.0
    assert found.bounds.y_mm[1] > 14.0
    assert found.bounds.x_mm == pytest.approx((0.0, 0.0), abs=1.0)


def test_exact_contacts_give_the_exact_configuration() -> None:
    rng = np.random.default_rng(12)
    model = outlines(SHIPPED_OBJECTS)[3]
    placed = place(model, rng)
    contacts = [
        replace(contact, normal=None) for contact in grip(placed, rng, fingers=5, radius=0.0, bound=0.0)
    ]
    found = holding_truth(recognise(Catalogue([model]), contacts), placed)
    assert found is not None
    assert found.configuration.x_mm == pytest.approx(placed.x, abs=1e-3)
    assert found.configuration.y_mm == pytest.approx(placed.y, abs=1e-3)
    assert found.configuration.theta_rad % (2 * math.pi) == pytest.approx(
        placed.theta % (2 * math.pi), abs=1e-4
    )


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_contacts_that_are_no_numbers_are_refused(value: float) -> None:
    with pytest.raises(InputError, match="finite"):
        touching("a", (value, 0.0), (0.0, 0.0))
    with pytest.raises(InputError, match="bounds must be from 0"):
        touching("a", (1.0, 0.0), (0.0, 0.0), -0.1)
    with pytest.raises(InputError, match="finite"):
        NormalRange(value, 0.0)
    with pytest.raises(InputError, match="counter-clockwise"):
        NormalRange(1.0, 0.0)
