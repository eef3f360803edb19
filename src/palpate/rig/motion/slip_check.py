"""Slip check: whether a slide's horn has slipped on its shaft in a run, shown by its hard stop.

A slide that has slipped looks like a part that lies elsewhere: contacts alone do not show it. Only slides of
which the rig file knows the stops are looked at.
"""

from collections.abc import Mapping

from palpate.base.errors import DeviceError
from palpate.config import SlideFingerConfig
from palpate.drivers.finger import TICK_RAD
from palpate.rig.host_finger import HostFinger
from palpate.rig.motion.end_stops import slide_of, stall
from palpate.rig.motion.hand import Hand
from palpate.rig.pads import has_pads

__all__ = ["check_slips", "slides_at_stops"]

_REPEATS_MM = 0.1  # a stall at a stiff stop comes back to within a few encoder steps


def slides_at_stops(hand: Hand) -> dict[HostFinger, float]:
    """Where each slide's servo stalls (rad) at its back stop; slides without one are left out.

    Fingers must be retracted, and stay so. Raises what `stall` raises.
    """
    found: dict[HostFinger, float] = {}
    for finger in hand.fingers:
        spec = finger.spec
        if isinstance(spec, SlideFingerConfig) and spec.slide.stops_mm is not None:
            found[finger] = stall(hand, finger, spec.slide.stops_mm[0])
    return found


def check_slips(hand: Hand, before: Mapping[HostFinger, float]) -> None:
    """Raise DeviceError for a slide that stalls elsewhere than `before` (rad)."""
    now = slides_at_stops(hand)
    for finger, at_rad in before.items():
        per_rad = abs(slide_of(finger).mm_per_rad)
        off_mm = abs(now[finger] - at_rad) * per_rad
        if off_mm > _REPEATS_MM + 2 * TICK_RAD * per_rad:
            servo = finger.drive.closing_servos[0]
            again = "measure slide.zero_mm again" if has_pads(hand.rig) else "calibrate again"
            raise DeviceError(
                f"finger {finger.name}: its slide (servo {servo.dxl_id}) meets its back stop {off_mm:.2f} mm "
                "from where it did before this run: its horn has slipped, and no answer is given; tighten "
                f"its screw, then {again}"
            )
