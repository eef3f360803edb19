"""The next approach (memo §3.2, third strategy): which reachable touches tell apart what is left.

From a recognition and the approaches that the rig can reach to a grip. Every hypothesis is represented by
some configurations of its region. Two of them need telling apart if they are of different hypotheses, or
further apart than is fine enough; what they would feel (`felt`) says how likely each approach is to do it.
Fingers are added one by one, as long as each takes away a good share of what would still be confused. What
the grip then promises is not taken from these samples, but from enclosures over whole regions (`prediction`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palpate.recognizer.arrays import Bools, Floats, Ints, wrap_angle
from palpate.recognizer.felt import Felt, Resolution, felt, likeness
from palpate.recognizer.poses import Goals, pairs_to_tell_apart, sampled_poses, witness_poses
from palpate.recognizer.prediction import Predictions, joined_predictions, predict
from palpate.recognizer.rays import Approach
from palpate.recognizer.recognise import Recognition

__all__ = [
    "Candidate",
    "Foreseen",
    "Grip",
    "Reachable",
    "fits",
    "foreseen",
    "grip_of",
    "other_side",
    "plan_grip",
    "twins",
]

_HOPELESS = 1e-3  # the first finger must take at least this share of confusion away
_WORTH = 0.08  # and every further one this
_ENOUGH = 0.1  # where less is confused, no further finger is worth its touch
_ALIKE = 0.02  # plans this near to the best are as good: the quickest of them is taken
_SHORT, _LISTED = 250_000, 20  # where there is more to compare, only the most promising candidates are
_CLASSED = 200  # pairs among which twins are looked for; where more are confused, not all are twins
_AT_ONCE = 500_000  # outcomes to compare: bounds the temporary arrays to tens of MB
_FEW = 8
_PERCEPTIBLE = np.exp(-1.0)  # likeness of what the rig can just tell apart
_TWO_SIDES_RAD = np.radians(30.0)
_MARGIN_MM = 10.0  # beyond the furthest stop of the sampled poses, until more is known


@dataclass(frozen=True, eq=False)
class Candidate:
    """An approach that the rig can reach with one of its fingers."""

    finger_index: int
    approach: Approach


class Reachable(Protocol):
    """All approaches of a rig, and which of them go together."""

    @property
    def candidates(self) -> Sequence[Candidate]:
        """The approaches (n), of all fingers."""
        ...

    def together(self, one: int, travel_mm: float, others: Ints, travels_mm: Floats) -> Bools:
        """Whether candidate `one` can be carried out with each of `others` (m,), going this far at most."""
        ...

    def seconds(self, travels_mm: Floats) -> Floats:
        """How long each candidate (n,) takes, going this far (n,)."""
        ...


@dataclass(frozen=True, eq=False)
class Grip:
    """Approaches to carry out together, and what each of the hypotheses says will happen.

    `indices` into the reachable candidates; `travels_mm`: how far each finger has to go, if it meets nothing.
    `predictions` are (approaches, hypotheses). `decisive`: whatever happens, hypotheses of one class survive,
    the class being what no reachable approach tells apart; a certificate as long as no touch is blunter than
    its approach's position bound and the resolution's normal range. `remaining`: expected share of what needs
    telling apart that will still feel alike, 0 to 1. `seconds`: estimated time of the motion.
    """

    indices: tuple[int, ...]
    candidates: tuple[Candidate, ...]
    travels_mm: tuple[float, ...]
    predictions: Predictions
    decisive: bool
    remaining: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Foreseen:
    """Candidate `index` with its predictions (1, hypotheses) and the travel after which it meets nothing."""

    index: int
    predictions: Predictions
    travel_mm: float


def plan_grip(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    goals: Goals,
    used: Bools | None = None,
    fingers: int = 1,
) -> Grip | None:
    """Choose approaches, at most one for each finger, that leave the least confusion; None if none helps.

    As many as `fingers`, where that many go together, and more if they are worth it. `used` (n,): candidates
    not to choose, because they were carried out before: what they can tell they have told.
    """
    approaches = [item.approach for item in reachable.candidates]
    poses = sampled_poses(recognition.hypotheses)
    pairs = pairs_to_tell_apart(poses, recognition.hypotheses, goals)
    outcome = felt(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    open_to: Bools = np.any(outcome.hit, axis=1)
    if used is not None:
        open_to = open_to & ~used
    furthest = np.where(outcome.hit, outcome.travel, 0.0).max(axis=1, initial=0.0) + _MARGIN_MM
    seconds = reachable.seconds(furthest)
    confused, remaining = pairs.weight.copy(), 1.0
    chosen: list[Foreseen] = []
    while open_to.any() and len(pairs.first):
        wanted = len(chosen) < fingers
        if remaining <= _ENOUGH and not wanted:
            break
        taken = [item.index for item in chosen]
        rows = _shortlist(np.flatnonzero(open_to), outcome, poses.weight, taken, resolution, len(pairs.first))
        sides = other_side(outcome.normal[:, 0], rows, taken)
        if wanted and sides.any():
            rows = rows[sides]
        alike = likeness(outcome, pairs.first, pairs.second, resolution, rows)
        scores = alike @ confused
        least = float(scores.min())
        worth = (0.0 if wanted else _WORTH) if chosen else _HOPELESS
        if least > remaining - worth:
            break
        good = np.flatnonzero(scores <= least + _ALIKE * remaining)
        best = good[np.argmin(seconds[rows[good]])]
        one = foreseen(recognition, reachable, int(rows[best]))
        open_to[one.index] = False
        if not fits(reachable, one, chosen):
            continue
        furthest[one.index] = one.travel_mm
        confused, remaining = confused * alike[best], float(scores[best])
        chosen.append(one)
        open_to &= reachable.together(one.index, one.travel_mm, np.arange(len(open_to)), furthest)
    return grip_of(recognition, reachable, chosen, resolution, remaining) if chosen else None


def foreseen(recognition: Recognition, reachable: Reachable, index: int) -> Foreseen:
    """What candidate `index` will meet, and how far it has to go for it."""
    approaches = [reachable.candidates[index].approach]
    found = predict(recognition.catalogue, recognition.hypotheses, recognition.anchor_mm, approaches)
    return Foreseen(index, found, float(found.needed_mm(approaches)[0]))


def fits(reachable: Reachable, one: Foreseen, chosen: Sequence[Foreseen]) -> bool:
    """Whether a candidate can be carried out together with all that are chosen."""
    others = np.array([item.index for item in chosen], dtype=np.int64)
    travels = np.array([item.travel_mm for item in chosen])
    return bool(reachable.together(one.index, one.travel_mm, others, travels).all())


def other_side(normal_rad: Floats, rows: Ints, chosen: Sequence[int]) -> Bools:
    """Which candidates `rows` (m,) meet a surface that is not parallel to those that the chosen ones meet.

    `normal_rad` (n,): the normals that all candidates meet under the first hypothesis. Met from two sides, a
    part that has moved is noticed.
    """
    turned = np.abs(wrap_angle(2 * (normal_rad[rows][:, None] - normal_rad[list(chosen)]))) / 2
    result: Bools = np.all(turned > _TWO_SIDES_RAD, axis=1)
    return result


def grip_of(
    recognition: Recognition,
    reachable: Reachable,
    chosen: Sequence[Foreseen],
    resolution: Resolution,
    remaining: float,
) -> Grip:
    """The grip of certain candidates, with what it promises."""
    indices = [item.index for item in chosen]
    predictions = joined_predictions([item.predictions for item in chosen])
    travels = np.zeros(len(reachable.candidates))
    travels[indices] = [item.travel_mm for item in chosen]
    return Grip(
        tuple(indices),
        tuple(reachable.candidates[k] for k in indices),
        tuple(item.travel_mm for item in chosen),
        predictions,
        _decisive(recognition, reachable, predictions, resolution),
        remaining,
        float(reachable.seconds(travels)[indices].max()),
    )


def twins(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, used: Bools | None = None
) -> Bools:
    """Which two hypotheses (h, h) no candidate that is left may tell apart, at their own configurations.

    Their stops and normals agree to within the rig's resolution, or both are missed. `used` (n,): candidates
    that have been carried out.
    """
    count = len(recognition.hypotheses)
    alike = np.ones((count, count), dtype=bool)
    left = np.ones(len(reachable.candidates), dtype=bool) if used is None else ~used
    first, second = np.triu_indices(count, 1)
    if left.any() and len(first):
        same = _alike(recognition, reachable, resolution, np.flatnonzero(left), first, second)
        alike[first, second] = alike[second, first] = same
    return alike


def _alike(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    rows: Ints,
    first: Ints,
    second: Ints,
) -> Bools:
    """Which pairs of hypotheses, `first` and `second` (n,), none of the candidates `rows` tells apart."""
    approaches = [reachable.candidates[k].approach for k in rows.tolist()]
    poses = witness_poses(recognition.hypotheses)
    outcome = felt(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    # Most pairs feel different to one of the first few that touch much: few are left for the others.
    order = np.argsort(-outcome.hit.sum(axis=1), kind="stable")
    left = np.arange(len(first))
    for begin in range(0, len(rows), _FEW):
        some = order[begin : begin + _FEW]
        kept = [
            piece[
                likeness(outcome, first[piece], second[piece], resolution, some).min(axis=0) >= _PERCEPTIBLE
            ]
            for piece in np.array_split(left, 1 + len(left) * _FEW // _AT_ONCE)
        ]
        left = np.concatenate(kept)
    result: Bools = np.zeros(len(first), dtype=bool)
    result[left] = True
    return result


def _decisive(
    recognition: Recognition, reachable: Reachable, predictions: Predictions, resolution: Resolution
) -> bool:
    """Whether every two hypotheses that something reachable tells apart are told apart by this.

    Where touches may be spurious nothing is certain.
    """
    if recognition.max_spurious:
        return False
    apart = predictions.apart(resolution.normal_half_rad)
    first, second = np.nonzero(np.triu(~apart, 1))
    if not len(first):
        return True
    if len(first) > _CLASSED:
        return False
    # Survivors of an outcome are confused two by two; if these are twins two by two, they are one class.
    every = np.arange(len(reachable.candidates))
    return bool(_alike(recognition, reachable, resolution, every, first, second).all())


def _shortlist(
    rows: Ints, outcome: Felt, weight: Floats, chosen: Sequence[int], resolution: Resolution, pairs: int
) -> Ints:
    """Candidates `rows` that are worth comparing pair by pair: all of them, if that is quick.

    Else those that sort the poses into the smallest heaps, when outcomes are rounded.
    """
    if len(rows) * pairs <= _SHORT or len(rows) <= _LISTED:
        return rows
    heap = _heaps(outcome, rows, resolution)
    for index in chosen:
        before = np.unique(_heaps(outcome, np.array([index]), resolution)[0], return_inverse=True)[1]
        heap = heap * (int(before.max()) + 1) + before
    _, number = np.unique(heap + (int(heap.max()) + 1) * np.arange(len(rows))[:, None], return_inverse=True)
    number = number.reshape(heap.shape)
    total = np.bincount(number.ravel(), np.broadcast_to(weight, heap.shape).ravel())
    alike = (total[number] * weight).sum(axis=1)
    return np.sort(rows[np.argsort(alike, kind="stable")[:_LISTED]])


def _heaps(outcome: Felt, rows: Ints, resolution: Resolution) -> Ints:
    """Outcomes (c, p) as whole numbers: alike if stop and normal round to the same."""
    stop = np.floor(outcome.travel[rows] / (2 * resolution.distance_mm)).astype(np.int64)
    normal = np.floor(outcome.normal[rows] % (2 * np.pi) / (2 * resolution.normal_half_rad)).astype(np.int64)
    result: Ints = np.where(outcome.hit[rows], 1 + stop * 64 + normal, 0)
    return result
