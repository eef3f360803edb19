"""Correspondence graph: pairings of a touch with an edge, linked where two of them are consistent.

A clique with a pairing for every touch is an interpretation (Bolles and Cain 1982). Two peers look for
cliques with others' programs; what is before and after that is here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from outline import QUAD_SEGMENTS, Outline, Ring, bulge_mm, distinct
from question import Answer, Model, Solve, Touch, angle_between

__all__ = ["clique_solver"]

STEPS = 30

Cliques = Callable[[np.ndarray, int], list[list[int]]]
"""From an adjacency matrix (v, v) of bools and a size: all cliques of that size, as lists of nodes."""


@dataclass(frozen=True)
class Features:
    """A grown outline's edges, and the shortest and longest distance (n, n) of points of any two."""

    outline: Outline
    ring: Ring
    shortest: np.ndarray
    longest: np.ndarray

    @classmethod
    def of(cls, outline: Outline, radius_mm: float) -> "Features":
        ring = outline.grown(radius_mm)
        ends = np.stack([ring.begin, ring.end])
        longest = np.hypot(*np.moveaxis(ends[:, None, :, None] - ends[None, :, None, :], -1, 0)).max((0, 1))
        to_edge = [np.hypot(*np.moveaxis(end[:, None] - ring.nearest(end), -1, 0)) for end in ends]
        shortest = np.minimum(*to_edge)  # edges of a simple ring do not cross
        return cls(outline, ring, np.minimum(shortest, shortest.T), longest)


def adjacency(features: Features, touches: Sequence[Touch]) -> np.ndarray:
    """Whether two pairings are consistent: node k·n + e is touch k on edge e."""
    count = len(features.ring.normal)
    matrix = np.zeros((len(touches) * count,) * 2, dtype=bool)
    turn = features.ring.normal[:, None] - features.ring.normal
    for i, one in enumerate(touches):
        for j in range(i + 1, len(touches)):
            two = touches[j]
            apart = float(np.hypot(*(one.centre - two.centre)))
            slack = sum(touch.bound_mm + bulge_mm(touch.radius_mm) for touch in (one, two))
            fits = (features.shortest - slack <= apart) & (apart <= features.longest + slack)
            span = np.pi / 2 / QUAD_SEGMENTS if one.radius_mm + two.radius_mm > 0 else 0.0
            off = np.abs(angle_between(one.middle_rad - two.middle_rad - turn))
            fits &= off <= one.half_rad + two.half_rad + span + 1e-9
            matrix[i * count : (i + 1) * count, j * count : (j + 1) * count] = fits
    return matrix | matrix.T


def poses_of(features: Features, touches: Sequence[Touch], pairings: np.ndarray) -> np.ndarray:
    """A pose (m, 3) for each pairing (m, k): iterated closest points on the edges, steps in closed form."""
    points = np.stack([touch.centre for touch in touches])
    begin, along = features.ring.begin[pairings], (features.ring.end - features.ring.begin)[pairings]
    on_edge = begin + along / 2
    first = features.ring.normal[pairings]
    middle = np.array([touch.middle_rad for touch in touches])
    theta = np.angle(np.exp(1j * (middle - first)).sum(axis=1))
    squared = (along**2).sum(axis=2)
    for step in range(STEPS):
        centre, middle_point = on_edge.mean(axis=1), points.mean(axis=0)
        a, b = on_edge - centre[:, None], points - middle_point
        if step:
            cross = (a[..., 0] * b[:, 1] - a[..., 1] * b[:, 0]).sum(axis=1)
            theta = np.arctan2(cross, (a * b).sum(axis=(1, 2)))
        cos, sin = np.cos(theta)[:, None], np.sin(theta)[:, None]
        seen = np.stack([cos * b[:, 0] + sin * b[:, 1], cos * b[:, 1] - sin * b[:, 0]], -1) + centre[:, None]
        part = np.clip(((seen - begin) * along).sum(axis=2) / squared, 0.0, 1.0)
        on_edge = begin + part[..., None] * along
    x = middle_point[0] - cos[:, 0] * centre[:, 0] + sin[:, 0] * centre[:, 1]
    y = middle_point[1] - sin[:, 0] * centre[:, 0] - cos[:, 0] * centre[:, 1]
    return np.column_stack([x, y, theta])


def clique_solver(cliques: Cliques, models: Sequence[Model]) -> Solve:
    """Cliques of each model's graph, a pose for each, and those poses that satisfy the touches."""
    outlines = [Outline.of(model) for model in models]
    ready: dict[float, list[Features]] = {}

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        radius = touches[0].radius_mm
        found: list[Answer] = []
        for features in ready.setdefault(radius, [Features.of(item, radius) for item in outlines]):
            matrix = adjacency(features, touches)
            nodes = np.flatnonzero(matrix.any(axis=1))
            if not len(nodes):
                continue
            groups = cliques(matrix[np.ix_(nodes, nodes)], len(touches))
            if groups:
                pairings = np.sort(nodes[np.array(groups)], axis=1) % len(features.ring.normal)
                poses = poses_of(features, touches, pairings)
                found += distinct(features.outline.name, poses[features.outline.satisfied(touches, poses)])
        return found

    return solve
