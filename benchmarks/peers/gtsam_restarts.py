"""gtsam: a factor graph with one custom factor for each touch, optimised from many starts.

The variable is the object's pose (Pose2), moved on its manifold; derivatives are differences, in one call
for all three. Starts and acceptance are those of `scipy_restarts`.
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from outline import Outline, distinct
from question import Answer, Model, Peer, Solve, Touch

STARTS = 100
STEP = 1e-5


def prepare(models: Sequence[Model]) -> Solve:
    outlines = [Outline.of(model) for model in models]

    def solve(touches: Sequence[Touch]) -> list[Answer]:
        rng = np.random.default_rng(0)
        found: list[Answer] = []
        for outline in outlines:
            graph = gtsam.NonlinearFactorGraph()
            for touch in touches:
                graph.add(factor(outline, touch))
            starts = outline.on_manifold(touches[0], outline.grown(touches[0].radius_mm), rng, STARTS)
            ends = np.array([descended(graph, start) for start in starts])
            found += distinct(outline.name, ends[outline.satisfied(touches, ends)])
        return found

    return solve


def factor(outline: Outline, touch: Touch) -> gtsam.CustomFactor:
    """Gap and normal of one touch, in units of their bounds."""

    def errors(this: gtsam.CustomFactor, values: gtsam.Values, jacobians: list | None) -> np.ndarray:
        pose = values.atPose2(this.keys()[0])
        moved = [pose, *(pose.retract(step) for step in np.eye(3) * STEP)]
        poses = np.array([[item.x(), item.y(), item.theta()] for item in moved])
        found = outline.residuals([touch], poses)
        if jacobians is not None:
            jacobians[0] = np.asfortranarray((found[1:] - found[0]).T / STEP)
        return found[0]

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(2), [0], errors)


def descended(graph: gtsam.NonlinearFactorGraph, start: np.ndarray) -> np.ndarray:
    """Where Levenberg-Marquardt ends."""
    values = gtsam.Values()
    values.insert(0, gtsam.Pose2(*start))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(30)
    end = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize().atPose2(0)
    return np.array([end.x(), end.y(), end.theta()])


PEER = Peer(prepare, ("gtsam", "numpy", "shapely"))
