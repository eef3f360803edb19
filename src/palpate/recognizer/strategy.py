"""Strategies for the next grip: the memo's three ways to more data (§3.2), and confirmation of an answer.

`random`: a new grip at random, among approaches that may meet something. `rotate`: every finger next to where
it touched last, as if the hand turned a little in contact. `planned`: what tells the hypotheses apart best.
A confirmation touches where strangers, or a part that has been moved, would hardly agree.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.base.vocabulary import Strategy
from palpate.recognizer.approach import approach_lines, offset_from_lines
from palpate.recognizer.contact import Contact
from palpate.recognizer.evidence import (
    CandidateTouches,
    StrangerEvidence,
    candidate_touches,
    detectable_shift_mm,
)
from palpate.recognizer.planner import (
    FingerApproach,
    Grip,
    PredictedApproach,
    Reachable,
    fits_together,
    make_grip,
    meets_other_side,
    predict_approach,
)
from palpate.recognizer.prediction import Predictions, predict
from palpate.recognizer.recognition import Recognition
from palpate.recognizer.touch_model import (
    PushLimits,
    Resolution,
    push_hazard,
    sampled_poses,
    touch_outcomes,
    witness_poses,
)

_SAME_LINE_MM, _SAME_LINE_RAD = 1.0, 0.01
_ASIDE_MM = 3.0  # a touch nearer to an earlier one than this says little new
_LEVER_MM = 50.0  # makes turns and distances comparable, to see whose approach a contact was


def heuristic_grip(
    strategy: Strategy,
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    rng: np.random.Generator,
) -> Grip | None:
    """The next grip by a `strategy` that does not plan; None if none is of use.

    Approaches that earlier contacts came by are not taken again. `rng` is asked by `random` alone.
    """
    if not reachable.approaches:
        return None
    order = _approaches_meeting(recognition, reachable)
    if strategy is Strategy.RANDOM:
        order = rng.permutation(order)
    else:
        order = _approaches_beside(recognition, reachable, order)
    return _first_compatible(recognition, reachable, order, resolution)


def used_approaches(contacts: Sequence[Contact], candidates: Sequence[FingerApproach]) -> Bools:
    """Mask of candidates (n,) that run along the path of a contact or a miss of the same kind of finger.

    A pad does if both ends of its face run along paths.
    """
    start, angle = approach_lines(candidates)
    half = np.array([item.finger.face_half_mm for item in candidates])
    left, right = np.zeros((2, len(candidates)), dtype=bool)
    for contact in contacts:
        same = np.array([item.finger.face_point == contact.finger for item in candidates], dtype=bool)
        same &= np.abs(wrap_angle(angle - contact.direction_rad)) < _SAME_LINE_RAD
        off = offset_from_lines(start, angle, np.array(contact.end_mm))
        left |= same & (np.abs(off - half) < _SAME_LINE_MM)
        right |= same & (np.abs(off + half) < _SAME_LINE_MM)
    result: Bools = left & right
    return result


def _approaches_meeting(recognition: Recognition, reachable: Reachable) -> Ints:
    """Candidates that have not been used and may meet what lies there, as far as some configurations tell."""
    poses = sampled_poses(recognition.hypotheses)
    approaches = reachable.approaches
    used = used_approaches(recognition.contacts, approaches)
    outcome = touch_outcomes(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    return np.flatnonzero(outcome.hit.any(axis=1) & ~used)


def _approaches_beside(recognition: Recognition, reachable: Reachable, rows: Ints) -> Ints:
    """Candidates by how near they pass to their finger's last contact, those that pass too near left out."""
    start, angle = approach_lines(reachable.approaches)
    finger = np.array([item.finger_index for item in reachable.approaches])
    off = np.full(len(angle), np.inf)
    ends: dict[int, list[Floats]] = {}
    for contact in recognition.contacts:
        if contact.touched:
            end = np.array(contact.end_mm)
            turned = np.abs(wrap_angle(angle - contact.direction_rad))
            nearest = int(np.argmin(np.abs(offset_from_lines(start, angle, end)) + _LEVER_MM * turned))
            ends.setdefault(int(finger[nearest]), []).append(end)
    for index, touched in ends.items():
        own = np.flatnonzero(finger == index)
        away = np.abs([offset_from_lines(start[own], angle[own], end) for end in touched])
        off[own] = np.where(away.min(axis=0) >= _ASIDE_MM, away[-1], np.inf)
    rows = rows[np.isfinite(off[rows])]
    return rows[np.argsort(off[rows], kind="stable")]


def _first_compatible(
    recognition: Recognition, reachable: Reachable, order: Ints, resolution: Resolution
) -> Grip | None:
    """A grip of the first candidates of `order` (n,) that go together; None if there is none."""
    fingers = len({item.finger_index for item in reachable.approaches})
    chosen: list[PredictedApproach] = []
    for index in order.tolist():
        one = predict_approach(recognition, reachable, index)
        if fits_together(reachable, one, chosen):
            chosen.append(one)
        if len(chosen) == fingers:
            break
    return make_grip(recognition, reachable, chosen, resolution, 1.0) if chosen else None


_RESERVE = 0.5  # of the probability that is wanted: touches agree a little less clearly than predicted
_EQUAL_HAZARD = 0.1  # hazards that differ by less are alike
_LEAST_FACING = 0.5  # cosine: a check meets its surface at least this squarely


@dataclass(frozen=True, eq=False)
class Confirmation:
    """Aims of confirming touches: `touches` at least, to notice a shift of the part by `shift_mm`, and to
    bring what `strangers` says down to `probability`.
    """

    touches: int
    shift_mm: float
    strangers: StrangerEvidence
    probability: float


def confirmation_grip(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    wanted: Confirmation,
    limits: PushLimits | None = None,
) -> Grip | None:
    """Touches where the first hypothesis must be met, and strangers would least agree.

    As many as it takes until all aims of `wanted` are met; None if there are none. Where `limits` are
    given, those that are more likely to tip or roll the part are the last to be taken.
    """
    found = _candidates(recognition, reachable, resolution, limits)
    if found is None:
        return None
    chosen: list[int] = []
    left = np.ones(len(found.rows), dtype=bool)
    strangers = wanted.strangers
    while left.any() and _more_wanted(found, chosen, strangers, wanted):
        agreeing = found.touches.agreement(chosen)
        best = found.best(
            left,
            strangers.different_kinds @ agreeing,
            chosen,
            [item.end_mm for item in recognition.contacts if item.touched],
        )
        if best is None:
            break
        left[best] = False
        if fits_together(reachable, found.at(best), [found.at(k) for k in chosen]):
            chosen.append(best)
            strangers = strangers.after(agreeing[:, best][None])
    if not chosen:
        return None
    return make_grip(recognition, reachable, [found.at(k) for k in chosen], resolution, 1.0)


def extend_to_confirm(
    grip: Grip,
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    wanted: Confirmation,
    limits: PushLimits | None = None,
) -> Grip | None:
    """A planned grip with touches of further fingers that confirm the answer, too; None if none do.

    A touch that places a part confirms it, too: a grip that is made only to confirm costs as much time again.
    """
    found = _candidates(recognition, reachable, resolution, limits)
    if found is None:
        return None
    planned = [
        PredictedApproach(index, grip.predictions.select([k]), grip.travels_mm[k])
        for k, index in enumerate(grip.indices)
    ]
    left, strangers = ~np.isin(found.rows, grip.indices), wanted.strangers
    chosen: list[int] = []
    for k in np.flatnonzero(~left).tolist():  # others of the grip may miss
        strangers = strangers.after(found.touches.agreement(chosen)[:, k][None])
        chosen.append(k)
    known_mm = [item.end_mm for item in recognition.contacts if item.touched]
    added: list[int] = []
    with_reserve = replace(wanted, probability=_RESERVE * wanted.probability)
    while _more_wanted(found, chosen, strangers, with_reserve):
        agreeing = found.touches.agreement(chosen)
        best = found.best(left, strangers.different_kinds @ agreeing, chosen, known_mm)
        if best is None:
            break
        left[best] = False
        if fits_together(reachable, found.at(best), [*planned, *map(found.at, added)]):
            chosen.append(best)
            added.append(best)
            strangers = strangers.after(agreeing[:, best][None])
    if _more_wanted(found, chosen, strangers, wanted):
        return None
    together = [*planned, *map(found.at, added)]
    return make_grip(recognition, reachable, together, resolution, grip.remaining)


@dataclass(frozen=True, eq=False)
class _Candidates:
    """c approaches that surely meet the first hypothesis: `rows` (c,) of the reachable ones.

    `predictions` (c, h), `travel_mm` (c,) as far as they go, `touches` as strangers meet them; where the
    first hypothesis's configuration is met: `end_mm` (c, 2), `normal_rad` (c,); `hazard` (c,) of moving it.
    """

    rows: Ints
    approaches: Sequence[FingerApproach]
    predictions: Predictions
    travel_mm: Floats
    touches: CandidateTouches
    end_mm: Floats
    normal_rad: Floats
    hazard: Floats

    def at(self, index: int) -> PredictedApproach:
        """One of them."""
        return PredictedApproach(
            int(self.rows[index]), self.predictions.select([index]), float(self.travel_mm[index])
        )

    def best(
        self, left: Bools, agreeing: Floats, chosen: Sequence[int], known_mm: Sequence[tuple[float, float]]
    ) -> int | None:
        """The candidate of those left with which strangers least agree; None if all are near known places."""
        places = np.concatenate([np.array(known_mm).reshape(-1, 2), self.end_mm[list(chosen)]])
        away = np.linalg.norm(self.end_mm[:, None] - places, axis=2).min(axis=1)
        open_to = left & (away >= _ASIDE_MM)
        if not open_to.any():
            return None
        sides = open_to & meets_other_side(self.normal_rad, np.arange(len(self.rows)), chosen)
        if sides.any():
            open_to = sides
        open_to &= self.hazard <= self.hazard[open_to].min() + _EQUAL_HAZARD
        return int(np.argmin(np.where(open_to, agreeing, np.inf)))

    def hidden_mm(self, chosen: Sequence[int]) -> float:
        """Largest shift of the part that the chosen ones may not notice."""
        rows = list(chosen)
        direction = np.array([self.approaches[k].direction_rad for k in rows])
        return detectable_shift_mm(self.predictions.select(rows), self.normal_rad[rows], direction)


def _more_wanted(
    found: _Candidates, chosen: Sequence[int], strangers: StrangerEvidence, wanted: Confirmation
) -> bool:
    if len(chosen) < wanted.touches or found.hidden_mm(chosen) > wanted.shift_mm:
        return True
    return strangers.probability > wanted.probability


def _candidates(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, limits: PushLimits | None
) -> _Candidates | None:
    """Approaches not used yet that surely meet the first hypothesis, squarely; None if there are none."""
    used = used_approaches(recognition.contacts, reachable.approaches)
    poses = witness_poses(recognition.hypotheses)
    catalogue, anchor_mm = recognition.catalogue, recognition.anchor_mm
    outcome = touch_outcomes(catalogue, poses.cells, anchor_mm, reachable.approaches)
    rows = np.flatnonzero(outcome.hit[:, 0] & (outcome.facing[:, 0] >= _LEAST_FACING) & ~used)
    if not len(rows):
        return None
    predictions = predict(
        catalogue, recognition.hypotheses, anchor_mm, [reachable.approaches[k] for k in rows.tolist()]
    )
    sure = np.flatnonzero(np.isfinite(predictions.latest[:, 0]))
    rows, predictions = rows[sure], predictions.select(sure)
    if not len(rows):
        return None
    approaches = [reachable.approaches[k] for k in rows.tolist()]
    start, angle = approach_lines(approaches)
    hazard = np.zeros(len(reachable.approaches))
    if limits is not None:
        hazard = push_hazard(limits, reachable.approaches, poses, anchor_mm, outcome)
    return _Candidates(
        rows,
        approaches,
        predictions,
        predictions.sufficient_travel_mm(approaches),
        candidate_touches(recognition, approaches, resolution.normal_half_rad, predictions),
        start + outcome.travel[rows, 0][:, None] * np.column_stack([np.cos(angle), np.sin(angle)]),
        outcome.normal[rows, 0],
        hazard[rows],
    )
