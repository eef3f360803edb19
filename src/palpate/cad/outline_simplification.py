"""Simplification of outlines: as few edges as a budget allows, in the recogniser's sense of being off.

An edge of length L stands for a run of true edges as well as the recogniser's tolerance δ says: they lie
within δ of it and their normals differ by at most asin(4δ/L). So a chord costs the greater of the run's
distance and of L/4 times the sine of the angle between normals, and a step of 0.03 mm in a long wall stays,
because its riser cannot pass for the wall.
"""

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import cross

_STRAIGHT_SINE = 1e-7
"""Sine of the turn between facets of one plane, or next to it."""
_GUESS_FACTORS = np.array([0.7, 0.9, 0.96, 1.0, 1.04, 1.12, 1.4])
_SHORT_EDGES = 8
"""Chords over so many edges are tried from every point at once."""
_REACH_FRACTION = 32
"""A chord is as long as it may be within this part of it."""


def normal_mismatch(normal: Floats, other: Floats) -> Floats:
    """4δ/L that lets an edge's normal (n, 2) turn to another: the sine of the angle, or 1 beyond 90°."""
    across = np.abs(cross(normal, other))
    return np.where(normal[:, 0] * other[:, 0] + normal[:, 1] * other[:, 1] > 0, across, 1.0)


def simplify_ring(points: Floats, normal: Floats, bare: Bools, budget_mm: float) -> Ints:
    """Choose points (k,) of a ring (n, 2), ascending, so that no chord costs more than the budget.

    `normal` (n, 2): the outward unit normal of the edge after each point, unless it is `bare`. Points in a
    straight line go in any case; a budget of 0 keeps all others. Starts at the sharpest corner. Fewer than
    three are left of a ring that is no wider than the budget.
    """
    bent = np.flatnonzero(_bends(normal, bare))
    if len(bent) < 4 or budget_mm <= 0:
        return bent if len(bent) > 2 else np.arange(len(points))
    return bent[_fewest_points(points[bent], normal[bent], bare[bent], budget_mm)]


def _bends(normal: Floats, bare: Bools) -> Bools:
    """Mark corners of a ring (n,), however slight: facets of one plane leave points in a straight line."""
    before, bare_before = np.roll(normal, 1, axis=0), np.roll(bare, 1)
    result: Bools = (normal_mismatch(normal, before) > _STRAIGHT_SINE) | bare | bare_before
    return result


def _fewest_points(points: Floats, normal: Floats, bare: Bools, budget_mm: float) -> Ints:
    count = len(points)
    if count < 4:
        return np.arange(count)
    begin = int(np.sum(normal * np.roll(normal, 1, axis=0), axis=1).argmin())
    ring = np.roll(points, -begin, axis=0)
    normals, bares = np.roll(normal, -begin, axis=0), np.roll(bare, -begin)
    short = _short_reach(ring, normals, bares, budget_mm)
    kept = []
    at, step = 0, _SHORT_EDGES
    while at < count:
        kept.append(at)
        if short[at] < _SHORT_EDGES or at + _SHORT_EDGES >= count:
            at += short[at]
        else:
            step = _long_reach(ring, normals, bares, budget_mm, at, step)
            at += step
    return np.sort((np.array(kept) + begin) % count)


def _short_reach(ring: Floats, normal: Floats, bare: Bools, budget_mm: float) -> list[int]:
    """Over how many edges a chord from each point may go: no more than `_SHORT`, and not past the end."""
    count = len(ring)
    reach = np.ones(count, dtype=np.int64)
    left = np.arange(count)
    # Most chords are short: longer ones are only tried from where those before them fit.
    for steps in (np.arange(2, 4), np.arange(4, _SHORT_EDGES + 1)):
        start, step = np.repeat(left, len(steps)), np.tile(steps, len(left))
        fits = _chord_costs(ring, normal, bare, start, step) <= budget_mm
        fits &= start + step <= count
        longer = np.cumprod(fits.reshape(len(left), len(steps)), axis=1).sum(axis=1)
        reach[left] += longer
        left = left[longer == len(steps)]
        if not len(left):
            break
    result: list[int] = reach.tolist()
    return result


def _long_reach(ring: Floats, normal: Floats, bare: Bools, budget_mm: float, start: int, guess: int) -> int:
    """Over how many edges a chord from `start` may go, at least `_SHORT`; looked for about a guess first."""
    most = len(ring) - start
    good, bad = _SHORT_EDGES, most + 1
    tries = np.unique(np.clip(np.round(guess * _GUESS_FACTORS), _SHORT_EDGES, most).astype(np.int64))
    while True:
        fits = _chord_costs(ring, normal, bare, np.full(len(tries), start), tries) <= budget_mm
        fail = len(tries) if fits.all() else int(fits.argmin())
        good = max(good, int(tries[fail - 1])) if fail else good
        bad = min(bad, int(tries[fail])) if fail < len(tries) else bad
        if bad - good <= 1 + good // _REACH_FRACTION:
            return good
        end = min(bad - 1, 4 * good)
        tries = np.unique(np.linspace(good + 1, end, 6).astype(np.int64))


def _chord_costs(ring: Floats, normal: Floats, bare: Bools, start: Ints, step: Ints) -> Floats:
    """Cost of each chord from points `start` (k,) over `step` (k,) edges."""
    count = len(ring)
    chord = ring[(start + step) % count] - ring[start]
    length = np.hypot(*chord.T)
    owner = np.repeat(np.arange(len(start)), step)
    first = np.cumsum(step) - step
    edge = (start[owner] + np.arange(len(owner)) - first[owner]) % count
    away = ring[edge] - ring[start[owner]]
    unit = (chord / np.maximum(length, 1e-300)[:, None])[owner]
    along = away[:, 0] * unit[:, 0] + away[:, 1] * unit[:, 1]
    beyond = along - np.clip(along, 0.0, length[owner])
    distance = np.hypot(cross(away, unit), beyond)
    turn = normal_mismatch(normal[edge], np.stack([unit[:, 1], -unit[:, 0]], axis=1))
    cost = np.maximum(distance, np.where(bare[edge], 0.0, length[owner] / 4 * turn))
    result: Floats = np.maximum.reduceat(cost, first)
    return result
