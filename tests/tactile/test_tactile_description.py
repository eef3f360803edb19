"""What an array says of itself: places and normals of its taxels, and what makes it unusable."""

import math
from dataclasses import replace

import numpy as np
import pytest
from tactile_vectors import FREE, PLACES, SMALL

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.description import Description, Shape

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
        (replace(FREE, geometry=PLACES[:-1]), "11 reals of geometry (allowed: 12)"),
        (replace(FREE, geometry=PLACES[:6]), "6 reals of geometry (allowed: 12)"),
        (replace(FREE, geometry=(*PLACES[:3], 1.011, *PLACES[4:])), "length 1.011 (allowed: 1 within 1 %)"),
        (replace(FREE, geometry=(*PLACES[:3], 0.989, *PLACES[4:])), "length 0.989 (allowed: 1 within 1 %)"),
        (replace(FREE, geometry=(math.inf, *PLACES[1:])), "position of inf mm (allowed: -1000 to 1000 mm)"),
        (replace(FREE, geometry=(*PLACES[:3], math.nan, *PLACES[4:])), "normal of length nan"),
        (replace(FREE, columns=(0.0, 1.0)), "allowed: on a surface that is not free"),
        (replace(FREE, row_heights_mm=(1.0,)), "allowed: on a surface that is not free"),
        (replace(SMALL, geometry=PLACES * 3), "place of its own for each taxel"),
        (replace(SMALL, columns=(0.0, 1.0)), "2 column positions (allowed: 3)"),
        (replace(SMALL, columns=(-20.0, 0.0, 20.0)), "column 0 at -20 rad (allowed: -3.1416 to 3.1416 rad)"),
        (replace(PAD, columns=(-1e4, 0.0, 2.0)), "column 0 at -10000 mm (allowed: -1000 to 1000 mm)"),
        (replace(SMALL, columns=(0.0, 1e-9, 1.0)), "column 1 at 1e-09 rad after one at 0 rad"),
        (replace(SMALL, row_heights_mm=(3.0, 1.0)), "row 1 at 1 mm after one at 3 mm (allowed: ascending"),
        (replace(SMALL, tip_radius_mm=0.0), "tip radius 0 mm (allowed: 0.1 to 1000 mm)"),
        (replace(SMALL, full_scale_n=math.nan), "full scale nan N (allowed: 0.001 to 100000 N)"),
        (replace(SMALL, counts_per_n=1e-38), "counts per N 1e-38 (allowed: 0.001 to 1e+07)"),
        (replace(SMALL, max_rate_hz=0.0), "maximum rate 0 Hz (allowed: 0.001 to"),
        (replace(SMALL, rows=0), "rows 0 (allowed: 1 to 255)"),
        (replace(SMALL, rows=64, cols=65), "64 x 65 taxels, together 4160 (allowed: 1 to 4096)"),
        (replace(SMALL, bit_depth=17), "bit depth 17 (allowed: 1 to 16)"),
    ],
)
def test_what_cannot_be_used_is_said(bad: Description, problem: str) -> None:
    assert problem in str(bad.problem())
