"""Hidden truth of emulated mechanics: drawn within what a rig file's `[emulation]` allows.

How fingers are really built; friction, cogging and lost torque, which are each servo's own, and a supply
with a resistance, which all share (`[emulation.mechanics]`); and where fingers stand when they are switched
on: as a person has put them, or anywhere, drawn again while fingers would cross, or one would stand in the
part or in an obstacle.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.config import (
    ArmFingerConfig,
    EmulationConfig,
    FingerConfig,
    JointConfig,
    RigFile,
    SlideFingerConfig,
)
from palpate.config.emulation import MechanicsConfig
from palpate.drivers.emulators import ArmTruth, Bench, EmulatedServo, FingerTruth, JointCompliance, JointTruth
from palpate.drivers.kinematics import FingerBody, Servos, Turn
from palpate.drivers.tactile import Description, Shape
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.slide import slide_kinematics
from palpate.rig.mechanisms.swept_volume import is_apart

_TOUCHABLE_RAD = math.radians(60.0)
_REACH_FACTOR = 1.02  # slides are off by a little: no tip is further out than that


def truth_of(
    finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator, newer: np.random.Generator
) -> FingerTruth | ArmTruth:
    """How this finger really is built.

    `newer` draws the errors of tips, arrays, slides and joints' zeros: they came later, and a seed
    keeps what it has drawn from `rng`.
    """
    built = _placed_truth(finger, emulation, rng)
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
        furthest_mm = _REACH_FACTOR * finger.slide.range_mm[1]
        return replace(truth, aim_yield=JointCompliance(softness / furthest_mm**2, holds))
    share = rng.uniform(0.2, 0.8)
    upper = JointCompliance(share * softness / (truth.upper_mm + truth.fore_mm) ** 2, holds)
    fore = JointCompliance((1 - share) * softness / truth.fore_mm**2, holds)
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
    columns = np.flatnonzero(np.logical_or(not is_round, np.abs(description.columns) <= _TOUCHABLE_RAD))
    felt = [(row, int(col)) for row in range(description.rows) for col in columns]
    if count > len(felt):
        raise InputError(
            f"emulation.dead_taxels: is {count}; an emulated array has {len(felt)} taxels within 60° of its "
            "middle; let fewer be dead"
        )
    return tuple(felt[k] for k in rng.choice(len(felt), count, replace=False))


def _placed_truth(
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
        shape=finger.tip.shape,
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
        shape=finger.tip.shape,
    )


def _half_length_mm(finger: FingerConfig, emulation: EmulationConfig) -> float:
    """As the rig file says, unless the emulated tips are to be of another length; none reaches the table."""
    if emulation.tip_length_mm is None or "length_mm" in finger.tip.kind.lacks:
        return finger.tip.half_length_mm
    return min(emulation.tip_length_mm / 2, finger.height_mm)


def _stiffness(finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator) -> float:
    return finger.tip.stiffness_n_per_mm * (1 + emulation.stiffness_spread * rng.uniform(-1, 1))


_COGS_PER_TURN = 60  # along a turn of the output shaft
_LEAST_CHANGE_V = 0.05


def with_cables(
    truth: FingerTruth | ArmTruth, emulation: EmulationConfig, rng: np.random.Generator
) -> FingerTruth | ArmTruth:
    """The same finger, its slide pulled by a cable and giving way along its travel; arms as they are."""
    drawn = emulation.mechanics
    if drawn is None or isinstance(truth, ArmTruth):
        return truth
    cable, soft = _draw(drawn.cable_n, 0.0, rng), _draw(drawn.slide_deflection_mm_per_n, 0.0, rng)
    return replace(truth, cable_n=cable, slide_yield_mm_per_n=soft)


def add_imperfections(bench: Bench, rig: RigFile, seed: int) -> None:
    """Let servos, supply and screws of a bench be as they are drawn."""
    drawn = None if rig.emulation is None else rig.emulation.mechanics
    if drawn is None:
        return
    rng = np.random.default_rng([seed, 13])
    servos = [servo for finger in bench.fingers for servo in finger.servos]
    servos += [] if bench.stage is None else [bench.stage.servo]
    for servo in servos:
        _add_servo_imperfections(servo, drawn, rng)
    ohm = _draw(drawn.supply_ohm, 0.0, rng)
    if ohm:
        bench.supply = _SharedSupply(servos, ohm).sag
    slipping = bench.fingers[int(rng.integers(len(bench.fingers)))]
    at, by = float(rng.uniform(*drawn.slip_after_s)), _draw(drawn.slip_mm, 0.0, rng)
    if by:
        bench.happenings.append((at, partial(slipping.slip, by)))


def _add_servo_imperfections(servo: EmulatedServo, drawn: MechanicsConfig, rng: np.random.Generator) -> None:
    model_nm = servo.motion.friction_nm
    servo.motion.set_mechanics(
        _draw(drawn.friction, 1.0, rng),
        _draw(drawn.rest_friction, 1.0, rng),
        1.0 - _draw(drawn.torque_loss, 0.0, rng),
    )
    cogging_nm, phase = _draw(drawn.cogging, 0.0, rng) * model_nm, float(rng.uniform(0, 2 * math.pi))
    if cogging_nm:
        servo.hold(lambda rad, _rad_s: cogging_nm * math.sin(_COGS_PER_TURN * rad + phase))


class _SharedSupply:
    """A supply whose voltage drops by its resistance times what all motors take."""

    def __init__(self, servos: list[EmulatedServo], ohm: float) -> None:
        self._servos, self._ohm = servos, ohm
        self._full_v = self._now_v = min(servo.nominal_v for servo in servos)

    def sag(self) -> None:
        """Set the voltage that is left."""
        taken_a = sum(servo.motor_power_w for servo in self._servos) / max(self._now_v, 1.0)
        left_v = max(self._full_v - self._ohm * taken_a, 0.0)
        if abs(left_v - self._now_v) < _LEAST_CHANGE_V:
            return
        self._now_v = left_v
        for servo in self._servos:
            servo.set_supply(left_v)


def _draw(span: tuple[float, float] | None, absent: float, rng: np.random.Generator) -> float:
    share = float(rng.uniform())
    return absent if span is None else span[0] + share * (span[1] - span[0])


_MAX_DRAWS = 10_000
_MIN_GAP_MM = 3.0  # more than the truth may differ from the description, on any rig that is used


def start_stage_rad(rig: RigFile, rng: np.random.Generator) -> float:
    """Angle at which the stage stands at first; 0 without one, or where nothing starts anywhere."""
    if rig.stage is None or rig.emulation is None or rig.emulation.start == "waiting":
        return 0.0
    return math.radians(rng.uniform(*rig.stage.range_deg))


def start_postures(
    rig: RigFile, placement: Placement | None, stage_rad: float, rng: np.random.Generator
) -> list[Servos]:
    """Shaft angles (rad) of each finger's servos, turns counted, with the stage at an angle.

    Raises InputError if no posture is found in which fingers are apart.
    """
    mechanisms = [mechanism_of(finger) for finger in rig.fingers]
    if rig.emulation is None or rig.emulation.start == "waiting":
        return [item.start_rad(rig.clear_radius_mm) for item in mechanisms]
    turn = Turn(Stage.of(rig).centre_mm, stage_rad)
    parts = [] if placement is None else [shape_of(placement, part) for part in placement.state.sections]
    posts: list[shapely.Geometry] = [shapely.Polygon(item.outline_mm) for item in rig.obstacles]
    for _ in range(_MAX_DRAWS):
        drawn = [item.draw_posture(rng) for item in mechanisms]
        if _is_free(mechanisms, drawn, turn, parts, posts):
            return drawn
    raise InputError(
        'emulation.start: is "anywhere", and no posture was found in which fingers stand apart; '
        'let it be "waiting"'
    )


def _is_free(
    fingers: Sequence[Mechanism],
    postures: Sequence[Servos],
    turn: Turn,
    parts: Sequence[shapely.Geometry],
    posts: Sequence[shapely.Geometry],
) -> bool:
    """Whether fingers are apart, and clear of the part, above which links of arms pass, and of posts."""
    bodies = [
        finger.kinematics.body(angles, finger.spec.tip.radius_mm)
        for finger, angles in zip(fingers, postures, strict=True)
    ]
    apart = all(is_apart(one, two, _MIN_GAP_MM) for k, one in enumerate(bodies) for two in bodies[:k])
    return (
        apart
        and all(
            _clear_mm(body, k, turn, part) > _MIN_GAP_MM
            for finger, body in zip(fingers, bodies, strict=True)
            for k in (range(len(body.start)) if math.isinf(finger.lowest_link_mm) else (len(body.start) - 1,))
            for part in parts
        )
        and all(
            _clear_mm(body, k, turn, post) > _MIN_GAP_MM
            for body in bodies
            for k in range(len(body.start))
            for post in posts
        )
    )


def _clear_mm(body: FingerBody, piece: int, turn: Turn, part: shapely.Geometry) -> float:
    ends = [turn.point_mm((float(x), float(y))) for x, y in (body.start[piece], body.end[piece])]
    return float(shapely.LineString(ends).distance(part) - body.half_width[piece])
