"""Motion bounds of a grip: how far its touches can have moved the part, from the loads that were measured.

See docs/recogniser.md, "A part that moves". Nothing slides while the forces on the part are too small for it;
while they are not, friction at the table takes at least F for every mm of slide (`support`), so the slide is
at most the work done on the part over F.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.config import FingerConfig, RigFile
from palpate.geometry import Bools, Floats, Ints
from palpate.recognizer import Catalogue, Contact, Hypothesis, Motion, Recognition
from palpate.rig.contact_peak import expected_peak_n
from palpate.rig.conversion import measured_force_share
from palpate.rig.identification.support import Support, supports_of
from palpate.rig.motion.contact_from_touch import Touch
from palpate.rig.motion.contact_load import LoadTrace

__all__ = ["GripMotion", "MotionBounds"]

_TIP_FRICTION = 0.7
_SHEAR_STIFFNESS_SHARE = 0.7
_OBLIQUE = math.hypot(1.0, _TIP_FRICTION)
"""Arrays measure what presses, not what shears: with that friction a force is larger by this factor."""
_SHEARED = 1 + _TIP_FRICTION**2 / _SHEAR_STIFFNESS_SHARE
"""Elastic energy of skin that is pressed and sheared, over that of skin that is pressed."""
_THERE_MM = 1.0  # from where it was measured, a finger presses on the same place
_NUDGED_MM = 1.0  # by more a touch must not move what was known of the part, to count where it presses
_HIDDEN = 1.5  # times the noise's limit: three standard deviations more, and a force is noticed


@dataclass(frozen=True, eq=False)
class GripMotion:
    """What a grip may have moved: `before` its contacts were measured, `after`, as fingers left, and `whole`.

    Infinite where there is no bound.
    """

    before: Motion
    after: Motion
    whole: Motion

    def within(self, states: Ints) -> tuple[float, float] | None:
        """How far (mm, rad) a part in one of `states` (indices) was moved at most; None: any distance."""
        shift = float(self.whole.shift_mm[states].max())
        turn = float(self.whole.turn_rad[states].max())
        return (shift, turn) if math.isfinite(shift + turn) else None


@dataclass(frozen=True, eq=False)
class _Loads:
    """Upper bounds on what g fingers did in b periods of time, one after the other; all (g, b).

    `at_contact_n`: force where its contact was measured; `anywhere_n`: elsewhere; `work_mj` by the finger;
    `stored_mj` in its skin. `measured`: the period in which the contacts were measured. All of that holds as
    long as the part has moved by `within_mm` at most: further, ways that were free may no longer be.
    """

    at_contact_n: Floats
    anywhere_n: Floats
    work_mj: Floats
    stored_mj: Floats
    measured: int
    within_mm: float


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Bounds motions of parts of a catalogue on a rig."""

    rig: RigFile
    catalogue: Catalogue

    @cached_property
    def supports(self) -> tuple[Support, ...]:
        """Of every state of the catalogue."""
        height_mm = max(finger.span_mm[1] for finger in self.rig.fingers)
        return supports_of(self.catalogue, self.rig.search, height_mm)

    def holds_n(self, states: Ints) -> float | None:
        """What a part in one of `states` (indices) bears; None if that is not said of all of them."""
        least = min(self.supports[state].holds_n for state in states.tolist())
        undeclared = any(math.isinf(self.supports[state].holds_n) for state in states.tolist())
        return None if undeclared else least

    def touch_mm_s(self, states: Ints) -> float | None:
        """Speed at which to meet a part in one of `states` (indices) that has been found; None: any.

        The rig's slow one, but for a part that the rig's search does not move.
        """
        holds = self.holds_n(states)
        if holds is None:
            return None
        peak = _OBLIQUE * expected_peak_n(self.rig, self.rig.closing.search_mm_s)
        leverage = max(self.supports[state].leverage for state in states.tolist())
        return self.rig.closing.touch_speed_mm_s if peak * leverage > holds else None

    def peak_force_n(self, touches: Sequence[Touch]) -> float:
        """Largest force of the fingers of a grip together, at most; infinite if not known."""
        loads = self._loads(touches)
        if not loads:
            return math.inf
        return float((loads[0].at_contact_n + loads[0].anywhere_n).sum(axis=0).max(initial=0.0))

    def of_grip(
        self,
        touches: Sequence[Touch],
        recognition: Recognition | None = None,
        since: Motion | None = None,
    ) -> GripMotion:
        """Bounds on what a grip moved.

        `recognition`: what was known of the part, `since`: how it may have moved from then to the grip.
        """
        loads, count = self._loads(touches), len(self.catalogue.states)
        contacts = [touch.contact for touch in touches]
        since = since or Motion.none(self.catalogue)
        slides = np.zeros((count, 3))
        for row, support in enumerate(self.supports):
            leverages = np.full(len(touches), support.leverage)
            if recognition is not None and math.isfinite(support.holds_n + since.shift_mm[row]):
                near = _leverages(support, row, contacts, recognition, since)
                slides[row] = _slides_mm(support, loads, near)
                if slides[row, 2] * support.leverage <= _NUDGED_MM:
                    continue
            slides[row] = _slides_mm(support, loads, leverages)
        shift = np.array([support.shift for support in self.supports])
        # A round part that is turned about its centre lies as before.
        round_ = [item.state.is_round for item in self.catalogue.states]
        turn = np.where(round_, 0.0, [support.turn_rad_per_mm for support in self.supports])
        before, after, whole = (Motion(_times(slide, shift), _times(slide, turn)) for slide in slides.T)
        return GripMotion(before, after, whole)

    def _loads(self, touches: Sequence[Touch]) -> list[_Loads]:
        """Loads of all fingers on one timeline; for motions that are larger and larger, the last for any.

        Empty if nothing is known of one of them.
        """
        traces = [touch.trace for touch in touches]
        known = [trace for trace in traces if trace is not None]
        if len(known) < len(traces) or not known:
            return []
        period_s = 1 / self.rig.closing.sample_rate_hz
        begin_s = min(float(trace.time_s[0]) for trace in known)
        periods = [np.floor((trace.time_s - begin_s) / period_s).astype(np.int64) for trace in known]
        count = max(int(index[-1]) for index in periods) + 1
        fingers = [self.rig.fingers[touch.finger_index] for touch in touches]
        measured_s = [trace.measured_s for trace in known if math.isfinite(trace.measured_s)]
        measured = int((max(measured_s) - begin_s) / period_s) + 1 if measured_s else count
        found = []
        margins_mm = np.unique(np.concatenate([trace.free_within_mm for trace in known]))
        for within_mm in (*margins_mm[margins_mm > 0].tolist(), math.inf):
            rows = [
                _row(finger, trace, within_mm, index, count, period_s)
                for finger, trace, index in zip(fingers, known, periods, strict=True)
            ]
            at_contact, anywhere, work, stored = (np.stack(column) for column in zip(*rows, strict=True))
            found.append(_Loads(at_contact, anywhere, work, stored, min(measured, count), within_mm))
        return found


def _row(
    finger: FingerConfig, trace: LoadTrace, within_mm: float, index: Ints, count: int, period_s: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Force at the contact and anywhere, work and stored energy (count,) of one finger at most.

    As long as the part has moved by `within_mm` at most.
    """
    gain = 1 / (1 - measured_force_share(finger))
    tip = finger.tip
    soft = tip.stiffness_n_per_mm * (1 - tip.stiffness_spread)
    stiff = tip.stiffness_n_per_mm * (1 + tip.stiffness_spread)
    # Between two frames force grows.
    grown = np.where(trace.force_n > 0, stiff * trace.touch_mm_s * period_s, 0.0)
    there = np.zeros(len(trace.time_s), dtype=bool)
    if math.isfinite(trace.measured_s):
        end_mm = np.interp(trace.measured_s, trace.time_s, trace.travel_mm)
        there = (trace.force_n > 0) & (np.abs(trace.travel_mm - end_mm) < _THERE_MM)
    free = trace.free_within_mm >= within_mm  # there it touches nothing but what it feels
    doubt = trace.zero_doubt_n if math.isfinite(within_mm) else trace.any_zero_doubt_n
    hidden = np.where(free, 0.0, _HIDDEN * trace.unnoticed_n)
    unsure = np.where(free & (trace.force_n == 0), 0.0, doubt)
    most = gain * (np.maximum(trace.force_n, hidden) + unsure) + grown
    at_contact, anywhere = (_by_period(np.where(at, most, 0.0), index, count) for at in (there, ~there))
    normal = np.maximum(at_contact, anywhere)
    advance = np.zeros(count)
    np.add.at(advance, index, trace.advance_mm)
    work = _OBLIQUE * normal * advance
    return _OBLIQUE * at_contact, _OBLIQUE * anywhere, work, _SHEARED * normal**2 / (2 * soft)


def _by_period(values: Floats, index: Ints, count: int) -> Floats:
    """The largest of each period's frames and its neighbours': frames may be older by a period."""
    result = np.zeros(count)
    np.maximum.at(result, index, values)
    return _spread(_filled(result, index))


def _leverages(
    support: Support, row: int, contacts: Sequence[Contact], recognition: Recognition, since: Motion
) -> Floats:
    """Leverage (g,) of each finger's contact on a part in state `row`, which is one of the hypotheses."""
    result = np.full(len(contacts), support.leverage)
    centres = [_centre(support, item) for item in recognition.hypotheses if item.state_index == row]
    for k, contact in enumerate(contacts):
        if contact.touched and centres:
            point, unsure_mm = _touched_point(contact)
            furthest = max(float(np.hypot(*(point - at))) + within for at, within in centres)
            off = float(np.hypot(*(support.centre_mm - recognition.catalogue.origins_mm[row])))
            drift_mm = float(since.shift_mm[row] + since.turn_rad[row] * off)
            result[k] = support.leverage_at(furthest + unsure_mm + drift_mm + _NUDGED_MM)
    return result


def _centre(support: Support, hypothesis: Hypothesis) -> tuple[Floats, float]:
    """Where the centre of mass is (2,), within how many mm."""
    bounds = hypothesis.search_bounds
    (x0, x1), (y0, y1), (t0, t1) = bounds.x_mm, bounds.y_mm, bounds.theta_rad
    theta = (t0 + t1) / 2
    c, s = math.cos(theta), math.sin(theta)
    x, y = support.centre_mm.tolist()
    at = np.array([(x0 + x1) / 2 + c * x - s * y, (y0 + y1) / 2 + s * x + c * y])
    return at, math.hypot(x1 - x0, y1 - y0) / 2 + math.hypot(x, y) * (t1 - t0) / 2


def _touched_point(contact: Contact) -> tuple[Floats, float]:
    """Where a tip touches (2,), within how many mm."""
    centre, radius = np.array(contact.end_mm), contact.finger.tip_radius_mm
    if contact.normal is None:
        return centre, radius + contact.position_bound_mm
    middle = (contact.normal.lo_rad + contact.normal.hi_rad) / 2
    half = (contact.normal.hi_rad - contact.normal.lo_rad) / 2
    at: Floats = centre - radius * np.array([math.cos(middle), math.sin(middle)])
    return at, radius * half + contact.position_bound_mm


def _slides_mm(support: Support, loads: Sequence[_Loads], leverages: Floats) -> tuple[float, float, float]:
    """Largest slide before the measurement, after it, and in all; `leverages` (g,): of the contacts."""
    if math.isinf(support.holds_n):
        return 0.0, 0.0, 0.0
    found = math.inf, math.inf, math.inf
    for item in loads:
        found = _slides_under(support, item, leverages)
        if found[2] * support.leverage <= item.within_mm:
            break
    return found


def _slides_under(support: Support, loads: _Loads, leverages: Floats) -> tuple[float, float, float]:
    elsewhere = loads.anywhere_n.sum(axis=0)
    push = loads.at_contact_n.sum(axis=0) + elsewhere
    pull = leverages @ loads.at_contact_n + support.leverage * elsewhere
    pull += push * support.carried * np.minimum(push / support.holds_n, 1.0)
    moving = pull > support.holds_n
    count, measured = len(moving), loads.measured
    before = _dissipated_mj(loads, moving, 0, measured)
    after = _dissipated_mj(loads, moving, measured, count)
    whole = min(_dissipated_mj(loads, moving, 0, count), before + after)
    holds = support.holds_n
    return min(before, whole) / holds, min(after, whole) / holds, whole / holds


def _dissipated_mj(loads: _Loads, moving: Bools, begin: int, end: int) -> float:
    """Most that friction at the table can have taken in some periods.

    While the part may move: what the fingers do, and what their skin has stored when it begins to.
    """
    going = moving[begin:end]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], going, [False]]).astype(np.int8)))
    total = 0.0
    for first, last in zip(begin + edges[::2], begin + edges[1::2], strict=True):
        total += float(loads.stored_mj[:, max(first - 1, 0)].sum())
        total += float(loads.work_mj[:, first:last].sum())
    return total


def _filled(values: Floats, index: Ints) -> Floats:
    """Periods without a frame take the larger one of those on either side."""
    known = np.unique(index)
    every = np.arange(len(values))
    after = np.minimum(np.searchsorted(known, every), len(known) - 1)
    before = np.maximum(np.searchsorted(known, every, side="right") - 1, 0)
    result: Floats = np.maximum(values[known[before]], values[known[after]])
    return np.where(every < known[0], 0.0, result)


def _spread(values: Floats) -> Floats:
    """The largest of each period and its neighbours."""
    padded = np.concatenate([[0.0], values, [0.0]])
    result: Floats = np.maximum(np.maximum(padded[:-2], padded[2:]), values)
    return result


def _times(slide: Floats, per_mm: Floats) -> Floats:
    """Products; nothing for states that do not slide (a state that lies still has no factor)."""
    result: Floats = np.zeros_like(slide)
    np.multiply(slide, per_mm, out=result, where=slide > 0)
    return result
