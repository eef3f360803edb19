"""Model of an aim and slide finger.

In touches a slide's backlash is always taken up on the side to which the part pushes the tip back; the
fitted zero belongs to that side.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.calibration.actuator_estimators import (
    Backlash,
    Homing,
    StopStalls,
    combine_backlash,
    estimate_backlash,
    estimate_friction,
    fit_homing,
    line_through_stops,
)
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
    waves,
    with_play,
)
from palpate.calibration.measurements import TouchMeasurement
from palpate.config import ActuatorsCalibration, RotaryCalibration, SlideCalibration, SlideFingerConfig
from palpate.config.calibration_finger import PlaceCalibration
from palpate.config.rig_servos import AimConfig, SlideConfig
from palpate.drivers.kinematics import TICK_RAD

ZERO, AIM_PLAY, SCALE, ENCODERS = 4, 5, 6, slice(7, 15)
"""Columns of a slide: zero (mm), play of the aim (rad), error of its travel per turn (a share), encoders."""

_FRAME_LAG_SAMPLES = (
    0.5  # samples by which frames, averaged since the last look, are older than the servo's state
)
_STEP_SHARE = 0.1  # of the slide's encoder step: it is measured on the move, over several of them
_MIN_SIGMAS = np.array([0.02, 0.02, 2e-4, 0.005, 0.002, 1e-5, 1e-6, *[1e-5] * 2 * WAVES])
"""Standard deviations that no prior goes below, so that nothing is quite certain."""


@dataclass(frozen=True, eq=False)
class SlideModel(FingerModel):
    """An aim and a slide: aim = (servo − aim_zero_rad) / gear_ratio.

    distance = zero + mm_per_rad · (1 + scale) · servo, with servos' angles as their encoders are corrected.
    """

    spec: SlideFingerConfig
    gear_ratio: float
    aim_zero_rad: float
    mm_per_rad: float
    gives_all_round = False
    place_columns = (0, 1, HEADING, RADIUS, ZERO)
    encoders = ENCODERS
    joints = (("aim", HEADING, AIM_PLAY), ("slide", ZERO, ZERO))

    @property
    def slide(self) -> SlideConfig:
        """Slide of the finger."""
        return self.spec.slide

    @property
    def plays_rad(self) -> Floats:
        """Play of the aim: that of the slide is in its zero, because a touch keeps it on one flank."""
        return np.radians([self.spec.aim.backlash_deg, 0.0])

    @property
    def pushable(self) -> tuple[bool, bool]:
        """Aim alone."""
        return self.spec.aim.backlash_holds_n is not None, False

    @classmethod
    def nominal(cls, spec: SlideFingerConfig) -> Self:
        """Prior by the rig file alone."""
        return cls.with_slide(spec, slide_in_contact(spec))

    @classmethod
    def from_actuators(cls, spec: SlideFingerConfig, actuators: ActuatorsCalibration) -> Self:
        """Prior with the slide as it was measured."""
        model = cls.with_slide(spec, SlideInContact.from_calibration(actuators.slide))
        if not actuators.slide.homed:
            return model
        shift, own = stops_by_encoder(spec), slice(ENCODERS.start + WAVES, ENCODERS.stop)
        carry = np.eye(len(model.prior))
        carry[[ZERO, SCALE], own] = shift
        return replace(model, prior=carry @ model.prior, covariance=carry @ model.covariance @ carry.T)

    @classmethod
    def certain(cls, spec: SlideFingerConfig) -> Self:
        """Prior with the slide as the rig file has it, without a doubt."""
        per_rad = spec.slide.mm_per_rad
        zero_mm = spec.slide.zero_mm + math.pi * per_rad
        return cls.with_slide(spec, SlideInContact(zero_mm, per_rad, np.zeros((2, 2))))

    def centres(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Along the slide's direction."""
        angles = self.angles_rad(values, servos_rad)
        along = unit_vectors(self._facing_rad(values, angles, ways))
        result: Floats = values[:, BASE] + self._distance(values, angles)[:, None] * along
        return result

    def slopes(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Base, heading and play turn and shift it, zero and scale move it along."""
        angles = self.angles_rad(values, servos_rad)
        along = unit_vectors(self._facing_rad(values, angles, ways))
        across = left_normals(along) * self._distance(values, angles)[:, None]
        result = np.zeros((len(values), 2, values.shape[1]))
        result[:, 0, 0] = result[:, 1, 1] = 1.0
        result[:, :, HEADING] = across
        result[:, :, ZERO] = along
        result[:, :, AIM_PLAY] = -ways[:, :1] * across
        result[:, :, SCALE] = along * (self.mm_per_rad * angles[:, 1:])
        per_rad = self.mm_per_rad * (1 + values[:, SCALE, None])
        turns = np.stack([across / self.gear_ratio, along * per_rad], axis=1)
        result[:, :, ENCODERS] = encoder_slopes(turns, servos_rad)
        return result

    def facing_rad(self, values: Floats, servos_rad: Floats, ways: Floats) -> Floats:
        """Direction of the slide."""
        return self._facing_rad(values, self.angles_rad(values, servos_rad), ways)

    def _facing_rad(self, values: Floats, angles_rad: Floats, ways: Floats) -> Floats:
        aim = (angles_rad[:, 0] - self.aim_zero_rad) / self.gear_ratio
        result: Floats = values[:, HEADING] - ways[:, 0] * values[:, AIM_PLAY] + aim
        return result

    def travel_per_turn(self, values: Floats, servos_rad: Floats) -> Floats:
        """The aim turns it about the base, the slide moves it along."""
        angles = self.angles_rad(values, servos_rad)
        along = unit_vectors(self._facing_rad(values, angles, np.zeros_like(servos_rad)))
        aim = left_normals(along) * self._distance(values, angles)[:, None]
        return np.stack([aim, along * self.mm_per_rad], axis=1)

    def rounding_mm(self, values: Floats, servos_rad: Floats, _normal: Floats, /) -> Floats:
        """The slide is measured on the move, over several steps; the aim stands."""
        along = abs(self.mm_per_rad) * TICK_RAD * _STEP_SHARE
        # Contacts are oblique by less than 48°: half of what the aim is off counts, or so.
        away = np.abs(self._distance(values, self.angles_rad(values, servos_rad)))
        across = 0.5 * away * TICK_RAD / abs(self.gear_ratio) / math.sqrt(12)
        result: Floats = np.hypot(along, across)
        return result

    def repeat_mm(self, first_rad: Floats, again_rad: Floats, _facing_rad: float, /) -> tuple[float, float]:
        """Steps of the slide; an aim that comes from the other side stands elsewhere, which is seen."""
        per_rad = abs(self.mm_per_rad)
        off = abs(float(again_rad[1] - first_rad[1])) * per_rad
        limit = REPEAT_SIGMAS * math.hypot(per_rad * TICK_RAD / math.sqrt(6), REPEAT_SIGMA_MM)
        distance = abs(float(self.prior[ZERO]) + self.mm_per_rad * float(first_rad[1]))
        apart = abs(float(again_rad[0] - first_rad[0])) + TICK_RAD
        turned = 4 * float(self.prior[AIM_PLAY]) + apart / abs(self.gear_ratio)
        return off, limit + turned * distance * MAX_OBLIQUE_TANGENT

    def _distance(self, values: Floats, angles_rad: Floats) -> Floats:
        reach = self.mm_per_rad * angles_rad[:, 1]
        result: Floats = values[:, ZERO] + (1 + values[:, SCALE]) * reach
        return result

    @classmethod
    def with_slide(cls, spec: SlideFingerConfig, slide: "SlideInContact") -> Self:
        """Prior by the rig file's numbers and bounds, and what is known of the slide."""
        aim_play = math.radians(spec.aim.backlash_deg)
        prior = np.array(
            [
                *spec.base_mm,
                math.radians(spec.heading_deg),
                spec.tip.radius_mm,
                slide.zero_mm,
                aim_play / 2,
                0.0,
                *np.radians(spec.aim.encoder_harmonics_deg),
                *np.radians(spec.slide.encoder_harmonics_deg),
            ]
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
                *[encoder_sigma_rad(spec)] * 2 * WAVES,
            ]
        )
        covariance = np.zeros((len(prior), len(prior)))
        covariance[np.ix_([4, 6], [4, 6])] = slide.covariance
        covariance += np.diag(np.maximum(sigma, _MIN_SIGMAS) ** 2)
        return cls(
            spec,
            prior,
            covariance,
            gear_ratio=spec.aim.gear_ratio,
            aim_zero_rad=math.radians(spec.aim.zero_deg) - math.pi,
            mm_per_rad=slide.mm_per_rad,
        )

    def describe_actuators(self, measured: ActuatorMeasurements) -> ActuatorsCalibration:
        """Slide and aim."""
        spec, presses, stalls = self.spec, measured.presses, measured.stalls
        backlash = combine_backlash(
            [estimate_backlash(press, press.counts.sum(axis=(1, 2)), _FRAME_LAG_SAMPLES) for press in presses]
        )
        friction = estimate_friction(presses)
        home = _described_homing(spec.slide) if stalls is None else fit_homing(spec, stalls, backlash)
        seen = slide_in_contact(spec, backlash, stalls)
        if stalls is not None:
            home = _homing_by_encoder(spec, home)
        slide = SlideCalibration(
            direction_confirmed=friction.direction > 0,
            mm_per_turn=2 * math.pi * home.mm_per_rad,
            mm_per_turn_sigma=2 * math.pi * home.mm_per_rad_sigma,
            zero_mm=zero_in_file_mm(home.zero_mm, home.mm_per_rad),
            zero_sigma_mm=math.hypot(home.zero_sigma_mm, home.mm_per_rad_sigma * math.pi),
            homed=stalls is not None,
            backlash_mm=backlash.half_mm,
            backlash_sigma_mm=backlash.sigma_mm,
            touch_zero_mm=seen.zero_mm,
            touch_covariance=seen.covariance.tolist(),
            friction_a=abs(friction.push_n) / abs(presses[0].newton_per_a[1]),
            **dict(measured.stops),
        )
        half = spec.aim.backlash_deg / 2
        aim = RotaryCalibration(
            direction_confirmed=_aim_turns(spec.aim, measured.touched, measured.normal),
            backlash_deg=half,
            backlash_sigma_deg=half / BOUND_SIGMAS,
            friction_a=measured.aim_friction_a,
        )
        return ActuatorsCalibration(slide=slide, aim=aim)

    def describe_place(
        self, values: Floats, covariance: Floats, heading: tuple[float, float]
    ) -> PlaceCalibration:
        """Place with the zero and the travel per turn that belong to it."""
        per_rad = self.mm_per_rad * (1 + float(values[SCALE]))
        return PlaceCalibration(
            **describe_stand(self, values, covariance, heading),
            zero_mm=zero_in_file_mm(float(values[ZERO]), per_rad),
            mm_per_turn=2 * math.pi * per_rad,
            covariance=covariance[np.ix_(self.place_columns, self.place_columns)].tolist(),
        )

    def fit_plays(self, before: ActuatorsCalibration, values: Floats, sigma: Floats) -> ActuatorsCalibration:
        """Play of the aim."""
        aim = with_play(before.aim, float(values[AIM_PLAY]), float(sigma[AIM_PLAY]))
        return before.model_copy(update={"aim": aim})

    def known_values(self, actuators: ActuatorsCalibration) -> dict[int, tuple[float, float]]:
        """Play of the aim, and the error of the slide's travel."""
        slide = actuators.slide
        share = slide.mm_per_turn_sigma / abs(slide.mm_per_turn)
        return {AIM_PLAY: known_play(actuators.aim), SCALE: (0.0, share)}

    def joint_bounds(
        self, values: Floats, covariance: Floats, levers_mm: Floats, sigmas: float, slow: SlowTouch
    ) -> JointBounds:
        """Play and steps of the aim at the furthest, and those of the slide."""
        slide, farthest_mm = slow.actuators.slide, float(levers_mm[0])
        play = abs(float(values[AIM_PLAY])) + sigmas * math.sqrt(covariance[AIM_PLAY, AIM_PLAY])
        step = TICK_RAD / 2 / abs(self.gear_ratio)
        return JointBounds(
            quantisation_mm=math.hypot(abs(self.mm_per_rad) * TICK_RAD / 2, farthest_mm * step),
            play_mm=farthest_mm * play,
            # A slide that has run on comes back to where it was to stop; in its play the tip need not follow.
            overshoot_mm=min(2 * slide.backlash_mm, slow.speed_mm_s * slide.settle_s),
            quantisation_rad=step,
            play_rad=play,
        )


def stops_by_encoder(spec: SlideFingerConfig) -> Floats:
    """Derivatives (2, 4) of zero (mm) and error of the travel, as stalls at both stops say, by the encoder.

    The stops' angles as the rig file has them are near enough.
    """
    slide = spec.slide
    assert slide.stops_mm is not None
    per_rad = slide.mm_per_rad
    servos = (np.array(slide.stops_mm) - slide.zero_mm) / per_rad - math.pi
    back, front = waves(servos)
    share = -(front - back) / (servos[1] - servos[0])
    return np.stack([-per_rad * (back + servos[0] * share), share])


def _homing_by_encoder(spec: SlideFingerConfig, home: Homing) -> Homing:
    """The same, as uncertain as an encoder that is off makes it."""
    shift = encoder_sigma_rad(spec) * stops_by_encoder(spec)
    in_file = shift[0] - math.pi * home.mm_per_rad * shift[1]
    travel = math.hypot(home.mm_per_rad_sigma, home.mm_per_rad * float(np.linalg.norm(shift[1])))
    # What both have in common is in the latter: the sum of their squares is no less than the truth.
    return replace(home, mm_per_rad_sigma=travel, zero_sigma_mm=math.hypot(home.zero_sigma_mm, *in_file))


def _described_homing(slide: SlideConfig) -> Homing:
    """Travel and zero as the rig file says."""
    per_rad = slide.mm_per_rad
    return Homing(
        per_rad,
        abs(per_rad) * slide.mm_per_turn_spread / math.sqrt(3),
        slide.zero_mm + per_rad * math.pi,
        slide.zero_bound_mm / math.sqrt(3),
    )


def _aim_turns(aim: AimConfig, touched: Sequence[TouchMeasurement], normal: Floats) -> bool:
    """True if contacts wander round the tip the way they must if the aim turns as described."""
    measured = np.unwrap([item.angle_rad for item in touched])
    aims = np.array([item.servos_rad[0] for item in touched]) / aim.gear_ratio
    bearing = np.unwrap(np.arctan2(-normal[:, 1], -normal[:, 0]) - aims)
    return len(touched) > 1 and float(np.dot(measured - measured.mean(), bearing - bearing.mean())) > 0


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
        """Slide by its calibration."""
        per_rad = found.mm_per_turn / (2 * math.pi)
        return cls(found.touch_zero_mm, per_rad, np.array(found.touch_covariance))


def slide_in_contact(
    spec: SlideFingerConfig, backlash: Backlash | None = None, stalls: StopStalls | None = None
) -> SlideInContact:
    """Slide by the rig file, its backlash and its stops, as far as they were measured."""
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


def zero_in_file_mm(zero_mm: float, mm_per_rad: float) -> float:
    """A zero at Goal Position 2048, as kinematics have it, at Goal Position 0, as files have it."""
    return zero_mm - mm_per_rad * math.pi
