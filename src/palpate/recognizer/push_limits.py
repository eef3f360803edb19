"""Push limits: which approaches may move a part: slide it, or worse, tip or roll it."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.measurement_model import TouchOutcomes
from palpate.recognizer.poses import Poses
from palpate.recognizer.rays import Approach

__all__ = ["PushLimits", "push_hazard"]


class PushLimits(Protocol):
    """How states of a catalogue may be pushed."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        """Heights (n, D) up to which a push only slides states (n,), infinite if at all.

        Directions are inward normals of the surface that is pushed, at 2πk/D in the object frame.
        """
        ...

    def slide_shares(self, states: Ints) -> Floats:
        """Share (n, 2) of what holds states (n,): what a touch through the middle takes of it, and what a mm
        off the middle adds; 0 where nothing is known to slide.
        """
        ...


def push_hazard(
    limits: PushLimits,
    approaches: Sequence[Approach],
    poses: Poses,
    anchor_mm: Floats,
    outcome: TouchOutcomes,
) -> Floats:
    """Hazard (n,) of approaches, 0 to 1, over the poses.

    0 for one that cannot move the part at all, 1 for one under which it may roll away: the share of its
    height that is above the safe one, or by how much it exceeds what holds the part, if that is more.
    """
    tipping = _tipping(limits, approaches, poses, outcome)
    result: Floats = (
        np.maximum(tipping, _sliding(limits, approaches, poses, anchor_mm, outcome)) @ poses.weight
    )
    return result


def _sliding(
    limits: PushLimits,
    approaches: Sequence[Approach],
    poses: Poses,
    anchor_mm: Floats,
    outcome: TouchOutcomes,
) -> Floats:
    """By how much (n, p) approaches exceed what holds the part, relative to what they take of it."""
    shares = limits.slide_shares(poses.cells.state)
    if not shares.any():
        return np.zeros(outcome.hit.shape)
    start = np.array([item.start_mm for item in approaches]) - anchor_mm
    along = np.array([[np.cos(item.direction_rad), np.sin(item.direction_rad)] for item in approaches])
    at = start[:, None] + np.where(outcome.hit, outcome.travel, 0.0)[..., None] * along[:, None]
    cos, sin = np.cos(poses.cells.lo), np.sin(poses.cells.lo)
    x = cos * at[..., 0] + sin * at[..., 1] - poses.cells.centre[:, 0]
    y = cos * at[..., 1] - sin * at[..., 0] - poses.cells.centre[:, 1]
    taken = shares[:, 0] + shares[:, 1] * np.hypot(x, y)
    return np.where(outcome.hit & (taken > 1.0), 1 - 1 / np.maximum(taken, 1.0), 0.0)


def _tipping(
    limits: PushLimits, approaches: Sequence[Approach], poses: Poses, outcome: TouchOutcomes
) -> Floats:
    """Share (n, p) of the approaches' height that is above the safe one."""
    states, row = np.unique(poses.cells.state, return_inverse=True)
    table = limits.safe_heights_mm(states)
    if np.isinf(table).all():
        return np.zeros(outcome.hit.shape)
    count = table.shape[1]
    inward = outcome.normal + np.pi - poses.cells.lo
    column = np.round(inward * (count / (2 * np.pi))).astype(np.int64) % count
    # A tip of some length may push with its upper end alone.
    height = np.array([item.finger.span_mm[1] for item in approaches])[:, None]
    above = np.maximum(height - table[row, column], 0.0) / np.maximum(height, 1e-9)
    return np.where(outcome.hit, above, 0.0)
