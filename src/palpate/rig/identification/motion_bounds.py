"""Motion bounds of a grip: how far its touches can have moved the part, from measured loads.

See docs/motion-bounds.md. Nothing slides while the forces on the part are too small for
it; while they are not, friction at the table takes at least F for every mm of slide (`pushing_mechanics`),
so the slide is at most the work done on the part over F.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.config import FingerConfig, RigFile
from palpate.drivers.tactile import ContactPatch, PatchFlag
from palpate.recognizer import Catalogue, Contact, Hypotheses, Motion, Recognition
from palpate.rig.contact_peak import quickest_mm_s
from palpate.rig.conversion import SHEAR_SHARE, measured_force_share
from palpate.rig.identification.pushing_mechanics import MAX_TABLE_FRICTION, SupportTable, supports_of
from palpate.rig.motion.load_meter import HIDDEN_FACTOR, LoadTrace, friction_factor, tip_friction
from palpate.rig.motion.touch import Touch
from palpate.rig.motion.touch_timing import MEASURE_FRAMES

_ROUNDING_SHARE = 1e-9


@dataclass(frozen=True, eq=False)
class GripLoads:
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


def _slide_bounds_mm(table: SupportTable, loads: Sequence[GripLoads], leverages: Floats) -> Floats:
    """Largest slide of n states (n, 3) before the measurement, after it, and in all.

    `leverages` (n, g): of the contacts. Infinite where there are no `loads`, nothing for a part that is taken
    to lie still.
    """
    found = np.where(np.isinf(table.holds_n)[:, None], 0.0, np.full((len(table), 3), np.inf))
    left = np.flatnonzero(np.isfinite(table.holds_n))
    for item in loads:
        found[left] = _slides_under(table.select(left), item, leverages[left])
        left = left[found[left, 2] * table.leverage[left] > item.within_mm]
    return found


def _slides_under(table: SupportTable, loads: GripLoads, leverages: Floats) -> Floats:
    push_n = (loads.at_contact_n + loads.anywhere_n).sum(axis=0)
    # In all other periods, which are most, every part lies still.
    least_n = np.min(table.holds_n / (table.leverage + table.carried), initial=np.inf)
    periods = np.flatnonzero(push_n > least_n * (1 - _ROUNDING_SHARE))
    pushed = _Pushed(
        periods,
        _may_slide(table, loads, leverages, periods),
        loads.work_mj.sum(axis=0),
        loads.stored_mj.sum(axis=0),
    )
    count, measured = len(push_n), loads.measured
    before, after = pushed.dissipation_mj(0, measured), pushed.dissipation_mj(measured, count)
    whole = np.minimum(pushed.dissipation_mj(0, count), before + after)
    parts = np.stack([np.minimum(before, whole), np.minimum(after, whole), whole], axis=1)
    result: Floats = parts / table.holds_n[:, None]
    return result


def _may_slide(table: SupportTable, loads: GripLoads, leverages: Floats, periods: Ints) -> Bools:
    """Periods (p,) in which each state may slide, (n, p)."""
    at_contact, holds = loads.at_contact_n[:, periods], table.holds_n[:, None]
    elsewhere = loads.anywhere_n[:, periods].sum(axis=0)
    push = at_contact.sum(axis=0) + elsewhere
    pull = leverages @ at_contact + table.leverage[:, None] * elsewhere
    pull += push * table.carried[:, None] * np.minimum(push / holds, 1.0)
    result: Bools = pull > holds
    return result


@dataclass(frozen=True, eq=False)
class _Pushed:
    """States that may be `moving` (n, p) in some `periods` (p,), in order; of all periods (b,) what fingers
    do, `work_mj`, and what their skin has stored, `stored_mj`.
    """

    periods: Ints
    moving: Bools
    work_mj: Floats
    stored_mj: Floats

    def dissipation_mj(self, begin: int, end: int) -> Floats:
        """Most that friction at the table can have taken (n,) from one period to another.

        While the part may move: what fingers do, and what their skin has stored when it begins to. Where it
        may have stood in between, the least of what skin has stored then and what fingers have done since:
        any interval with all of the motion in it is a bound.
        """
        some = slice(*np.searchsorted(self.periods, [begin, end]))
        periods, moving = self.periods[some], self.moving[:, some]
        stored = self.stored_mj[np.maximum(periods - 1, 0)]
        done = np.append(0.0, np.cumsum(self.work_mj))
        last = np.maximum.accumulate(np.where(moving, periods + 1, 0), axis=1)  # 1: the first period
        before = np.column_stack([np.zeros(len(moving), dtype=np.int64), last[:, :-1]])
        again = np.where(before > 0, np.minimum(done[periods] - done[before], stored), stored)
        result: Floats = (moving * again).sum(axis=1) + moving @ self.work_mj[periods]
        return result


_LIFT_FACTOR = math.hypot(1.0, MAX_TABLE_FRICTION)
"""A ball may lift a part, so that it slides sooner: of what presses, this counts at most against its hold."""
_SAME_PLACE_MM = 1.0  # from where it was measured, a finger presses on the same place
_MAX_NUDGE_MM = 1.0  # by more a touch must not move what was known of the part, to count where it presses


@dataclass(frozen=True, eq=False)
class GripMotion:
    """Motion in a grip: `before` its contacts were measured, `after`, as fingers left, and `whole`.

    Infinite where there is no bound.
    """

    before: Motion
    after: Motion
    whole: Motion

    def within(self, states: Ints) -> tuple[float, float] | None:
        """Distance (mm, rad) by which a part in one of `states` (indices) was moved at most; None: any."""
        shift = float(self.whole.shift_mm[states].max())
        turn = float(self.whole.turn_rad[states].max())
        return (shift, turn) if math.isfinite(shift + turn) else None


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Bounds motions of parts of a catalogue on a rig."""

    rig: RigFile
    catalogue: Catalogue

    @cached_property
    def supports(self) -> SupportTable:
        """Support of every state of the catalogue."""
        height_mm = max(finger.span_mm[1] for finger in self.rig.fingers)
        return supports_of(self.catalogue, self.rig.search, height_mm)

    def holds_n(self, states: Ints) -> float | None:
        """Force that a part in one of `states` (indices) bears; None if that is not said of all of them."""
        holds = self.supports.holds_n[states]
        return None if np.isinf(holds).any() else float(holds.min())

    def touch_mm_s(self, states: Ints) -> float | None:
        """Speed at which to meet a part in one of `states` (indices) that has been found; None: any.

        The quickest at which its expected peak force does not move the part, if that is any.
        """
        holds = self.holds_n(states)
        if holds is None:
            return None
        sheared = max(friction_factor(tip_friction(finger.tip)) for finger in self.rig.fingers)
        return quickest_mm_s(self.rig, holds / (sheared * float(self.supports.leverage[states].max())))

    def peak_force_n(self, touches: Sequence[Touch]) -> float:
        """Largest force of the fingers of a grip together, at most; infinite if not known."""
        loads = self.loads(touches)
        if not loads:
            return math.inf
        return float((loads[0].at_contact_n + loads[0].anywhere_n).sum(axis=0).max(initial=0.0))

    def of_grip(
        self,
        touches: Sequence[Touch],
        recognition: Recognition | None = None,
        since: Motion | None = None,
        loads: Sequence[GripLoads] | None = None,
    ) -> GripMotion:
        """Bounds on what a grip moved.

        `recognition`: what was known of the part, `since`: how it may have moved from then to the grip;
        `loads`: those of the touches, if they are worked out already.
        """
        loads, table = self.loads(touches) if loads is None else loads, self.supports
        anywhere = np.repeat(table.leverage[:, None], len(touches), axis=1)
        if recognition is None:
            slides = _slide_bounds_mm(table, loads, anywhere)
        else:
            contacts = [touch.contact for touch in touches]
            slides = _slide_bounds_mm(table, loads, _leverages(table, contacts, recognition, since))
            nudged = np.flatnonzero(slides[:, 2] * table.leverage > _MAX_NUDGE_MM)
            slides[nudged] = _slide_bounds_mm(table.select(nudged), loads, anywhere[nudged])
        # A round part that is turned about its centre lies as before.
        round_ = [item.state.is_round for item in self.catalogue.states]
        turn = np.where(round_, 0.0, table.turn_rad_per_mm)
        before, after, whole = (
            Motion(_multiply_sliding(slide, table.shift), _multiply_sliding(slide, turn))
            for slide in slides.T
        )
        return GripMotion(before, after, whole)

    def loads(self, touches: Sequence[Touch]) -> list[GripLoads]:
        """Loads of all fingers on one timeline; for motions that are larger and larger, the last for any.

        Empty if nothing is known of one of them.
        """
        traces = [touch.trace for touch in touches]
        known = [trace for trace in traces if trace is not None]
        if len(known) < len(traces) or not known:
            return []
        unfelt = [_blind_factor(touch.patch, trace) for touch, trace in zip(touches, known, strict=True)]
        if math.inf in unfelt:
            return []
        period_s = 1 / self.rig.closing.sample_rate_hz
        begin_s = min(float(trace.time_s[0]) for trace in known)
        count = math.floor((max(float(trace.time_s[-1]) for trace in known) - begin_s) / period_s) + 1
        periods = [_Periods.of(trace, begin_s, period_s, count) for trace in known]
        fingers = [self.rig.fingers[touch.finger_index] for touch in touches]
        measured_s = [trace.measured_s for trace in known if math.isfinite(trace.measured_s)]
        measured = int((max(measured_s) - begin_s) / period_s) + 1 if measured_s else count
        found = []
        margins_mm = np.unique(np.concatenate([trace.free_within_mm for trace in known]))
        for within_mm in (*margins_mm[margins_mm > 0].tolist(), math.inf):
            rows = [
                _finger_loads(finger, trace, within_mm, of, period_s, factor)
                for finger, trace, of, factor in zip(fingers, known, periods, unfelt, strict=True)
            ]
            at_contact, anywhere, work, stored = (np.stack(column) for column in zip(*rows, strict=True))
            found.append(GripLoads(at_contact, anywhere, work, stored, min(measured, count), within_mm))
        return found


def _finger_loads(
    finger: FingerConfig,
    trace: LoadTrace,
    within_mm: float,
    periods: "_Periods",
    period_s: float,
    unfelt_factor: float,
) -> tuple[Floats, Floats, Floats, Floats]:
    """Force at the contact and anywhere, work and stored energy (b,) of one finger at most.

    As long as the part has moved by `within_mm` at most, and forces are up to `unfelt_factor` what is read.
    """
    gain = max(1 / (1 - measured_force_share(finger)), unfelt_factor)
    tip, friction = finger.tip, tip_friction(finger.tip)
    sheared = friction_factor(friction)
    lifted = 1.0 if tip.kind.is_upright else _LIFT_FACTOR
    soft = tip.stiffness_n_per_mm * (1 - tip.stiffness_spread)
    stiff = tip.stiffness_n_per_mm * (1 + tip.stiffness_spread)
    # Between two frames force grows.
    gap_s = np.diff(trace.time_s, prepend=-math.inf, append=math.inf)
    gap_s = np.where(np.isfinite(gap_s), np.maximum(gap_s, period_s), period_s)
    touch_mm_s = np.append(trace.touch_mm_s, trace.touch_mm_s[-1])
    advance = np.maximum(touch_mm_s * gap_s, [*trace.advance_mm, 0.0])
    grown = np.where(trace.force_n > 0, stiff * np.maximum(advance[:-1], advance[1:]), 0.0)
    there = np.zeros(len(trace.time_s), dtype=bool)
    if math.isfinite(trace.measured_s):
        late_s = trace.time_bound_s * np.array([[-1.0], [0.0], [1.0]])
        end_mm = np.interp(trace.measured_s, trace.time_s, trace.travel_mm)
        at_mm = np.interp(trace.time_s + late_s, trace.time_s, trace.travel_mm)
        there = (trace.force_n > 0) & (np.abs(at_mm - end_mm) < _SAME_PLACE_MM).all(axis=0)
    free = trace.free_within_mm >= within_mm  # there it touches nothing but what it feels
    doubt = trace.zero_doubt_n if math.isfinite(within_mm) else trace.any_zero_doubt_n
    hidden = np.where(free, 0.0, HIDDEN_FACTOR * trace.unnoticed_n)
    unsure = np.where(free & (trace.force_n == 0), 0.0, doubt)
    most = lifted * (gain * (np.maximum(trace.force_n, hidden) + unsure) + grown)
    swept = np.maximum(advance, np.maximum([*trace.retreat_mm, 0.0], [0.0, *trace.retreat_mm]))
    hooks = ~trace.quiet & (trace.dragging_n >= trace.force_n)
    pulled = np.where(hooks, stiff * np.maximum(swept[:-1], swept[1:]), 0.0)
    dragging = np.where(trace.quiet, np.maximum(trace.dragging_n, sheared * hidden), trace.dragging_n)
    dragging = lifted * (gain * (dragging + sheared * unsure) + sheared * pulled)
    at_contact, anywhere = (periods.largest(np.where(at, most, 0.0)) for at in (there, ~there))
    normal = np.maximum(at_contact, anywhere)
    work = sheared * normal * periods.ways_mm(trace.advance_mm)
    work += periods.largest(dragging) * periods.ways_mm(trace.retreat_mm)
    # Skin is pressed and sheared, and what carries the tip is bent.
    yields = (1 + friction**2 / SHEAR_SHARE) / soft + finger.bounds.deflection_mm_per_n * sheared**2
    return sheared * at_contact, sheared * anywhere, work, yields * normal**2 / 2


def _blind_factor(patch: ContactPatch | None, trace: LoadTrace) -> float:
    """Factor by which a finger may press harder than frames show, because taxels are left out there.

    By what the patch may bear at most, and by what frames showed when it was measured.
    """
    if patch is None or PatchFlag.DEAD_NEIGHBOUR not in patch.flags:
        return 1.0
    measured = int(np.searchsorted(trace.time_s, trace.measured_s))
    shown_n = float(trace.force_n[max(measured - MEASURE_FRAMES, 0) : measured].mean())
    return (patch.force_n + patch.force_bound_n) / shown_n if shown_n > 0 else math.inf


@dataclass(frozen=True, eq=False)
class _Periods:
    """Periods of time, `count` of them: those of which frames (f,) are.

    In those from `first` to `last` the force of a frame may have pressed while any finger did its work.
    """

    frames: Ints
    first: Ints
    last: Ints
    count: int

    @classmethod
    def of(cls, trace: LoadTrace, begin_s: float, period_s: float, count: int) -> Self:
        """Periods of a trace's frames. A force may last from just after the frame before to the next.

        Both may be off by the bound of a trace's times, and so may be those of another finger, beside whose
        work it counts; work is put where its way ended, up to a period after it was done.
        """
        bound_s = trace.time_bound_s * np.array([[0.0], [-1.0], [1.0], [-2.0], [2.0]])
        at = np.floor((trace.time_s + bound_s - begin_s) / period_s).astype(np.int64)
        frames, first, last, early, late = np.clip(at, 0, count - 1)
        first, last = np.append(first[:1], first[:-1]), np.append(last[1:], last[-1:])
        last = np.minimum(np.maximum(last, late) + 1, count - 1)
        return cls(frames, np.minimum(first, early), last, count)

    def ways_mm(self, way_mm: Floats) -> Floats:
        """Distance that a finger may have gone in each period, (b,), if so far (f,) since the last frame.

        Where frames are missing it may have gone all the way in any one of the periods between.
        """
        since = np.maximum(np.diff(self.frames, prepend=self.frames[0] - 1), 1)
        back = np.arange(since.sum()) - np.repeat(np.cumsum(since) - since, since)
        periods = np.maximum(np.repeat(self.frames, since) - back, 0)
        return np.bincount(periods, np.repeat(way_mm, since), minlength=self.count).astype(float)

    def largest(self, values: Floats) -> Floats:
        """The largest of the values (f,) of the frames whose force may have pressed in each period, (b,)."""
        most = np.zeros(self.count)
        for step in range(int((self.last - self.first).max()) + 1):
            np.maximum.at(most, np.minimum(self.first + step, self.last), values)
        before, after = self._nearest
        # Periods without a frame take the larger one of those on either side.
        result: Floats = np.where(
            np.arange(self.count) < self.first.min(), 0.0, np.maximum(most[before], most[after])
        )
        return result

    @cached_property
    def _nearest(self) -> tuple[Ints, Ints]:
        """The nearest periods of which frames may be, before and after each, (b,)."""
        every = np.arange(self.count)
        edges = np.bincount(self.first, minlength=self.count + 1)
        edges -= np.bincount(self.last + 1, minlength=self.count + 1)
        known = np.flatnonzero(np.cumsum(edges)[:-1])
        after = known[np.minimum(np.searchsorted(known, every), len(known) - 1)]
        return known[np.maximum(np.searchsorted(known, every, side="right") - 1, 0)], after


def _leverages(
    table: SupportTable, contacts: Sequence[Contact], recognition: Recognition, since: Motion | None
) -> Floats:
    """Leverage (S, g) of each finger's contact on a part in each state, as its hypotheses place it."""
    result = np.repeat(table.leverage[:, None], len(contacts), axis=1)
    touched = [(k, *_touched_point(contact)) for k, contact in enumerate(contacts) if contact.touched]
    hypotheses = recognition.hypotheses
    point, within = _centres(table, hypotheses)
    off = np.hypot(*(table.centre_mm - recognition.catalogue.origins_mm).T)
    drift_mm = (
        np.zeros(len(off)) if since is None else since.shift_mm + _multiply_sliding(off, since.turn_rad)
    )
    for k, at, unsure_mm in touched:
        furthest = np.full(len(off), -np.inf)
        np.maximum.at(furthest, hypotheses.state, np.hypot(*(at - point).T) + within)
        near = np.flatnonzero(np.isfinite(furthest) & np.isfinite(drift_mm))
        result[near, k] = table.leverage_at(near, furthest[near] + unsure_mm + drift_mm[near] + _MAX_NUDGE_MM)
    return result


def _centres(table: SupportTable, hypotheses: Hypotheses) -> tuple[Floats, Floats]:
    """Centres of mass of hypotheses (h, 2), within how many mm (h,)."""
    (x0, y0, t0), (x1, y1, t1) = hypotheses.lo.T, hypotheses.hi.T
    c, s = np.cos((t0 + t1) / 2), np.sin((t0 + t1) / 2)
    x, y = table.centre_mm[hypotheses.state].T
    at = np.column_stack([(x0 + x1) / 2 + c * x - s * y, (y0 + y1) / 2 + s * x + c * y])
    return at, np.hypot(x1 - x0, y1 - y0) / 2 + np.hypot(x, y) * (t1 - t0) / 2


def _touched_point(contact: Contact) -> tuple[Floats, float]:
    """Point that a tip touches (2,), within how many mm."""
    centre, radius = np.array(contact.end_mm), contact.finger.tip_radius_mm
    if contact.normal is None:
        return centre, radius + contact.position_bound_mm
    # By which of its circles is not known.
    least = contact.finger.tip.least_share * radius
    radius, unsure = (radius + least) / 2, (radius - least) / 2
    middle = (contact.normal.lo_rad + contact.normal.hi_rad) / 2
    half = (contact.normal.hi_rad - contact.normal.lo_rad) / 2
    at: Floats = centre - radius * np.array([math.cos(middle), math.sin(middle)])
    return at, radius * half + unsure + contact.position_bound_mm


def _multiply_sliding(slide: Floats, per_mm: Floats) -> Floats:
    """Products; nothing for states that do not slide (a state that lies still has no factor)."""
    result: Floats = np.zeros_like(slide)
    np.multiply(slide, per_mm, out=result, where=slide > 0)
    return result
