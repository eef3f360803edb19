"""Fewest touches that any strategy needs to single out one hypothesis and to place it: a lower bound.

Whoever knew what lies there would choose, of all approaches, a set of which each other pose that is possible
is told from the true one by at least one touch. How small such a set can be is a problem of set cover; its
linear relaxation bounds it from below (Chvátal 1979). A strategy that does not know needs as many at least.
Poses are sampled as the planner samples them, and told apart as it tells them apart; what confirms an answer
against things outside the catalogue comes on top.
"""

import math

import numpy as np

from palpate.base.geometry import Bools
from palpate.recognizer.planner import PERCEPTIBLE_SIMILARITY, Reachable
from palpate.recognizer.recognition import Recognition
from palpate.recognizer.touch_model import (
    Goals,
    Resolution,
    distances_between,
    near_equal,
    sampled_poses,
    similarity,
    touch_outcomes,
)

_ROUNDING = 1e-6


def fewest_touches(
    recognition: Recognition, reachable: Reachable, resolution: Resolution, goals: Goals, truth: int
) -> int:
    """Touches that any strategy needs after `recognition` if its hypothesis `truth` (index) is the true one.

    Until nothing else is left that some approach tells from it, nor a pose of its own further away than
    `goals` allow.
    """
    hypotheses = recognition.hypotheses
    poses = sampled_poses(hypotheses)
    others = np.arange(len(poses.owner))
    first = np.full(len(others), truth)  # a hypothesis's own configuration is sampled first
    wanted = ~near_equal(hypotheses, goals)[truth, poses.owner]
    # Bounds that meet the goals may hold what is two of their half-widths away.
    away, turned = distances_between(poses, hypotheses, first, others)
    wanted |= (away > 2 * goals.position_mm) | (turned > 2 * goals.orientation_rad)
    if not wanted.any():
        return 0
    catalogue, rows = recognition.catalogue, np.arange(len(reachable.approaches))
    outcome = touch_outcomes(catalogue, poses.cells, recognition.anchor_mm, reachable.approaches)
    alike = similarity(outcome, first[wanted], others[wanted], resolution, rows)
    return smallest_cover_bound(alike < PERCEPTIBLE_SIMILARITY)


def smallest_cover_bound(covers: Bools) -> int:
    """Bound on the number of rows of `covers` (n, q) that together cover all columns that any covers."""
    from scipy.optimize import linprog  # noqa: PLC0415  (slow to import)

    sets = np.unique(covers[:, covers.any(axis=0)], axis=0)
    if not sets.size:
        return 0
    if sets.all(axis=1).any():
        return 1
    found = linprog(np.ones(len(sets)), -sets.T.astype(float), -np.ones(sets.shape[1]), bounds=(0, 1))
    assert found.fun is not None, "all rows together cover every column"
    return math.ceil(found.fun - _ROUNDING)
