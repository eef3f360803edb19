"""Mechanics driven by emulated servos: slides, arms, a turning stage; backlash, and reaction on the shafts.

Between the emulated servos and the tips of the bench. Each kind of mechanics says where the tip really is. It
is written from drawings of the mechanics, not from the host's kinematics, so that the two check each other.
What the host does not know (the `…Truth` values) is drawn by whoever builds the rig.

A gear and what it turns wind up elastically, quasi-statically and with a short lag. Friction holds the driven
side somewhere within its play; a force on the tip that overcomes it pushes the driven side to its flank. Both
are solved implicitly against the tip's stiffness, so that a step of any length is stable.
"""

import cmath
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.tips import TipShape
from palpate.drivers.emulators.servo import EmulatedServo

_YIELD_LAG_S = 0.005  # until 63 % of what a constant force bends
_DAMPING_N_S_PER_MM = 0.02  # of the driven side, while a force pushes it through its play
_MIN_BEND_RAD = 1e-9  # less is none: a tip that stands still is not looked at again


class Play:
    """A coupling with play: the driven side follows once the play is used up."""

    def __init__(self, half: float, at: float) -> None:
        self._half = half
        self.at = at

    def follow_all(self, driving: Iterable[float]) -> None:
        """`follow` the driving side through places in a row."""
        at, half = self.at, self._half
        for place in driving:
            if place - at > half:
                at = place - half
            elif place - at < -half:
                at = place + half
        self.at = at

    def follow(self, driving: float) -> float:
        """Move on with the driving side."""
        if driving - self.at > self._half:
            self.at = driving - self._half
        elif driving - self.at < -self._half:
            self.at = driving + self._half
        return self.at

    def push_to(self, place: float, driving: float) -> None:
        """Push the driven side towards a place, as far as the play lets it go."""
        self.at = min(max(place, driving - self._half), driving + self._half)


@dataclass(frozen=True)
class JointCompliance:
    """Compliance of a joint to a force on the tip that it carries.

    `rad_per_nmm`: elastic turn for a torque of 1 N mm. `play_holds_n`: up to this force on the tip, across
    its lever, friction keeps the joint where it is within its play.
    """

    rad_per_nmm: float
    play_holds_n: float


class CompliantJoint:
    """A joint that a servo drives and a tip's force turns; `yields` None: the force does not move it."""

    def __init__(
        self, play_rad: float, driving_rad: float, yields: JointCompliance | None, stiffness_n_per_mm: float
    ) -> None:
        """`stiffness_n_per_mm`: of the tip, which takes the force away as the joint gives way."""
        self.yields = yields
        self._play = Play(play_rad, driving_rad)
        self._stiffness = stiffness_n_per_mm
        self._bend_rad = 0.0

    @property
    def at(self) -> float:
        """True angle."""
        return self._play.at + self._bend_rad

    def step(self, dt_s: float, driving_rad: float, push_n: float, lever_mm: float) -> None:
        """Follow the servo's side, and give way to a force on the tip: `push_n`, positive counter-clockwise.

        `lever_mm`: from the joint to the tip; the force is the component across it.
        """
        if self.yields is not None:
            self._bend(dt_s, self.yields.rad_per_nmm, push_n, lever_mm)
            beyond_n = max(abs(push_n) - self.yields.play_holds_n, 0.0)
            if beyond_n and lever_mm > 0:
                moved_mm = beyond_n * dt_s / (_DAMPING_N_S_PER_MM + self._stiffness * dt_s)
                turned = moved_mm / lever_mm if push_n > 0 else -moved_mm / lever_mm
                self._play.push_to(self._play.at + turned, driving_rad)
        self._play.follow(driving_rad)

    @property
    def is_straight(self) -> bool:
        """True if it only follows the servo's side until a force on the tip bends it."""
        return self._bend_rad == 0.0

    def follow_all(self, driving_rad: Iterable[float]) -> None:
        """Follow the servo's side through angles in a row, as `step` does while straight and unloaded."""
        self._play.follow_all(driving_rad)

    def _bend(self, dt_s: float, rad_per_nmm: float, push_n: float, lever_mm: float) -> None:
        # As it bends on, a tip in contact is pushed by its stiffness times that way less.
        share = dt_s / _YIELD_LAG_S
        stiffness = self._stiffness if push_n else 0.0
        missing = rad_per_nmm * lever_mm * push_n - self._bend_rad
        change = share * missing / (1 + share * (1 + stiffness * rad_per_nmm * lever_mm**2))
        if abs(change) > _MIN_BEND_RAD:
            self._bend_rad += change
        elif push_n == 0.0:
            self._bend_rad = 0.0


_MM_PER_M = 1000.0
_STOP_N_PER_MM = 2000.0  # a slide's hard stop is a stiff spring
_STOP_N_S_PER_MM = 0.3  # and a damper, so that the slide does not bounce for long
_MIN_LEVER_MM = 1e-6
_STOP_SUBSTEPS = 10  # of a step: the lightest motor swings faster on that spring than in milliseconds


@dataclass(frozen=True)
class FingerTruth:
    """True geometry of an emulated aim + slide finger; mm, rad, N.

    aim = heading + (servo − aim_zero_rad) / gear_ratio and distance = zero_mm + mm_per_rad · servo, with
    servo angles as the shaft has them and `aim_play_rad` and `slide_play_mm` either way between the two.
    `array_heading_rad`: where the array's middle looks, from the direction of travel. `stops_mm`: distances
    at which the carriage that bears the tip meets its hard stops, None if it has none. `aim_yield`: how the
    aim gives way to a force across the slide; None: it bears none. `slide_yield_mm_per_n`: how far the tip
    gives way along the slide; `cable_n`: what a cable pulls the carriage outwards with. `half_length_mm`: how
    far the tip reaches above `height_mm` and below; 0: as thin as a disc. `shape`: a ball has its equator at
    `height_mm`; of a flat pad, which looks where its array does, `tip_radius_mm` is half of the width.
    """

    base_mm: tuple[float, float]
    heading_rad: float
    height_mm: float
    gear_ratio: float
    aim_zero_rad: float
    aim_play_rad: float
    mm_per_rad: float
    zero_mm: float
    slide_play_mm: float
    tip_radius_mm: float
    stiffness_n_per_mm: float
    array_heading_rad: float
    stops_mm: tuple[float, float] | None = None
    aim_yield: JointCompliance | None = None
    slide_yield_mm_per_n: float = 0.0
    cable_n: float = 0.0
    half_length_mm: float = 0.0
    shape: TipShape = TipShape.CYLINDER

    def mechanics(self, near: EmulatedServo, far: EmulatedServo) -> "SlideMechanics":
        """Mechanics that its two servos drive."""
        return SlideMechanics(self, near, far)


@dataclass(frozen=True)
class JointTruth:
    """A joint behind a gear: joint angle = (servo − zero_rad) / gear_ratio, with play either way.

    `yields`: how it gives way to a force on the tip; None: not at all.
    """

    gear_ratio: float
    zero_rad: float
    play_rad: float
    yields: JointCompliance | None = None


@dataclass(frozen=True)
class ArmTruth:
    """True geometry of an emulated two-link arm; mm, rad, N.

    The shoulder's angle counts from `heading_rad`, the elbow's from the first link. `array_heading_rad`:
    where the array's middle looks, from the second link's direction. `half_length_mm`, `shape`: as in
    `FingerTruth`; no arm has a pad.
    """

    base_mm: tuple[float, float]
    heading_rad: float
    height_mm: float
    upper_mm: float
    fore_mm: float
    shoulder: JointTruth
    elbow: JointTruth
    tip_radius_mm: float
    stiffness_n_per_mm: float
    array_heading_rad: float
    half_length_mm: float = 0.0
    shape: TipShape = TipShape.CYLINDER

    def mechanics(self, near: EmulatedServo, far: EmulatedServo) -> "ArmMechanics":
        """Mechanics that its two servos drive."""
        return ArmMechanics(self, near, far)


class SlideMechanics:
    """An aim servo that turns a slide about a fixed base, and a slide servo that moves the tip along it."""

    def __init__(self, truth: FingerTruth, aim: EmulatedServo, slide: EmulatedServo) -> None:
        self._truth = truth
        self._aim = aim
        self._slide = slide
        self._aim_joint = CompliantJoint(
            truth.aim_play_rad, self._aim_drive(), truth.aim_yield, truth.stiffness_n_per_mm
        )
        self._slide_play = Play(truth.slide_play_mm, self._slide_drive())
        self._slide_bend = CompliantJoint(
            0.0, 0.0, JointCompliance(truth.slide_yield_mm_per_n, math.inf), truth.stiffness_n_per_mm
        )
        self._stood = (math.nan, math.nan)
        self._centre = np.full(2, math.nan)

    @property
    def servos(self) -> tuple[EmulatedServo, EmulatedServo]:
        """Aim and slide."""
        return self._aim, self._slide

    @property
    def facing_rad(self) -> float:
        """True direction of the slide."""
        return self._aim_joint.at

    @property
    def centre_mm(self) -> Floats:
        """True position (2,) of the tip's axis; the same array as long as it stands still."""
        at = angle, distance = self._aim_joint.at, self._slide_play.at + self._slide_bend.at
        if at != self._stood:
            x, y = self._truth.base_mm
            self._stood = at
            self._centre = np.array([x + distance * math.cos(angle), y + distance * math.sin(angle)])
        return self._centre

    def step(self, dt_s: float, force_n: Floats | None) -> None:
        """Move on; the force loads the slide, and the aim if that gives way; stops load the slide only."""
        push = across = 0.0
        if force_n is not None:
            facing = self.facing_rad
            push = float(force_n[0]) * math.cos(facing) + float(force_n[1]) * math.sin(facing)
            if self._aim_joint.yields is not None:
                across = float(force_n[1]) * math.cos(facing) - float(force_n[0]) * math.sin(facing)
        steps = 1 if self._reached_mm() is None else _STOP_SUBSTEPS
        for _ in range(steps):
            self._slide_on(dt_s / steps, push + self._truth.cable_n)
        if self._truth.slide_yield_mm_per_n:
            self._slide_bend.step(dt_s, 0.0, push, 1.0)
        lever = self._slide_play.at
        self._aim.step(dt_s, across * lever / _MM_PER_M / self._truth.gear_ratio)
        self._aim_joint.step(dt_s, self._aim_drive(), across, lever)

    def slip(self, by_mm: float) -> None:
        """Let the slide's horn slip on its shaft."""
        self._truth = replace(self._truth, zero_mm=self._truth.zero_mm + by_mm)
        self._slide_play.at += by_mm

    def reach_mm(self, dt_s: float, steps: int) -> float:
        """The furthest that `run` may move the tip; infinite where more than servos may move it."""
        slide = self._slide.motion.reach_rad(dt_s, steps) * abs(self._truth.mm_per_rad)
        at, stops = self._slide_play.at, self._truth.stops_mm
        if (
            self._truth.cable_n
            or not (self._aim_joint.is_straight and self._slide_bend.is_straight)
            or (stops and not stops[0] + slide < at < stops[1] - slide)
        ):
            return math.inf
        turn = self._aim.motion.reach_rad(dt_s, steps) / self._truth.gear_ratio
        return slide + (abs(at) + slide) * turn

    def run(self, dt_s: float, steps: int) -> None:
        """So many times `step` without a force, quicker; within `reach_mm` and the servos' `quiet_steps`."""
        truth = self._truth
        zero_mm, mm_per_rad = truth.zero_mm, truth.mm_per_rad
        self._slide_play.follow_all([zero_mm + mm_per_rad * shaft for shaft in self._slide.run(dt_s, steps)])
        heading, zero, ratio = truth.heading_rad, truth.aim_zero_rad, truth.gear_ratio
        self._aim_joint.follow_all([heading + (shaft - zero) / ratio for shaft in self._aim.run(dt_s, steps)])

    def _slide_on(self, dt_s: float, push_n: float) -> None:
        self._slide.step(dt_s, (push_n + self._stop_n()) * self._truth.mm_per_rad / _MM_PER_M)
        self._slide_play.follow(self._slide_drive())
        stop = self._reached_mm()
        if stop is not None:
            self._slide_play.push_to(stop, self._slide_drive())

    def _reached_mm(self) -> float | None:
        """Distance of the stop that the carriage presses into, if any."""
        at, stops = self._slide_play.at, self._truth.stops_mm
        if stops is None or stops[0] <= at <= stops[1]:
            return None
        return stops[0] if at < stops[0] else stops[1]

    def _stop_n(self) -> float:
        """Force of a stop on the carriage, positive outwards."""
        stop = self._reached_mm()
        if stop is None:
            return 0.0
        deep = stop - self._slide_play.at
        speed = self._slide.motion.velocity_rad_s * self._truth.mm_per_rad
        push = _STOP_N_PER_MM * deep - _STOP_N_S_PER_MM * speed
        return push if push * deep > 0 else 0.0

    def _aim_drive(self) -> float:
        truth = self._truth
        return truth.heading_rad + (self._aim.motion.shaft_rad - truth.aim_zero_rad) / truth.gear_ratio

    def _slide_drive(self) -> float:
        return self._truth.zero_mm + self._truth.mm_per_rad * self._slide.motion.shaft_rad


class ArmMechanics:
    """Two links in a row, each behind a gear with play. Places are complex numbers here: x + iy."""

    def __init__(self, truth: ArmTruth, shoulder: EmulatedServo, elbow: EmulatedServo) -> None:
        self._truth = truth
        self._servos = (shoulder, elbow)
        self._truths = (truth.shoulder, truth.elbow)
        self._joints = tuple(
            CompliantJoint(joint.play_rad, self._drive(k), joint.yields, truth.stiffness_n_per_mm)
            for k, joint in enumerate(self._truths)
        )

    @property
    def servos(self) -> tuple[EmulatedServo, EmulatedServo]:
        """Shoulder and elbow."""
        return self._servos

    def slip(self, _by_mm: float) -> None:
        """Leave the arm as it is: it has no horn that slips."""

    @property
    def facing_rad(self) -> float:
        """True direction of the second link."""
        return self._truth.heading_rad + self._joints[0].at + self._joints[1].at

    @property
    def centre_mm(self) -> Floats:
        """True position (2,) of the tip's axis."""
        tip = complex(*self._truth.base_mm) + self._upper() + self._fore()
        return np.array([tip.real, tip.imag])

    def step(self, dt_s: float, force_n: Floats | None) -> None:
        """Move on; the force turns both joints by its levers (the Jacobian's transpose)."""
        force = 0j if force_n is None else complex(*force_n)
        fore = self._fore()
        arms = (self._upper() + fore, fore)
        for k, (servo, truth, arm, joint) in enumerate(
            zip(self._servos, self._truths, arms, self._joints, strict=True)
        ):
            torque_nmm = (arm.conjugate() * force).imag
            servo.step(dt_s, torque_nmm / _MM_PER_M / truth.gear_ratio)
            joint.step(dt_s, self._drive(k), torque_nmm / max(abs(arm), _MIN_LEVER_MM), abs(arm))

    def reach_mm(self, dt_s: float, steps: int) -> float:
        """The furthest that `run` may move the tip; infinite where more than servos may move it."""
        if not all(joint.is_straight for joint in self._joints):
            return math.inf
        near, far = (
            servo.motion.reach_rad(dt_s, steps) / truth.gear_ratio
            for servo, truth in zip(self._servos, self._truths, strict=True)
        )
        return near * (self._truth.upper_mm + self._truth.fore_mm) + far * self._truth.fore_mm

    def run(self, dt_s: float, steps: int) -> None:
        """So many times `step` without a force, quicker; within `reach_mm` and the servos' `quiet_steps`."""
        for servo, truth, joint in zip(self._servos, self._truths, self._joints, strict=True):
            zero, ratio = truth.zero_rad, truth.gear_ratio
            joint.follow_all([(shaft - zero) / ratio for shaft in servo.run(dt_s, steps)])

    def _upper(self) -> complex:
        return cmath.rect(self._truth.upper_mm, self._truth.heading_rad + self._joints[0].at)

    def _fore(self) -> complex:
        return cmath.rect(self._truth.fore_mm, self.facing_rad)

    def _drive(self, k: int) -> float:
        return (self._servos[k].motion.shaft_rad - self._truths[k].zero_rad) / self._truths[k].gear_ratio


class EmulatedStage:
    """A ring that carries all fingers and turns about a centre, behind a gear with play."""

    def __init__(self, centre_mm: tuple[float, float], joint: JointTruth, servo: EmulatedServo) -> None:
        self.servo = servo
        self._centre = complex(*centre_mm)
        self._joint = joint
        self._play = Play(joint.play_rad, self._drive())

    @property
    def centre_mm(self) -> tuple[float, float]:
        """True place of its axis, in W."""
        return self._centre.real, self._centre.imag

    @property
    def truth(self) -> JointTruth:
        """True gearing."""
        return self._joint

    @property
    def angle_rad(self) -> float:
        """True angle of the ring."""
        self.servo.catch_up()
        return self._play.at

    @property
    def at_rad(self) -> float:
        """The ring's angle as it has been stepped."""
        return self._play.at

    def place(self, point_mm: Floats) -> Floats:
        """A point (2,) of the ring in W."""
        turned = (complex(*point_mm) - self._centre) * cmath.rect(1.0, self._play.at) + self._centre
        return np.array([turned.real, turned.imag])

    def back(self, vector: Floats) -> Floats:
        """A vector (2,) of W as the ring sees it."""
        turned = complex(*vector) * cmath.rect(1.0, -self._play.at)
        return np.array([turned.real, turned.imag])

    def torque_nm(self, point_mm: Floats, force_n: Floats) -> float:
        """Torque about the centre of a force (2,) that acts at a point (2,), both in W."""
        arm = complex(*point_mm) - self._centre
        return (arm.conjugate() * complex(*force_n)).imag / _MM_PER_M

    def reach_mm(self, dt_s: float, steps: int, point_mm: Floats) -> float:
        """The furthest that `run` may move a point (2,) that the ring carries, in W."""
        turn = self.servo.motion.reach_rad(dt_s, steps) / self._joint.gear_ratio
        return turn * abs(complex(*point_mm) - self._centre)

    def run(self, dt_s: float, steps: int) -> None:
        """So many times `step` without a torque, quicker; within the servo's `quiet_steps`."""
        zero, ratio = self._joint.zero_rad, self._joint.gear_ratio
        self._play.follow_all([(shaft - zero) / ratio for shaft in self.servo.run(dt_s, steps)])

    def step(self, dt_s: float, torque_nm: float) -> None:
        """Move on, with a torque on the ring."""
        self.servo.step(dt_s, torque_nm / self._joint.gear_ratio)
        self._play.follow(self._drive())

    def _drive(self) -> float:
        return (self.servo.motion.shaft_rad - self._joint.zero_rad) / self._joint.gear_ratio
