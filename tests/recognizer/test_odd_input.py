"""Degenerate contacts and models, and input that is refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise
from support.benches.parts import FINGER, SQUARE, SQUARE_RING, STRAIGHT, sections, three_sides, touching
from support.oracles.shapely_touches import (
    SHIPPED_OBJECTS,
    Placed,
    flat,
    grip,
    holding_truth,
    outlines,
    place,
    touch,
)

# ----------------------------------------------------------------------------------------------------
# Odd contacts get an honest answer: no exception, no warning, no hang, the truth kept or nothing left.


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


# ----------------------------------------------------------------------------------------------------
# Objects of odd shapes get an honest answer: no exception, no warning, no hang, the truth kept.


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


# ----------------------------------------------------------------------------------------------------
# What cannot be an object or a contact is refused with an InputError that names it.


def test_an_empty_catalogue_is_refused() -> None:
    with pytest.raises(InputError, match="catalogue is empty"):
        Catalogue([])


def test_nothing_touched_is_refused() -> None:
    missed = Contact("f", Finger(5.0, 10.0), False, (-100.0, 90.0), (100.0, 90.0), 0.3)
    for contacts in ([], [missed], [missed, replace(missed, name="g")]):
        with pytest.raises(InputError, match="no finger touched"):
            recognise(Catalogue([SQUARE]), contacts)


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


SHORT_OF_POINTS = [[], [(0, 0)], [(0, 0), (10, 0)], [(1, 1)] * 4, [(0, 0), (10, 0), (0, 0), (10, 0)]]
WITHOUT_AREA = [
    [(0, 0), (10, 0), (20, 0)],
    [(0, 0), (1e-7, 0), (0, 1e-7)],
    [(-20, -20), (20, 20), (20, -20), (-20, 20)],
]


@pytest.mark.parametrize("points", [*SHORT_OF_POINTS, *WITHOUT_AREA])
def test_outlines_that_enclose_nothing_are_refused_by_name(points: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="object odd"):
        Catalogue([SQUARE, flat("odd", np.array(points, dtype=float).reshape(-1, 2))])


def test_needles_thinner_than_anything_are_refused_by_name() -> None:
    with pytest.raises(InputError, match="object needle"):
        Catalogue([flat("needle", [(0, 0), (80, 0), (80, 1e-12)])])


@pytest.mark.parametrize("points", [*SHORT_OF_POINTS, WITHOUT_AREA[0], WITHOUT_AREA[2]])
def test_holes_that_enclose_nothing_are_refused_by_name(points: list[tuple[float, float]]) -> None:
    hole = np.array(points, dtype=float).reshape(-1, 2) / 2
    with pytest.raises(InputError, match="object odd"):
        Catalogue([sections("odd", Polygon(SQUARE_RING, (hole,)))])


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_outlines_that_are_no_numbers_are_refused_by_name(value: float) -> None:
    for at in range(3):
        ring = np.array([(-20.0, -20.0), (20.0, -20.0), (0.0, 20.0)])
        ring[at, at % 2] = value
        with pytest.raises(InputError, match="object odd"):
            Catalogue([flat("odd", ring)])


@pytest.mark.parametrize(
    "hole",
    [
        [(50, 50), (60, 50), (60, 60)],
        [(10, 10), (60, 10), (60, 12)],
        [(-20, -20), (20, -20), (20, 20), (-20, 20)],
        [(-20, -20), (0, -20), (0, 0), (-20, 0)],
    ],
    ids=["outside", "across", "all of it", "along its edges"],
)
def test_holes_that_are_none_are_refused_by_name(hole: list[tuple[float, float]]) -> None:
    with pytest.raises(InputError, match="object odd"):
        Catalogue([sections("odd", Polygon(SQUARE_RING, (np.array(hole, dtype=float),)))])


def test_models_without_states_sections_or_polygons_are_refused_by_name() -> None:
    for model in (
        ObjectModel("odd", ()),
        ObjectModel("odd", (State("flat", ()),)),
        ObjectModel("odd", (State("flat", (Section((0.0, 20.0), ()),)),)),
        sections("odd", Polygon(SQUARE_RING), z_hi=math.nan),
        sections("odd", Polygon(SQUARE_RING), z_hi=-1.0),
    ):
        with pytest.raises(InputError, match="object odd"):
            Catalogue([SQUARE, model])


@pytest.mark.parametrize("value", [math.nan, math.inf, -0.1])
def test_bounds_that_are_none_are_refused(value: float) -> None:
    with pytest.raises(InputError, match="object square"):
        Catalogue([replace(SQUARE, tolerance_mm=value)])
    with pytest.raises(InputError, match="radius"):
        Finger(value, 10.0)
    contact = touching("a", (-100.0, 0.0), (-25.0, 0.0))
    with pytest.raises(InputError, match="contact of a"):
        replace(contact, position_bound_mm=value)
    with pytest.raises(InputError, match="contact of a"):
        replace(contact, path_bound_mm=value)
    with pytest.raises(InputError, match="facet error"):
        Catalogue([SQUARE], facet_error_mm=value)
    if value != -0.1:
        with pytest.raises(InputError, match="height"):
            Finger(5.0, value)


def test_a_facet_error_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="facet error"):
        Catalogue([SQUARE], facet_error_mm=0.0)


@pytest.mark.parametrize("value", [1.1e4, 1e9, 1e300, -1e308])
def test_huge_coordinates_are_refused(value: float) -> None:
    with pytest.raises(InputError, match="contact of a"):
        touching("a", (value, 0.0), (0.0, 0.0))
    with pytest.raises(InputError, match="contact of a"):
        touching("a", (0.0, 0.0), (0.0, value))
    with pytest.raises(InputError, match="contact of a"):
        touching("a", (-100.0, 0.0), (0.0, 0.0), abs(value))
    with pytest.raises(InputError, match="radius"):
        Finger(abs(value), 10.0)


@pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
def test_friction_that_is_none_is_refused(value: float) -> None:
    with pytest.raises(InputError, match="friction"):
        replace(three_sides()[0], friction=value)
