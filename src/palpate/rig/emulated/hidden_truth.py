"""Hidden truth of emulated servos: drawn within what a rig file's `[emulation]` allows.

Friction, cogging and lost torque, which are each servo's own, and a supply
with a resistance, which all share (`[emulation.mechanics]`); and where fingers stand when they are switched
on: as a person has put them, or anywhere, drawn again while fingers would cross, or one would stand in the
part or in an obstacle.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.config import RigFile
from palpate.config.emulation import MechanicsConfig
from palpate.drivers.emulators import Bench, EmulatedServo
from palpate.drivers.kinematics import FingerBody, Servos, Turn
from palpate.rig.emulated.finger_truth import draw
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.mechanisms.swept_volume import is_apart

_COGS_PER_TURN = 60  # along a turn of the output shaft
_LEAST_CHANGE_V = 0.05


def add_imperfections(bench: Bench, rig: RigFile, seed: int) -> None:
    """Let servos, supply and screws of a bench be as they are drawn."""
    drawn = None if rig.emulation is None else rig.emulation.mechanics
    if drawn is None:
        return
    rng = np.random.default_rng([seed, 13])
    for servo in bench.servos:
        _add_servo_imperfections(servo, drawn, rng)
    ohm = draw(drawn.supply_ohm, 0.0, rng)
    if ohm:
        bench.supply = _SharedSupply(bench.servos, ohm).sag
    slipping = bench.fingers[int(rng.integers(len(bench.fingers)))]
    at, by = float(rng.uniform(*drawn.slip_after_s)), draw(drawn.slip_mm, 0.0, rng)
    if by:
        bench.happenings.append((at, partial(slipping.slip, by)))


def _add_servo_imperfections(servo: EmulatedServo, drawn: MechanicsConfig, rng: np.random.Generator) -> None:
    model_nm = servo.motion.friction_nm
    servo.motion.set_mechanics(
        draw(drawn.friction, 1.0, rng),
        draw(drawn.rest_friction, 1.0, rng),
        1.0 - draw(drawn.torque_loss, 0.0, rng),
    )
    cogging_nm, phase = draw(drawn.cogging, 0.0, rng) * model_nm, float(rng.uniform(0, 2 * math.pi))
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
    """True if fingers are apart, and clear of the part, above which links of arms pass, and of posts."""
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
