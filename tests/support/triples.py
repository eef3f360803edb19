"""The closed-form model test as triples of half-planes: an oracle for the tests on two and three contacts.

By Helly's theorem and Farkas' lemma the half-planes of all contacts have a common point iff every positively
dependent triple of them allows one, and each triple is one arc of θ. The recogniser says the same in fewer
conditions (recognizer/model_test.py, recognizer/model_test.py).
"""

from itertools import product

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import cross


def _pair_triples() -> list[tuple[int, int, int]]:
    """Two half-planes that meet at a corner of one contact's rectangle, and one of the other contact's."""
    corners = [(0, 2), (0, 3), (1, 2), (1, 3)]
    one = [(a, b, 4 + c) for (a, b), c in product(corners, range(4))]
    return one + [(4 + a, 4 + b, c) for (a, b), c in product(corners, range(4))]


PAIR_TRIPLES: Ints = np.array(_pair_triples())
"""(32, 3) indices into the eight half-planes of two contacts: all triples that can rule a pairing out."""

TRIPLE_TRIPLES: Ints = np.array([(a, 4 + b, 8 + c) for a, b, c in product(range(4), repeat=3)])
"""(64, 3) indices into the twelve half-planes of three contacts: those that no pair of contacts holds."""


def triple_arcs(g: Floats, coefficients: Floats, triples: Ints) -> Floats:
    """The condition that each triple of half-planes puts on θ: (C, A, B) with C + A cos θ + B sin θ ≥ 0.

    g (n, m, 2), coefficients (n, m, 3), triples (t, 3); returns (n, t, 3). A triple that does not surround
    the origin says nothing: (1, 0, 0).
    """
    a, b, c = (g[:, triples[:, k]] for k in range(3))
    weight = np.stack([cross(b, c), cross(c, a), cross(a, b)], axis=2)
    tiny = 1e-12
    ccw, cw = np.all(weight >= -tiny, axis=2), np.all(weight <= tiny, axis=2)
    magnitude = np.where(ccw[..., None], np.maximum(weight, 0.0), np.maximum(-weight, 0.0))
    combined = np.einsum("ntk,ntkj->ntj", magnitude, coefficients[:, triples])
    silent = ~(ccw | cw)
    combined[silent] = (1.0, 0.0, 0.0)
    combined[..., 0] += 1e-9
    result: Floats = combined
    return result


def arc_hull(lo: Floats, hi: Floats, conditions: Floats) -> tuple[Floats, Floats]:
    """Narrow intervals [lo, hi] (n,) of θ to the hull of what every condition (n, t, 3) leaves of them.

    Each condition is C + A cos θ + B sin θ ≥ 0. Where nothing is left, lo > hi. The hull may hold
    orientations that are ruled out, never the other way about.
    """
    constant, a, b = conditions[..., 0], conditions[..., 1], conditions[..., 2]
    amplitude = np.hypot(a, b)
    ratio = constant / np.maximum(amplitude, 1e-300)
    always, never = ratio >= 1.0, ratio < -1.0
    half = np.arccos(np.clip(-ratio, -1.0, 1.0)) + 1e-12
    width = (hi - lo)[:, None]
    # The allowed arcs are [begin, begin + 2 half] and its copies a turn before and after, from lo on.
    begin = (np.arctan2(b, a) - half - lo[:, None]) % (2 * np.pi)
    tail = begin - 2 * np.pi + 2 * half
    reaches_lo, starts_inside = tail >= 0, begin <= width
    first = np.where(reaches_lo, 0.0, np.where(starts_inside, begin, np.inf))
    last = np.where(starts_inside, np.minimum(width, begin + 2 * half), np.minimum(width, tail))
    first = np.where(always, 0.0, np.where(never, np.inf, first)).max(axis=1, initial=0.0)
    last = np.where(always, width, np.where(never, -np.inf, last)).min(axis=1, initial=np.inf)
    return lo + first, np.minimum(hi, lo + last)
