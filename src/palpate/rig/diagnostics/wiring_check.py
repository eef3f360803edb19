"""Proof of the wiring: tips are pressed and joints moved one after another, and a person says what happens.

Nobody else knows: a servo knows only its own angle, an array only its own skin. The emulated bench has a
person who sees the table and its tips, and is told nothing of the rig file but the place that is asked for.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from palpate.base.errors import DeviceError
from palpate.base.geometry import Floats
from palpate.config import FingerConfig, RigFile
from palpate.config.rig_servos import RotaryConfig, SlideConfig
from palpate.drivers.dynamixel import MoveEnd, Servo, ServoMover
from palpate.drivers.emulators import EmulatedFinger, PartSection
from palpate.drivers.tactile import ArrayDriver, ContactReading, Description, Shape, TactileFrame
from palpate.drivers.transport import PortSharing, open_port
from palpate.rig.arrays import array_of
from palpate.rig.bench import BenchRig
from palpate.rig.diagnostics.wiring import Side, TipMove, TipPress, Way, standing_at
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import ACCELERATION_RAD_S2, AIM_TOLERANCE_RAD
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.homing import HomingPolicy

_SPEED_RAD_S = 0.8
_PERIOD_S = 0.01
_REST_S, _LOOK_S = 0.6, 0.4
_LOOKS = 15  # until nobody is waited for any longer
_LET_GO_S = 0.2
_FRAMES, _LATE_S = 10, 2.0  # frames of each array that are waited for, and how long
_POLL_S = 0.02
_MIN_FORCE_N = 0.2
_NOISE_SIGMAS = 6.0
_OTHERS_SHARE = 0.3  # of the strongest array's force: less is not a press
_SEEN_MM = 0.5  # a tip that moves less is not seen to move
_PRESSED_N = 2.0
_FINGER_MM = 8.0


@dataclass(frozen=True)
class Sight:
    """Sight of a tip that moved: about where its base is, and which way it went."""

    base_mm: tuple[float, float]
    way: Way


class Onlooker(Protocol):
    """A person at the table, who presses tips and sees them move."""

    def press(self, finger: FingerConfig, side: Side) -> bool:
        """Go to press the tip that stands where `finger` is drawn; False if none stands there.

        On a side, near its lower end in front; on a pad's face in the middle, or left or right of it; for as
        long as it is not let go, with the finger held in the other hand, so that it does not give way.
        """
        ...

    def release(self) -> None:
        """Let go of the tip."""
        ...

    def watch(self) -> None:
        """Look at all tips: one joint is about to move; it may take a moment."""
        ...

    def saw(self) -> Sight | None:
        """Say which tip moved, and which way; None for none."""
        ...


class EmulatedOnlooker:
    """A person at an emulated bench, who sees where its fingers really stand."""

    def __init__(self, bench: BenchRig) -> None:
        """Raises ValueError for a real rig."""
        if bench.emulated is None:
            raise ValueError("only an emulated bench has an emulated person")
        self._bench = bench.emulated.bench
        self._fingers = self._bench.fingers
        self._bases = [finger.truth.base_mm for finger in self._fingers]
        self._before: list[Floats] = []

    def press(self, finger: FingerConfig, side: Side) -> bool:
        """Press with a square fingertip, as high as the tip's middle in front, else all along it."""
        index = standing_at(self._bases, finger.base_mm)
        if index is not None:
            held = self._fingers[index]
            held.is_held = True
            tip = _fingertip(held, side)
            self._bench.put_beside(tip if finger is held else None for finger in self._fingers)
        return index is not None

    def release(self) -> None:
        """Take the fingertip away."""
        for finger in self._fingers:
            finger.is_held = False
        self._bench.put_beside(None for _ in self._fingers)

    def watch(self) -> None:
        """Remember where tips are."""
        self._before = [finger.centre_mm for finger in self._fingers]

    def saw(self) -> Sight | None:
        """Compare with where they are now."""
        ways = [finger.centre_mm - at for finger, at in zip(self._fingers, self._before, strict=True)]
        index = int(np.argmax([np.hypot(*way) for way in ways]))
        if np.hypot(*ways[index]) < _SEEN_MM:
            return None
        base, out = self._bases[index], self._before[index] - self._bases[index]
        along = float(ways[index] @ out)
        across = float(out[0] * ways[index][1] - out[1] * ways[index][0])
        if abs(across) > abs(along):
            return Sight(base, Way.LEFT if across > 0 else Way.RIGHT)
        return Sight(base, Way.OUT if along > 0 else Way.IN)


def _fingertip(finger: EmulatedFinger, side: Side) -> PartSection:
    """A square that presses on a side of a tip."""
    truth, direction = finger.truth, finger.facing_rad
    across, away = 0.0, truth.tip_radius_mm
    if truth.shape.tip.has_face:
        across, away = truth.tip_radius_mm * math.sin(math.radians(side.value)) * 0.6, 0.0
    else:
        direction += math.radians(side.value)
    ahead = np.array([math.cos(direction), math.sin(direction)])
    left = np.array([-ahead[1], ahead[0]])
    half = min(_FINGER_MM, truth.tip_radius_mm) / 2
    touched = finger.centre_mm + across * left + (away - _PRESSED_N / truth.stiffness_n_per_mm) * ahead
    corners = np.array([touched + a * ahead + b * left for a, b in ((0, -half), (2 * half, -half))])
    corners = np.vstack([corners, corners[::-1] + 2 * half * left])
    top_mm = truth.height_mm if side is Side.FRONT else math.inf
    return PartSection(corners, np.roll(corners, -1, axis=0), top_mm)


def see_presses(
    rig: RigFile, bench: BenchRig, onlooker: Onlooker, tell: Callable[[str], None]
) -> list[TipPress]:
    """Have every tip pressed in two places, or three where only one of them was felt. Nothing moves.

    Raises DeviceError if an array fails.
    """
    found: list[TipPress] = []
    with ExitStack() as ways_out:
        arrays = _Arrays(rig, bench, ways_out)
        for spec in rig.fingers:
            tell(f"a press on finger {spec.name}")
            own: list[TipPress] = []
            for side in Side:
                felt_once = len({bool(press.arrays) for press in own}) == 2
                if side is not Side.RIGHT or (felt_once and not spec.tip.kind.has_face):
                    own.append(_see_press(spec, side, arrays, onlooker))
                if not own[-1].stood:
                    break
            found += own
    return found


def _see_press(finger: FingerConfig, side: Side, arrays: "_Arrays", onlooker: Onlooker) -> TipPress:
    """One press, held until it was looked at."""
    if not onlooker.press(finger, side):
        return TipPress(finger.name, side, stood=False)
    for _ in range(_LOOKS):
        if max(float(force.sum()) for force in arrays.forces_n().values()) >= _MIN_FORCE_N:
            break
    forces, contacts = arrays.forces_n(), arrays.contacts
    onlooker.release()
    arrays.listen(_LET_GO_S)
    least = max(_MIN_FORCE_N, _OTHERS_SHARE * max(float(force.sum()) for force in forces.values()))
    felt = [name for name, force in forces.items() if float(force.sum()) >= least]
    if len(felt) != 1:
        return TipPress(finger.name, side, tuple(felt))
    force, described = forces[felt[0]], arrays.drivers[felt[0]].description
    height = float(np.average(np.linspace(0, 1, described.rows), weights=force.sum(axis=1)))
    low = None if described.rows < 2 or 0.4 <= height <= 0.6 else height < 0.5
    if finger.array.reports_contacts:
        angle_deg, low = _source_angle_deg(felt[0], contacts[felt[0]]), None
    else:
        angle_deg = _angle_deg(described, force)
    return TipPress(finger.name, side, tuple(felt), angle_deg, low if side is Side.FRONT else None)


_Statistics = tuple[Floats, Floats, int]
"""Mean and deviation of each taxel's counts, and the number of frames."""


class _Arrays:
    """All arrays of a rig, by finger, which stream until the ways out are taken; untouched at first.

    `contacts`: what contact sources reported when they were listened to last.
    """

    def __init__(self, rig: RigFile, bench: BenchRig, ways_out: ExitStack) -> None:
        """Raises DeviceError if one does not answer."""
        self._clock = bench.clock
        self.drivers: dict[str, ArrayDriver] = {}
        self.contacts: Mapping[str, Sequence[ContactReading]] = {}
        rig.require_arrays()
        sharing = PortSharing(lambda port, baudrate: open_port(bench.urls(port), baudrate))
        for spec in rig.fingers:
            port = sharing.open(spec.array.port, spec.array.baudrate_bps)
            ways_out.callback(port.close)
            self.drivers[spec.name] = array_of(spec, port, bench.clock)
            self.drivers[spec.name].connect()
        for array in self.drivers.values():
            array.start(rig.closing.sample_rate_hz)
            ways_out.callback(array.stop)
        self._rest = self.listen(_REST_S)

    def listen(self, seconds: float) -> dict[str, _Statistics]:
        """What taxels read from now on."""
        frames: dict[str, list[TactileFrame]] = {name: [] for name in self.drivers}
        for array in self.drivers.values():
            array.frames()
        begin = self._clock.now()
        while (passed := self._clock.now() - begin) < seconds or (
            passed < _LATE_S and min(map(len, frames.values())) < _FRAMES
        ):
            self._clock.sleep(_POLL_S)
            for name, array in self.drivers.items():
                frames[name] += array.frames()
        self.contacts = {
            name: [frame.contact for frame in own if frame.contact is not None]
            for name, own in frames.items()
        }
        return {name: _statistics(name, own) for name, own in frames.items()}

    def forces_n(self) -> dict[str, Floats]:
        """Force on each taxel now (N), where it is certainly more than noise."""
        now = self.listen(_LOOK_S)
        return {
            name: _taxels_n(array.description, self._rest[name], now[name])
            for name, array in self.drivers.items()
        }


def _statistics(name: str, frames: Sequence[TactileFrame]) -> _Statistics:
    if not frames:
        raise DeviceError(f"tactile array {name} sends nothing; check its power and its cable")
    counts = np.array([frame.counts for frame in frames], dtype=np.float64)
    return counts.mean(axis=0), counts.std(axis=0), len(frames)


def _taxels_n(described: Description, before: _Statistics, now: _Statistics) -> Floats:
    """Force on each taxel (N), where it is certainly more than noise."""
    noise = np.maximum(before[1], 0.5) * math.sqrt(1 / before[2] + 1 / now[2])
    above = now[0] - before[0]
    result: Floats = np.where(above > _NOISE_SIGMAS * noise, above, 0.0) / described.counts_per_n
    return result


def _angle_deg(described: Description, force: Floats) -> float:
    """Where on an array it is pressed, from its middle; on a flat one ahead, or by a quarter to a side."""
    if described.shape is Shape.FLAT:
        columns = np.asarray(described.columns)
        share = float(np.average(columns, weights=force.sum(axis=0))) / float(np.abs(columns).max())
        return 0.0 if abs(share) < 0.25 else math.copysign(90.0, share)
    x, y, _ = np.einsum("rc,rcd->d", force, described.normals())
    return math.degrees(math.atan2(y, x))


def _source_angle_deg(name: str, contacts: Sequence[ContactReading]) -> float:
    """Mean of the angles that a contact source reports; DeviceError if it reports none."""
    known = [np.exp(1j * reading.angle_rad) for reading in contacts if not math.isnan(reading.angle_rad)]
    if not known:
        raise DeviceError(
            f"contact source {name} feels the press and does not report where; press harder, or see "
            "whether it can tell angles at all"
        )
    return math.degrees(float(np.angle(np.sum(known))))


def see_moves(hand: Hand, onlooker: Onlooker, tell: Callable[[str], None]) -> list[TipMove]:
    """Move each joint of each finger from where it stands, and back. Raises what motion raises."""
    hand.prepare(home=HomingPolicy.NONE)  # which way slides go is not known yet
    found: list[TipMove] = []
    for finger in hand.fingers:
        tell(f"moving finger {finger.name}")
        at = hand.servos_of([finger])[finger]
        moves = finger.mechanism.test_moves(at)
        for joint, (servo, move) in enumerate(zip(finger.drive.servos, moves, strict=True)):
            seen = _see_move(hand, servo, move.goal_rad, onlooker)
            found.append(
                TipMove(finger.name, joint, *((None, None) if seen is None else (seen.base_mm, seen.way)))
            )
    return found


def _see_move(hand: Hand, servo: Servo, goal_rad: float, onlooker: Onlooker) -> Sight | None:
    """A joint moved to a goal and back, torque on, and what was seen of it. It may meet a stop on its way."""
    start = hand.states([servo])[servo.dxl_id].position_rad
    onlooker.watch()
    ends = _go(hand, servo, goal_rad)
    seen = onlooker.saw()
    if seen is None:
        hand.require_arrival(ends)
    _go(hand, servo, start)
    return seen


def _go(hand: Hand, servo: Servo, goal_rad: float) -> Mapping[ServoMover, MoveEnd]:
    hand.arm()
    servo.set_profile(_SPEED_RAD_S, ACCELERATION_RAD_S2)
    mover = ServoMover(servo, servo.nearest_rad(goal_rad), AIM_TOLERANCE_RAD)
    ends = hand.guarded([mover], period_s=_PERIOD_S)
    hand.disarm()  # a person takes longer than servos wait
    return ends


def read_turns(hand: Hand) -> dict[int, float]:
    """Turns of all servos by id, as the rig file counts them: from Goal Position 0. Nothing moves."""
    states = hand.states(hand.servos)
    return {dxl_id: state.position_rad / (2 * math.pi) + 0.5 for dxl_id, state in states.items()}


def rig_for_moves(rig: RigFile, turns: Mapping[int, float]) -> RigFile:
    """The rig; a finger that cannot stand where its zeros say has such as if it stood where people leave it.

    For small moves from there, by which it is found out why.
    """
    return rig.model_copy(update={"fingers": [_for_moves(rig, spec, turns) for spec in rig.fingers]})


def _for_moves(rig: RigFile, spec: FingerConfig, turns: Mapping[int, float]) -> FingerConfig:
    mechanism, radius_mm = mechanism_of(spec), rig.clear_radius_mm
    near, far = (servo.dxl_id for servo in spec.servos.values())
    at_rad = [(turns[dxl_id] - 0.5) * 2 * math.pi for dxl_id in (near, far)]
    if mechanism.start_problem(radius_mm, (near, far), (at_rad[0], at_rad[1]), is_homed=False) is None:
        return spec
    tables: dict[str, dict[str, float]] = {}
    for (key, servo), at, start in zip(
        spec.servos.items(), at_rad, mechanism.start_rad(radius_mm), strict=True
    ):
        off = (at - start) / (2 * math.pi)
        if isinstance(servo, SlideConfig):
            tables[key] = {"zero_mm": servo.zero_mm - off * servo.mm_per_turn}
        elif isinstance(servo, RotaryConfig):
            tables[key] = {"zero_deg": servo.zero_deg + 360 * off}
    return spec.replace_in_tables(**tables)
