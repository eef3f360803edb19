"""What the recogniser answers to a trial, and whether its truth was lost."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from campaign_trials import Trial
from shapely import affinity
from shapely_bench import Placed, turned

from palpate.base.geometry import Bools, Floats, ObjectModel
from palpate.recognizer import Budget, Hypothesis, Recognition, recognise

_CELL_SLACK_MM, _CELL_SLACK_RAD = 1e-6, 1e-9
_ROUNDING_MM2 = 1e-9
_ALIKE_MM = 1.001e-3  # what looks the same but for this is the same


@dataclass(frozen=True)
class Outcome:
    """Whether the bounds, and the cells, of some hypothesis held the truth after every step."""

    in_bounds: bool
    in_cells: bool
    hypotheses: int
    verified: int


def asked(trial: Trial) -> list[Recognition]:
    """The recogniser's answer after every step."""
    budget = Budget(trial.setting.budget)
    answers = [recognise(trial.catalogue(), trial.steps[0], budget=budget)]
    for step in trial.steps[1:]:
        answers.append(answers[-1].extend(step))
    return answers


def outcome(trial: Trial, answers: list[Recognition]) -> Outcome:
    """Whether the truth was kept in all answers, and what the last of them says."""
    last = answers[-1].hypotheses
    return Outcome(
        in_bounds=all(_in_bounds(answer, trial.model, trial.placed) for answer in answers),
        in_cells=all(holding_cell(answer, trial.model, trial.placed) is not None for answer in answers),
        hypotheses=len(last),
        verified=sum(item.verified for item in last),
    )


def _in_bounds(recognition: Recognition, model: ObjectModel, placed: Placed) -> bool:
    for item in recognition.hypotheses:
        if item.state.object_name != model.name:
            continue
        bounds = item.bounds
        for x, y, theta in _alike(item, model, placed, *bounds.theta_rad):
            values = ((x, bounds.x_mm), (y, bounds.y_mm), (theta, bounds.theta_rad))
            if all(lo <= value <= hi for value, (lo, hi) in values):
                return True
    return False


def holding_cell(recognition: Recognition, model: ObjectModel, placed: Placed) -> Hypothesis | None:
    """The hypothesis that has the true configuration, or one that looks the same, in a cell; None if lost.

    Sharper than its bounds: a cell holds positions s = R(−θ)(p − anchor) of the centroid in a polygon, for θ
    in an interval (`Cells`).
    """
    for item in recognition.hypotheses:
        if item.state.object_name != model.name:
            continue
        centre, cells = item.state.origin_mm, item.cells
        for x, y, theta in _alike(item, model, placed, float(cells.lo.min()), float(cells.hi.max())):
            turns = (cells.lo - _CELL_SLACK_RAD <= theta) & (theta <= cells.hi + _CELL_SLACK_RAD)
            if not turns.any():
                continue
            away = np.array([x, y]) - recognition.anchor_mm
            cos, sin = math.cos(theta), math.sin(theta)
            seen = np.array([cos * away[0] + sin * away[1], cos * away[1] - sin * away[0]])
            if in_polygons(cells.polygon[turns], centre + seen).any():
                return item
    return None


def _alike(
    item: Hypothesis, model: ObjectModel, placed: Placed, lo: float, hi: float
) -> Iterator[tuple[float, float, float]]:
    """(x, y, θ) of the object with θ in [lo, hi], turned about its centre so that it looks the same.

    The recogniser says by which turns; that these are true is for shapely to say.
    """
    centre, step = item.state.origin_mm, 2 * math.pi / item.state.symmetry_order
    at = placed.on_table(centre)
    first = math.ceil((lo - placed.theta - _CELL_SLACK_RAD) / step)
    last = math.floor((hi - placed.theta + _CELL_SLACK_RAD) / step)
    for count in range(first, last + 1):
        if looks_alike(model, centre, count * step):
            theta = placed.theta + count * step
            x, y = at - turned(centre, theta)
            yield float(x), float(y), theta


def looks_alike(model: ObjectModel, centre: Floats, angle: float) -> bool:
    """Whether no boundary is off by more than a micrometre or so after a turn about `centre` (2,)."""
    if abs(math.remainder(angle, 2 * math.pi)) < _CELL_SLACK_RAD:
        return True
    for section in model.states[0].sections:
        edge = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons]).boundary
        image = affinity.rotate(edge, angle, origin=(centre[0], centre[1]), use_radians=True)
        if shapely.hausdorff_distance(edge, image) > _ALIKE_MM:
            return False
    return True


def in_polygons(polygon: Floats, point: Floats) -> Bools:
    """Which convex polygons (k, v, 2), counter-clockwise and maybe flat, hold a point, give or take.

    `point`: the same for all, (2,), or one for each, (k, 1, 2).
    """
    leg = np.roll(polygon, -1, axis=1) - polygon
    away = point - polygon
    # Corners that are one but for rounding make a leg of no length, to which nothing is left or right.
    left = leg[..., 0] * away[..., 1] - leg[..., 1] * away[..., 0] >= -_ROUNDING_MM2
    square = np.maximum(np.sum(leg * leg, axis=2), 1e-300)
    along = np.clip(np.sum(leg * away, axis=2) / square, 0.0, 1.0)
    gap = np.linalg.norm(away - along[..., None] * leg, axis=2).min(axis=1)
    solid = np.any(np.abs(polygon - polygon[:, :1]) > _CELL_SLACK_MM, axis=(1, 2))
    result: Bools = (left.all(axis=1) & solid) | (gap <= _CELL_SLACK_MM)
    return result
