"""Error of an answer against the truth on an emulated table; known after the run only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from palpate.recognizer import Configuration, Hypothesis
from palpate.recognizer.edges import CatalogueState
from palpate.rig.emulated.scene import Placement

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True)
class Comparison:
    """The truth as the configuration equal to it, by the state's symmetry, that is nearest to the answer.

    `hypothesis` is the answer's hypothesis with the right object and state, None if there is none; then the
    errors are None too.
    """

    hypothesis: Hypothesis | None
    configuration: Configuration
    inside_bounds: bool
    position_error_mm: float | None
    orientation_error_rad: float | None


def compare(placement: Placement, hypotheses: Sequence[Hypothesis]) -> Comparison:
    """Compare the truth with the best of the hypotheses that name its object and state."""
    truth = Configuration(placement.x_mm, placement.y_mm, placement.theta_rad)
    found = [
        _compared(placement, item)
        for item in hypotheses
        if item.state.object_name == placement.model.name and item.state.state.name == placement.state.name
    ]
    if not found:
        return Comparison(None, truth, False, None, None)
    return min(found, key=lambda item: (not item.inside_bounds, item.position_error_mm))


def _compared(placement: Placement, hypothesis: Hypothesis) -> Comparison:
    answer, bounds = hypothesis.configuration, hypothesis.search_bounds
    theta = _equal_turn(hypothesis.state, placement.theta_rad, answer.theta_rad)
    # A symmetry turns the object about its centroid, which stays where it is.
    cx, cy = hypothesis.state.origin_mm
    x, y = placement.x_mm, placement.y_mm
    x += _turned_x(cx, cy, placement.theta_rad) - _turned_x(cx, cy, theta)
    y += _turned_x(cy, -cx, placement.theta_rad) - _turned_x(cy, -cx, theta)
    inside = all(
        lo <= value <= hi
        for value, (lo, hi) in ((x, bounds.x_mm), (y, bounds.y_mm), (theta, bounds.theta_rad))
    )
    return Comparison(
        hypothesis,
        Configuration(float(x), float(y), float(theta)),
        inside,
        math.hypot(answer.x_mm - x, answer.y_mm - y),
        abs(answer.theta_rad - theta),
    )


def _equal_turn(state: CatalogueState, theta_rad: float, near_rad: float) -> float:
    """The orientation next to `near_rad` at which the state looks as it does at `theta_rad`."""
    if state.symmetry_order == 0:
        return near_rad
    turn = 2 * math.pi / state.symmetry_order
    return theta_rad + turn * round((near_rad - theta_rad) / turn)


def _turned_x(x: float, y: float, angle: float) -> float:
    """First coordinate of (x, y) turned by `angle`; the second is that of (y, −x)."""
    return math.cos(angle) * x - math.sin(angle) * y
