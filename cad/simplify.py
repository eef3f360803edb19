"""Outlines with as few edges as a budget allows, in the recogniser's sense of being off.

From rings of a slice to the regions of a cross section. An edge of length L stands for a run of true edges as
well as the recogniser's tolerance δ says: they lie within δ of it and their normals differ by at most
asin(4δ/L). So a chord costs the greater of the run's distance and of L/4 times the sine of the angle between
normals, and a step of 0.03 mm in a long wall stays, because its riser cannot pass for the wall.
"""

import numpy as np

from palpate.cad.values import Floats, Ints

__all__ = ["simplified", "turned", "wrapped"]

_MOST_PAIRS = 2_000_000


def wrapped(angle: Floats) -> Floats:
    """Angles in [−π, π)."""
    result: Floats = (angle + np.pi) % (2 * np.pi) - np.pi
    return result


def turned(angle: Floats) -> Floats:
    """The share of an edge's length, times four, that lets its normal turn by `angle` ≥ 0."""
    result: Floats = np.where(angle < np.pi / 2, np.sin(np.minimum(angle, np.pi / 2)), 1.0)
    return result


def simplified(points: Floats, heading: Floats, bare: Floats, budget_mm: float) -> Ints:
    """Which points (k,) of a ring (n, 2) to keep, ascending, so that no chord costs more than the budget.

    `heading` (n,) rad: of the outward normal of the edge after each point, unless it is `bare`. Starts at
    the sharpest corner. Fewer than three are left of a ring that is no wider than the budget.
    """
    count = len(points)
    if count < 4:
        return np.arange(count)
    bend = np.abs(wrapped(heading - np.roll(heading, 1)))
    begin = int(bend.argmax())
    ring = np.roll(points, -begin, axis=0)
    reach = _reach(ring, np.roll(heading, -begin), np.roll(bare, -begin), budget_mm).tolist()
    kept = []
    at = 0
    while at < count:
        kept.append(at)
        at += reach[at]
    return np.sort((np.array(kept) + begin) % count)


def _reach(ring: Floats, heading: Floats, bare: Floats, budget_mm: float) -> Ints:
    """How many edges (n,) from each point on one chord may stand for; none passes the first point."""
    count = len(ring)
    most = count - np.arange(count)
    good = np.ones(count, dtype=np.int64)
    bad = most + 1
    step = np.minimum(2, most)
    open_ = np.flatnonzero(bad - good > 1)
    while len(open_) and step[open_].sum() < _MOST_PAIRS:
        fits = _costs(ring, heading, bare, open_, step[open_]) <= budget_mm
        good[open_[fits]] = step[open_[fits]]
        bad[open_[~fits]] = step[open_[~fits]]
        doubled = np.minimum(2 * good, most)
        step = np.where(doubled < bad, doubled, (good + bad) // 2)
        open_ = open_[bad[open_] - good[open_] > 1]
    return good


def _costs(ring: Floats, heading: Floats, bare: Floats, start: Ints, step: Ints) -> Floats:
    """What the chords from points `start` (k,) over `step` (k,) edges each cost."""
    count = len(ring)
    chord = ring[(start + step) % count] - ring[start]
    length = np.hypot(*chord.T)
    owner = np.repeat(np.arange(len(start)), step)
    first = np.cumsum(step) - step
    edge = start[owner] + np.arange(len(owner)) - first[owner]
    away = ring[edge] - ring[start[owner]]
    unit = (chord / np.maximum(length, 1e-300)[:, None])[owner]
    along = np.clip(np.sum(away * unit, axis=1), 0.0, length[owner])
    distance = np.hypot(*(away - along[:, None] * unit).T)
    normal = np.arctan2(-unit[:, 0], unit[:, 1])
    turn = np.where(bare[edge], 0.0, np.abs(wrapped(heading[edge] - normal)))
    cost = np.maximum(distance, length[owner] * turned(turn) / 4)
    result: Floats = np.maximum.reduceat(cost, first)
    return result
