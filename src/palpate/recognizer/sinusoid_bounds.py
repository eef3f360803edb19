"""Bounds of sinusoids: conditions lo ≤ a cos(θ − φ) ≤ hi on θ, and maxima over an interval.

All that position constraints say of θ has this form, because positions in the object's frame turn with θ.
"""

import numpy as np

from palpate.base.geometry import Floats

__all__ = ["clip_to_sinusoids", "sinusoid_maximum"]

_ROUNDING_RAD = 1e-12


def clip_to_sinusoids(
    lo: Floats, hi: Floats, crest: Floats, least: Floats, most: Floats, height: Floats | float
) -> tuple[Floats, Floats]:
    """Hull of the θ in [lo, hi] (n,) with least ≤ height·cos(θ − crest) ≤ most, each (k, n), for all k.

    Where nothing is left, lo > hi. The hull may hold orientations that are ruled out, never the other way
    about.
    """
    scale = np.maximum(height, 1e-9)
    least, most = least / scale, most / scale
    # |θ − crest| must lie between these two.
    nearest = np.arccos(np.clip(most, -1.0, 1.0)) - _ROUNDING_RAD
    furthest = np.arccos(np.clip(least, -1.0, 1.0)) + _ROUNDING_RAD
    never = (most < -1.0) | (least > 1.0)
    # The allowed set is even about the crest: going down from hi is going up from −hi.
    first = np.where(never, np.inf, _advance_to_allowed(lo - crest, nearest, furthest)).max(axis=0)
    last = np.where(never, np.inf, _advance_to_allowed(crest - hi, nearest, furthest)).max(axis=0)
    return lo + first, hi - last


def _advance_to_allowed(angle: Floats, nearest: Floats, furthest: Floats) -> Floats:
    """How far up from `angle` the first angle with nearest ≤ |angle| ≤ furthest (modulo 2π) is."""
    begin = angle - 2 * np.pi * np.rint(angle / (2 * np.pi))
    at = np.maximum(begin, -furthest)
    at = np.where((at > -nearest) & (at < nearest), nearest, at)
    at = np.where(at > furthest, 2 * np.pi - furthest, at)
    return at - begin


def sinusoid_maximum(a: Floats, b: Floats, lo: Floats, hi: Floats) -> Floats:
    """Maximum of a cos θ + b sin θ over [lo, hi]; a and b of one shape, lo and hi broadcast to it.

    Never too small; over half a turn and more the amplitude stands for it.
    """
    cos_lo, sin_lo, cos_hi, sin_hi = np.cos(lo), np.sin(lo), np.cos(hi), np.sin(hi)
    at_ends = np.maximum(a * cos_lo + b * sin_lo, a * cos_hi + b * sin_hi)
    # Inside, where the wave still rises at lo and falls at hi, is the crest.
    crest = ((b * cos_lo > a * sin_lo) & (b * cos_hi < a * sin_hi)) | (hi - lo >= np.pi)
    return np.where(crest, np.sqrt(a * a + b * b), at_ends)
