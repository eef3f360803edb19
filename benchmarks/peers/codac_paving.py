"""codac: guaranteed enclosure of all poses of each model, by interval paving (`pave` with contractors).

A pose is possible while each touch is in the rectangle round some edge of the grown outline whose normal its
range allows. Boxes of the paving that cannot be excluded hold all solutions: like palpate, and unlike all
other peers here, codac proves that there are no more. To be fair to it, a paving is begun for each edge of
the first touch, in the box of poses that this edge leaves, and with those edges of other touches only that
are consistent with it (`correspondence`): many times as quick as one paving of everything. Boxes that touch
are one answer.
"""

import ctypes
import ctypes.util
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import reduce

import numpy as np
from correspondence import Features, adjacency
from outline import QUAD_SEGMENTS, Outline, Ring, bulge_mm
from question import Answer, Model, Peer, Solve, Touch
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

_LIBM = ctypes.CDLL(ctypes.util.find_library("m"))
_NEAREST = _LIBM.fegetround()

import codac  # noqa: E402 (from its import on the processor rounds upward)

_UPWARD = _LIBM.fegetround()
_LIBM.fesetround(_NEAREST)

LEVER_MM = 20.0  # θ times this is a length like x and y
RESOLUTION_MM = 0.25
SPAN_RAD = math.pi / 4 / QUAD_SEGMENTS


@contextmanager
def rounding_upward() -> Iterator[None]:
    """As codac's intervals need it. Not for shapely: it then grows outlines wrongly, by millimetres."""
    _LIBM.fesetround(_UPWARD)
    try:
        yield
    finally:
        _LIBM.fesetround(_NEAREST)


def prepare(models: Sequence[Model]) -> Solve:
    outlines = [Outline.of(model) for model in models]
    ready: dict[float, list[Features]] = {}

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        radius = touches[0].radius_mm
        found = []
        for features in ready.setdefault(radius, [Features.of(item, radius) for item in outlines]):
            boxes = paved(features, touches)
            if len(boxes):
                found += answers(features.outline, touches, boxes)
        return found

    return solve


def paved(features: Features, touches: Sequence[Touch]) -> np.ndarray:
    """Boxes (m, 3, 2) that hold all poses."""
    ring = features.ring
    count = len(ring.normal)
    fits = adjacency(features, touches).reshape(len(touches), count, len(touches), count)
    boxes = []
    for edge in range(count):
        others = [np.flatnonzero(fits[0, edge, number]) for number in range(1, len(touches))]
        if not all(len(edges) for edges in others):
            continue
        with rounding_upward():
            parts = [
                reduce(codac.CtcUnion, [on_edge(ring, touch, other) for other in edges])
                for touch, edges in zip(touches, [[edge], *others], strict=True)
            ]
            paving = codac.pave(
                first_box(ring, touches[0], edge), reduce(codac.CtcInter, parts), RESOLUTION_MM
            )
            boxes += [
                [(side.lb(), side.ub()) for side in box]
                for box in paving.boxes(codac.PavingOut.outer)
                if not box.is_empty()
            ]
    return np.array(boxes)


def on_edge(ring: Ring, touch: Touch, edge: int) -> codac.Ctc_IntervalVector:
    """Contracts to where the touch is in an edge's rectangle, and the edge's normal in the touch's range.

    As (x, y, θ·lever) ↦ how far the touch is outward and along, and the cosine of the normal's turn.
    """
    at = codac.VectorVar(3)
    x, y = touch.centre_mm[0] - at[0], touch.centre_mm[1] - at[1]
    turn = at[2] / LEVER_MM + float(ring.normal[edge])
    cos, sin = codac.cos(turn), codac.sin(turn)
    outward = np.array([np.cos(ring.normal[edge]), np.sin(ring.normal[edge])])
    aside = float(outward @ ring.begin[edge])
    ahead = float(np.array([-outward[1], outward[0]]) @ ring.begin[edge])
    bound, half = touch.bound_mm, half_width(touch)
    ranges = [
        (cos * x + sin * y, aside - bound, aside + bound + bulge_mm(touch.radius_mm)),
        (cos * y - sin * x, ahead - bound, ahead + float(ring.length[edge]) + bound),
    ]
    if half < math.pi:
        ranges.append((codac.cos(turn - touch.middle_rad), math.cos(half), 2.0))
    return reduce(
        codac.CtcInter,
        [
            codac.CtcInverse(codac.AnalyticFunction([at], value), codac.Interval(low, high))
            for value, low, high in ranges
        ],
    )


def half_width(touch: Touch) -> float:
    """Half width of the orientations at which an edge's normal, or its arc's, is allowed."""
    return touch.half_rad + (SPAN_RAD if touch.radius_mm > 0 else 0.0)


def first_box(ring: Ring, touch: Touch, edge: int) -> codac.IntervalVector:
    """All poses of one touch on one edge: p = P − R(θ) q, with intervals."""
    points = np.array([ring.begin[edge], ring.end[edge]])
    bound = touch.bound_mm + bulge_mm(touch.radius_mm)
    low, high = points.min(0) - bound, points.max(0) + bound
    q = [codac.Interval(float(a), float(b)) for a, b in zip(low, high, strict=True)]
    middle, half = touch.middle_rad - float(ring.normal[edge]), half_width(touch)
    turn = codac.Interval(middle - half, middle + half)
    cos, sin = codac.cos(turn), codac.sin(turn)
    x = touch.centre_mm[0] - cos * q[0] + sin * q[1]
    y = touch.centre_mm[1] - sin * q[0] - cos * q[1]
    return codac.IntervalVector([x, y, turn * LEVER_MM])


def answers(outline: Outline, touches: Sequence[Touch], boxes: np.ndarray) -> list[Answer]:
    """One answer for boxes that touch one another; its pose is the middle of one that satisfies the touches.

    A group without such a middle is an answer all the same: codac has not excluded it.
    """
    boxes = boxes / np.array([1.0, 1.0, LEVER_MM])[:, None]
    found = []
    for group in groups(boxes):
        held = boxes[group]
        poses = held.mean(axis=2)
        good = outline.satisfied(touches, poses)
        x, y, theta = poses[np.argmax(good)]
        low, high = held[..., 0].min(0), held[..., 1].max(0)
        box = tuple((float(a), float(b)) for a, b in zip(low, high, strict=True))
        found.append(Answer(outline.name, (float(x), float(y), float(theta)), box))
    return found


def groups(boxes: np.ndarray) -> list[np.ndarray]:
    """Indices of the boxes of every connected set; θ as it was paved, with no turn of 2π between."""
    low, high = boxes[..., 0], boxes[..., 1]
    turn = np.round((high[:, None, 2] - high[None, :, 2]) / (2 * np.pi)) * 2 * np.pi
    meet = np.abs(turn) < 1e-9
    for axis in range(3):
        meet &= low[:, None, axis] <= high[None, :, axis] + 1e-9
        meet &= low[None, :, axis] <= high[:, None, axis] + 1e-9
    count, label = connected_components(coo_array(meet), directed=False)
    return [np.flatnonzero(label == number) for number in range(count)]


PEER = Peer(prepare, ("codac", "numpy", "scipy", "shapely"))
