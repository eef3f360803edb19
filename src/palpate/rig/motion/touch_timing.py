"""Timing of a touch: speeds, waits and margins, shared by the rig's motion and the study that simulates it.

A grip touches twice: quickly to find the part, then slowly to measure it, unless the search is that slow
already.
"""

import math
from collections.abc import Callable, Iterable

from palpate.base.geometry import Floats
from palpate.config import ClosingConfig, FingerConfig
from palpate.recognizer import FingerApproach
from palpate.rig.contact_peak import travel_step_mm
from palpate.rig.motion.load_meter import LoadMeter, TouchStage, tip_friction

SAMPLES_PER_STATE_READ = 5
"""Samples between looks at the servos while nothing is touched, if that is soon enough."""
SETTLE_S = 0.08
"""Wait between a touch and its measurement, at least: quick touches take longer to rest."""
MEASURE_FRAMES = 8
"""Frames of which the mean is a contact's patch."""
RETOUCH_MARGIN_MM = 0.5
"""Distance before its quick contact in which a finger may meet the part again: the rest was free."""


def touch_speed_mm_s(approach: FingerApproach, speed_mm_s: float) -> float:
    """Speed at which to meet the part, no higher than the approach allows."""
    return min(speed_mm_s, approach.touch_mm_s or math.inf)


def search_stage(closing: ClosingConfig, approaches: Iterable[FingerApproach]) -> TouchStage:
    """Stage that a grip begins with: slow where every finger searches no faster than it measures."""
    speeds = [touch_speed_mm_s(approach, closing.search_mm_s) for approach in approaches]
    return TouchStage.SLOW if max(speeds, default=0.0) <= closing.touch_speed_mm_s else TouchStage.QUICK


def load_meter_of(
    closing: ClosingConfig,
    spec: FingerConfig,
    approach: FingerApproach,
    unnoticed_n: float,
    noise_share: Callable[[int], float],
    drags: Floats | None = None,
) -> LoadMeter:
    """Meter of what a finger loads the part with; the array's noise and `drags` as `LoadMeter` has them."""
    return LoadMeter(
        closing.contact_force_n,
        1 / closing.sample_rate_hz,
        unnoticed_n,
        touch_speed_mm_s(approach, closing.search_mm_s),
        travel_step_mm(spec),
        noise_share,
        drags,
        tip_friction(spec.tip),
    )
