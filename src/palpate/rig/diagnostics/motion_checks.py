"""Checks of the force at which a part slides, for which fingers move, and of the force of touches.

First each finger finds the part by a light touch; then each pushes towards the estimated middle. A
single push on a part that does not accelerate cannot exceed F = μ m g, wherever and however obliquely the
part is pushed: an off-centre push turns it at a smaller force. So every force that certainly acted is a
lower bound of F, also while the part slides, and the greatest of them is the best one.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.config import RigFile
from palpate.config.diagnosis_results import Cause, FindingOut, FingerHoldOut, HoldCheckOut, TouchForceOut
from palpate.drivers.tactile import ContactPatch
from palpate.recognizer import FingerApproach, approach_lines, offset_from_lines
from palpate.rig.contact_peak import expected_peak_n, unstopped_peak_n, unstopped_peaks_n
from palpate.rig.diagnostics.readings import Readings
from palpate.rig.diagnostics.steps import (
    DiagnosisCase,
    Judgement,
    NamedDevice,
    warning,
    wrong,
)
from palpate.rig.identification.accuracy import check_accuracy
from palpate.rig.identification.exploration import (
    InscribedDisc,
    exploring_grip,
    fast_to_workspace,
    sweeping_grip,
    unswept_places,
)
from palpate.rig.motion.creep import SlipPush, SlipPusher
from palpate.rig.motion.guarded_approach import Measure, carry_out_grip
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.load_meter import TouchStage
from palpate.rig.motion.touch import Touch, may_touch_two_edges
from palpate.rig.reach.approaches import Reach, reach_of

_MAX_SEARCH_MM_S = 8.0
_MAX_TOUCH_MM_S = 2.0
_MIN_CONTACT_N = 0.05
_NOISE_MARGIN = 1.5  # times the least threshold that noise lets arrays have
_MAX_PUSH_N = 3.0
_MAX_PUSH_SHARE = 0.5  # of max_force_n
_AIM_COUNT = 81
_MIN_DISC_RADIUS_MM = 10.0  # radius of a disc that the part has room for: a smaller one may be missed
_READ_S = 0.02  # between two looks at the servos while nothing is touched


def with_light_touch(rig: RigFile, quietest_n: float) -> RigFile:
    """The rig with lighter touches; `quietest_n`: as `quietest_force_n` gave it."""
    closing = rig.closing
    contact_n = min(closing.contact_force_n, max(_MIN_CONTACT_N, _NOISE_MARGIN * quietest_n))
    light = closing.model_copy(
        update={
            "search_speed_mm_s": min(closing.search_mm_s, _MAX_SEARCH_MM_S),
            "touch_speed_mm_s": min(closing.touch_speed_mm_s, _MAX_TOUCH_MM_S),
            "contact_force_n": contact_n,
        }
    )
    return rig.model_copy(update={"closing": light})


def least_threshold_n(hand: Hand) -> float:
    """Tare all arrays; the least threshold (N) that the noise of none of them exceeds. Nothing moves.

    The hand must be prepared.
    """
    hand.tare()
    hand.stop_arrays()
    return max(finger.extractor.least_force_n for finger in hand.fingers)


def check_hold(hand: Hand, tell: Callable[[str], None] = lambda _: None) -> HoldCheckOut:
    """Find the part and push it with every finger. The hand must be prepared, its rig `gentle`.

    Raises InputError if nothing is found, or no finger can tell anything for certain, as balls and pads
    cannot; DeviceError and SafetyStop as `carry_out_grip`.
    """
    hand.rig.require("check what parts hold")
    reach = reach_of(hand.rig, aims=_AIM_COUNT)
    tell("looking for the part")
    touches = _locate_part(hand, reach)
    moved_mm = sum(_slide_mm(hand.rig, touch, TouchStage.QUICK) for touch in touches)
    largest_n = min(_MAX_PUSH_N, _MAX_PUSH_SHARE * hand.rig.closing.max_force_n)
    fingers = []
    for index, finger in enumerate(hand.fingers):
        tell(f"pushing with finger {finger.name}")
        pusher = SlipPusher(largest_n)
        touch = _touch(hand, _nearest(reach, index, _part_middle(touches)), pusher.push_until_slip)
        touches.append(touch)
        fingers += [_push_result(hand.rig, push, touch) for push in pusher.pushes[-1:]]
    certain = [item.holds_n for item in fingers if item.holds_n is not None]
    slid = [item.holds_n for item in fingers if item.holds_n is not None and item.slid]
    if not certain:
        raise InputError(
            "no finger could push the part so that a force was certain: put it nearer to the middle, turned "
            "so that fingers do not meet it in a notch, and check again"
        )
    return HoldCheckOut(
        part_holds_n=round_down(max(certain)),
        least_n=round_down(min(slid or certain)),
        slid=bool(slid),
        largest_n=largest_n,
        moved_mm=moved_mm + sum(item.moved_mm for item in fingers),
        fingers=tuple(fingers),
    )


def _certain_force_n(patch: ContactPatch) -> float | None:
    """Force (N) with which a tip certainly pressed on the part; None if nothing is certain.

    Taxels' forces do not all point the same way: over an extent of 2 h a load that is greatest in the middle
    leaves sin(h) / h of their sum, at least. In a notch forces may cancel. Friction at the tip only adds to
    what taxels measure.
    """
    if may_touch_two_edges(patch):
        return None
    least = (patch.force_n - patch.force_bound_n) * float(np.sinc(patch.extent_rad / 2 / math.pi))
    return least if least > 0 else None


def judge_hold(rig: RigFile, found: HoldCheckOut) -> Judgement:
    """Judge what a part held beside what the rig file declares."""
    declared, findings = rig.search.part_holds_n, []
    if declared is not None and found.slid and declared > found.part_holds_n:
        findings.append(
            warning(
                Cause.PART_SLIDES,
                NamedDevice("the rig file"),
                f"it declares part_holds_n = {declared:g} N, and this part was only certain to hold "
                f"{found.part_holds_n:g} N",
                "parts may move under touches that are taken for harmless",
                f"write part_holds_n = {found.part_holds_n:g} below [search] in the rig file",
            )
        )
    return f"it held {found.part_holds_n:g} N at least", findings


def expect_touch_force(rig: RigFile) -> TouchForceOut:
    """Expected peak forces of touches."""
    return TouchForceOut(
        quick_n=expected_peak_n(rig, rig.closing.search_mm_s),
        slow_n=expected_peak_n(rig, rig.closing.touch_speed_mm_s),
        unstopped_n=unstopped_peak_n(rig),
    )


def judge_touch_force(case: DiagnosisCase, readings: Readings) -> Judgement:
    """Touches that are harder than parts are said to bear, or so hard that the run may end by them."""
    expected = readings.touch_force
    saw = f"{expected.quick_n:.2g} N when a part is found, {expected.slow_n:.2g} N when it is measured"
    found = (_harder_than_held(case.rig, expected), _harder_than_allowed(case.rig, expected))
    known = _known_too_little(case.rig)
    return saw, [*(item for item in (*found, known) if item is not None), *_harder_than_borne(case.rig)]


def _known_too_little(rig: RigFile) -> FindingOut | None:
    """Bounds with which a run is refused, as before a calibration."""
    try:
        check_accuracy(rig, None)
    except InputError as error:
        saw, _, rest = str(error).partition(": ")[2].partition(": ")
        means, _, do = rest.partition("; ")
        return warning(Cause.BOUNDS_MISSING, NamedDevice("the rig file"), saw, means, do)
    return None


def _harder_than_borne(rig: RigFile) -> list[FindingOut]:
    """Fingers that would break something if the bus or the program were gone."""
    means = "once its bus or its program is gone nothing stops it: what it presses with may break it"
    findings = []
    for finger in rig.fingers:
        for peak_n, stall_n in unstopped_peaks_n(rig, finger):
            borne = finger.tip.bears_n or math.inf
            if peak_n > min(borne, stall_n):
                what = "tip.bears_n" if borne <= stall_n else "the stall torque of its servo"
                saw = f"unstopped it presses with up to {peak_n:.2g} N; {what} is {min(borne, stall_n):.2g} N"
                do = "lower approach_speed_mm_s or max_force_n"
                device = NamedDevice(f"finger {finger.name}")
                findings.append(wrong(Cause.TOUCH_TOO_HARD, device, saw, means, do))
    return findings


def _harder_than_held(rig: RigFile, expected: TouchForceOut) -> FindingOut | None:
    """A touch that measures the part and may move it; where it lay when it was found, nothing depends on."""
    holds = rig.search.part_holds_n
    if holds is None or expected.slow_n <= holds:
        return None
    saw = f"a touch that measures a part is expected to press with {expected.slow_n:.2g} N"
    means = f"a part may slide above part_holds_n = {holds:g} N"
    return _too_hard(saw, means, "lower touch_speed_mm_s or contact_force_n")


def _harder_than_allowed(rig: RigFile, expected: TouchForceOut) -> FindingOut | None:
    most, quick_n = rig.closing.max_force_n, expected.quick_n
    remedy = "lower search_speed_mm_s or contact_force_n, or raise max_force_n"
    limit = f"above max_force_n = {most:g} N, and would end the run"
    if quick_n > most:
        saw = f"a touch that finds a part is expected to press with {quick_n:.2g} N, {limit}"
        return wrong(
            Cause.TOUCH_TOO_HARD, NamedDevice("touches"), saw, "arrays stop a run at max_force_n", remedy
        )
    hit = [finger for finger in rig.fingers if finger.tip.kind.corners_at_once * quick_n > most]
    if not hit:
        return None
    names, kind = ", ".join(finger.name for finger in hit), hit[0].tip.kind
    saw = (
        f"{names}: a {kind.noun} may meet {kind.corners_at_once} corners at once, each with {quick_n:.2g} N "
        f"when it finds a part; {kind.corners_at_once * quick_n:.2g} N is {limit}"
    )
    return _too_hard(saw, "arrays stop a run at max_force_n", remedy)


def _too_hard(saw: str, means: str, do: str) -> FindingOut:
    return warning(Cause.TOUCH_TOO_HARD, NamedDevice("touches"), saw, means, do)


def _locate_part(hand: Hand, reach: Reach) -> list[Touch]:
    """Light touches until the part is found, and one of each other finger; InputError if it is not found."""
    touches: list[Touch] = []
    while not _has_met(touches):
        approach = _next_search(reach, touches, hand.rig)
        if approach is None:
            raise InputError(
                f"no part was found that is {2 * _MIN_DISC_RADIUS_MM:g} mm wide and bears a touch of "
                f"{hand.rig.closing.contact_force_n:.2g} N: put one near the middle, or a heavier one"
            )
        touches.append(_touch(hand, approach, None))
    first = touches[-1].finger_index
    for index in range(len(hand.fingers)):
        if index != first:
            touches.append(_touch(hand, _nearest(reach, index, _part_middle(touches)), None))
    return touches


def _has_met(touches: Sequence[Touch]) -> bool:
    return any(touch.contact.touched for touch in touches)


def _next_search(reach: Reach, misses: Sequence[Touch], rig: RigFile) -> FingerApproach | None:
    """The next way on which to look for the part, by fingers in turns; None once it is nowhere."""
    contacts = [touch.contact for touch in misses]
    if len(misses) < len(rig.fingers):
        grip = exploring_grip(reach, contacts)
    else:
        discs = {
            finger.span_mm: InscribedDisc(_MIN_DISC_RADIUS_MM, frozenset((0,))) for finger in rig.fingers
        }
        left = unswept_places(contacts, discs, rig.workspace.radius_mm)
        grip = sweeping_grip(reach, contacts, left, discs)
    own = [item for item in grip if item.finger_index == len(misses) % len(rig.fingers)]
    return next(iter(own or grip), None)


def _part_middle(touches: Sequence[Touch]) -> Floats:
    """Mean (2,) of where the part was touched."""
    points = []
    for contact in (touch.contact for touch in touches):
        if contact.touched:
            angle = contact.middle_normal_rad
            inward = np.array([math.cos(angle), math.sin(angle)])
            points.append(np.array(contact.end_mm) - contact.finger.tip_radius_mm * inward)
    middle: Floats = np.mean(points, axis=0)
    return middle


def _nearest(reach: Reach, finger_index: int, target: Floats) -> FingerApproach:
    """A finger's approach that passes nearest to a point."""
    own = reach.of_finger(finger_index, reach.middle_rad)
    start, angle = approach_lines([reach.approaches[k] for k in own])
    return reach.approaches[own[int(np.argmin(np.abs(offset_from_lines(start, angle, target))))]]


def _touch(hand: Hand, approach: FingerApproach, measure: Measure | None) -> Touch:
    """One finger's touch, slow from where the part may be."""
    way = fast_to_workspace(approach, hand.rig.workspace.radius_mm)
    (touch,) = carry_out_grip(hand, [way], lambda _: None, measure)
    return touch


def _push_result(rig: RigFile, push: SlipPush, touch: Touch) -> FingerHoldOut:
    """Result of a finger's push, which ended its touch."""
    moved_mm = _slide_mm(rig, touch, TouchStage.QUICK)
    if push.slid:
        moved_mm += _slide_mm(rig, touch, TouchStage.SLOW)
    return FingerHoldOut(
        finger=push.finger.name,
        slid=push.slid,
        pressed_n=0.0 if push.patch is None else push.patch.force_n,
        holds_n=None if push.patch is None else _certain_force_n(push.patch),
        moved_mm=moved_mm,
    )


def _slide_mm(rig: RigFile, touch: Touch, stage: TouchStage) -> float:
    """About how far a touch has moved the touched place: travel in contact, less the skin's dent."""
    stiffness = rig.fingers[touch.finger_index].tip.stiffness_n_per_mm
    loads = [load for load in touch.loads if load.stage is stage]
    return sum(max(load.travel_mm - load.peak_force_n / stiffness, 0.0) for load in loads)


def round_down(value: float) -> float:
    """A positive force, rounded down to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.floor(value / step * (1 + 1e-12)) * step:.2g}")
