"""What the recogniser answers to a trial, and whether its truth was lost."""

import math
from dataclasses import dataclass

import numpy as np
from campaign_objects import catalogue_of
from campaign_trials import Trial
from shapely_bench import Placed, equivalent_configurations, holding_truth

from palpate.geometry import Bools, Floats
from palpate.recognizer import Hypothesis, Recognition, recognise

_CELL_SLACK_MM, _CELL_SLACK_RAD = 1e-6, 1e-9
_ROUNDING_MM2 = 1e-9


@dataclass(frozen=True)
class Outcome:
    """Whether the bounds, and the cells, of some hypothesis held the truth after every step."""

    in_bounds: bool
    in_cells: bool
    hypotheses: int
    verified: int


def asked(trial: Trial) -> list[Recognition]:
    """The recogniser's answer after every step."""
    answers = [recognise(catalogue_of(trial.setting.family), trial.steps[0])]
    for step in trial.steps[1:]:
        answers.append(answers[-1].extend(step))
    return answers


def outcome(trial: Trial, answers: list[Recognition]) -> Outcome:
    """Whether the truth was kept in all answers, and what the last of them says."""
    last = answers[-1].hypotheses
    return Outcome(
        in_bounds=all(holding_truth(answer, trial.placed) is not None for answer in answers),
        in_cells=all(holding_cell(answer, trial.placed) is not None for answer in answers),
        hypotheses=len(last),
        verified=sum(item.verified for item in last),
    )


def holding_cell(recognition: Recognition, placed: Placed) -> Hypothesis | None:
    """The hypothesis that has the true configuration, or a symmetric one, in a cell; None if lost.

    Sharper than its bounds: a cell holds positions s = R(−θ)(p − anchor) of the centroid in a polygon, for θ
    in an interval (`Cells`).
    """
    for item in recognition.hypotheses:
        if item.state.object_name != placed.model.name:
            continue
        centre, cells = item.state.origin_mm, item.cells
        for x, y, theta in equivalent_configurations(placed, item.state.symmetry_order, centre):
            turns = (cells.lo - _CELL_SLACK_RAD <= theta) & (theta <= cells.hi + _CELL_SLACK_RAD)
            if not turns.any():
                continue
            away = np.array([x, y]) - recognition.anchor_mm
            cos, sin = math.cos(theta), math.sin(theta)
            seen = np.array([cos * away[0] + sin * away[1], cos * away[1] - sin * away[0]])
            position = centre + seen
            if in_polygons(cells.polygon[turns], position).any():
                return item
    return None


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
