"""A plan in words: numbers rounded so that what is printed still holds, and what the certificate rests on.

Shared by the terminal (`plan_table`) and the picture, which therefore say the same.
"""

import math
from collections.abc import Sequence

from palpate.base.vocabulary import RecognitionVerdict, Strategy
from palpate.recognizer import Grip, Prediction
from palpate.rig.identification.next_grip import Planned
from palpate.views.grip_result import outward_normals

__all__ = [
    "SHOWN",
    "certainty",
    "direction",
    "left_over",
    "letter",
    "may_miss",
    "named",
    "normal_words",
    "rests_on",
    "stop_words",
]

SHOWN = 12
"""So many hypotheses are shown one by one; the picture draws as many."""


def letter(index: int) -> str:
    """What a hypothesis is called where it is shown; the first `SHOWN` have letters, the rest numbers."""
    return chr(ord("a") + index) if index < SHOWN else str(index)


def direction(angle_rad: float) -> str:
    """A direction in degrees from −180 to 180."""
    degrees = math.degrees(math.remainder(angle_rad, 2 * math.pi))
    return f"{round(degrees, 1) + 0.0:.1f}°".replace("-", "−")


def stop_words(item: Prediction) -> str | None:
    """Where a finger is stopped, in mm, rounded outward; None if nothing stops it."""
    if not math.isfinite(item.earliest_mm):
        return None
    lo, hi = math.floor(10 * item.earliest_mm) / 10, math.ceil(10 * item.furthest_mm) / 10
    return f"{lo:.1f} … {hi:.1f}".replace("-", "−")


def normal_words(item: Prediction) -> str | None:
    """Interval of the contact normal, in whole degrees rounded outward; None if nothing stops it."""
    interval = outward_normals(item)
    if interval is None or not math.isfinite(item.earliest_mm):
        return None
    lo, hi = math.floor(math.degrees(interval[0])), math.ceil(math.degrees(interval[1]))
    return "any" if hi - lo >= 360 else f"{lo} … {hi}°".replace("-", "−")


def may_miss(item: Prediction) -> bool:
    """Whether perhaps nothing stops the finger."""
    return not math.isfinite(item.latest_mm)


def rests_on(planned: Planned, grip: Grip) -> str:
    """The bounds on contacts for which the grip is decisive."""
    ordered = [grip.approaches[row] for row in planned.rows]
    names = [planned.rig.fingers[item.finger_index].name for item in ordered]
    bounds = [f"{math.floor(100 * item.position_bound_mm) / 100:.2f}" for item in ordered]
    normal = f"{math.floor(10 * math.degrees(planned.resolution.normal_half_rad) + 1e-6) / 10:g}"
    if len(set(bounds)) == 1:
        return f"± {bounds[0]} mm and ± {normal}°"
    each = ", ".join(f"± {bound} mm ({name})" for name, bound in zip(names, bounds, strict=True))
    return f"{each} and ± {normal}°"


def certainty(planned: Planned) -> list[str]:
    """The certificate of the grip, or why there is no grip."""
    grip, recognition = planned.grip, planned.recognition
    if planned.hopeless:
        more = [] if grip is None else ["the grip can only place them more finely"]
        return ["no approach within reach distinguishes the hypotheses that are left", *more]
    if recognition.verdict is RecognitionVerdict.UNIQUE:
        return [_about_one(planned)]
    if grip is None:
        return ["no grip: no approach that is left is expected to distinguish the hypotheses"]
    if not grip.decisive:
        return ["not decisive: some outcomes leave hypotheses that another touch may distinguish"]
    left = "one indistinguishable set" if planned.alike else "one hypothesis"
    return [f"decisive: every outcome leaves {left}, if contacts are within {rests_on(planned, grip)}"]


def left_over(planned: Planned) -> str | None:
    """Expected share of confusion after the grip, as a percentage; None if it was not foreseen."""
    if planned.grip is None or planned.strategy is not Strategy.PLANNED:
        return None
    share = 100 * planned.grip.remaining
    return f"{share:.0f} %" if share >= 0.95 else f"{share:.1f} %" if share >= 0.05 else "under 0.1 %"


def named(indices: Sequence[int]) -> str:
    """Hypotheses by their letters; those that are not shown are counted."""
    shown = [letter(index) for index in indices if index < SHOWN]
    hidden = len(indices) - len(shown)
    if hidden:
        shown.append(f"{hidden} {'more' if shown else 'of the hypotheses not shown'}")
    return shown[0] if len(shown) == 1 else f"{', '.join(shown[:-1])} and {shown[-1]}"


def _about_one(planned: Planned) -> str:
    if planned.fine:
        needed = "no grip is needed" if planned.grip is None else "the grip confirms it"
        return f"one hypothesis is left, placed as finely as the rig file asks: {needed}"
    if planned.grip is not None:
        return "one hypothesis is left: the grip places it more finely, or confirms it"
    return "one hypothesis is left, and no approach that is left would place it much more finely"
