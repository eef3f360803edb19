"""Fitted kinematics: a finger's tip as a function of the values that calibration looks for, and their priors.

Every kind of finger has its values in one row: base x, base y (mm), heading (rad) and tip radius (mm) first,
then its own. All fingers of a rig have rows of one width; what a kind has no use for is pinned.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.drivers.finger import TICK_RAD

__all__ = ["AIM_PLAY", "BASE", "ELBOW_PLAY", "ELBOW_ZERO", "FORE", "HEADING", "RADIUS", "SCALE"]
__all__ += ["SHOULDER_PLAY", "UPPER", "ZERO"]
__all__ += ["ArmModel", "FingerModel", "SlideModel", "of_one_width"]

BASE, HEADING, RADIUS = slice(0, 2), 2, 3
"""Of every kind."""

ZERO, AIM_PLAY, SCALE = 4, 5, 6
"""Of a slide: zero (mm), play of the aim (rad), error of its travel per turn (a share)."""

UPPER, FORE, ELBOW_ZERO, SHOULDER_PLAY, ELBOW_PLAY = 4, 5, 6, 7, 8
"""Of an arm: lengths of its links (mm), elbow angle where it should be 0, plays of both joints (rad)."""

_STEP_LEFT = 0.1  # of a slide's encoder step: it is measured on the move, over several of them
_JOINT_STEP_LEFT = 0.15  # of a joint's: over a few of them
_STILL_SIGMAS, _STILL_MM = 5.0, 0.01  # of a touch that is made again
_MOST_SIDEWAYS = 1.12  # tangent of 48°: touches are not more oblique, and a way that is off shifts them so
_PINNED_SIGMA = 1e-3  # of values that a kind has no use for: nothing moves them


@dataclass(frozen=True, eq=False)
class FingerModel(ABC):
    """What of a finger is known: how its values and its servos place the tip.

    `prior` (k,) of the values, and its `covariance` (k, k). `values` (n, k), `servos_rad` (n, 2) and `ways`
    (n, 2) are of n touches: from which side each joint came, +1 from below, -1 from above, 0 in the middle of
    its play.
    """

    name: str
    prior: Floats
    covariance: Floats

    def widened(self, columns: int) -> Self:
        """The same with so many values, of which those that it has no use for are pinned at 0."""
        own = len(self.prior)
        prior, covariance = np.zeros(columns), _PINNED_SIGMA**2 * np.eye(columns)
        prior[:own], covariance[:own, :own] = self.prior, self.covariance
        return replace(self, prior=prior, covariance=covariance)

    def fixed(self, sigma: float) -> Self:
        """The same, all its values known to within a deviation of `sigma` (mm, rad)."""
        return replace(self, covariance=sigma**2 * np.eye(len(self.prior)))

    @abstractmethod
    def centres(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Tip centres (n, 2), mm."""
        ...

    @abstractmethod
    def slopes(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Derivatives (n, 2, k) of the centres by the values."""
        ...

    @abstractmethod
    def facing_rad(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Directions (n,) from which the array's heading counts."""
        ...

    @abstractmethod
    def moved_by(self, values: Floats, servos_rad: Floats) -> Floats:
        """By what a turn of each joint moves the tip, mm/rad: (n, 2, 2), the one next to the base first.

        A slide's second joint is its servo.
        """
        ...

    @abstractmethod
    def rounding_mm(self, values: Floats, servos_rad: Floats, normal: Floats, /) -> Floats:
        """What encoder steps leave of a touch's distance along a surface's normal (n, 2): deviations (n,)."""
        ...

    @abstractmethod
    def repeated_mm(self, first_rad: Floats, again_rad: Floats, facing_rad: float, /) -> tuple[float, float]:
        """How far a touch that was made again stands from the first one, along its way, and what explains.

        Servo angles (2,) of both; `facing_rad`: where the finger faces, from its direction of travel. A way
        that is a little elsewhere, or the other flank of the play, lets an oblique touch be further.
        """
        ...


@dataclass(frozen=True, eq=False)
class SlideModel(FingerModel):
    """An aim and a slide: aim = (servo − aim_zero_rad) / gear_ratio.

    distance = zero + mm_per_rad · (1 + scale) · servo.
    """

    gear_ratio: float
    aim_zero_rad: float
    mm_per_rad: float

    def centres(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Along the slide's direction."""
        along = _directions(self.facing_rad(values, servos_rad, ways))
        result: Floats = values[:, BASE] + self._distance(values, servos_rad)[:, None] * along
        return result

    def slopes(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Base, heading and play turn and shift it, zero and scale move it along."""
        along = _directions(self.facing_rad(values, servos_rad, ways))
        across = _left(along) * self._distance(values, servos_rad)[:, None]
        result = np.zeros((len(values), 2, values.shape[1]))
        result[:, 0, 0] = result[:, 1, 1] = 1.0
        result[:, :, HEADING] = across
        result[:, :, ZERO] = along
        result[:, :, AIM_PLAY] = -ways[:, :1] * across
        result[:, :, SCALE] = along * (self.mm_per_rad * servos_rad[:, 1:])
        return result

    def facing_rad(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Direction of the slide."""
        aim = (servos_rad[:, 0] - self.aim_zero_rad) / self.gear_ratio
        result: Floats = values[:, HEADING] - ways[:, 0] * values[:, AIM_PLAY] + aim
        return result

    def moved_by(self, values: Floats, servos_rad: Floats) -> Floats:
        """The aim turns it about the base, the slide moves it along."""
        along = _directions(self.facing_rad(values, servos_rad, np.zeros_like(servos_rad)))
        aim = _left(along) * self._distance(values, servos_rad)[:, None]
        return np.stack([aim, along * self.mm_per_rad], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, _normal: Floats, /) -> Floats:
        """The slide is measured on the move, over several steps; the aim stands."""
        along = abs(self.mm_per_rad) * TICK_RAD * _STEP_LEFT
        # Contacts are oblique by less than 48°: half of what the aim is off counts, or so.
        away = np.abs(self._distance(values, servos_rad))
        across = 0.5 * away * TICK_RAD / abs(self.gear_ratio) / math.sqrt(12)
        result: Floats = np.hypot(along, across)
        return result

    def repeated_mm(self, first_rad: Floats, again_rad: Floats, _facing_rad: float, /) -> tuple[float, float]:
        """An aim that comes from the other side stands a few encoder steps elsewhere, which is seen."""
        per_rad = abs(self.mm_per_rad)
        off = abs(float(again_rad[1] - first_rad[1])) * per_rad
        limit = _STILL_SIGMAS * math.hypot(per_rad * TICK_RAD / math.sqrt(6), _STILL_MM)
        distance = abs(float(self.prior[ZERO]) + self.mm_per_rad * float(first_rad[1]))
        apart = abs(float(again_rad[0] - first_rad[0])) + TICK_RAD
        turned = 4 * float(self.prior[AIM_PLAY]) + apart / abs(self.gear_ratio)
        return off, limit + turned * distance * _MOST_SIDEWAYS

    def _distance(self, values: Floats, servos_rad: Floats) -> Floats:
        reach = self.mm_per_rad * servos_rad[:, 1]
        result: Floats = values[:, ZERO] + (1 + values[:, SCALE]) * reach
        return result


@dataclass(frozen=True, eq=False)
class ArmModel(FingerModel):
    """A shoulder and an elbow: joint angle = (servo − zero_rad) / gear_ratio, (2,) each.

    The shoulder's zero is in the heading, the elbow's error is a value of its own.
    """

    gear_ratio: Floats
    zero_rad: Floats

    def centres(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """At the end of both links."""
        upper, fore = self._links(values, servos_rad, ways)
        result: Floats = values[:, BASE] + upper + fore
        return result

    def slopes(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Turns of the shoulder move the whole arm, those of the elbow its second link."""
        upper, fore = self._links(values, servos_rad, ways)
        whole, end = _left(upper + fore), _left(fore)
        result = np.zeros((len(values), 2, values.shape[1]))
        result[:, 0, 0] = result[:, 1, 1] = 1.0
        result[:, :, HEADING] = whole
        result[:, :, UPPER] = upper / values[:, UPPER, None]
        result[:, :, FORE] = fore / values[:, FORE, None]
        result[:, :, ELBOW_ZERO] = end
        result[:, :, SHOULDER_PLAY] = -ways[:, :1] * whole
        result[:, :, ELBOW_PLAY] = -ways[:, 1:] * end
        return result

    def facing_rad(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Direction of the second link."""
        return self._angles(values, servos_rad, ways)[1]

    def moved_by(self, values: Floats, servos_rad: Floats) -> Floats:
        """Both joints turn it about their axes."""
        upper, fore = self._links(values, servos_rad, np.zeros_like(servos_rad))
        return np.stack([_left(upper + fore), _left(fore)], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, normal: Floats, /) -> Floats:
        """Both joints are measured on the move, over a few steps."""
        along = np.einsum("nkx,nx->nk", self.moved_by(values, servos_rad), normal) / self.gear_ratio
        result: Floats = TICK_RAD * _JOINT_STEP_LEFT * np.hypot(along[:, 0], along[:, 1])
        return result

    def repeated_mm(self, first_rad: Floats, again_rad: Floats, facing_rad: float, /) -> tuple[float, float]:
        """Steps of both encoders, and joints that may be on the other flank of their play."""
        values, servos = np.tile(self.prior, (2, 1)), np.stack([first_rad, again_rad])
        ways = np.zeros((2, 2))
        first, again = self.centres(values, servos, ways) @ [1.0, 1j]
        travel = float(self.facing_rad(values, servos, ways)[0]) - facing_rad
        moved = (again - first) * np.exp(-1j * travel)
        levers = np.linalg.norm(self.moved_by(values, servos)[0], axis=1)
        steps = float(np.hypot(*(levers * TICK_RAD / self.gear_ratio))) / math.sqrt(6)
        turned = 4 * float(levers @ self.prior[[SHOULDER_PLAY, ELBOW_PLAY]])
        limit = _STILL_SIGMAS * math.hypot(steps, _STILL_MM)
        return abs(moved.real), limit + (turned + abs(moved.imag)) * _MOST_SIDEWAYS

    def _angles(self, values: Floats, servos_rad: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Directions (n,) of both links."""
        joints = (servos_rad - self.zero_rad) / self.gear_ratio
        first = values[:, HEADING] + joints[:, 0] - ways[:, 0] * values[:, SHOULDER_PLAY]
        bend = joints[:, 1] + values[:, ELBOW_ZERO] - ways[:, 1] * values[:, ELBOW_PLAY]
        return first, first + bend

    def _links(self, values: Floats, servos_rad: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Both links (n, 2), mm."""
        first, second = self._angles(values, servos_rad, ways)
        return values[:, UPPER, None] * _directions(first), values[:, FORE, None] * _directions(second)


def of_one_width(models: Sequence[FingerModel]) -> list[FingerModel]:
    """Models with as many values each as the one that has most."""
    columns = max(len(model.prior) for model in models)
    return [model.widened(columns) for model in models]


def _directions(angle_rad: Floats) -> Floats:
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def _left(vectors: Floats) -> Floats:
    """Vectors (n, 2), a quarter turn to the left."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])
