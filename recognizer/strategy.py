"""The memo's three ways to get at more data (§3.2), and the check of an answer. From a recognition to a grip.

`random`: a new grip at random, among approaches that may meet something. `rotate`: every finger next to where
it touched last, as if the hand turned a little in contact. `planned`: what tells the hypotheses apart best.
"""

from collections.abc import Sequence

import numpy as np

from palpate.geometry import Bools, Floats, Ints
from palpate.geometry.plane import wrap_angle
from palpate.recognizer.contact import Contact
from palpate.recognizer.evidence import detectable_shift_mm
from palpate.recognizer.grips import (
    FingerApproach,
    Grip,
    PredictedApproach,
    Reachable,
    fits_together,
    make_grip,
    predict_approach,
)
from palpate.recognizer.measurement_model import Resolution, TouchOutcomes, touch_outcomes
from palpate.recognizer.planner import meets_other_side, plan_grip
from palpate.recognizer.poses import Goals, sampled_poses, witness_poses
from palpate.recognizer.prediction import Predictions
from palpate.recognizer.push_limits import PushLimits, push_hazard
from palpate.recognizer.rays import approach_lines, offset_from_lines
from palpate.recognizer.recognition import Recognition
from palpate.vocabulary import Strategy

__all__ = ["already_used", "checking_grip", "next_grip"]

_SAME_LINE_MM, _SAME_LINE_RAD = 1.0, 0.01
_ASIDE_MM = 3.0  # a touch nearer to an earlier one than this says little new
_LEVER_MM = 50.0  # makes turns and distances comparable, to see whose approach a contact was
_CHECKS = 2  # touches that confirm an answer
_AS_SAFE = 0.1  # hazards that differ by less are alike
_SQUARE = 0.5  # cosine: a check meets its surface at least this squarely


def next_grip(
    strategy: Strategy,
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    goals: Goals,
    rng: np.random.Generator,
    fingers: int = 1,
    limits: PushLimits | None = None,
) -> Grip | None:
    """The next grip, of `fingers` or more if as many go together; None if none is of use.

    Approaches that earlier contacts came by are not taken again. `rng` is asked by `random` alone,
    `limits` by `planned`.
    """
    if not reachable.approaches:
        return None
    used = already_used(recognition.contacts, reachable.approaches)
    if strategy is Strategy.PLANNED:
        return plan_grip(recognition, reachable, resolution, goals, used, fingers, limits)
    order = _meeting(recognition, reachable, used)
    if strategy is Strategy.RANDOM:
        return _first_together(recognition, reachable, rng.permutation(order), resolution)
    return _first_together(recognition, reachable, _beside(recognition, reachable, order), resolution)


def checking_grip(
    recognition: Recognition,
    reachable: Reachable,
    resolution: Resolution,
    shift_mm: float,
    limits: PushLimits | None = None,
) -> Grip | None:
    """Touches where the first hypothesis must be met, as far as can be from all that was touched before.

    Two of them, or more until a shift of the part by `shift_mm` would be noticed; None if there are none.
    What is not in the catalogue would hardly be met just there as well. Where `limits` are given, those
    that are more likely to tip or roll the part are the last to be taken.
    """
    used = already_used(recognition.contacts, reachable.approaches)
    approaches = reachable.approaches
    poses = witness_poses(recognition.hypotheses)
    outcome = touch_outcomes(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    rows = np.flatnonzero(outcome.hit[:, 0] & (outcome.facing[:, 0] >= _SQUARE) & ~used)
    hazard = np.zeros(len(approaches))
    if limits is not None:
        hazard = push_hazard(limits, approaches, poses, recognition.anchor_mm, outcome)
    known = [contact.end_mm for contact in recognition.contacts if contact.touched]
    chosen: list[PredictedApproach] = []
    while len(rows) and (len(chosen) < _CHECKS or _hidden(outcome, reachable, chosen) > shift_mm):
        ends = _ends([reachable.approaches[k] for k in rows.tolist()], outcome.travel[rows, 0])
        away = np.linalg.norm(ends[:, None] - np.array(known), axis=2).min(axis=1)
        sides = meets_other_side(outcome.normal[:, 0], rows, [item.index for item in chosen])
        if sides.any():
            away = np.where(sides, away, 0.0)
        least = hazard[rows[away >= _ASIDE_MM]].min(initial=1.0)
        away = np.where(hazard[rows] <= least + _AS_SAFE, away, 0.0)
        best = int(np.argmax(away))
        if away[best] < _ASIDE_MM:
            break
        one = predict_approach(recognition, reachable, int(rows[best]))
        rows, ends = np.delete(rows, best), ends[best]
        if np.isfinite(one.predictions.latest[0, 0]) and fits_together(reachable, one, chosen):
            chosen.append(one)
            known.append((float(ends[0]), float(ends[1])))
    return make_grip(recognition, reachable, chosen, resolution, 1.0) if chosen else None


def _hidden(outcome: TouchOutcomes, reachable: Reachable, chosen: Sequence[PredictedApproach]) -> float:
    """How far a shift may go unnoticed by the chosen approaches (mm)."""
    rows = [item.index for item in chosen]
    direction = np.array([reachable.approaches[k].direction_rad for k in rows])
    predictions = Predictions.joined([item.predictions for item in chosen])
    return detectable_shift_mm(predictions, outcome.normal[rows, 0], direction)


def already_used(contacts: Sequence[Contact], candidates: Sequence[FingerApproach]) -> Bools:
    """Which candidates (n,) run along the path of a contact or a miss of the same kind of finger."""
    start, angle = approach_lines(candidates)
    used = np.zeros(len(candidates), dtype=bool)
    for contact in contacts:
        same = np.array([item.finger == contact.finger for item in candidates], dtype=bool)
        off = np.abs(offset_from_lines(start, angle, np.array(contact.end_mm)))
        turned = np.abs(wrap_angle(angle - contact.direction_rad))
        used |= same & (off < _SAME_LINE_MM) & (turned < _SAME_LINE_RAD)
    return used


def _ends(candidates: Sequence[FingerApproach], travel_mm: Floats) -> Floats:
    """Where tips (n, 2) are in W after a travel (n,) mm."""
    start, angle = approach_lines(candidates)
    result: Floats = start + travel_mm[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return result


def _meeting(recognition: Recognition, reachable: Reachable, used: Bools) -> Ints:
    """Candidates that have not been used and may meet what lies there, as far as some configurations tell."""
    poses = sampled_poses(recognition.hypotheses)
    approaches = reachable.approaches
    outcome = touch_outcomes(recognition.catalogue, poses.cells, recognition.anchor_mm, approaches)
    return np.flatnonzero(outcome.hit.any(axis=1) & ~used)


def _beside(recognition: Recognition, reachable: Reachable, rows: Ints) -> Ints:
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


def _first_together(
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
