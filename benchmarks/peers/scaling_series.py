"""Scaling Series, written for this after Petrovskaya and Khatib (IEEE Transactions on Robotics 27(3), 2011).

Particles in shrinking neighbourhoods of radius δ, weighted by an annealed measurement model: from
δ = START down to END, by 2^(-1/3) each time, M particles in each neighbourhood. The error is the Mahalanobis
distance of gap and normal to the nearest edge, as in the paper. Each model has its own series.
"""

from collections.abc import Sequence

import numpy as np
from outline import Outline, distinct
from question import Answer, Model, Peer, Solve, Touch

LEVER_MM = 30.0  # θ times this is a length like x and y
START_MM, END_MM = 40.0, 0.15
PER_NEIGHBOURHOOD = 6
ZOOM = 2 ** (-1 / 3)
PRUNED = 0.02
MOST = 20_000
SCALE = np.array([1.0, 1.0, LEVER_MM])


def prepare(models: Sequence[Model]) -> Solve:
    outlines = [Outline.of(model) for model in models]

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        rng = np.random.default_rng(0)
        found: list[Answer] = []
        for outline in outlines:
            poses = series(outline, touches, rng)
            found += distinct(outline.name, poses[outline.satisfied(touches, poses)])
        return found

    return solve


def series(outline: Outline, touches: Sequence[Touch], rng: np.random.Generator) -> np.ndarray:
    """The particles of the last step, the best first."""
    middle = np.mean([touch.centre for touch in touches], axis=0)
    reach = float(np.hypot(*outline.points.T).max()) + touches[0].radius_mm
    size = START_MM
    spacing = np.arange(-reach, reach + size, size)
    turns = np.arange(0, 2 * np.pi * LEVER_MM, size)
    grid = np.stack(np.meshgrid(middle[0] + spacing, middle[1] + spacing, turns), -1).reshape(-1, 3)
    final = np.inf
    while True:
        drawn = np.repeat(grid, PER_NEIGHBOURHOOD, axis=0)
        drawn = drawn + rng.uniform(-size, size, drawn.shape)
        squared = errors(outline, touches, drawn / SCALE) * (END_MM / size) ** 2
        weight = np.exp(-(squared - squared.min()) / 2)
        kept = weight >= PRUNED
        drawn, final = drawn[kept], squared[kept]
        if size <= END_MM:
            return drawn[np.argsort(final)] / SCALE
        size *= ZOOM
        grid = centres(drawn, size, rng)


def errors(outline: Outline, touches: Sequence[Touch], poses: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance (m,): bounds are two standard deviations."""
    return 4 * (outline.residuals(touches, poses) ** 2).sum(axis=1)


def centres(points: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """Middles of the occupied cubes whose half edge is `size`: even cover of what is left."""
    turn = 2 * np.pi * LEVER_MM
    points = np.column_stack([points[:, :2], points[:, 2] % turn])
    cells = np.unique(np.floor(points / (2 * size)), axis=0)
    if len(cells) * PER_NEIGHBOURHOOD > MOST:
        cells = rng.permutation(cells)[: MOST // PER_NEIGHBOURHOOD]
    return (cells + 0.5) * 2 * size


PEER = Peer(prepare, ("numpy", "shapely"))
