"""How an answer compares with what the emulator had on the table: after the run, on emulated rigs only."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from palpate.calibration.gauge import BasePose, align_to_nominal
from palpate.config import RigFile
from palpate.recognizer import Configuration, Hypothesis
from palpate.rig.emulated.scene import Placement

__all__ = ["Comparison", "Standing", "compare", "in_hand_frame"]


class Standing(Protocol):
    """What of a finger's truth says where it stands in W."""

    @property
    def base_mm(self) -> tuple[float, float]:
        """Its base."""
        ...

    @property
    def heading_rad(self) -> float:
        """Its direction at aim 0, or of its first link at shoulder angle 0."""
        ...


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


def in_hand_frame(placement: Placement, rig: RigFile, truths: Sequence[Standing]) -> Placement:
    """The placement as a calibrated rig speaks of it: fingers stand nearest to the drawing there.

    `rig` is the drawing, the rig file before it was calibrated; `truths` are its fingers', in their order.
    """
    drawn = [BasePose(finger.base_mm, math.radians(finger.heading_deg)) for finger in rig.fingers]
    moved = align_to_nominal(drawn, [BasePose(truth.base_mm, truth.heading_rad) for truth in truths])
    x, y = moved.point_mm((placement.x_mm, placement.y_mm))
    return replace(placement, x_mm=x, y_mm=y, theta_rad=placement.theta_rad + moved.angle_rad)


def _compared(placement: Placement, hypothesis: Hypothesis) -> Comparison:
    turn = 2 * math.pi / hypothesis.state.symmetry_order
    answer, bounds = hypothesis.configuration, hypothesis.bounds
    steps = round((answer.theta_rad - placement.theta_rad) / turn)
    theta = placement.theta_rad + steps * turn
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


def _turned_x(x: float, y: float, angle: float) -> float:
    """First coordinate of (x, y) turned by `angle`; the second is that of (y, −x)."""
    return math.cos(angle) * x - math.sin(angle) * y
