"""Hand as a prober: measurements requested by `calibration.prober`, carried out by the hand of a rig.

Whoever puts references on the table is a `TableOperator`: a person who is asked, or the emulated bench.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.calibration.measurements import (
    IdleMeasurement,
    PressMeasurement,
    Probe,
    Reference,
    ServoPath,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.config import FingerConfig, RigFile
from palpate.config.rig_servos import AimConfig, RotaryConfig
from palpate.drivers.kinematics import TICK_RAD, FingerKinematics, Line
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import line_of
from palpate.rig.fingers import Stage
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import Mechanism
from palpate.rig.motion.creep import measure_quasi_statically
from palpate.rig.motion.guarded_approach import (
    GripPhase,
    aim_fingers,
    carry_out_grip,
    retract_all,
    turn_stage,
)
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.press import press_contacts, stall_at_stop, stop_at_speed, swing_aims
from palpate.rig.motion.touch import ApproachState, Touch
from palpate.rig.reach.approaches import Reach, reach_of

_AIMS, _ARM_AIMS = 81, 61  # an arm has about five ways for each
_TURNED_AIMS, _TURNED_ARM_AIMS = 21, 13  # at each of several angles of a stage
_MIN_TAKE_UP_RAD = math.radians(1.0)  # of an aim's servo: less may not take up its play
_PATH_POSTURES = 65  # of an arm's approach
_PRESS_TRAVEL_MM = 4.0  # a press goes so far beyond its contact
_TAKE_UP_MM = 2.0  # of an arm's approach, on which its joints take up their play: a touch comes from further


class TableOperator(Protocol):
    """Whoever puts things on the table."""

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Put a reference near a place in W, alone, and see that it cannot move."""
        ...

    def clear(self) -> None:
        """Take everything away."""
        ...


class HandProber:
    """Does for calibration what a hand can do. The hand must be prepared."""

    def __init__(
        self,
        hand: Hand,
        table: TableOperator,
        tell: Callable[[GripPhase], None] = lambda _: None,
        *,
        turned: bool = False,
    ) -> None:
        """`turned`: with paths at several angles of the stage. Raises InputError for fingers without room."""
        self._hand, self._table, self._tell = hand, table, tell
        self._mechanisms = [finger.mechanism for finger in hand.fingers]
        self._reach, self._number = (_stage_reach if turned else _middle_reach)(hand.rig)
        self.approaches: Sequence[ServoPath] = [
            _approach(hand.rig, self._reach, index, self._mechanisms) for index in self._number
        ]
        self._aims: dict[int, tuple[float, int]] = {}
        self._stage_rad = self._reach.middle_rad

    @property
    def turned(self) -> "HandProber":
        """The same rig with paths at several angles of its stage."""
        return HandProber(self._hand, self._table, self._tell, turned=True)

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Have a reference put near a place."""
        self._table.put(reference, about_mm)

    def clear(self) -> None:
        """Have the table cleared."""
        self._table.clear()

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        """Close fingers on approaches, as many at once as do not come too near to one another."""
        found: dict[int, TouchMeasurement | None] = {}
        for some in self._together(grip):
            self._turn_to(self.approaches[some[0].approach].stage_rad)
            self._take_up_play(some)
            approaches = [self._to_contact(probe)[0] for probe in some]
            ways = [self._ways(probe.approach) for probe in some]
            done = carry_out_grip(self._hand, approaches, self._tell, measure_quasi_statically)
            touches = {touch.finger_index: touch for touch in done}
            for probe, item, way in zip(some, approaches, ways, strict=True):
                found[probe.approach] = self._probe_touch(touches[item.finger_index], item, placing, way)
        return [found[probe.approach] for probe in grip]

    def press(self, contacts: Sequence[Probe], placing: int) -> list[PressMeasurement]:
        """Press with fingers on contacts, as many at once."""
        found: list[PressMeasurement] = []
        for some in self._together(contacts):
            self._take_up_play(some)
            self._note(some)
            found += press_contacts(self._hand, [self._to_contact(item) for item in some], placing)
        return found

    def stop(self, contacts: Sequence[Probe], speed_mm_s: float) -> list[StopMeasurement]:
        """Run into contacts, as many at once."""
        found: list[StopMeasurement] = []
        for some in self._together(contacts):
            self._note(some)
            found += stop_at_speed(self._hand, [self._to_contact(item) for item in some], speed_mm_s)
        return found

    def swing(self) -> list[float]:
        """Turn all aims a little either way and back."""
        return swing_aims(self._hand)

    def idle(self, seconds: float) -> list[IdleMeasurement]:
        """Read all arrays for a time, fingers waiting."""
        hand = self._hand
        rate = hand.rig.closing.sample_rate_hz
        hand.start_arrays()
        taken = hand.collect(hand.fingers, max(16, round(seconds * rate)))
        hand.stop_arrays()
        return [
            IdleMeasurement(
                finger.name,
                np.stack([frame.counts for frame in frames]),
                np.array([frame.device_time_s for frame in frames]),
            )
            for finger, frames in zip(hand.fingers, taken, strict=True)
        ]

    def home(self, finger: int, stop_mm: float) -> float:
        """Stall against a hard stop that the rig file tells."""
        return stall_at_stop(self._hand, self._hand.fingers[finger], stop_mm)

    def _to_contact(self, probe: Probe) -> tuple[FingerApproach, float]:
        """The approach up to where the probe ends, and how far that is."""
        return self._reach.approaches[self._number[probe.approach]].up_to(probe.end_mm), probe.end_mm

    def _together(self, probes: Sequence[Probe]) -> list[list[Probe]]:
        """Probes in groups of those that go together, one after the other. Links of arms cross easily.

        Slides that are known only roughly may be too near by their bounds, and are guarded on their way.
        """
        if not any(item.aim is None for item in self._mechanisms):
            return [list(probes)] if probes else []
        groups: list[list[Probe]] = []
        for probe in probes:
            home = next((group for group in groups if self._goes_with(probe, group)), None)
            if home is None:
                groups.append([probe])
            else:
                home.append(probe)
        return groups

    def _goes_with(self, probe: Probe, group: Sequence[Probe]) -> bool:
        others = np.array([self._number[item.approach] for item in group])
        ends = np.array([item.end_mm + _PRESS_TRAVEL_MM for item in group])
        own = self._number[probe.approach]
        return bool(self._reach.together(own, probe.end_mm + _PRESS_TRAVEL_MM, others, ends).all())

    def _turn_to(self, stage_rad: float) -> None:
        """Note that the stage is going to turn: every aim goes home for it, to come from there."""
        if stage_rad != self._stage_rad:
            for index, mechanism in enumerate(self._mechanisms):
                if mechanism.aim is not None:
                    self._aims[index] = (_home_rad(mechanism.aim), 0)
        self._stage_rad = stage_rad

    def _take_up_play(self, probes: Sequence[Probe]) -> None:
        """Let aims whose play a force may take up stand beside their goals, on the side to come from."""
        beside = [
            number
            for probe in probes
            if probe.side and self._may_push_aim(probe) and (number := self._beside(probe)) is not None
        ]
        if not beside:
            return
        self._hand.arm()
        retract_all(self._hand)
        turn = turn_stage(self._hand, {self.approaches[number].stage_rad for number in beside})
        aim_fingers(
            self._hand,
            [
                ApproachState.of(
                    self._hand.fingers[self.approaches[number].finger],
                    self._reach.approaches[self._number[number]],
                    turn,
                )
                for number in beside
            ],
        )
        for number in beside:
            self._ways(number)
        self._hand.disarm()

    def _may_push_aim(self, probe: Probe) -> bool:
        aim = self._mechanisms[self.approaches[probe.approach].finger].aim
        return aim is not None and aim.backlash_holds_n is not None

    def _beside(self, probe: Probe) -> int | None:
        """The next approach of its finger on the side to come from; None at the end of the aim's range."""
        item = self.approaches[probe.approach]
        aim = self._mechanisms[item.finger].aim
        assert aim is not None
        before = [
            (further, number)
            for number, other in enumerate(self.approaches)
            if other.finger == item.finger
            and other.stage_rad == item.stage_rad
            and (further := probe.side * (_aim_rad(item) - _aim_rad(other)) / aim.gear_ratio) > 1e-6
        ]
        return min(before)[1] if before else None

    def _note(self, probes: Sequence[Probe]) -> None:
        for probe in probes:
            self._ways(probe.approach)

    def _ways(self, number: int) -> tuple[int, int] | None:
        """Sides from which the aim will come to its angle, as far as that is sure; noted for the next.

        None without an aim: joints move all of the way, and how they came shows where each stands.
        """
        item = self.approaches[number]
        aim = self._mechanisms[item.finger].aim
        if aim is None:
            return None
        at = _aim_rad(item)
        before, way = self._aims.get(item.finger, (math.nan, 0))
        moved = (at - before) / aim.gear_ratio
        sure = abs(at - before) > _MIN_TAKE_UP_RAD
        if sure:
            way = 1 if moved > 0 else -1
        elif at != before:
            way = 0
        self._aims[item.finger] = (at, way)
        return way, 0

    def _probe_touch(
        self, touch: Touch, approach: FingerApproach, placing: int, ways: tuple[int, int] | None
    ) -> TouchMeasurement | None:
        patch = touch.patch
        if patch is None:
            return None
        mechanism = self._mechanisms[touch.finger_index]
        kinematics, facing = mechanism.kinematics, 0.0
        if ways is None:
            line = _ring_line(self._hand.rig, approach)
            facing = wrap_angle(kinematics.facing_rad(touch.servos) - line.direction_rad)
            last = line.travel_mm(kinematics.centre_mm(touch.servos))
            ways = joint_sides(mechanism.spec, servo_table(kinematics, line, (last - _TAKE_UP_MM, last)))
        return TouchMeasurement(
            self._hand.fingers[touch.finger_index].name,
            placing,
            touch.servos,
            ways[0],
            patch.angle_rad,
            patch.angle_half_range_rad,
            patch.force_n,
            patch.force_bound_n,
            ways[1],
            float(facing),
            touch.stage_rad,
        )


def approaches_of(rig: RigFile, *, turned: bool = False) -> list[ServoPath]:
    """Every way that the fingers of a rig can go, as their servos go it; `turned`: at all stage angles."""
    reach, numbers = (_stage_reach if turned else _middle_reach)(rig)
    mechanisms = [mechanism_of(finger) for finger in rig.fingers]
    return [_approach(rig, reach, index, mechanisms) for index in numbers]


def _middle_reach(rig: RigFile) -> tuple[Reach, list[int]]:
    """The reach of a rig, and its approaches with the stage where it is nearest to 0."""
    reach = reach_of(rig, aims=_ARM_AIMS if _lacks_aims(rig) else _AIMS)
    return reach, reach.of_stage(reach.middle_rad)


def _stage_reach(rig: RigFile) -> tuple[Reach, list[int]]:
    """The reach at several angles of the stage, and those of its approaches whose play is taken up."""
    reach = reach_of(rig, aims=_TURNED_ARM_AIMS if _lacks_aims(rig) else _TURNED_AIMS)
    mechanisms = [mechanism_of(spec) for spec in rig.fingers]

    def counts(number: int) -> bool:
        item = reach.approaches[number]
        mechanism = mechanisms[item.finger_index]
        if mechanism.aim is None:
            return True
        aim_rad, _ = mechanism.kinematics.servos_rad(_ring_line(rig, item), 0.0)
        return abs(aim_rad - _home_rad(mechanism.aim)) > _MIN_TAKE_UP_RAD

    return reach, [number for number in range(len(reach.approaches)) if counts(number)]


def _lacks_aims(rig: RigFile) -> bool:
    return any(mechanism_of(finger).aim is None for finger in rig.fingers)


def _home_rad(aim: AimConfig) -> float:
    """Servo angle of an aim where it waits while the stage turns."""
    return math.radians(aim.zero_deg) - math.pi


def joint_sides(spec: FingerConfig, servos_rad: Floats) -> tuple[int, int]:
    """Sides from which both joints of an arm came, +1 from below, by servo angles (2, 2); 0 if not sure.

    Sure is what has moved on by more than all of the play, and what encoders may be off.
    """
    ways = []
    for joint, turned in zip(spec.servos.values(), (servos_rad[1] - servos_rad[0]).tolist(), strict=True):
        assert isinstance(joint, RotaryConfig), "joints of a finger without an aim turn"
        moved = turned / joint.gear_ratio
        least = 2 * math.radians(joint.backlash_deg) + 2 * TICK_RAD / abs(joint.gear_ratio)
        ways.append(int(math.copysign(1, moved)) if abs(moved) > least else 0)
    return ways[0], ways[1]


def servo_table(kinematics: FingerKinematics, line: Line, travels_mm: Sequence[float]) -> Floats:
    """Servo angles (m, 2) after travels along a line."""
    return np.array([kinematics.servos_rad(line, travel) for travel in travels_mm])


def _approach(rig: RigFile, reach: Reach, index: int, mechanisms: Sequence[Mechanism]) -> ServoPath:
    item = reach.approaches[index]
    mechanism = mechanisms[item.finger_index]
    travels = np.linspace(0.0, item.travel_mm, _PATH_POSTURES if mechanism.aim is None else 2).tolist()
    line = _ring_line(rig, item)
    servos = servo_table(mechanism.kinematics, line, travels)
    return ServoPath(item.finger_index, servos, item.travel_mm, item.stage_rad)


def _ring_line(rig: RigFile, item: FingerApproach) -> Line:
    """An approach's line in the frame that carries the fingers."""
    return Stage.of(rig).planned_turn(item.stage_rad).line_back(line_of(item))


def _aim_rad(approach: ServoPath) -> float:
    """Servo angle of a slide's aim."""
    return float(approach.servos_rad[0, 0])
