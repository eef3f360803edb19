"""What a grip told: what it ruled out, what it narrowed, and how surely it would have told of a move.

Between the recogniser's answers before and after a grip and the loop that judges by them.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.recognizer import (
    Approach,
    Contact,
    Hypothesis,
    Predictions,
    Recognition,
    predict,
    unnoticed_shift_mm,
)

__all__ = ["extent_of", "foretold_by", "survives", "unnoticed_mm"]

_FURTHER_MM = 50.0  # than a finger got: it might have been stopped there


def foretold_by(before: Recognition, contacts: Sequence[Contact]) -> Predictions:
    """What was to be expected of the contacts before they were made, as they were made and measured."""
    approaches = [
        Approach(
            contact.finger,
            contact.start_mm,
            contact.direction_rad,
            contact.travel_mm + _FURTHER_MM,
            contact.free_path_bound_mm,
        )
        for contact in contacts
    ]
    return predict(before.catalogue, before.hypotheses, before.anchor_mm, approaches)


def unnoticed_mm(foretold: Predictions, contacts: Sequence[Contact]) -> float:
    """How far the part may have been shifted before this grip, though it came out as foretold."""
    rows = [k for k, contact in enumerate(contacts) if contact.touched]
    some = [contacts[k] for k in rows]
    return unnoticed_shift_mm(
        foretold.select(rows),
        np.array([contact.middle_normal_rad for contact in some]),
        np.array([contact.direction_rad for contact in some]),
    )


def extent_of(recognition: Recognition) -> tuple[float, float]:
    """Half-widths of all hypotheses' bounds, added up: position (mm) and orientation (rad)."""
    return (
        sum(item.bounds.position_half_mm for item in recognition.hypotheses),
        sum(item.bounds.orientation_half_rad for item in recognition.hypotheses),
    )


def survives(hypothesis: Hypothesis, recognition: Recognition) -> bool:
    """Whether some part of a hypothesis's region is still among the hypotheses."""
    return any(
        item.state_index == hypothesis.state_index and _overlap(item, hypothesis)
        for item in recognition.hypotheses
    )


def _overlap(a: Hypothesis, b: Hypothesis) -> bool:
    turn = 2 * math.pi / a.state.symmetry_order
    lo, hi = a.bounds.theta_rad
    other_lo, other_hi = b.bounds.theta_rad
    apart = abs(((lo + hi) / 2 - (other_lo + other_hi) / 2 + turn / 2) % turn - turn / 2)
    if apart > (hi - lo + other_hi - other_lo) / 2:
        return False
    if a.state.symmetry_order > 1:
        return True
    return all(
        p[0] <= q[1] and q[0] <= p[1]
        for p, q in ((a.bounds.x_mm, b.bounds.x_mm), (a.bounds.y_mm, b.bounds.y_mm))
    )
