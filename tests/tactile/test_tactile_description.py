"""What an array says of itself: places and normals of its taxels, and what makes it unusable."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tactile_vectors import FREE, PLACES, SMALL

from palpate.drivers.tactile.messages import Description, Shape
from palpate.errors import DeviceError

PAD = replace(SMALL, shape=Shape.FLAT, tip_radius_mm=0.0, columns=(-2.0, 0.0, 2.0))


def test_places_on_a_cylinder() -> None:
    place, normal = SMALL.positions_mm(), SMALL.normals()
    assert place.shape == normal.shape == (2, 3, 3)
    np.testing.assert_allclose(place[1, 2], [5 * math.cos(0.5), 5 * math.sin(0.5), 3.0])
    np.testing.assert_allclose(normal[0, 0], [math.cos(0.5), -math.sin(0.5), 0.0])


def test_places_on_a_flat_pad() -> None:
    np.testing.assert_allclose(PAD.positions_mm()[1, 2], [2.0, 0.0, 3.0])
    np.testing.assert_allclose(PAD.normals(), np.broadcast_to([0.0, -1.0, 0.0], (2, 3, 3)), atol=1e-15)


def test_places_on_a_free_surface() -> None:
    known = replace(FREE, geometry=PLACES)
    assert known.problem() is None
    np.testing.assert_array_equal(known.positions_mm(), [[[5, 0, 1], [0, 5, 1]]])
    np.testing.assert_array_equal(known.normals(), [[[1, 0, 0], [0, 1, 0]]])


def test_normals_that_were_rounded_come_out_with_length_one() -> None:
    known = replace(FREE, geometry=(*PLACES[:3], 1.009, 0.0, 0.0, *PLACES[6:]))
    assert known.problem() is None
    np.testing.assert_array_equal(known.normals(), [[[1, 0, 0], [0, 1, 0]]])


def test_places_that_were_never_fetched_are_no_places() -> None:
    assert FREE.problem() is None
    for ask in (FREE.positions_mm, FREE.normals):
        with pytest.raises(DeviceError, match=r"2 taxels of array 000102.* not known; .* fetch its geometry"):
            ask()


@pytest.mark.parametrize(
    ("bad", "problem"),
    [
        (replace(FREE, geometry=PLACES[:-1]), "not six reals a taxel"),
        (replace(FREE, geometry=PLACES[:6]), "not six reals a taxel"),
        (replace(FREE, geometry=(*PLACES[:3], 1.011, *PLACES[4:])), "not of length 1"),
        (replace(FREE, geometry=(*PLACES[:3], 0.989, *PLACES[4:])), "not of length 1"),
        (replace(FREE, geometry=(math.inf, *PLACES[1:])), "place is not finite"),
        (replace(FREE, geometry=(*PLACES[:3], math.nan, *PLACES[4:])), "place is not finite"),
        (replace(FREE, columns=(0.0, 1.0)), "columns or row heights on a free surface"),
        (replace(FREE, row_heights_mm=(1.0,)), "columns or row heights on a free surface"),
        (replace(SMALL, geometry=PLACES * 3), "place of its own for each taxel"),
        (replace(SMALL, columns=(0.0, 1.0)), "not one position per column"),
        (replace(SMALL, row_heights_mm=(3.0, 1.0)), "row heights do not ascend"),
        (replace(SMALL, tip_radius_mm=0.0), "cylinder without a radius"),
        (replace(SMALL, full_scale_n=math.nan), "not finite"),
        (replace(SMALL, rows=0), "outside 1..255"),
        (replace(SMALL, rows=64, cols=65), "more than 4096 taxels"),
        (replace(SMALL, bit_depth=17), "bit depth"),
    ],
)
def test_what_cannot_be_used_is_said(bad: Description, problem: str) -> None:
    assert problem in str(bad.problem())
