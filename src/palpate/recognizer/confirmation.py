"""Confirmation of an answer: touches where strangers, or a part that has been moved, would hardly agree."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.evidence import detectable_shift_mm
from palpate.recognizer.grips import (
    FingerApproach,
    Grip,
    PredictedApproach,
    Reachable,
    fits_together,
    make_grip,
)
from palpate.recognizer.measurement_model import Resolution, touch_outcomes
from palpate.recognizer.planner import meets_other_side
from palpate.recognizer.poses import witness_poses
from palpate.recognizer.prediction import Predictions, predict
from palpate.recognizer.push_limits import PushLimits, push_hazard
from palpate.recognizer.rays import approach_lines
from palpate.recognizer.recognition import Recognition
from palpate.recognizer.strangers import CandidateTouches, StrangerEvidence, candidate_touches
from palpate.recognizer.strategy import already_used

__all__ = ["Confirmation", "checking_grip"]

_ASIDE_MM = 3.0  # a touch nearer to an earlier one than this says little new
_CHECKS = 2  # touches that confirm an answer
_AS_SAFE = 0.1  # hazards that differ by less are alike
_SQUARE = 0.5  # cosine: a check meets its surface at least this squarely


@dataclass(frozen=True, eq=False)
class Confirmation:
    """What confirming touches are for: to notice a shift of the part by `shift_mm`, and to bring what
    `strangers` says down to `probability`.
    """

    shift_mm: float
    strangers: StrangerEvidence
    probability: float


def checking_grip(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    wanted: Confirmation,
    limits: PushLimits | None = None,
) -> Grip | None:
    """Touches where the first hypothesis must be met, and strangers would least agree.

    Two of them, or more until both aims of `wanted` are met; None if there are none. Where `limits` are
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
        open_to &= self.hazard <= self.hazard[open_to].min() + _AS_SAFE
        return int(np.argmin(np.where(open_to, agreeing, np.inf)))

    def hidden_mm(self, chosen: Sequence[int]) -> float:
        """How far a shift of the part may go unnoticed by the chosen ones."""
        rows = list(chosen)
        direction = np.array([self.approaches[k].direction_rad for k in rows])
        return detectable_shift_mm(self.predictions.select(rows), self.normal_rad[rows], direction)


def _more_wanted(
    found: _Candidates, chosen: Sequence[int], strangers: StrangerEvidence, wanted: Confirmation
) -> bool:
    if len(chosen) < _CHECKS or found.hidden_mm(chosen) > wanted.shift_mm:
        return True
    return strangers.probability > wanted.probability


def _candidates(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, limits: PushLimits | None
) -> _Candidates | None:
    """Approaches not used yet that surely meet the first hypothesis, squarely; None if there are none."""
    used = already_used(recognition.contacts, reachable.approaches)
    poses = witness_poses(recognition.hypotheses)
    catalogue, anchor_mm = recognition.catalogue, recognition.anchor_mm
    outcome = touch_outcomes(catalogue, poses.cells, anchor_mm, reachable.approaches)
    rows = np.flatnonzero(outcome.hit[:, 0] & (outcome.facing[:, 0] >= _SQUARE) & ~used)
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
        predictions.needed_mm(approaches),
        candidate_touches(recognition, approaches, resolution.normal_half_rad, predictions),
        start + outcome.travel[rows, 0][:, None] * np.column_stack([np.cos(angle), np.sin(angle)]),
        outcome.normal[rows, 0],
        hazard[rows],
    )
