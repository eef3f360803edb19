"""Columns that are certainly pressed are pressed, whatever gains, crosstalk and noise make of it."""

import numpy as np
import pytest
from contact_sweep import describe
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, TipCalibration

ROWS, COLS, PITCH = 4, 12, 1.0
DESCRIPTION = describe(Shape.FLAT, ROWS, COLS, PITCH, 4.0, counts_per_n=2000.0)


def touched(
    force_n: np.ndarray, *, usable: np.ndarray | None = None, seed: int = 0, **hidden: float
) -> ContactPatch | None:
    """What an array shows of a force on each column, shared by its rows."""
    shape = (ROWS, COLS)
    dead = [] if usable is None else [(int(row), int(col)) for row, col in np.argwhere(~usable)]
    taxels = Taxels(DESCRIPTION, seed=seed, offset_counts=20.0, dead=dead, **hidden)
    extractor = ContactExtractor(
        DESCRIPTION,
        TipCalibration(gain=np.ones(shape), gain_spread=0.2, noise_counts=2.0, usable=usable),
    )
    extractor.tare([TactileFrame(k, 0.0, 0.0, taxels.counts(np.zeros(shape))) for k in range(64)])
    force = np.repeat(force_n[None] / ROWS, ROWS, axis=0)
    return extractor.extract([TactileFrame(k, 0.0, 0.0, taxels.counts(force)) for k in range(8)])


def at(column: int) -> tuple[float, float]:
    middle = (column - (COLS - 1) / 2) * PITCH
    return middle - PITCH / 2, middle + PITCH / 2


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, COLS - 1), st.floats(0.02, 3.0)), min_size=1, max_size=4),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.2),
    st.integers(0, 2**31),
)
def test_what_is_certainly_pressed_is_pressed(
    loads: list[tuple[int, float]], crosstalk: float, spread: float, seed: int
) -> None:
    force = np.zeros(COLS)
    for column, load in loads:
        force[column] += load
    found = touched(force, seed=seed, crosstalk=crosstalk, gain_spread=spread, noise_counts=2.0)
    if found is None:
        return
    pressed = [at(column) for column in np.flatnonzero(force)]
    for item in found.pressed_mm or ():
        assert any(item == pytest.approx(place) for place in pressed)
    if max(load for _, load in loads) > 0.3:
        assert found.pressed_mm is not None, "of a touch that is felt it is known where"
        assert found.loaded_mm is not None
        assert found.loaded_mm[0] <= found.pressed_mm[0][0]
        assert found.pressed_mm[1][1] <= found.loaded_mm[1]


def test_two_corners_are_two_places_and_their_middle_is_none() -> None:
    force = np.zeros(COLS)
    force[[2, 9]] = 0.5
    found = touched(force, crosstalk=0.06, noise_counts=2.0)
    assert found is not None
    assert found.pressed_mm == (pytest.approx(at(2)), pytest.approx(at(9)))
    assert found.loaded_mm == pytest.approx((at(1)[0], at(10)[1])), "crosstalk is shown beside"


def test_beside_a_taxel_that_cannot_be_read_nothing_is_certain() -> None:
    usable = np.ones((ROWS, COLS), dtype=bool)
    usable[1, 4] = False
    force = np.zeros(COLS)
    force[5] = 0.5
    beside = touched(force, usable=usable, noise_counts=2.0)
    assert beside is not None
    assert beside.pressed_mm is None
    force = np.roll(force, 3)
    elsewhere = touched(force, usable=usable, noise_counts=2.0)
    assert elsewhere is not None
    assert elsewhere.pressed_mm == (pytest.approx(at(8)),) * 2
