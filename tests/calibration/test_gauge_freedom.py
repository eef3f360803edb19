"""The hand frame: any rigid motion is undone, and what is left is the least there can be."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from palpate.calibration.frame_alignment import HEADING_ARM_MM, BasePose, RigidMotion, align_to_nominal

ANGLES = st.floats(-math.pi, math.pi)
NEAR = st.floats(-200.0, 200.0)


def places(seed: int, count: int) -> list[BasePose]:
    rng = np.random.default_rng(seed)
    return [
        BasePose((float(rng.uniform(-200, 200)), float(rng.uniform(-200, 200))), float(rng.uniform(-3, 3)))
        for _ in range(count)
    ]


def moved(place: BasePose, angle: float, shift: complex) -> BasePose:
    """Turned about the origin, then shifted: with complex numbers, so that no matrix has to be right."""
    base = complex(*place.base_mm) * complex(math.cos(angle), math.sin(angle)) + shift
    return BasePose((base.real, base.imag), place.heading_rad + angle)


def disagreement(nominal: list[BasePose], found: list[BasePose], angle: float, shift: complex) -> float:
    """Sum of squares of bases, and of points as far away as headings count."""
    total = 0.0
    for one, other in zip(nominal, (moved(place, angle, shift) for place in found), strict=True):
        total += abs(complex(*one.base_mm) - complex(*other.base_mm)) ** 2
        arms = [complex(math.cos(p.heading_rad), math.sin(p.heading_rad)) for p in (one, other)]
        total += HEADING_ARM_MM**2 * abs(arms[0] - arms[1]) ** 2
    return total


@settings(max_examples=60)
@given(st.integers(0, 1000), st.integers(1, 5), ANGLES, NEAR, NEAR)
def test_any_motion_is_undone(seed: int, count: int, angle: float, x: float, y: float) -> None:
    nominal = places(seed, count)
    found = [moved(place, angle, complex(x, y)) for place in nominal]
    frame = align_to_nominal(nominal, found)
    for wanted, place in zip(nominal, found, strict=True):
        back = frame.place(place)
        assert back.base_mm == pytest.approx(wanted.base_mm, abs=1e-7)
        assert math.remainder(back.heading_rad - wanted.heading_rad, 2 * math.pi) == pytest.approx(
            0, abs=1e-9
        )


@pytest.mark.parametrize("seed", range(6))
def test_nothing_brings_places_nearer(seed: int) -> None:
    rng = np.random.default_rng(seed)
    nominal = places(seed, 1 + seed % 4)
    off = [
        BasePose(
            (place.base_mm[0] + float(rng.normal(0, 5)), place.base_mm[1] + float(rng.normal(0, 5))),
            place.heading_rad + float(rng.normal(0, 0.1)),
        )
        for place in nominal
    ]
    found = [moved(place, 0.7, 12 - 9j) for place in off]
    frame = align_to_nominal(nominal, found)
    own = disagreement(nominal, found, frame.angle_rad, complex(*frame.shift_mm))
    best = minimize(
        lambda x: disagreement(nominal, found, float(x[0]), complex(x[1], x[2])),
        [-0.7, 0.0, 0.0],
        method="BFGS",
        options={"gtol": 1e-9},
    )
    assert own <= best.fun + 1e-6
    assert (frame.angle_rad, *frame.shift_mm) == pytest.approx(best.x, abs=1e-3)


def test_one_finger_is_put_where_it_is_described() -> None:
    """Its base and its heading say all; three unknowns are used up."""
    nominal, found = [BasePose((10.0, 190.0), -1.5)], [BasePose((-3.0, 150.0), 2.0)]
    back = align_to_nominal(nominal, found).place(found[0])
    assert back.base_mm == pytest.approx((10.0, 190.0))
    assert math.remainder(back.heading_rad + 1.5, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


def test_points_and_places_move_alike() -> None:
    frame = RigidMotion(math.pi / 2, (10.0, -5.0))
    assert frame.point_mm((2.0, 1.0)) == pytest.approx((9.0, -3.0))
    place = frame.place(BasePose((2.0, 1.0), 0.25))
    assert place.base_mm == pytest.approx((9.0, -3.0))
    assert place.heading_rad == pytest.approx(0.25 + math.pi / 2)


@pytest.mark.parametrize(("nominal", "found"), [(0, 0), (1, 2), (3, 2)])
def test_numbers_of_places_must_agree(nominal: int, found: int) -> None:
    with pytest.raises(ValueError, match="at least one"):
        align_to_nominal(places(0, nominal), places(1, found))
