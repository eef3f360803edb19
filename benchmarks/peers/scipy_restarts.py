"""scipy: least squares from many starts, each model in turn, by `scipy.optimize.least_squares`.

Starts satisfy the first touch (`Outline.on_manifold`). Far better than starts anywhere: there most runs end
in minima that satisfy nothing. What is reported are ends that satisfy all touches.
"""

from collections.abc import Sequence

import numpy as np
from outline import Outline, distinct
from question import Answer, Model, Peer, Solve, Touch
from scipy.optimize import least_squares

STARTS = 100


def prepare(models: Sequence[Model]) -> Solve:
    outlines = [Outline.of(model) for model in models]

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        rng = np.random.default_rng(0)
        found: list[Answer] = []
        for outline in outlines:
            starts = outline.on_manifold(touches[0], outline.grown(touches[0].radius_mm), rng, STARTS)
            ends = np.array([descended(outline, touches, start) for start in starts])
            found += distinct(outline.name, ends[outline.satisfied(touches, ends)])
        return found

    return solve


def descended(outline: Outline, touches: Sequence[Touch], start: np.ndarray) -> np.ndarray:
    """Where least squares end, by Levenberg-Marquardt."""

    def errors(pose: np.ndarray) -> np.ndarray:
        return outline.residuals(touches, pose[None])[0]

    return least_squares(errors, start, method="lm", x_scale=(1.0, 1.0, 0.05), max_nfev=60).x


PEER = Peer(prepare, ("scipy", "numpy", "shapely"))
