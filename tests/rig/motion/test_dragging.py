"""What a tip may drag the part with as it goes back: by where its array feels it."""

import math

import numpy as np
import pytest
from contact_sweep import describe

from palpate.base.geometry import Floats
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import TipCalibration
from palpate.rig.motion.load_meter import TIP_FRICTION, LoadMeter, friction_factor

COUNTS_PER_N, FORCE_N, NOISE_COUNTS = 1000.0, 0.5, 2.0
ARRAY = describe(Shape.CYLINDER, 4, 8, math.radians(24), 2.0, counts_per_n=COUNTS_PER_N, radius_mm=6.0)
LAST_TWO = np.array([0.0] * 6 + [math.inf] * 2)
LAST_FOUR = np.array([0.0] * 4 + [math.inf] * 4)


def dragging_n(column: int, drags: Floats | None) -> float:
    """Of a force on one column, after a while in which nothing was felt."""
    calibration = TipCalibration(gain=np.ones((4, 8)), noise_counts=NOISE_COUNTS)
    extractor = ContactExtractor(ARRAY, calibration)
    rng = np.random.default_rng(5)

    def frame(number: int, force_n: float) -> TactileFrame:
        counts = 100 + rng.normal(0.0, NOISE_COUNTS, (4, 8))
        counts[:, column] += force_n * COUNTS_PER_N / 4
        at_s = number / 250
        return TactileFrame(number, at_s, at_s, counts.round().astype(np.uint16))

    extractor.tare([frame(number, 0.0) for number in range(64)])
    meter = LoadMeter(FORCE_N, 0.004, extractor.least_force_n, noise_share=extractor.noise_share, drags=drags)
    for number in range(64, 128):
        force, readings = extractor.sense(frame(number, 0.0))
        assert meter.quiet_mean(readings, force) is not None
    touched = frame(128, FORCE_N)
    force, readings = extractor.sense(touched)
    assert force == pytest.approx(FORCE_N, rel=0.1)
    assert meter.quiet_mean(readings, force) is None
    return meter.dragging_n(extractor, touched, readings)


@pytest.mark.parametrize("column", [6, 7])
def test_the_back_counts_whole_also_where_it_is_too_narrow_to_be_looked_at_by_itself(column: int) -> None:
    assert dragging_n(column, LAST_TWO) >= friction_factor(TIP_FRICTION) * FORCE_N * 0.98
    assert math.isinf(dragging_n(column, LAST_FOUR))


@pytest.mark.parametrize("drags", [LAST_TWO, LAST_FOUR])
def test_what_presses_ahead_drags_no_more_than_noise_may_hide(drags: Floats) -> None:
    assert 0.0 < dragging_n(1, drags) < 0.1 * FORCE_N


def test_all_of_a_force_counts_where_nothing_is_known_of_the_columns() -> None:
    assert math.isinf(dragging_n(1, None))
