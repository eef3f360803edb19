"""Model of an arm of two links."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.finger_model import (
    BASE,
    BOUND_SIGMAS,
    HEADING,
    MAX_OBLIQUE_TANGENT,
    RADIUS,
    REPEAT_SIGMA_MM,
    REPEAT_SIGMAS,
    WAVES,
    ActuatorMeasurements,
    FingerModel,
    JointBounds,
    SlowTouch,
    describe_stand,
    encoder_sigma_rad,
    encoder_slopes,
    known_play,
    left_normals,
    unit_vectors,
    with_play,
)
from palpate.calibration.measurements import PressMeasurement
from palpate.config import ArmFingerConfig, JointConfig, RotaryCalibration
from palpate.config.calibration_finger import ArmActuatorsCalibration, ArmPlaceCalibration
from palpate.drivers.kinematics import TICK_RAD

UPPER, FORE, ELBOW_ZERO, SHOULDER_PLAY, ELBOW_PLAY, ENCODERS = 4, 5, 6, 7, 8, slice(9, 17)
"""Columns of an arm: lengths of its links (mm), elbow angle at its 0, plays of joints (rad), encoders."""

_STEP_SHARE = 0.15  # of a joint's encoder step: it is measured on the move, over a few of them
_MIN_SIGMAS = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 0.002, 1e-5, 1e-5, 1e-5, *[1e-5] * 2 * WAVES])
"""Standard deviations that no prior goes below, so that nothing is quite certain."""


@dataclass(frozen=True, eq=False)
class ArmModel(FingerModel):
    """A shoulder and an elbow: joint angle = (servo − zero_rad) / gear_ratio, (2,) each.

    The shoulder's zero is in the heading, the elbow's error is a value of its own.
    """

    spec: ArmFingerConfig
    gear_ratio: Floats
    zero_rad: Floats
    gives_all_round = True
    place_columns = (0, 1, HEADING, RADIUS, UPPER, FORE, ELBOW_ZERO)
    encoders = ENCODERS
    joints = (("shoulder", HEADING, SHOULDER_PLAY), ("elbow", ELBOW_ZERO, ELBOW_PLAY))

    @property
    def facing_sigma_deg(self) -> float:
        """Deviation by the elbow's zero and both encoders."""
        encoders = self.spec.bounds.encoder_deg / self.gear_ratio
        return math.hypot(self.spec.elbow.zero_bound_deg, *encoders) / math.sqrt(3)

    @property
    def plays_rad(self) -> Floats:
        """Plays of both joints."""
        return np.radians([self.spec.shoulder.backlash_deg, self.spec.elbow.backlash_deg])

    @property
    def pushable(self) -> tuple[bool, bool]:
        """Both joints."""
        shoulder, elbow = self.spec.shoulder, self.spec.elbow
        return shoulder.backlash_holds_n is not None, elbow.backlash_holds_n is not None

    @classmethod
    def nominal(cls, spec: ArmFingerConfig) -> Self:
        """Prior by the rig file's numbers and bounds."""
        bounds, links = spec.bounds, spec.links
        plays = [math.radians(joint.backlash_deg) for joint in (spec.shoulder, spec.elbow)]
        turned_deg = math.hypot(bounds.heading_deg, spec.shoulder.zero_bound_deg)
        prior = [
            *spec.base_mm,
            math.radians(spec.heading_deg),
            spec.tip.radius_mm,
            links.upper_mm,
            links.fore_mm,
        ]
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
                *[encoder_sigma_rad(spec)] * 2 * WAVES,
            ]
        )
        harmonics = [*spec.shoulder.encoder_harmonics_deg, *spec.elbow.encoder_harmonics_deg]
        return cls(
            spec,
            np.array([*prior, 0.0, *(play / 2 for play in plays), *np.radians(harmonics)]),
            np.diag(np.maximum(sigma, _MIN_SIGMAS) ** 2),
            gear_ratio=np.array([spec.shoulder.gear_ratio, spec.elbow.gear_ratio]),
            zero_rad=np.array([_zero_rad(spec.shoulder), _zero_rad(spec.elbow)]),
        )

    def centres(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Tips at the end of both links."""
        upper, fore = self._links(values, servos_rad, ways)
        result: Floats = values[:, BASE] + upper + fore
        return result

    def slopes(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Turns of the shoulder move the whole arm, those of the elbow its second link."""
        upper, fore = self._links(values, servos_rad, ways)
        whole, end = left_normals(upper + fore), left_normals(fore)
        result = np.zeros((len(values), 2, values.shape[1]))
        result[:, 0, 0] = result[:, 1, 1] = 1.0
        result[:, :, HEADING] = whole
        result[:, :, UPPER] = upper / values[:, UPPER, None]
        result[:, :, FORE] = fore / values[:, FORE, None]
        result[:, :, ELBOW_ZERO] = end
        result[:, :, SHOULDER_PLAY] = -ways[:, :1] * whole
        result[:, :, ELBOW_PLAY] = -ways[:, 1:] * end
        turns = np.stack([whole, end], axis=1) / self.gear_ratio[:, None]
        result[:, :, ENCODERS] = encoder_slopes(turns, servos_rad)
        return result

    def facing_rad(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Direction of the second link."""
        return self._angles(values, servos_rad, ways)[1]

    def travel_per_turn(self, values: Floats, servos_rad: Floats) -> Floats:
        """Both joints turn it about their axes."""
        upper, fore = self._links(values, servos_rad, np.zeros_like(servos_rad))
        return np.stack([left_normals(upper + fore), left_normals(fore)], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, normal: Floats, /) -> Floats:
        """Both joints are measured on the move, over a few steps."""
        along = np.einsum("nkx,nx->nk", self.travel_per_turn(values, servos_rad), normal) / self.gear_ratio
        result: Floats = TICK_RAD * _STEP_SHARE * np.hypot(along[:, 0], along[:, 1])
        return result

    def repeat_mm(self, first_rad: Floats, again_rad: Floats, facing_rad: float, /) -> tuple[float, float]:
        """Steps of both encoders, and joints that may be on the other flank of their play."""
        values, servos = np.tile(self.prior, (2, 1)), np.stack([first_rad, again_rad])
        ways = np.zeros((2, 2))
        first, again = self.centres(values, servos, ways) @ [1.0, 1j]
        travel = float(self.facing_rad(values, servos, ways)[0]) - facing_rad
        moved = (again - first) * np.exp(-1j * travel)
        levers = np.linalg.norm(self.travel_per_turn(values, servos)[0], axis=1)
        steps = float(np.hypot(*(levers * TICK_RAD / self.gear_ratio))) / math.sqrt(6)
        turned = 4 * float(levers @ self.prior[[SHOULDER_PLAY, ELBOW_PLAY]])
        limit = REPEAT_SIGMAS * math.hypot(steps, REPEAT_SIGMA_MM)
        return abs(moved.real), limit + (turned + abs(moved.imag)) * MAX_OBLIQUE_TANGENT

    def _angles(self, values: Floats, servos_rad: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Directions (n,) of both links."""
        joints = (self.angles_rad(values, servos_rad) - self.zero_rad) / self.gear_ratio
        first = values[:, HEADING] + joints[:, 0] - ways[:, 0] * values[:, SHOULDER_PLAY]
        bend = joints[:, 1] + values[:, ELBOW_ZERO] - ways[:, 1] * values[:, ELBOW_PLAY]
        return first, first + bend

    def _links(self, values: Floats, servos_rad: Floats, ways: Floats) -> tuple[Floats, Floats]:
        """Both links (n, 2), mm."""
        first, second = self._angles(values, servos_rad, ways)
        return values[:, UPPER, None] * unit_vectors(first), values[:, FORE, None] * unit_vectors(second)

    def describe_actuators(self, measured: ActuatorMeasurements) -> ArmActuatorsCalibration:
        """Both joints; their plays stay as described, for the fit of the fingers to narrow down."""
        return ArmActuatorsCalibration(
            shoulder=_joint(self.spec.shoulder, measured.presses, 0),
            elbow=_joint(self.spec.elbow, measured.presses, 1),
            stops=measured.stops,
        )

    def describe_place(
        self, values: Floats, covariance: Floats, heading: tuple[float, float]
    ) -> ArmPlaceCalibration:
        """Place with the lengths of the links and the elbow's zero."""
        sigma = np.sqrt(np.diag(covariance))
        return ArmPlaceCalibration(
            **describe_stand(self, values, covariance, heading),
            upper_mm=float(values[UPPER]),
            upper_sigma_mm=float(sigma[UPPER]),
            fore_mm=float(values[FORE]),
            fore_sigma_mm=float(sigma[FORE]),
            elbow_zero_deg=math.degrees(values[ELBOW_ZERO]),
            elbow_zero_sigma_deg=math.degrees(sigma[ELBOW_ZERO]),
            covariance=covariance[np.ix_(self.place_columns, self.place_columns)].tolist(),
        )

    def fit_plays(
        self, before: ArmActuatorsCalibration, values: Floats, sigma: Floats
    ) -> ArmActuatorsCalibration:
        """Plays of both joints."""
        shoulder, elbow = (
            with_play(joint, float(values[column]), float(sigma[column]))
            for joint, column in ((before.shoulder, SHOULDER_PLAY), (before.elbow, ELBOW_PLAY))
        )
        return before.model_copy(update={"shoulder": shoulder, "elbow": elbow})

    def known_values(self, actuators: ArmActuatorsCalibration) -> dict[int, tuple[float, float]]:
        """Plays of both joints."""
        return {SHOULDER_PLAY: known_play(actuators.shoulder), ELBOW_PLAY: known_play(actuators.elbow)}

    def joint_bounds(
        self, values: Floats, covariance: Floats, levers_mm: Floats, sigmas: float, slow: SlowTouch
    ) -> JointBounds:
        """Both joints; either may be anywhere in its play, so that an overshoot adds nothing to that."""
        del slow
        columns = [SHOULDER_PLAY, ELBOW_PLAY]
        plays = np.abs(values[columns]) + sigmas * np.sqrt(np.diag(covariance)[columns])
        steps = TICK_RAD / 2 / np.abs(self.gear_ratio)
        return JointBounds(
            quantisation_mm=float(levers_mm @ steps),
            play_mm=float(levers_mm @ plays),
            overshoot_mm=0.0,
            quantisation_rad=float(steps.sum()),
            play_rad=float(plays.sum()),
        )


def _joint(spec: JointConfig, presses: Sequence[PressMeasurement], which: int) -> RotaryCalibration:
    """Calibration of a joint by free paths of presses; a joint that never moved on them is not confirmed."""
    current = np.array([press.free_a[which] for press in presses])
    moved = np.isfinite(current)
    middle = float(np.median(current[moved])) if moved.any() else 0.0
    half = spec.backlash_deg / 2
    return RotaryCalibration(
        direction_confirmed=bool(moved.any()) and bool((current[moved] > 0).all()),
        backlash_deg=half,
        backlash_sigma_deg=half / BOUND_SIGMAS,
        friction_a=max(middle, 0.0),
    )


def _zero_rad(joint: JointConfig) -> float:
    return math.radians(joint.zero_deg) - math.pi
