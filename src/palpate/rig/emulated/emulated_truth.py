"""What emulated mechanics really are: drawn within what a rig file's `[emulation]` allows."""

import math
from dataclasses import replace

import numpy as np

from palpate.base.errors import InputError
from palpate.config import (
    ArmFingerConfig,
    EmulationConfig,
    FingerConfig,
    JointConfig,
    RigFile,
    SlideFingerConfig,
)
from palpate.drivers.emulators.joints import JointYield
from palpate.drivers.emulators.mechanics import ArmTruth, FingerTruth, JointTruth
from palpate.drivers.tactile.messages import Description, Shape
from palpate.rig.conversion import arm_kinematics, slide_kinematics
from palpate.rig.standby_geometry import on_circle, wait_radius_mm

__all__ = ["dead_taxels", "joint_truth", "start_angles_rad", "truth_of", "with_yield"]

_FELT_RAD = math.radians(60.0)
_BEYOND = 1.02  # slides are off by a little: no tip is further out than that


def truth_of(
    finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator, newer: np.random.Generator
) -> FingerTruth | ArmTruth:
    """How this finger really is built.

    `newer` draws the errors of tips, arrays, slides and joints' zeros: they came later, and a seed
    keeps what it has drawn from `rng`.
    """
    built = _as_placed(finger, emulation, rng)
    radius = finger.tip.radius_mm + emulation.tip_radius_error_mm * newer.uniform(-1, 1)
    turned = math.radians(emulation.array_heading_error_deg) * newer.uniform(-1, 1)
    built = replace(built, tip_radius_mm=radius, array_heading_rad=built.array_heading_rad + turned)
    if isinstance(built, ArmTruth):
        return _with_joints_off(built, emulation, newer)
    return _with_slide_off(built, emulation, newer)


def with_yield(
    truth: FingerTruth | ArmTruth,
    finger: FingerConfig,
    emulation: EmulationConfig,
    rng: np.random.Generator,
) -> FingerTruth | ArmTruth:
    """The same, with joints that give way to forces on the tip; no joint does if the rig file says nothing.

    Furthest out, a tip gives way by what was drawn, and by less nearer to its joints.
    """
    if emulation.deflection_mm_per_n == 0 and emulation.play_holds_n is None:
        return truth
    softness = emulation.deflection_mm_per_n * rng.uniform(0.3, 1)
    holds = math.inf if emulation.play_holds_n is None else rng.uniform(*emulation.play_holds_n)
    if isinstance(truth, FingerTruth):
        assert isinstance(finger, SlideFingerConfig)
        furthest_mm = _BEYOND * finger.slide.range_mm[1]
        return replace(truth, aim_yield=JointYield(softness / furthest_mm**2, holds))
    share = rng.uniform(0.2, 0.8)
    upper = JointYield(share * softness / (truth.upper_mm + truth.fore_mm) ** 2, holds)
    fore = JointYield((1 - share) * softness / truth.fore_mm**2, holds)
    return replace(
        truth,
        shoulder=replace(truth.shoulder, yields=upper),
        elbow=replace(truth.elbow, yields=fore),
    )


def dead_taxels(
    description: Description, count: int, rng: np.random.Generator
) -> tuple[tuple[int, int], ...]:
    """Rows and columns of `count` taxels that are dead, drawn where touches are felt: near the middle.

    InputError if the array has not so many there.
    """
    is_round = description.shape is Shape.CYLINDER
    columns = np.flatnonzero(np.logical_or(not is_round, np.abs(description.columns) <= _FELT_RAD))
    felt = [(row, int(col)) for row in range(description.rows) for col in columns]
    if count > len(felt):
        raise InputError(
            f"emulation.dead_taxels: is {count}; an emulated array has {len(felt)} taxels within 60° of its "
            "middle; let fewer be dead"
        )
    return tuple(felt[k] for k in rng.choice(len(felt), count, replace=False))


def _as_placed(
    finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator
) -> FingerTruth | ArmTruth:
    away, bearing = emulation.base_error_mm * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    turn = math.radians(emulation.heading_error_deg) * rng.uniform(-1, 1)
    base = (
        finger.base_mm[0] + away * math.cos(bearing),
        finger.base_mm[1] + away * math.sin(bearing),
    )
    heading = math.radians(finger.heading_deg) + turn
    if isinstance(finger, ArmFingerConfig):
        return _arm(finger, emulation, base, heading, rng)
    return _slide(finger, emulation, base, heading, rng)


def joint_truth(gear_ratio: float, zero_deg: float, play_deg: float, rng: np.random.Generator) -> JointTruth:
    """A joint behind a gear; the file counts servo angles from Goal Position 0, emulated shafts from 2048."""
    return JointTruth(
        gear_ratio, math.radians(zero_deg) - math.pi, math.radians(play_deg) * rng.uniform(0.3, 1)
    )


def start_angles_rad(finger: FingerConfig, rig: RigFile) -> tuple[float, float]:
    """Where the shafts stand at first: slides retracted at aim 0, arms at home, as people have put them.

    They go by what the servos read, because that is how they are told to. The truth may be a little off.
    """
    if isinstance(finger, ArmFingerConfig):
        home = on_circle(
            wait_radius_mm(finger, rig.clear_radius_mm),
            math.atan2(finger.base_mm[1], finger.base_mm[0]),
        )
        return arm_kinematics(finger).servos_at(home)
    nominal = slide_kinematics(finger)
    return nominal.aim_servo_rad(0.0), nominal.slide_servo_rad(finger.slide.range_mm[0] + 1.0)


def _with_joints_off(truth: ArmTruth, emulation: EmulationConfig, rng: np.random.Generator) -> ArmTruth:
    """With both joints' zeros off; where nothing may be off, nothing is drawn: seeds keep what they drew."""
    most = math.radians(emulation.joint_zero_error_deg)
    if most == 0:
        return truth

    def off(joint: JointTruth) -> JointTruth:
        return replace(joint, zero_rad=joint.zero_rad + joint.gear_ratio * most * rng.uniform(-1, 1))

    return replace(truth, shoulder=off(truth.shoulder), elbow=off(truth.elbow))


def _with_slide_off(truth: FingerTruth, emulation: EmulationConfig, rng: np.random.Generator) -> FingerTruth:
    """With zero and travel per turn off; the file's zero holds half a turn before the shaft's."""
    zero_off = emulation.zero_error_mm * rng.uniform(-1, 1)
    mm_per_rad = truth.mm_per_rad * (1 + emulation.mm_per_turn_error * rng.uniform(-1, 1))
    zero = truth.zero_mm + zero_off + (mm_per_rad - truth.mm_per_rad) * math.pi
    return replace(truth, mm_per_rad=mm_per_rad, zero_mm=zero)


def _slide(
    finger: SlideFingerConfig,
    emulation: EmulationConfig,
    base_mm: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> FingerTruth:
    nominal = slide_kinematics(finger)
    return FingerTruth(
        base_mm=base_mm,
        heading_rad=heading_rad,
        height_mm=finger.height_mm,
        gear_ratio=nominal.gear_ratio,
        aim_zero_rad=nominal.aim_zero_rad,
        aim_play_rad=math.radians(emulation.aim_backlash_deg) * rng.uniform(0.3, 1),
        mm_per_rad=nominal.mm_per_rad,
        zero_mm=nominal.zero_mm,
        slide_play_mm=emulation.backlash_mm * rng.uniform(0.3, 1),
        tip_radius_mm=finger.tip.radius_mm,
        stiffness_n_per_mm=_stiffness(finger, emulation, rng),
        array_heading_rad=math.radians(finger.array.heading_deg),
        stops_mm=finger.slide.stops_mm,
        half_length_mm=_half_length_mm(finger, emulation),
        is_ball=finger.tip.is_ball,
        is_pad=finger.tip.is_pad,
    )


def _arm(
    finger: ArmFingerConfig,
    emulation: EmulationConfig,
    base_mm: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> ArmTruth:
    def joint(servo: JointConfig) -> JointTruth:
        return joint_truth(servo.gear_ratio, servo.zero_deg, emulation.joint_backlash_deg, rng)

    return ArmTruth(
        base_mm=base_mm,
        heading_rad=heading_rad,
        height_mm=finger.height_mm,
        upper_mm=finger.links.upper_mm + emulation.link_error_mm * rng.uniform(-1, 1),
        fore_mm=finger.links.fore_mm + emulation.link_error_mm * rng.uniform(-1, 1),
        shoulder=joint(finger.shoulder),
        elbow=joint(finger.elbow),
        tip_radius_mm=finger.tip.radius_mm,
        stiffness_n_per_mm=_stiffness(finger, emulation, rng),
        array_heading_rad=math.radians(finger.array.heading_deg),
        half_length_mm=_half_length_mm(finger, emulation),
        is_ball=finger.tip.is_ball,
    )


def _half_length_mm(finger: FingerConfig, emulation: EmulationConfig) -> float:
    """As the rig file says, unless the emulated tips are to be of another length; none reaches the table."""
    if emulation.tip_length_mm is None or finger.tip.is_ball:
        return finger.tip.half_length_mm
    return min(emulation.tip_length_mm / 2, finger.height_mm)


def _stiffness(finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator) -> float:
    return finger.tip.stiffness_n_per_mm * (1 + emulation.stiffness_spread * rng.uniform(-1, 1))
