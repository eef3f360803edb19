"""Push limits: which approaches may move a part otherwise than by sliding it, as tipping or rolling it."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from palpate.geometry import Floats, Ints
from palpate.recognizer.measurement_model import TouchOutcomes
from palpate.recognizer.poses import Poses
from palpate.recognizer.rays import Approach

__all__ = ["PushLimits", "push_hazard"]


class PushLimits(Protocol):
    """Heights up to which states of a catalogue may be pushed."""

    def safe_heights_mm(self, states: Ints) -> Floats:
        """Heights (n, D) up to which a push only slides states (n,), infinite if at all.

        Directions are inward normals of the surface that is pushed, at 2πk/D in the object frame.
        """
        ...


def push_hazard(
    limits: PushLimits, approaches: Sequence[Approach], poses: Poses, outcome: TouchOutcomes
) -> Floats:
    """Hazard (n,) of approaches, 0 to 1: share of their height that is above the safe one, over the poses.

    0 for one that can only slide the part, 1 for one under which it may roll away.
    """
    states, row = np.unique(poses.cells.state, return_inverse=True)
    table = limits.safe_heights_mm(states)
    if np.isinf(table).all():
        return np.zeros(len(approaches))
    count = table.shape[1]
    inward = outcome.normal + np.pi - poses.cells.lo
    column = np.round(inward * (count / (2 * np.pi))).astype(np.int64) % count
    height = np.array([item.finger.height_mm for item in approaches])[:, None]
    above = np.maximum(height - table[row, column], 0.0) / np.maximum(height, 1e-9)
    result: Floats = np.where(outcome.hit, above, 0.0) @ poses.weight
    return result
