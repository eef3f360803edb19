"""Model of a finger: its tip as a function of the values that calibration looks for, and their priors.

Every kind of finger has its values in one row: base x, base y (mm), heading (rad) and tip radius (mm) first,
then its own. All fingers of a rig have rows of one width; what a kind has no use for is pinned. Priors are
what rig file and homing say before touches are looked at. Touches have a slide's backlash on one side
always, that on which the part pushes the tip back; the zero that is fitted is the one that belongs to that
side.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.actuator_estimators import Backlash, StopStalls, line_through_stops
from palpate.config import ArmFingerConfig, FingerConfig, JointConfig, SlideCalibration, SlideFingerConfig
from palpate.config.calibration_finger import Actuators, ActuatorsCalibration
from palpate.drivers.kinematics import TICK_RAD

BASE, HEADING, RADIUS = slice(0, 2), 2, 3
"""Of every kind."""

ZERO, AIM_PLAY, SCALE = 4, 5, 6
"""Of a slide: zero (mm), play of the aim (rad), error of its travel per turn (a share)."""

UPPER, FORE, ELBOW_ZERO, SHOULDER_PLAY, ELBOW_PLAY = 4, 5, 6, 7, 8
"""Of an arm: lengths of its links (mm), elbow angle where it should be 0, plays of both joints (rad)."""

_SLIDE_STEP_SHARE = 0.1  # of a slide's encoder step: it is measured on the move, over several of them
_JOINT_STEP_SHARE = 0.15  # of a joint's: over a few of them
_REPEAT_SIGMAS, _REPEAT_SIGMA_MM = 5.0, 0.01  # of a touch that is made again
_MAX_OBLIQUE_TANGENT = (
    1.12  # tangent of 48°: touches are not more oblique, and a way that is off shifts them so
)
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
        across = _left_normals(along) * self._distance(values, servos_rad)[:, None]
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
        aim = _left_normals(along) * self._distance(values, servos_rad)[:, None]
        return np.stack([aim, along * self.mm_per_rad], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, _normal: Floats, /) -> Floats:
        """The slide is measured on the move, over several steps; the aim stands."""
        along = abs(self.mm_per_rad) * TICK_RAD * _SLIDE_STEP_SHARE
        # Contacts are oblique by less than 48°: half of what the aim is off counts, or so.
        away = np.abs(self._distance(values, servos_rad))
        across = 0.5 * away * TICK_RAD / abs(self.gear_ratio) / math.sqrt(12)
        result: Floats = np.hypot(along, across)
        return result

    def repeated_mm(self, first_rad: Floats, again_rad: Floats, _facing_rad: float, /) -> tuple[float, float]:
        """An aim that comes from the other side stands a few encoder steps elsewhere, which is seen."""
        per_rad = abs(self.mm_per_rad)
        off = abs(float(again_rad[1] - first_rad[1])) * per_rad
        limit = _REPEAT_SIGMAS * math.hypot(per_rad * TICK_RAD / math.sqrt(6), _REPEAT_SIGMA_MM)
        distance = abs(float(self.prior[ZERO]) + self.mm_per_rad * float(first_rad[1]))
        apart = abs(float(again_rad[0] - first_rad[0])) + TICK_RAD
        turned = 4 * float(self.prior[AIM_PLAY]) + apart / abs(self.gear_ratio)
        return off, limit + turned * distance * _MAX_OBLIQUE_TANGENT

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
        whole, end = _left_normals(upper + fore), _left_normals(fore)
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
        return np.stack([_left_normals(upper + fore), _left_normals(fore)], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, normal: Floats, /) -> Floats:
        """Both joints are measured on the move, over a few steps."""
        along = np.einsum("nkx,nx->nk", self.moved_by(values, servos_rad), normal) / self.gear_ratio
        result: Floats = TICK_RAD * _JOINT_STEP_SHARE * np.hypot(along[:, 0], along[:, 1])
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
        limit = _REPEAT_SIGMAS * math.hypot(steps, _REPEAT_SIGMA_MM)
        return abs(moved.real), limit + (turned + abs(moved.imag)) * _MAX_OBLIQUE_TANGENT

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


def pad_to_one_width(models: Sequence[FingerModel]) -> list[FingerModel]:
    """Models with as many values each as the one that has most."""
    columns = max(len(model.prior) for model in models)
    return [model.widened(columns) for model in models]


def _directions(angle_rad: Floats) -> Floats:
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def _left_normals(vectors: Floats) -> Floats:
    """Vectors (n, 2), a quarter turn to the left."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])


_CERTAIN_SIGMA = 1e-5  # standard deviation of what is not to be fitted: mm, rad
_MIN_SIGMAS_SLIDE = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 1e-5, 1e-6])
_MIN_SIGMAS_ARM = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 0.002, 1e-5, 1e-5, 1e-5])
"""Standard deviations that no prior goes below, so that nothing is quite certain."""


@dataclass(frozen=True, eq=False)
class SlideInContact:
    """A slide as touches see it, its backlash taken up: distance = zero + mm_per_rad · servo.

    `covariance` (2, 2): of the zero (mm) and of the error of mm_per_rad, as a share.
    """

    zero_mm: float
    mm_per_rad: float
    covariance: Floats

    @classmethod
    def from_calibration(cls, found: SlideCalibration) -> "SlideInContact":
        """What a calibration says of a slide."""
        per_rad = found.mm_per_turn / (2 * math.pi)
        return cls(found.touch_zero_mm, per_rad, np.array(found.touch_covariance))


def slide_in_contact(
    spec: SlideFingerConfig, backlash: Backlash | None = None, stalls: StopStalls | None = None
) -> SlideInContact:
    """What is known of a slide by the rig file, its backlash and its stops, as far as they were measured."""
    described = spec.slide
    if backlash is not None and stalls is not None:
        # At the front stop the carriage is pushed back, as in a touch; at the back stop the other flank
        # bears.
        (zero, per_rad), covariance = line_through_stops(stalls, backlash, (-2.0, 0.0))
        scale = np.array([1.0, 1 / per_rad])
        return SlideInContact(float(zero), float(per_rad), covariance * np.outer(scale, scale))
    if backlash is None:
        backlash = Backlash(described.backlash_mm / 2, described.backlash_mm / math.sqrt(12))
    # The rig file's zero is at Goal Position 0, half a turn of the servo away.
    share, away = described.mm_per_turn_spread**2 / 3, described.mm_per_rad * math.pi
    variance = backlash.sigma_mm**2 + described.zero_bound_mm**2 / 3 + away**2 * share
    covariance = np.array([[variance, away * share], [away * share, share]])
    return SlideInContact(described.zero_mm + away - backlash.half_mm, described.mm_per_rad, covariance)


def nominal_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """Priors of all fingers by the rig file alone."""
    return pad_to_one_width(
        [
            _arm_model(spec)
            if isinstance(spec, ArmFingerConfig)
            else slide_model(spec, slide_in_contact(spec))
            for spec in specs
        ]
    )


def calibrated_models(specs: Sequence[FingerConfig], actuators: Sequence[Actuators]) -> list[FingerModel]:
    """Priors of all fingers whose actuators have been measured."""
    found: list[FingerModel] = []
    for spec, own in zip(specs, actuators, strict=True):
        if isinstance(spec, ArmFingerConfig):
            found.append(_arm_model(spec))
        else:
            assert isinstance(own, ActuatorsCalibration)
            found.append(slide_model(spec, SlideInContact.from_calibration(own.slide)))
    return pad_to_one_width(found)


def certain_models(specs: Sequence[FingerConfig]) -> list[FingerModel]:
    """The fingers of a calibrated rig, where they are and not elsewhere."""
    found: list[FingerModel] = []
    for spec in specs:
        if isinstance(spec, ArmFingerConfig):
            found.append(_arm_model(spec))
        else:
            per_rad = spec.slide.mm_per_rad
            zero_mm = spec.slide.zero_mm + math.pi * per_rad
            found.append(slide_model(spec, SlideInContact(zero_mm, per_rad, np.zeros((2, 2)))))
    return [model.fixed(_CERTAIN_SIGMA) for model in pad_to_one_width(found)]


def slide_model(spec: SlideFingerConfig, slide: SlideInContact) -> SlideModel:
    """The prior of a slide finger: the rig file's numbers and bounds, and what is known of its slide."""
    aim_play = math.radians(spec.aim.backlash_deg)
    prior = np.array(
        [*spec.base_mm, math.radians(spec.heading_deg), spec.tip.radius_mm, slide.zero_mm, aim_play / 2, 0.0]
    )
    sigma = np.array(
        [
            spec.bounds.base_mm / 2,
            spec.bounds.base_mm / 2,
            math.radians(spec.bounds.heading_deg) / math.sqrt(3),
            spec.tip.radius_bound_mm / math.sqrt(3),
            0.0,
            aim_play / math.sqrt(12),
            0.0,
        ]
    )
    covariance = np.zeros((len(prior), len(prior)))
    covariance[np.ix_([4, 6], [4, 6])] = slide.covariance
    covariance += np.diag(np.maximum(sigma, _MIN_SIGMAS_SLIDE) ** 2)
    return SlideModel(
        spec.name,
        prior,
        covariance,
        gear_ratio=spec.aim.gear_ratio,
        aim_zero_rad=math.radians(spec.aim.zero_deg) - math.pi,
        mm_per_rad=slide.mm_per_rad,
    )


def _arm_model(spec: ArmFingerConfig) -> ArmModel:
    """The prior of an arm: the rig file's numbers and bounds. The shoulder's zero is in its heading."""
    bounds, links = spec.bounds, spec.links
    plays = [math.radians(joint.backlash_deg) for joint in (spec.shoulder, spec.elbow)]
    turned_deg = math.hypot(bounds.heading_deg, spec.shoulder.zero_bound_deg)
    prior = [*spec.base_mm, math.radians(spec.heading_deg), spec.tip.radius_mm, links.upper_mm, links.fore_mm]
    sigma = np.array(
        [
            bounds.base_mm / 2,
            bounds.base_mm / 2,
            math.radians(turned_deg) / math.sqrt(3),
            spec.tip.radius_bound_mm / math.sqrt(3),
            links.bound_mm / math.sqrt(3),
            links.bound_mm / math.sqrt(3),
            math.radians(spec.elbow.zero_bound_deg) / math.sqrt(3),
            *(play / math.sqrt(12) for play in plays),
        ]
    )
    return ArmModel(
        spec.name,
        np.array([*prior, 0.0, *(play / 2 for play in plays)]),
        np.diag(np.maximum(sigma, _MIN_SIGMAS_ARM) ** 2),
        gear_ratio=np.array([spec.shoulder.gear_ratio, spec.elbow.gear_ratio]),
        zero_rad=np.array([_zero_rad(spec.shoulder), _zero_rad(spec.elbow)]),
    )


def _zero_rad(joint: JointConfig) -> float:
    return math.radians(joint.zero_deg) - math.pi


def zero_in_file_mm(zero_mm: float, mm_per_rad: float) -> float:
    """A zero at Goal Position 2048, as kinematics have it, at Goal Position 0, as files have it."""
    return zero_mm - mm_per_rad * math.pi
