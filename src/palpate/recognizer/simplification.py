"""Simplification of very fine outlines: runs of short edges replaced by one edge with slack.

Ten thousand edges of a tenth of a millimetre say no more than
two thousand do, and take their cube of interpretations to say it. How far a run strays from its chord, and
how much its normal turns, is kept with the chord as is done with arcs and their facets (memo §3.4: an edge
enclosed in a strip).
"""

import numpy as np
import shapely

from palpate.base.geometry import Floats, Ints
from palpate.base.geometry.plane import wrap_angle
from palpate.base.geometry.segments import cross
from palpate.recognizer.minkowski import GrownSection
from palpate.recognizer.tables import expand_ranges

__all__ = ["merge_runs", "simplify_outline"]

_FINEST_MM = 1e-3
_ROUGH_MM = 0.1


def simplify_outline(grown: GrownSection, most: int, fine_mm: float = 0.0) -> GrownSection:
    """The same outline in no more than `most` edges, if it has more and that can be done.

    Each ring keeps four edges at least. The stray allowed is doubled until the edges are few enough, up to
    the size of the outline. As long as it is no more than `fine_mm`, only a tenth of them are few enough.
    Where it has to be coarser than a rough surface is, a quarter as many edges are enough: more would only
    pair every contact with noise.
    """
    stray = _FINEST_MM
    size = float(np.ptp(grown.start, axis=0).max(initial=0.0))
    result = grown
    while len(result.length) > _enough(most, stray, fine_mm) and stray < size:
        result = merge_runs(grown, stray)
        stray *= 2
    return result


def _enough(most: int, stray_mm: float, fine_mm: float) -> int:
    if stray_mm <= fine_mm:
        return most // 10
    return most if stray_mm < _ROUGH_MM else most // 4


def merge_runs(grown: GrownSection, stray_mm: float) -> GrownSection:
    """Chords of runs of edges that stray from them by no more than `stray_mm`."""
    follows = np.all(grown.start == np.roll(grown.end, 1, axis=0), axis=1)
    begins = np.flatnonzero(~follows)
    begins = begins if len(begins) else np.zeros(1, np.int64)
    ends = np.append(begins[1:], len(grown.length))
    kept = [a + _corners(grown.start[a:b], stray_mm) for a, b in zip(begins, ends, strict=True)]
    first = np.concatenate(kept)
    count = np.diff(np.append(first, len(grown.length)))
    return _chords(grown, first, count)


def _corners(ring: Floats, stray_mm: float) -> Ints:
    """Indices of the ring's vertices that are kept (Douglas and Peucker), the first among them."""
    if len(ring) <= 4:
        return np.arange(len(ring))
    closed = np.vstack([ring, ring[:1]])
    half = len(ring) // 2
    kept = [_matched(closed[a : b + 1], stray_mm) + a for a, b in ((0, half), (half, len(ring)))]
    result = np.unique(np.concatenate(kept))
    result = result[result < len(ring)]
    if len(result) < 3:
        return np.arange(0, len(ring), -(-len(ring) // 4))
    return result


def _matched(line: Floats, stray_mm: float) -> Ints:
    """Indices of the vertices of a line that simplifying it keeps."""
    simple = shapely.get_coordinates(shapely.LineString(line).simplify(stray_mm, preserve_topology=False))
    found, at = [], 0
    for point in simple:
        at += int(np.argmax(np.all(line[at:] == point, axis=1)))
        found.append(at)
        at += 1
    return np.array(found, dtype=np.int64)


def _chords(grown: GrownSection, first: Ints, count: Ints) -> GrownSection:
    """One edge for each run of `count` (m,) edges from `first` (m,) on."""
    last = first + count - 1
    start, end = grown.start[first], grown.end[last]
    along = end - start
    length = np.hypot(*along.T)
    safe = np.where(length > 0, length, 1.0)
    direction = np.where(length[:, None] > 0, along / safe[:, None], grown.direction[first])
    run, edge = expand_ranges(first, count)
    rel = grown.start[edge] - start[run]
    along, inward = np.sum(rel * direction[run], axis=1), cross(direction[run], rel)
    turned = wrap_angle(_angle(grown.direction[edge]) - _angle(direction)[run])
    # An arc over a facet that is turned stands out along the chord, too.
    beyond = np.maximum(-along, along - length[run]) + grown.bulge[edge] * np.abs(np.sin(turned))
    out, back, bulge, dent, span = (np.zeros(len(first)) for _ in range(5))
    np.maximum.at(out, run, -inward)
    np.maximum.at(back, run, np.maximum(inward, beyond))
    np.maximum.at(bulge, run, grown.bulge[edge])
    np.maximum.at(dent, run, grown.dent[edge])
    np.maximum.at(span, run, np.abs(turned) + grown.span[edge])
    middle = first + count // 2
    return GrownSection(
        start=start,
        end=end,
        direction=direction,
        length=length,
        bulge=bulge + out,
        dent=dent + back,
        span=np.minimum(span, np.pi),
        feature=grown.feature[middle],
    )


def _angle(direction: Floats) -> Floats:
    return np.arctan2(direction[:, 1], direction[:, 0])
