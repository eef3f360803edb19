"""Planner of the next grip (memo §3.2, third strategy): reachable touches that distinguish hypotheses best.

A grip is approaches to carry out together, with the predictions of every hypothesis and a certificate. Every
hypothesis is represented by some configurations of its region. Two of them need distinguishing if they
belong to different hypotheses, or are further apart than the goals. The probability that an approach
distinguishes two poses follows from the outcomes of touches at both (`touch_model`). Fingers are added one
by one, as long as each removes a good share of the remaining confusion. The guarantees of the grip do not
come from these samples, but from enclosures over whole regions (`prediction`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.base.short_repr import ShortRepr, show_point
from palpate.recognizer.approach import Approach
from palpate.recognizer.hypotheses import Hypotheses
from palpate.recognizer.prediction import Predictions, predict
from palpate.recognizer.recognition import Recognition
from palpate.recognizer.touch_model import (
    Blur,
    Goals,
    PushLimits,
    Resolution,
    TouchOutcomes,
    pairs_to_distinguish,
    push_hazard,
    sampled_poses,
    similarity,
    touch_outcomes,
    witness_poses,
)

_MAX_TWIN_PAIRS = 200  # pairs among which twins are looked for; where more are confused, not all are twins
_OUTCOMES_AT_ONCE = 500_000  # outcomes to compare: bounds the temporary arrays to tens of MB
_APPROACHES_AT_ONCE = 8
FREE_MARGIN_MM = 1.0  # before the earliest predicted stop, for a part that earlier touches have nudged
PERCEPTIBLE_SIMILARITY = np.exp(-1.0)  # similarity of what the rig can just distinguish


@dataclass(frozen=True, eq=False, repr=False)
class FingerApproach(ShortRepr, Approach):
    """An approach that one of a rig's fingers, or a carrier, can make, with the turning stage at `stage_rad`.

    `fast_mm`: travel through space that is proven free, so that the finger need not search on it.
    `touch_mm_s`: the finger meets the part at this speed at most; None: as the rig does.
    """

    finger_index: int = 0
    stage_rad: float = 0.0
    fast_mm: float = 0.0
    touch_mm_s: float | None = None

    def _facts(self) -> Iterator[str]:
        yield f"finger_index={self.finger_index}"
        yield f"from {show_point(self.start_mm)} mm"
        yield f"direction={math.degrees(self.direction_rad):.1f}°"
        yield f"travel={self.travel_mm:.2f} mm"
        if self.stage_rad:
            yield f"stage={math.degrees(self.stage_rad):.1f}°"
        if self.fast_mm:
            yield f"fast={self.fast_mm:.2f} mm"

    def up_to(self, travel_mm: float) -> Self:
        """The same approach, for `travel_mm` at most. Raises InputError for less than 0."""
        if not travel_mm >= 0:
            raise InputError(f"an approach cannot be for {travel_mm:g} mm; its travel is 0 or more")
        shorter = min(travel_mm, self.travel_mm)
        return replace(self, travel_mm=shorter, fast_mm=min(self.fast_mm, shorter))


class Reachable(Protocol):
    """All approaches of a rig, and which of them go together."""

    @property
    def approaches(self) -> Sequence[FingerApproach]:
        """All (n), of all fingers."""
        ...

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Mask of `others` (m,) that can be carried out with approach `one`, going this far at most."""
        ...

    def seconds(self, travels_mm: Floats) -> Floats:
        """Duration of each approach (n,), going this far (n,)."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Grip(ShortRepr):
    """Approaches to carry out together, and what each of the hypotheses says will happen.

    `indices`: theirs among the reachable ones. `travels_mm`: how far each finger has to go, if it meets
    nothing. `predictions` are (approaches, hypotheses). `decisive`: whatever happens, hypotheses of one class
    survive, the class being what no reachable approach tells apart; a certificate as long as no touch is
    blunter than its approach's position bound and the resolution's normal range. `remaining`: expected share
    of what needs telling apart that will still be indistinguishable, 0 to 1. `seconds`: estimated time of the
    motion.
    """

    approaches: tuple[FingerApproach, ...]
    indices: tuple[int, ...]
    travels_mm: tuple[float, ...]
    predictions: Predictions
    decisive: bool
    remaining: float
    seconds: float

    @property
    def limited_approaches(self) -> tuple[FingerApproach, ...]:
        """The approaches, none longer than its finger has to go, fast where no hypothesis has anything."""
        free = np.maximum(self.predictions.earliest.min(axis=1) - FREE_MARGIN_MM, 0.0)
        rows = zip(self.approaches, self.travels_mm, free.tolist(), strict=True)
        return tuple(replace(item.up_to(far), fast_mm=min(far, fast)) for item, far, fast in rows)


@dataclass(frozen=True, eq=False, repr=False)
class PredictedApproach(ShortRepr):
    """Approach `index` with its predictions (1, hypotheses) and the travel after which it meets nothing."""

    index: int
    predictions: Predictions
    travel_mm: float


def predict_approach(
    recognition: Recognition, reachable: Reachable, index: int, most_mm: float = math.inf
) -> PredictedApproach:
    """Prediction for approach `index`, and how far it has to go, `most_mm` at most."""
    approaches = [reachable.approaches[index].up_to(max(most_mm, 0.0))]
    found = predict(recognition.catalogue, recognition.hypotheses, recognition.anchor_mm, approaches)
    return PredictedApproach(index, found, float(found.sufficient_travel_mm(approaches)[0]))


def fits_together(reachable: Reachable, one: PredictedApproach, chosen: Sequence[PredictedApproach]) -> bool:
    """Return whether a candidate can be carried out together with all that are chosen."""
    others = np.array([item.index for item in chosen], dtype=np.int64)
    travels = np.array([item.travel_mm for item in chosen])
    return bool(reachable.together(one.index, one.travel_mm, others, travels).all())


def make_grip(
    recognition: Recognition,
    reachable: Reachable,
    chosen: Sequence[PredictedApproach],
    resolution: Resolution,
    remaining: float,
) -> Grip:
    """The grip of certain candidates, with what it promises."""
    indices = [item.index for item in chosen]
    predictions = Predictions.join([item.predictions for item in chosen])
    travels = np.zeros(len(reachable.approaches))
    travels[indices] = [item.travel_mm for item in chosen]
    return Grip(
        tuple(reachable.approaches[k] for k in indices),
        tuple(indices),
        tuple(item.travel_mm for item in chosen),
        predictions,
        _is_decisive(recognition, reachable, predictions, resolution),
        remaining,
        float(reachable.seconds(travels)[indices].max()),
    )


def twins(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, used: Bools | None = None
) -> Bools:
    """Twins: pairs of hypotheses (h, h) that no remaining approach distinguishes at their configurations.

    Their stops and normals agree to within the rig's resolution, or both are missed. `used` (n,): candidates
    that have been carried out.
    """
    count = len(recognition.hypotheses)
    alike = np.ones((count, count), dtype=bool)
    left = np.ones(len(reachable.approaches), dtype=bool) if used is None else ~used
    first, second = np.triu_indices(count, 1)
    if left.any() and len(first):
        same = _indistinguishable(recognition, reachable, resolution, np.flatnonzero(left), first, second)
        alike[first, second] = alike[second, first] = same
    return alike


def _indistinguishable(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    rows: Ints,
    first: Ints,
    second: Ints,
) -> Bools:
    """Mask of pairs of hypotheses, `first` and `second` (n,), that no candidate of `rows` tells apart."""
    approaches = [reachable.approaches[k] for k in rows.tolist()]
    poses = witness_poses(recognition.hypotheses)
    outcome = touch_outcomes(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    # Most pairs differ for one of the first few that touch much: few are left for the others.
    order = np.argsort(-outcome.hit.sum(axis=1), kind="stable")
    left = np.arange(len(first))
    for begin in range(0, len(rows), _APPROACHES_AT_ONCE):
        some = order[begin : begin + _APPROACHES_AT_ONCE]
        kept = [
            piece[
                similarity(outcome, first[piece], second[piece], resolution, some).min(axis=0)
                >= PERCEPTIBLE_SIMILARITY
            ]
            for piece in np.array_split(left, 1 + len(left) * _APPROACHES_AT_ONCE // _OUTCOMES_AT_ONCE)
        ]
        left = np.concatenate(kept)
    result: Bools = np.zeros(len(first), dtype=bool)
    result[left] = True
    return result


def _is_decisive(
    recognition: Recognition, reachable: Reachable, predictions: Predictions, resolution: Resolution
) -> bool:
    """Return whether a grip distinguishes every two hypotheses that some reachable approach distinguishes.

    Where touches may be spurious nothing is certain.
    """
    if recognition.max_spurious:
        return False
    apart = predictions.apart(resolution.normal_half_rad)
    first, second = np.nonzero(np.triu(~apart, 1))
    if not len(first):
        return True
    if len(first) > _MAX_TWIN_PAIRS:
        return False
    # Survivors of an outcome are confused two by two; if these are twins two by two, they are one class.
    # A few approaches distinguish most others, which is soon seen.
    count = len(reachable.approaches)
    for rows in (
        np.unique(np.linspace(0, count - 1, 3 * _APPROACHES_AT_ONCE).astype(np.int64)),
        np.arange(count),
    ):
        if not _indistinguishable(recognition, reachable, resolution, rows, first, second).all():
            return False
    return True


_LEAST_FIRST_GAIN = 1e-3  # the first finger must take at least this share of confusion away
_LEAST_FURTHER_GAIN = 0.08  # and every further one this, unless touches may move the part
_MAX_CONFUSION_LEFT = 0.1  # where less is confused, no further finger is worth its touch
_EQUAL_PLAN_SHARE = 0.02  # plans this near to the best are as good: the quickest of them is taken
_HAZARD_WEIGHT = 0.2  # a plan may leave this share more, times the hazard that it saves
_MAX_COMPARISONS = 250_000  # where there is more to compare, only the most promising candidates are
_SHORTLIST_LENGTH = 20  # and these are so many
_NEGLIGIBLE_WEIGHT = 1e-9  # confused weight of a pair that need not be looked at any more
_TWO_SIDES_RAD = np.radians(30.0)
_SECONDS_TO_GOAL = 60.0  # a plan may search longer by the share of it by which it leaves less confusion
_WIDE_GOALS = 3.0  # of hypotheses that many goals wide, one touch excludes much less than of samples of them
_MOST_POSES_SHARE = 0.8  # fingers that went on for the rest would keep others out of their way
_TRAVEL_MARGIN_MM = 10.0  # beyond the furthest stop of the sampled poses, until more is known


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
    if not reachable.approaches:
        return None
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
    indistinguishable, `remaining` together; `compared`: number of pairs at first. `search_s` (n,): time of a
    slow search where the part may be. `least_gain`: share of confusion that a further finger must take away.
    `most_left`: share that a grip may leave. `most_mm` (n,): none of them goes further.
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
        fingers = {item.finger for item in reachable.approaches}
        self.blur = Blur.of(recognition.catalogue, poses, fingers)
        self.most_mm: Floats = np.full(len(reachable.approaches), math.inf)
        self.least_gain, self.most_left = _LEAST_FURTHER_GAIN, _MAX_CONFUSION_LEFT
        if limits is not None and limits.slide_shares(recognition.hypotheses.state).any():
            # Contacts of one grip are of the part as it lay then; a later grip's motion widens them. So
            # several fingers are worth more than each of them going as far as it may be of use.
            self.least_gain = 0.0
            if _typical_half_mm(recognition.hypotheses) > _WIDE_GOALS * goals.position_mm:
                self.most_left = 0.0
            self.most_mm = _way_to_most_mm(self.outcome, self.poses.weight)
            within = self.outcome.travel <= self.most_mm[:, None]
            self.outcome = replace(self.outcome, hit=self.outcome.hit & within)
        self.open_to: Bools = np.asarray(self.outcome.hit.any(axis=1))
        met = np.where(self.outcome.hit, self.outcome.travel, 0.0)
        self.furthest: Floats = met.max(axis=1, initial=0.0) + _TRAVEL_MARGIN_MM
        self.seconds = reachable.seconds(self.furthest)
        self.search_s: Floats = np.zeros(len(self.open_to))
        self.hazard: Floats = np.zeros(len(self.open_to))
        if limits is not None:
            search_mm = _search_mm(self.outcome, self.poses.weight)
            self.search_s = search_mm / limits.touch_mm_s(recognition.hypotheses.state)
            self.seconds = self.seconds + self.search_s
            self.hazard = push_hazard(
                limits, reachable.approaches, self.poses, recognition.anchor_mm, self.outcome
            )
        self.confused, self.compared = self.pairs.weight, len(self.pairs.first)
        self.remaining = 1.0
        self.chosen: list[PredictedApproach] = []

    def wants_more(self, fingers: int) -> bool:
        """Return whether a further approach could be of use."""
        enough = self.remaining <= self.most_left and len(self.chosen) >= fingers
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
        first, second = self.pairs.first, self.pairs.second
        blur = self.blur.of_pairs(first, second)
        alike = similarity(self.outcome, first, second, self.resolution, rows, blur)
        scores = alike @ self.confused
        least = float(scores.min())
        worth = (0.0 if wanted else self.least_gain) if self.chosen else _LEAST_FIRST_GAIN
        if least > self.remaining - worth:
            return None
        weighed = scores + _HAZARD_WEIGHT * self.remaining * self.hazard[rows]
        later_s = np.maximum(self.search_s[rows] - self.search_s[taken].max(initial=0.0), 0.0)
        weighed += self.remaining * later_s / _SECONDS_TO_GOAL
        good = np.flatnonzero(weighed <= weighed.min() + _EQUAL_PLAN_SHARE * self.remaining)
        row = good[np.argmin(self.seconds[rows[good]])]
        return int(rows[row]), alike[row], float(scores[row])

    def take(self, index: int, alike: Floats, remaining: float) -> None:
        """Add a candidate, if it goes together with those that were chosen before."""
        one = predict_approach(self.recognition, self.reachable, index, float(self.most_mm[index]))
        self.open_to[index] = False
        if not fits_together(self.reachable, one, self.chosen):
            return
        self.furthest[index] = one.travel_mm
        self.confused, self.remaining = self.confused * alike, remaining
        left = np.flatnonzero(self.confused > _NEGLIGIBLE_WEIGHT)
        if len(left):
            self.pairs, self.confused = self.pairs.select(left), self.confused[left]
        self.chosen.append(one)
        every = np.arange(len(self.open_to))
        self.open_to &= self.reachable.together(index, one.travel_mm, every, self.furthest)


def _typical_half_mm(hypotheses: Hypotheses) -> float:
    """Half-width of the positions of a hypothesis: as many by weight are wider as are narrower."""
    half = (hypotheses.hi - hypotheses.lo)[:, :2].max(axis=1) / 2
    order = np.argsort(half)
    lighter = np.cumsum(hypotheses.weight[order])
    return float(half[order[np.searchsorted(lighter, lighter[-1] / 2)]])


def _way_to_most_mm(outcome: TouchOutcomes, weight: Floats) -> Floats:
    """Travel (n,) on which candidates meet most of the poses (by `weight`) that they would meet at all."""
    travel = np.where(outcome.hit, outcome.travel, math.inf)
    order = np.argsort(travel, axis=1)
    met = np.cumsum(np.take_along_axis(np.where(outcome.hit, weight, 0.0), order, axis=1), axis=1)
    last = np.argmax(met >= _MOST_POSES_SHARE * met[:, -1:], axis=1)
    result: Floats = np.take_along_axis(travel, np.take_along_axis(order, last[:, None], axis=1), axis=1)
    return result[:, 0] + _TRAVEL_MARGIN_MM


def _search_mm(outcome: TouchOutcomes, weight: Floats) -> Floats:
    """Expected travel (n,) of candidates that is searched: from before the earliest stop of any pose on."""
    first = np.where(outcome.hit, outcome.travel, np.inf).min(axis=1, initial=np.inf)
    beyond = np.where(outcome.hit, outcome.travel - first[:, None], 0.0)
    result: Floats = FREE_MARGIN_MM + beyond @ weight
    return result


def meets_other_side(normal_rad: Floats, rows: Ints, chosen: Sequence[int]) -> Bools:
    """Mask of candidates `rows` (m,) whose surface is not parallel to those that the chosen ones meet.

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
    if len(rows) * pairs <= _MAX_COMPARISONS or len(rows) <= _SHORTLIST_LENGTH:
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
    return np.sort(rows[np.argsort(alike, kind="stable")[:_SHORTLIST_LENGTH]])


def _outcome_classes(outcome: TouchOutcomes, rows: Ints, resolution: Resolution) -> Ints:
    """Outcomes (c, p) as whole numbers: alike if stop and normal round to the same."""
    stop = np.floor(outcome.travel[rows] / (2 * resolution.distance_mm)).astype(np.int64)
    normal = np.floor(outcome.normal[rows] % (2 * np.pi) / (2 * resolution.normal_half_rad)).astype(np.int64)
    return np.where(outcome.hit[rows], 1 + stop * 64 + normal, 0)
