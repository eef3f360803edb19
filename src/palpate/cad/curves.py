"""Curves of drawings, and their approximation by chords.

Two kinds are enough for all that DXF and SVG know: arcs of ellipses, and Bézier curves with weights (a line
is one of degree 1; a NURBS falls into them by knot insertion). Chords have their ends on the curve. No point
of the curve is further than the stated deviation from its chord, and no normal of it differs by more than
asin(4 · deviation / length of the chord) from the chord's: what `CrossSection` promises of an edge.

Proofs. *Arc of an ellipse*, semi-axes a ≥ b, a chord over the parameter h: it is the affine image of an arc
of the unit circle, which deviates by 1 − cos(h/2); images of distances grow at most a-fold. The sine of the
angle between tangent and chord is at most 2a sin²(h/2) / length of the chord; a quarter of that times the
length, a/2 · sin²(h/2), is at most a (1 − cos(h/2)). *Bézier curve*: each point is a weighted mean of the
control points, so its distance from the chord is at most that of the furthest one, times 1 − 2^(1−n) where
the weights are equal (the first and last, on the chord, have at least 2^(1−n) of the mean's weight); each
tangent is a combination with positive factors of the legs of the control polygon, so its direction lies
between theirs (Floater, Derivatives of rational Bézier curves, CAGD 9, 1992).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.base.geometry.plane import turn_between

MAX_CHORD_TURN_RAD = math.radians(10.0)
"""By so much a curve may turn within a chord, unless that is shorter than the tolerance."""

_STRAIGHT_BULGE = 1e-7


@dataclass(frozen=True, eq=False)
class Arc:
    """centre + cos(t) · axes[0] + sin(t) · axes[1] for t from start_rad to start_rad + sweep_rad.

    `centre` (2,), `axes` (2, 2), mm; the axes need not be perpendicular. |sweep_rad| ≤ 2π.
    """

    centre: Floats
    axes: Floats
    start_rad: float
    sweep_rad: float


@dataclass(frozen=True, eq=False)
class Bezier:
    """Control points (n + 1, 2), mm, and their positive weights (n + 1,)."""

    points: Floats
    weights: Floats


DrawnCurve = Arc | Bezier


def bezier(points: Floats) -> Bezier:
    """The control points (n + 1, 2) with equal weights; two of them make a straight line."""
    return Bezier(points, np.ones(len(points)))


def bulge_curve(start: Floats, end: Floats, value: float) -> DrawnCurve:
    """The edge of a polyline from start to end (2,) with a bulge: tan(sweep / 4), positive to the left.

    Source: DXF reference, LWPOLYLINE, group code 42.
    """
    if value == 0:
        return bezier(np.array([start, end]))
    chord = end - start
    left = np.array([-chord[1], chord[0]])
    middle = (start + end) / 2
    if abs(value) < _STRAIGHT_BULGE:
        # The circle's centre is too far away to compute with; the parabola of this height is the same.
        return bezier(np.array([start, middle - value * left, end]))
    centre = middle + left * (1 - value * value) / (4 * value)
    first = start - centre
    return Arc(centre, np.array([first, [-first[1], first[0]]]), 0.0, 4 * math.atan(value))


def spline(degree: int, points: Floats, weights: Floats, knots: Floats) -> tuple[Bezier, ...]:
    """The Bézier curves that a NURBS consists of, by blossoming.

    `points` (n, 2), positive `weights` (n,), `knots` (n + degree + 1,), not decreasing. Its domain is from
    knots[degree] to knots[n]. Source: Ramshaw, Blossoms are polar forms, CAGD 6, 1989.
    """
    control = np.column_stack([points * weights[:, None], weights])
    found = []
    for k in range(degree, len(points)):
        lo, hi = knots[k], knots[k + 1]
        if lo == hi:
            continue
        at = np.where(np.arange(degree)[None] < np.arange(degree + 1)[:, None], hi, lo)
        values = np.repeat(control[None, k - degree : k + 1], degree + 1, axis=0)
        for r in range(1, degree + 1):
            i = np.arange(k - degree + r, k + 1)
            share = ((at[:, r - 1 : r] - knots[i]) / (knots[i + degree - r + 1] - knots[i]))[..., None]
            values[:, r:] = (1 - share) * values[:, r - 1 : -1] + share * values[:, r:]
        own = values[:, degree]
        found.append(Bezier(own[:, :-1] / own[:, -1:], own[:, -1].copy()))
    return tuple(found)


def transform_curve(curve: DrawnCurve, matrix: Floats, shift: Floats) -> DrawnCurve:
    """The curve of the points matrix (2, 2) @ p + shift (2,)."""
    if isinstance(curve, Arc):
        return Arc(matrix @ curve.centre + shift, curve.axes @ matrix.T, curve.start_rad, curve.sweep_rad)
    return Bezier(curve.points @ matrix.T + shift, curve.weights)


def control_hull(curve: DrawnCurve) -> Floats:
    """Points (k, 2) whose convex hull holds the curve."""
    if isinstance(curve, Arc):
        corners = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])
        around: Floats = curve.centre + corners @ curve.axes
        return around
    return curve.points


def chords(curve: DrawnCurve, curve_mm: float) -> tuple[Floats, float]:
    """Points (k, 2) of the curve from its start to its end, and by how much it leaves their chords, mm.

    That is at most `curve_mm`. Raises InputError where `curve_mm` is not positive.
    """
    if not curve_mm > 0:
        raise InputError(f"the tolerance for curves must be more than 0 mm, not {curve_mm:g} mm")
    return _arc_chords(curve, curve_mm) if isinstance(curve, Arc) else _bezier_chords(curve, curve_mm)


def _arc_chords(arc: Arc, curve_mm: float) -> tuple[Floats, float]:
    largest = float(np.linalg.norm(arc.axes, 2))
    step = MAX_CHORD_TURN_RAD
    if curve_mm < largest:
        # The deviation a (1 − cos(h/2)) = 2a sin²(h/4), without loss of digits.
        step = min(step, 4 * math.asin(math.sqrt(curve_mm / (2 * largest))))
    count = max(1, math.ceil(abs(arc.sweep_rad) / step - 1e-9))
    at = arc.start_rad + arc.sweep_rad * np.linspace(0.0, 1.0, count + 1)
    while True:
        points = arc.centre + np.cos(at)[:, None] * arc.axes[0] + np.sin(at)[:, None] * arc.axes[1]
        along = np.cos(at)[:, None] * arc.axes[1] - np.sin(at)[:, None] * arc.axes[0]
        turn = np.abs(turn_between(along[:-1], along[1:]))
        long = np.hypot(*np.diff(points, axis=0).T) > curve_mm
        sharp = np.flatnonzero((turn > MAX_CHORD_TURN_RAD * (1 + 1e-9)) & long)
        if not len(sharp):
            break
        at = np.insert(at, sharp + 1, (at[sharp] + at[sharp + 1]) / 2)
    if abs(arc.sweep_rad) == 2 * math.pi:
        points[-1] = points[0]
    return points, 2 * largest * math.sin(float(np.abs(np.diff(at)).max()) / 4) ** 2


def _bezier_chords(curve: Bezier, curve_mm: float) -> tuple[Floats, float]:
    if len(curve.points) == 2:
        return curve.points, 0.0
    pieces = np.column_stack([curve.points * curve.weights[:, None], curve.weights])[None]
    even = bool(np.all(curve.weights == curve.weights[0]))
    while True:
        off, turn, length = _bounds(pieces, even)
        coarse = (off > curve_mm) | ((turn > MAX_CHORD_TURN_RAD) & (length > curve_mm))
        if not coarse.any():
            break
        kept = np.repeat(pieces, np.where(coarse, 2, 1), axis=0)
        first = (np.arange(len(pieces)) + np.cumsum(coarse) - coarse)[coarse]
        kept[first], kept[first + 1] = _halves(pieces[coarse])
        pieces = kept
    ends = np.concatenate([pieces[:, 0], pieces[-1:, -1]])
    points = ends[:, :2] / ends[:, 2:]
    # As given, not as divided by a weight.
    points[0], points[-1] = curve.points[0], curve.points[-1]
    return points, float(off.max())


def _bounds(pieces: Floats, even: bool) -> tuple[Floats, Floats, Floats]:
    """Deviation from the chord, turn and length of the legs of pieces (k, n + 1, 3), homogeneous."""
    points = pieces[..., :2] / pieces[..., 2:]
    start, chord = points[:, :1], points[:, -1:] - points[:, :1]
    square = np.sum(chord * chord, axis=2)
    rest = points - start
    share = np.sum(rest * chord, axis=2) / np.where(square > 0, square, 1.0)
    away = rest - np.clip(share, 0.0, 1.0)[..., None] * chord
    degree = pieces.shape[1] - 1
    off = np.hypot(away[..., 0], away[..., 1]).max(axis=1) * (1 - 0.5 ** (degree - 1) if even else 1.0)
    legs = np.diff(points, axis=1)
    lengths = np.hypot(legs[..., 0], legs[..., 1])
    angles = turn_between(np.broadcast_to(chord, legs.shape), legs)
    most = np.abs(angles).max(axis=1)
    sine = np.where((most < math.pi / 2) & (square[:, 0] > 0), np.sin(most), 1.0)
    off = np.maximum(off, np.sqrt(square[:, 0]) / 4 * sine)
    return off, angles.max(axis=1) - angles.min(axis=1), lengths.sum(axis=1)


def _halves(pieces: Floats) -> tuple[Floats, Floats]:
    """Both halves of pieces (k, n + 1, 3), by de Casteljau's construction."""
    left, right = [], []
    rows = pieces
    while rows.shape[1]:
        left.append(rows[:, 0])
        right.append(rows[:, -1])
        rows = (rows[:, :-1] + rows[:, 1:]) / 2
    return np.stack(left, axis=1), np.stack(right[::-1], axis=1)


def chords_of_chain(curves: Sequence[DrawnCurve], curve_mm: float) -> tuple[Floats, float, float]:
    """Chords of curves that follow each other: points (k, 2), deviation, and the widest gap between them."""
    parts: list[Floats] = []
    off = gap = 0.0
    for curve in curves:
        points, own = chords(curve, curve_mm)
        if parts:
            gap = max(gap, math.dist(parts[-1][-1], points[0]))
            points = points[1:]
        parts.append(points)
        off = max(off, own)
    return np.concatenate(parts), off, gap
