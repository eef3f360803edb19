"""What cannot be an object or a contact is refused with an InputError that names it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from plain_square import SQUARE, SQUARE_RING, sections, three_sides, touching
from shapely_bench import flat

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Polygon, Section, State
from palpate.recognizer import Catalogue, Contact, Finger, NormalRange, recognise


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
