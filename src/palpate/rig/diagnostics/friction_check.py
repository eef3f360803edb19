"""Friction check: the current that slides need to move freely now, beside what the rig allows them for it.

A slide's current limit is what max_force_n takes and `slide.friction_a`, which its friction is to use up. A
carriage that runs more easily leaves the rest to the tip; one that runs harder takes it from the touch.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress

from palpate.base.errors import InputError
from palpate.calibration.fitted_kinematics import FingerModel, SlideModel
from palpate.calibration.friction import estimate_friction
from palpate.calibration.prober import Prober
from palpate.calibration.reference_search import LocatedReference, probes_at_bearing
from palpate.config import RigFile, SlideFingerConfig
from palpate.rig.conversion import slide_force_n

__all__ = ["friction_warnings", "measure_friction"]

_FEWEST_CONTACTS = 2.0
"""Times contact_force_n that a slide should be able to press with."""


def measure_friction(
    prober: Prober, models: Sequence[FingerModel], found: LocatedReference
) -> dict[str, float]:
    """Current (A) that each finger's slide needs to move out freely, from the begin of a press head-on.

    Left out are arms, slides that moved too little, and fingers that meet what was located too obliquely.
    """
    slides = {k for k, model in enumerate(models) if isinstance(model, SlideModel)}
    contacts = [
        probe
        for probe, _ in probes_at_bearing(found, prober, models, 0.0)
        if prober.approaches[probe.approach].finger in slides
    ]
    presses = {press.finger: press for press in prober.press(contacts, 0)} if contacts else {}
    found_a = {}
    for name, press in presses.items():
        with suppress(InputError):  # too few samples: what touches have shown must not be lost with it
            found_a[name] = abs(estimate_friction([press]).push_n / press.newton_per_a[1])
    return found_a


def friction_warnings(rig: RigFile, friction_a: Mapping[str, float]) -> list[str]:
    """What measured friction means for the force with which tips may press, where it matters."""
    slides = (item for item in rig.fingers if isinstance(item, SlideFingerConfig) and item.name in friction_a)
    found = (_warning(rig, spec, friction_a[spec.name]) for spec in slides)
    return [warning for warning in found if warning is not None]


def _warning(rig: RigFile, spec: SlideFingerConfig, measured_a: float) -> str | None:
    allowed_a = spec.slide.friction_a
    more_n = slide_force_n(spec.slide, allowed_a - measured_a)
    left_n = rig.closing.max_force_n + more_n
    servo = f"finger {spec.name}: its slide (servo {spec.slide.dxl_id})"
    if more_n > 0:
        return (
            f"{servo} moves freely with {measured_a:.3f} A, and {allowed_a:.3f} A are allowed for its "
            f"friction: its tip may press with {math.ceil(10 * more_n) / 10:g} N more than max_force_n; "
            f"calibrate again, or make slide.friction_a at most {math.floor(1e3 * measured_a) / 1e3:g}"
        )
    if left_n < _FEWEST_CONTACTS * rig.closing.contact_force_n:
        return (
            f"{servo} needs {measured_a:.3f} A to move freely, and {allowed_a:.3f} A are allowed for it: "
            f"{max(left_n, 0.0):.1f} N of max_force_n are left to touch with; clean and grease it, then "
            "calibrate again"
        )
    return None
