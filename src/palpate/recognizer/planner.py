"""Planner of the next grip (memo §3.2, third strategy): reachable touches that distinguish hypotheses best.

Every hypothesis is represented by
some configurations of its region. Two of them need distinguishing if they are of different hypotheses, or
further apart than is fine enough. How likely each approach is to tell two poses apart follows from what
touches would come to at both (`touch_outcomes`).
Fingers are added one by one, as long as each takes away a good share of what would still be confused. What
the grip then promises is not taken from these samples, but from enclosures over whole regions (`grips`).
"""

from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.grips import (
    Grip,
    PredictedApproach,
    Reachable,
    fits_together,
    make_grip,
    predict_approach,
)
from palpate.recognizer.measurement_model import Resolution, TouchOutcomes, similarity, touch_outcomes
from palpate.recognizer.poses import Goals, pairs_to_distinguish, sampled_poses
from palpate.recognizer.push_limits import PushLimits, push_hazard
from palpate.recognizer.recognition import Recognition

__all__ = ["meets_other_side", "plan_grip"]

_HOPELESS = 1e-3  # the first finger must take at least this share of confusion away
_WORTH = 0.08  # and every further one this
_ENOUGH = 0.1  # where less is confused, no further finger is worth its touch
_ALIKE = 0.02  # plans this near to the best are as good: the quickest of them is taken
_CAUTION = 0.2  # a plan may leave this share more, times the hazard that it saves
_SHORT, _LISTED = 250_000, 20  # where there is more to compare, only the most promising candidates are
_SETTLED = 1e-9  # confused weight of a pair that need not be looked at any more
_TWO_SIDES_RAD = np.radians(30.0)
_MARGIN_MM = 10.0  # beyond the furthest stop of the sampled poses, until more is known


def plan_grip(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    goals: Goals,
    used: Bools | None = None,
    fingers: int = 1,
    limits: PushLimits | None = None,
) -> Grip | None:
    """Choose approaches, at most one for each finger, that leave the least confusion; None if none helps.

    As many as `fingers`, where that many go together, and more if they are worth it. `used` (n,): candidates
    not to choose, because they were carried out before. `limits`: what pushes may do to the part; approaches
    that cannot move it, or only slide it, are preferred.
    """
    choice = _GripSearch(recognition, reachable, resolution, goals, limits)
    if used is not None:
        choice.open_to &= ~used
    while choice.wants_more(fingers):
        best = choice.best(fingers)
        if best is None:
            break
        choice.take(*best)
    if not choice.chosen:
        return None
    return make_grip(recognition, reachable, choice.chosen, resolution, choice.remaining)


class _GripSearch:
    """A grip in the making; at first nothing is chosen, and what all poses miss is of no use.

    `open_to` (n,): candidates that may still join it; `furthest` (n,) mm: how far each goes; `hazard` (n,):
    of moving the part (`push_hazard`); `confused` (pairs,): the weight of pairs of poses that are still
    indistinguishable, `remaining` together; `compared`: number of pairs at first.
    """

    def __init__(
        self,
        recognition: Recognition,
        reachable: Reachable,
        resolution: Resolution,
        goals: Goals,
        limits: PushLimits | None,
    ) -> None:
        self.recognition, self.reachable, self.resolution = recognition, reachable, resolution
        self.poses = sampled_poses(recognition.hypotheses)
        self.pairs = pairs_to_distinguish(self.poses, recognition.hypotheses, goals)
        poses = self.poses.cells
        self.outcome = touch_outcomes(
            recognition.catalogue, poses, recognition.anchor_mm, reachable.approaches
        )
        self.open_to: Bools = np.asarray(self.outcome.hit.any(axis=1))
        met = np.where(self.outcome.hit, self.outcome.travel, 0.0)
        self.furthest: Floats = met.max(axis=1, initial=0.0) + _MARGIN_MM
        self.seconds = reachable.seconds(self.furthest)
        self.hazard: Floats = np.zeros(len(self.open_to))
        if limits is not None:
            self.hazard = push_hazard(
                limits, reachable.approaches, self.poses, recognition.anchor_mm, self.outcome
            )
        self.confused, self.compared = self.pairs.weight, len(self.pairs.first)
        self.remaining = 1.0
        self.chosen: list[PredictedApproach] = []

    def wants_more(self, fingers: int) -> bool:
        """Whether a further approach could be of use."""
        enough = self.remaining <= _ENOUGH and len(self.chosen) >= fingers
        return bool(self.open_to.any()) and len(self.pairs.first) > 0 and not enough

    def best(self, fingers: int) -> tuple[int, Floats, float] | None:
        """Approach to add, similarity (n,) of pairs under it, and what would remain; None if none pays."""
        taken = [item.index for item in self.chosen]
        rows = _shortlist(
            np.flatnonzero(self.open_to),
            self.outcome,
            self.poses.weight,
            taken,
            self.resolution,
            self.compared,
        )
        wanted = len(self.chosen) < fingers
        sides = meets_other_side(self.outcome.normal[:, 0], rows, taken)
        if wanted and sides.any():
            rows = rows[sides]
        alike = similarity(self.outcome, self.pairs.first, self.pairs.second, self.resolution, rows)
        scores = alike @ self.confused
        least = float(scores.min())
        worth = (0.0 if wanted else _WORTH) if self.chosen else _HOPELESS
        if least > self.remaining - worth:
            return None
        weighed = scores + _CAUTION * self.remaining * self.hazard[rows]
        good = np.flatnonzero(weighed <= weighed.min() + _ALIKE * self.remaining)
        row = good[np.argmin(self.seconds[rows[good]])]
        return int(rows[row]), alike[row], float(scores[row])

    def take(self, index: int, alike: Floats, remaining: float) -> None:
        """Add a candidate, if it goes together with those that were chosen before."""
        one = predict_approach(self.recognition, self.reachable, index)
        self.open_to[index] = False
        if not fits_together(self.reachable, one, self.chosen):
            return
        self.furthest[index] = one.travel_mm
        self.confused, self.remaining = self.confused * alike, remaining
        left = np.flatnonzero(self.confused > _SETTLED)
        if len(left):
            self.pairs, self.confused = self.pairs.select(left), self.confused[left]
        self.chosen.append(one)
        every = np.arange(len(self.open_to))
        self.open_to &= self.reachable.together(index, one.travel_mm, every, self.furthest)


def meets_other_side(normal_rad: Floats, rows: Ints, chosen: Sequence[int]) -> Bools:
    """Which candidates `rows` (m,) meet a surface that is not parallel to those that the chosen ones meet.

    `normal_rad` (n,): the normals that all candidates meet under the first hypothesis. Met from two sides, a
    part that has moved is noticed.
    """
    turned = np.abs(wrap_angle(2 * (normal_rad[rows][:, None] - normal_rad[list(chosen)]))) / 2
    result: Bools = np.all(turned > _TWO_SIDES_RAD, axis=1)
    return result


def _shortlist(
    rows: Ints,
    outcome: TouchOutcomes,
    weight: Floats,
    chosen: Sequence[int],
    resolution: Resolution,
    pairs: int,
) -> Ints:
    """Candidates `rows` that are worth comparing pair by pair: all of them, if that is quick.

    Else those that sort the poses into the smallest heaps, when outcomes are rounded.
    """
    if len(rows) * pairs <= _SHORT or len(rows) <= _LISTED:
        return rows
    heap = _outcome_classes(outcome, rows, resolution)
    for index in chosen:
        before = np.unique(_outcome_classes(outcome, np.array([index]), resolution)[0], return_inverse=True)[
            1
        ]
        heap = heap * (int(before.max()) + 1) + before
    _, number = np.unique(heap + (int(heap.max()) + 1) * np.arange(len(rows))[:, None], return_inverse=True)
    number = number.reshape(heap.shape)
    total = np.bincount(number.ravel(), np.broadcast_to(weight, heap.shape).ravel())
    alike = (total[number] * weight).sum(axis=1)
    return np.sort(rows[np.argsort(alike, kind="stable")[:_LISTED]])


def _outcome_classes(outcome: TouchOutcomes, rows: Ints, resolution: Resolution) -> Ints:
    """Outcomes (c, p) as whole numbers: alike if stop and normal round to the same."""
    stop = np.floor(outcome.travel[rows] / (2 * resolution.distance_mm)).astype(np.int64)
    normal = np.floor(outcome.normal[rows] % (2 * np.pi) / (2 * resolution.normal_half_rad)).astype(np.int64)
    return np.where(outcome.hit[rows], 1 + stop * 64 + normal, 0)
