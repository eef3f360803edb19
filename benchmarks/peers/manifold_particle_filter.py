"""Manifold particle filter, written for this after Koval, Pollard and Srinivasa (IJRR 34(7), 2015).

Particles are drawn from the manifold of poses that satisfy one touch, and weighted by the others: each touch
in turn is the one to draw from (the paper's mixture over contacts), in proportion to each model's
circumference. As the object lies still, resampled particles are moved by a little noise between rounds, and
weighted again. The annealing of the weights is ours: without it the particles are too few for touches as
precise as these.
"""

from collections.abc import Sequence

import numpy as np
from outline import Outline, distinct
from question import Answer, Model, Peer, Solve, Touch

PARTICLES = 3000  # of each model
ROUNDS = 8
SPREAD = np.array([2.0, 2.0, 0.06])  # noise of the first move; halved with each round


def prepare(models: Sequence[Model]) -> Solve:
    outlines = [Outline.of(model) for model in models]

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        rng = np.random.default_rng(0)
        found: list[Answer] = []
        for outline in outlines:
            poses = filtered(outline, touches, rng)
            found += distinct(outline.name, poses[outline.satisfied(touches, poses)])
        return found

    return solve


def filtered(outline: Outline, touches: Sequence[Touch], rng: np.random.Generator) -> np.ndarray:
    """Particles (m, 3) after all touches, the best first."""
    ring = outline.grown(touches[0].radius_mm)
    share = PARTICLES // len(touches)
    poses = np.concatenate([outline.on_manifold(touch, ring, rng, share) for touch in touches])
    for number in range(ROUNDS):
        squared = 4 * (outline.residuals(touches, poses) ** 2).sum(axis=1)
        hot = 4.0 ** (ROUNDS - 1 - number)
        weight = np.exp(-(squared - squared.min()) / 2 / hot)
        chosen = resampled(weight, rng)
        spread = SPREAD * 0.5**number
        poses = poses[chosen] + rng.normal(size=(len(poses), 3)) * spread
    squared = (outline.residuals(touches, poses) ** 2).sum(axis=1)
    return poses[np.argsort(squared)]


def resampled(weight: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Systematic resampling: indices (m,)."""
    places = (rng.random() + np.arange(len(weight))) / len(weight)
    return np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), places), len(weight) - 1)


PEER = Peer(prepare, ("numpy", "shapely"))
