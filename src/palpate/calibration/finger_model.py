"""Model of a finger: its tip as a function of the values that calibration estimates, and their priors.

Every kind of finger has its values in one row: base x, base y (mm), heading (rad) and tip radius (mm) first,
then its own. All fingers of a rig have rows of the same width; values that a kind does not use are fixed.
Priors come from the rig file and from homing. In touches a slide's backlash is always taken up on the side
to which the part pushes the tip back; the fitted zero belongs to that side.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.actuator_estimators import StopStalls
from palpate.calibration.measurements import PressMeasurement, TouchMeasurement
from palpate.config import FingerConfig
from palpate.config.calibration_finger import Actuators, FingerPlace, RotaryCalibration, StopsCalibration
from palpate.config.rig_servos import SlideConfig

BASE, HEADING, RADIUS = slice(0, 2), 2, 3
"""Of every kind."""

REPEAT_SIGMAS, REPEAT_SIGMA_MM = 5.0, 0.01
"""Deviations, and one more of them, that a touch may be off that is made again."""

MAX_OBLIQUE_TANGENT = 1.12
"""Tangent of 48°: touches are not more oblique, and a way that is off shifts them so."""

BOUND_SIGMAS = 3.3
"""Standard deviations that a bound is taken for, where nothing but a bound is known."""

_PINNED_SIGMA = 1e-3  # of values that a kind has no use for: nothing moves them


@dataclass(frozen=True, eq=False)
class FingerModel(ABC):
    """Model of a finger: how its values and its servos place the tip.

    `prior` (k,) of the values, and its `covariance` (k, k). `values` (n, k), `servos_rad` (n, 2) and `ways`
    (n, 2) are of n touches: from which side each joint came, +1 from below, -1 from above, 0 in the middle of
    its play.
    """

    spec: FingerConfig
    prior: Floats
    covariance: Floats
    gives_all_round: ClassVar[bool]
    """True if a force moves the tip in whatever direction it has; else only across its path."""
    place_columns: ClassVar[tuple[int, ...]]
    """Columns of the values whose covariance a calibration file has."""
    encoders: ClassVar[slice]
    """Columns of what corrects both encoders (rad), as `waves` has them, the servo next to the base first."""
    joints: ClassVar[tuple[tuple[str, int, int], ...]]
    """Keys of both servos, with the columns of their zeros and of their plays; of a slide both are one."""

    @property
    def name(self) -> str:
        """Name in the rig file."""
        return self.spec.name

    @property
    def slide(self) -> SlideConfig | None:
        """Slide that is driven against its stops, behind an aim that is swung; None without one."""
        return None

    @property
    def facing_sigma_deg(self) -> float:
        """Deviation of where the finger faces from what is described, in all presses alike."""
        return 0.0

    @property
    @abstractmethod
    def plays_rad(self) -> Floats:
        """Declared plays (2,) of the joints that touches leave open."""

    @property
    @abstractmethod
    def pushable(self) -> tuple[bool, bool]:
        """Joints that a force may push through their play, as the rig file says."""

    @classmethod
    @abstractmethod
    def nominal(cls, spec: Any) -> Self:
        """Prior by the rig file alone."""

    @classmethod
    def from_actuators(cls, spec: Any, _actuators: Any) -> Self:
        """Prior of a finger whose actuators have been measured."""
        return cls.nominal(spec)

    @classmethod
    def certain(cls, spec: Any) -> Self:
        """Prior of a calibrated finger, where it is and not elsewhere."""
        return cls.nominal(spec)

    def widen(self, columns: int) -> Self:
        """The same with so many values, of which those that it has no use for are pinned at 0."""
        own = len(self.prior)
        prior, covariance = np.zeros(columns), _PINNED_SIGMA**2 * np.eye(columns)
        prior[:own], covariance[:own, :own] = self.prior, self.covariance
        return replace(self, prior=prior, covariance=covariance)

    def fix(self, sigma: float) -> Self:
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

    def angles_rad(self, values: Floats, servos_rad: Floats) -> Floats:
        """Angles (n, 2) of the servos for what their encoders say."""
        result: Floats = servos_rad + np.einsum(
            "nsw,nsw->ns", values[:, self.encoders].reshape(-1, 2, WAVES), waves(servos_rad)
        )
        return result

    @abstractmethod
    def travel_per_turn(self, values: Floats, servos_rad: Floats) -> Floats:
        """Travel of the tip per turn of each joint, mm/rad: (n, 2, 2), the one next to the base first.

        A slide's second joint is its servo.
        """
        ...

    @abstractmethod
    def rounding_mm(self, values: Floats, servos_rad: Floats, normal: Floats, /) -> Floats:
        """Deviations (n,) of touches along a surface's normal (n, 2) by the steps of encoders."""
        ...

    @abstractmethod
    def repeat_mm(self, first_rad: Floats, again_rad: Floats, facing_rad: float, /) -> tuple[float, float]:
        """Distance of a repeated touch from the first one, along its way, and what explains.

        Servo angles (2,) of both; `facing_rad`: where the finger faces, from its direction of travel. A way
        that is a little elsewhere, or the other flank of the play, lets an oblique touch be further.
        """
        ...

    @abstractmethod
    def describe_actuators(self, measured: "ActuatorMeasurements") -> Actuators:
        """Actuators as a file has them. Raises InputError for what is not as described."""

    @abstractmethod
    def describe_place(self, values: Floats, covariance: Floats, heading: tuple[float, float]) -> FingerPlace:
        """Place as a file has it, of values (k,); `heading`: of the array, with its deviation (rad)."""

    @abstractmethod
    def fit_plays(self, before: Any, values: Floats, sigma: Floats) -> Actuators:
        """Actuators with the plays that touches from both sides have shown."""

    @abstractmethod
    def known_values(self, actuators: Any) -> dict[int, tuple[float, float]]:
        """Values and deviations that a calibration's actuators say, by columns."""

    @abstractmethod
    def joint_bounds(
        self, values: Floats, covariance: Floats, levers_mm: Floats, sigmas: float, slow: "SlowTouch"
    ) -> "JointBounds":
        """Share of the joints in the bound on contacts; `levers_mm` (2,): the largest of each joint."""


@dataclass(frozen=True, eq=False)
class ActuatorMeasurements:
    """Measurements of one finger's actuators: presses, and how it stops.

    `stalls`: of a slide at its stops; `aim_friction_a`: current that its aim needs to turn. `touched` are
    touches of a disc, with the surface's normals (n, 2).
    """

    presses: Sequence[PressMeasurement]
    stops: StopsCalibration
    stalls: StopStalls | None
    aim_friction_a: float
    touched: Sequence[TouchMeasurement]
    normal: Floats


@dataclass(frozen=True)
class SlowTouch:
    """Touch of a calibrated finger: its actuators, where its array was found to look, and its speed."""

    actuators: Any
    phase_deg: float
    speed_mm_s: float


@dataclass(frozen=True)
class JointBounds:
    """Share of servos, plays and stops in the bound on contacts: mm of the place, rad of the turn."""

    quantisation_mm: float
    play_mm: float
    overshoot_mm: float
    quantisation_rad: float
    play_rad: float


WAVES = 4
"""Waves of an encoder's error: cosine and sine of its angle, and of twice that."""


def waves_of(joint: int) -> slice:
    """Those of one of both encoders, among its finger's."""
    return slice(joint * WAVES, (joint + 1) * WAVES)


def waves(servos_rad: Floats) -> Floats:
    """Waves (…, 4) of encoders' errors at angles (…)."""
    turns = (np.cos(servos_rad), np.sin(servos_rad), np.cos(2 * servos_rad), np.sin(2 * servos_rad))
    return np.stack(turns, axis=-1)


def encoder_sigma_rad(spec: FingerConfig) -> float:
    """Deviation of each wave if both together are uniform within what the rig file declares."""
    return math.radians(spec.bounds.encoder_deg) / math.sqrt(6)


def encoder_rate_sigma(spec: FingerConfig) -> float:
    """Deviation of small turns of a servo, as a share of them: the derivative of its waves."""
    return encoder_sigma_rad(spec) * math.sqrt(1 + 2**2)


def encoder_slopes(per_rad: Floats, servos_rad: Floats) -> Floats:
    """Derivatives (n, 2, 8) of centres by what corrects the encoders; `per_rad` (n, 2, 2): by both servos."""
    slopes: Floats = np.einsum("nsx,nsw->nxsw", per_rad, waves(servos_rad))
    return slopes.reshape(len(servos_rad), 2, 2 * WAVES)


def describe_encoders(model: FingerModel, values: Floats, covariance: Floats) -> dict[str, Any]:
    """Keys of a place that say what corrects the encoders, and what may be left then, anywhere in a turn."""
    near, far = np.degrees(values[model.encoders]).reshape(2, WAVES).tolist()
    at = waves(np.linspace(0, 2 * math.pi, 72, endpoint=False))
    own = covariance[model.encoders, model.encoders]
    variance = [np.einsum("pi,ij,pj->p", at, own[joint, joint], at) for joint in (waves_of(0), waves_of(1))]
    left_rad = BOUND_SIGMAS * math.sqrt(max(float(np.max(variance)), 0.0))
    return {"encoder_harmonics_deg": (near, far), "encoder_bound_deg": math.degrees(left_rad)}


def describe_stand(
    model: FingerModel, values: Floats, covariance: Floats, heading: tuple[float, float]
) -> dict[str, Any]:
    """Keys of a place that fingers of every kind have."""
    sigma = np.sqrt(np.diag(covariance))
    return describe_encoders(model, values, covariance) | {
        "base_mm": (float(values[0]), float(values[1])),
        "base_sigma_mm": (float(sigma[0]), float(sigma[1])),
        "heading_deg": math.degrees(values[HEADING]),
        "heading_sigma_deg": math.degrees(sigma[HEADING]),
        "tip_radius_mm": float(values[RADIUS]),
        "tip_radius_sigma_mm": float(sigma[RADIUS]),
        "array_heading_deg": math.degrees(heading[0]),
        "array_heading_sigma_deg": math.degrees(heading[1]),
    }


def with_play(joint: RotaryCalibration, play_rad: float, sigma_rad: float) -> RotaryCalibration:
    """The joint with a play that touches have shown."""
    # Not a copy with other numbers: these are checked, and rounded as the file has them.
    return RotaryCalibration(
        direction_confirmed=joint.direction_confirmed,
        backlash_deg=math.degrees(max(play_rad, 0.0)),
        backlash_sigma_deg=math.degrees(sigma_rad),
        friction_a=joint.friction_a,
    )


def known_play(joint: RotaryCalibration) -> tuple[float, float]:
    """Play of a joint and its deviation (rad)."""
    return math.radians(joint.backlash_deg), math.radians(joint.backlash_sigma_deg)


def unit_vectors(angle_rad: Floats) -> Floats:
    """Unit vectors (n, 2) of directions (n,)."""
    return np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])


def left_normals(vectors: Floats) -> Floats:
    """Vectors (n, 2), a quarter turn to the left."""
    return np.column_stack([-vectors[:, 1], vectors[:, 0]])
