"""Stops of rays with NumPy: earliest, latest, furthest, and the normals that they may have there."""

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.recognizer.approach import EdgeCapsules, Facing, Rays, capsules_of, split_rays
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.strip_trees import StripForest


def enclose_stops(edges: EdgeSet, strips: StripForest, rays: Rays, facing: Facing) -> Floats:
    """As `palpate.recognizer.steps.Steps` has it."""
    parts, begin = [], 0
    for some in split_rays(edges, strips, rays):
        piece = slice(begin, begin + len(some))
        begin = piece.stop
        parts.append(_enclose(edges, capsules_of(edges, strips, some), facing.select(piece)))
    return np.concatenate(parts, axis=1)


def _enclose(edges: EdgeSet, met: EdgeCapsules, facing: Facing) -> Floats:
    edge: Ints = np.maximum(met.edge, 0)
    lean, vague = facing.lean, facing.vague
    off = wrap_angle(edges.normal_rad[edge] - facing.against[:, None])
    spread = edges.span[edge] + facing.half_width[:, None] + 1e-9
    stops = met.touchable & (met.edge >= 0) & (met.enter <= met.latest[:, None])
    stops &= vague[:, None] | (np.abs(off) - spread <= lean[:, None])
    leave = np.minimum(met.leave, met.latest[:, None])
    furthest = np.where(stops, leave, -np.inf).max(axis=1, initial=-np.inf)
    lo = np.where(stops, off - spread, np.inf).min(axis=1, initial=np.inf)
    hi = np.where(stops, off + spread, -np.inf).max(axis=1, initial=-np.inf)
    lo, hi = np.maximum(lo, -lean), np.minimum(hi, lean)
    lo, hi = np.where(vague, -np.pi, lo), np.where(vague, np.pi, hi)
    return np.stack([met.earliest, met.latest, furthest, lo, hi])
