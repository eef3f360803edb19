"""The memo's three ways to get at more data (§3.2): from a recognition to a grip.

`random`: a new grip at random, among approaches that may meet something. `rotate`: every finger next to where
it touched last, as if the hand turned a little in contact. `planned`: what tells the hypotheses apart best.
"""

from collections.abc import Sequence

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.base.vocabulary import Strategy
from palpate.recognizer.contact import Contact
from palpate.recognizer.grips import (
    FingerApproach,
    Grip,
    PredictedApproach,
    Reachable,
    fits_together,
    make_grip,
    predict_approach,
)
from palpate.recognizer.measurement_model import Resolution, touch_outcomes
from palpate.recognizer.planner import plan_grip
from palpate.recognizer.poses import Goals, sampled_poses
from palpate.recognizer.push_limits import PushLimits
from palpate.recognizer.rays import approach_lines, offset_from_lines
from palpate.recognizer.recognition import Recognition

__all__ = ["already_used", "next_grip"]

_SAME_LINE_MM, _SAME_LINE_RAD = 1.0, 0.01
_ASIDE_MM = 3.0  # a touch nearer to an earlier one than this says little new
_LEVER_MM = 50.0  # makes turns and distances comparable, to see whose approach a contact was


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


def already_used(contacts: Sequence[Contact], candidates: Sequence[FingerApproach]) -> Bools:
    """Which candidates (n,) run along the path of a contact or a miss of the same kind of finger.

    A pad does if both ends of its face run along paths.
    """
    start, angle = approach_lines(candidates)
    half = np.array([item.finger.tip_radius_mm if item.finger.is_pad else 0.0 for item in candidates])
    left, right = np.zeros((2, len(candidates)), dtype=bool)
    for contact in contacts:
        same = np.array([item.finger.face_point == contact.finger for item in candidates], dtype=bool)
        same &= np.abs(wrap_angle(angle - contact.direction_rad)) < _SAME_LINE_RAD
        off = offset_from_lines(start, angle, np.array(contact.end_mm))
        left |= same & (np.abs(off - half) < _SAME_LINE_MM)
        right |= same & (np.abs(off + half) < _SAME_LINE_MM)
    result: Bools = left & right
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
