"""Odd contacts get an honest answer: no exception, no warning, no hang, the truth kept or nothing left."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_square import FINGER, SQUARE, STRAIGHT, three_sides, touching
from shapely_bench import SHIPPED_OBJECTS, Placed, grip, holding_truth, outlines, place

from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise


def test_coincident_contacts_say_no_more_than_one() -> None:
    one = touching("f1", (-100.0, 0.0), (-25.0, 0.0))
    catalogue = Catalogue([SQUARE])
    for count in (1, 2, 3, 5):
        found = recognise(catalogue, [replace(one, name=f"f{k}") for k in range(count)])
        assert holding_truth(found, STRAIGHT) is not None


def test_contradicting_contacts_leave_nothing() -> None:
    contacts = [touching("a", (-100.0, 0.0), (-25.0, 0.0)), touching("b", (900.0, 0.0), (400.0, 0.0))]
    assert recognise(Catalogue([SQUARE]), contacts).verdict is RecognitionVerdict.NONE


def test_a_normal_against_the_approach_leaves_nothing() -> None:
    wrong = replace(touching("a", (-100.0, 0.0), (-25.0, 0.0)), normal=NormalRange(-0.1, 0.1))
    found = recognise(Catalogue([SQUARE]), [wrong, touching("b", (100.0, 0.0), (25.0, 0.0))])
    assert found.verdict is RecognitionVerdict.NONE
    assert found.extend([touching("c", (0.0, 100.0), (0.0, 25.0))]).verdict is RecognitionVerdict.NONE


def test_a_finger_at_a_height_where_nothing_is() -> None:
    high = replace(touching("a", (-100.0, 0.0), (-25.0, 0.0)), finger=Finger(5.0, 80.0))
    assert recognise(Catalogue([SQUARE]), [high]).verdict is RecognitionVerdict.NONE
    both = [touching("b", (100.0, 0.0), (25.0, 0.0)), high]
    assert recognise(Catalogue([SQUARE]), both).verdict is RecognitionVerdict.NONE


def test_no_travel_at_all() -> None:
    still = touching("a", (-25.0, 0.0), (-25.0, 0.0))
    found = recognise(Catalogue([SQUARE]), [still, touching("b", (100.0, 1.0), (25.0, 1.0))])
    assert holding_truth(found, STRAIGHT) is not None


@pytest.mark.parametrize("bound", [0.0, 10.0])
def test_bounds_of_nothing_and_of_half_the_object(bound: float) -> None:
    found = recognise(Catalogue([SQUARE]), three_sides(bound))
    assert holding_truth(found, STRAIGHT) is not None


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


def test_far_from_the_origin_the_truth_is_kept() -> None:
    """Everything moved to where coordinates may just be: the answer is the same, moved."""
    rng = np.random.default_rng(71)
    for corner in ((9800.0, 9800.0), (-9800.0, 9800.0)):
        placed = Placed(SQUARE, 3.0, -4.0, 0.7)
        contacts = grip(placed, rng, fingers=4)
        near = recognise(Catalogue([SQUARE]), contacts)
        moved = [
            replace(
                contact,
                start_mm=(contact.start_mm[0] + corner[0], contact.start_mm[1] + corner[1]),
                end_mm=(contact.end_mm[0] + corner[0], contact.end_mm[1] + corner[1]),
            )
            for contact in contacts
        ]
        far = recognise(Catalogue([SQUARE]), moved)
        there = Placed(SQUARE, placed.x + corner[0], placed.y + corner[1], placed.theta)
        assert holding_truth(far, there) is not None
        assert len(far.hypotheses) == len(near.hypotheses)
        shift = (*corner, 0.0)
        np.testing.assert_allclose(far.hypotheses.lo, near.hypotheses.lo + shift, atol=1e-6)


def test_normal_ranges_without_width() -> None:
    """Exact normals of a square that lies straight are enough; one that points nowhere leaves nothing."""
    normals = (math.pi, 0.0, 1.5 * math.pi)
    contacts = [
        replace(contact, normal=NormalRange(normal, normal))
        for contact, normal in zip(three_sides(), normals, strict=True)
    ]
    catalogue = Catalogue([SQUARE])
    found = recognise(catalogue, contacts)
    assert holding_truth(found, STRAIGHT) is not None
    assert found.hypotheses[0].bounds.orientation_half_rad < 1e-6
    tilted = replace(contacts[1], normal=NormalRange(0.2, 0.2))
    assert recognise(catalogue, [contacts[0], tilted, contacts[2]]).verdict is RecognitionVerdict.NONE


def test_a_bound_as_large_as_the_object() -> None:
    for count in (1, 2, 3):
        found = recognise(Catalogue([SQUARE]), three_sides(40.0)[:count])
        assert holding_truth(found, STRAIGHT) is not None


@pytest.mark.parametrize("count", [12, 40])
@pytest.mark.parametrize("half_range", [math.radians(10), None])
def test_contacts_by_the_dozen(count: int, half_range: float | None) -> None:
    rng = np.random.default_rng(count)
    models = [*outlines(SHIPPED_OBJECTS), SQUARE]
    catalogue = Catalogue(models)
    for model in (models[3], SQUARE):
        placed = place(model, rng)
        contacts = grip(placed, rng, fingers=count, half_range=half_range)
        found = recognise(catalogue, contacts)
        assert holding_truth(found, placed) is not None
        assert found.contacts == tuple(contacts)


def test_a_path_that_starts_inside_the_object() -> None:
    """A finger cannot have come out of the solid: that leaves no configuration in which it does."""
    outside, *contacts = three_sides()
    known = recognise(Catalogue([SQUARE]), [*contacts, outside])
    assert known.verdict is not RecognitionVerdict.NONE
    inside = recognise(Catalogue([SQUARE]), [*contacts, touching("a", (0.0, 3.0), (-25.0, 3.0))])
    assert holding_truth(inside, STRAIGHT) is None
    miss = Contact("m", FINGER, False, (0.0, 0.0), (1.0, 0.0), 0.3)
    assert holding_truth(known.extend([miss]), STRAIGHT) is None


def test_paths_without_length() -> None:
    catalogue = Catalogue([SQUARE])
    beside = Contact("m", FINGER, False, (40.0, 0.0), (40.0, 0.0), 0.3)
    for bound in (0.0, 0.3):
        still = [replace(contact, start_mm=contact.end_mm) for contact in three_sides(bound)]
        assert holding_truth(recognise(catalogue, [*still, beside]), STRAIGHT) is not None


def test_the_same_name_and_the_same_object_twice() -> None:
    """Names are labels: two contacts of one name count as two, two models of one name as two."""
    one = touching("f", (-100.0, 0.0), (-25.0, 0.0))
    two = touching("f", (100.0, 1.0), (25.0, 1.0))
    found = recognise(Catalogue([SQUARE, SQUARE]), [one, two])
    assert len(found.contacts) == 2
    assert {item.state_index for item in found.hypotheses} == {0, 1}


def test_friction_narrows_the_normals_to_its_cone() -> None:
    contacts = three_sides()
    contacts[0] = replace(contacts[0], position_bound_mm=0.0)
    held = replace(contacts[0], friction=0.5).outward_normals()
    assert held is not None
    assert held.lo_rad == pytest.approx(math.pi - math.atan(0.5), abs=1e-6)
    assert held.hi_rad == pytest.approx(math.pi + math.atan(0.5), abs=1e-6)
    without = recognise(Catalogue([SQUARE]), contacts)
    found = recognise(Catalogue([SQUARE]), [replace(item, friction=0.3) for item in contacts])
    assert holding_truth(found, STRAIGHT) is not None
    assert found.cells.volume.sum() < without.cells.volume.sum()
