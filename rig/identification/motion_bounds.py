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
from palpate.recognizer import Catalogue, Motion
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
_HIDDEN = 1.5  # times the noise's limit: a force above is noticed for certain


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

    `force_n` on the part; `work_mj` by the finger; `stored_mj` in its skin. `measured`: the period in which
    the contacts were measured.
    """

    force_n: Floats
    work_mj: Floats
    stored_mj: Floats
    measured: int


@dataclass(frozen=True, eq=False)
class MotionBounds:
    """Bounds motions of parts of a catalogue on a rig."""

    rig: RigFile
    catalogue: Catalogue

    @cached_property
    def supports(self) -> tuple[Support, ...]:
        """Of every state of the catalogue."""
        height_mm = max(finger.height_mm for finger in self.rig.fingers)
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
        return math.inf if loads is None else float(loads.force_n.sum(axis=0).max(initial=0.0))

    def of_grip(self, touches: Sequence[Touch]) -> GripMotion:
        """Bounds on what a grip moved."""
        loads = self._loads(touches)
        count = len(self.catalogue.states)
        slides = np.array([_slides_mm(support, loads) for support in self.supports]).reshape(count, 3)
        shift = np.array([support.shift for support in self.supports])
        turn = np.array([support.turn_rad_per_mm for support in self.supports])
        before, after, whole = (Motion(_times(slide, shift), _times(slide, turn)) for slide in slides.T)
        return GripMotion(before, after, whole)

    def _loads(self, touches: Sequence[Touch]) -> _Loads | None:
        """Loads of all fingers on one timeline; None if of one of them nothing is known."""
        traces = [touch.trace for touch in touches]
        known = [trace for trace in traces if trace is not None]
        if len(known) < len(traces) or not known:
            return None
        period_s = 1 / self.rig.closing.sample_rate_hz
        begin_s = min(float(trace.time_s[0]) for trace in known)
        periods = [np.floor((trace.time_s - begin_s) / period_s).astype(np.int64) for trace in known]
        count = max(int(index[-1]) for index in periods) + 1
        fingers = [self.rig.fingers[touch.finger_index] for touch in touches]
        rows = [
            _row(finger, trace, index, count, period_s)
            for finger, trace, index in zip(fingers, known, periods, strict=True)
        ]
        force, work, stored = (np.stack(column) for column in zip(*rows, strict=True))
        measured_s = [trace.measured_s for trace in known if math.isfinite(trace.measured_s)]
        measured = int((max(measured_s) - begin_s) / period_s) + 1 if measured_s else count
        return _Loads(force, work, stored, min(measured, count))


def _row(
    finger: FingerConfig, trace: LoadTrace, index: Ints, count: int, period_s: float
) -> tuple[Floats, Floats, Floats]:
    """Force, work and stored energy (count,) of one finger at most, in each period."""
    gain = 1 / (1 - measured_force_share(finger))
    tip = finger.tip
    soft = tip.stiffness_n_per_mm * (1 - tip.stiffness_spread)
    stiff = tip.stiffness_n_per_mm * (1 + tip.stiffness_spread)
    # Between two frames force grows.
    grown = np.where(trace.force_n > 0, stiff * trace.touch_mm_s * period_s, 0.0)
    normal = np.zeros(count)
    np.maximum.at(normal, index, gain * np.maximum(trace.force_n, _HIDDEN * trace.unnoticed_n) + grown)
    normal = _spread(_filled(normal, index))  # frames are older than they seem by up to a period
    advance = np.zeros(count)
    np.add.at(advance, index, trace.advance_mm)
    force = _OBLIQUE * normal
    return force, force * advance, _SHEARED * normal**2 / (2 * soft)


def _slides_mm(support: Support, loads: _Loads | None) -> tuple[float, float, float]:
    """Largest slide before the measurement, after it, and in all."""
    if math.isinf(support.holds_n):
        return 0.0, 0.0, 0.0
    if loads is None:
        return math.inf, math.inf, math.inf
    moving = loads.force_n.sum(axis=0) * support.leverage > support.holds_n
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
