"""A rig that calibration can measure: what `calibration.prober` asks for, done by a hand.

Between calibration and the hand. Whoever puts references on the table is a `Table`: a person who is asked, or
the emulated bench.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from palpate.calibration.measurements import (
    IdleMeasurement,
    PressMeasurement,
    StopMeasurement,
    TouchMeasurement,
)
from palpate.calibration.prober import Probe, SlideApproach
from palpate.calibration.reference import Reference
from palpate.config import RigFile, SlideFingerConfig
from palpate.drivers.slide_finger import SlideKinematics
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import line_of, slide_kinematics
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.end_stops import slide_of, stall, swing
from palpate.rig.motion.guarded_approach import GripPhase, Touch, aim, carry_out_grip, retract_all
from palpate.rig.motion.hand import Hand
from palpate.rig.motion.press import press, stop_at_speed
from palpate.rig.motion.quasi_static_touch import measure_quasi_statically
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.turning_stage import planned_turn

__all__ = ["HandProber", "Table", "approaches_of"]

_AIMS = 81
_SURE_MOVE_RAD = math.radians(1.0)  # of an aim's servo: less may not take up its play


class Table(Protocol):
    """Whoever puts things on the table."""

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Put a reference near a place in W, alone, and see that it cannot move."""
        ...

    def clear(self) -> None:
        """Take everything away."""
        ...


class HandProber:
    """Does for calibration what a hand can do. The hand must be prepared; all its fingers must be slides."""

    def __init__(self, hand: Hand, table: Table, tell: Callable[[GripPhase], None] = lambda _: None) -> None:
        """Raises InputError for a finger that is not a slide or has no room."""
        self._hand, self._table, self._tell = hand, table, tell
        self._kinematics = [slide_of(finger) for finger in hand.fingers]
        self._reach: Reach = reach_of(hand.rig, aims=_AIMS)
        self._number = self._reach.of_stage(self._reach.middle_rad)
        self.approaches: Sequence[SlideApproach] = [
            _approach(self._reach, index, self._kinematics) for index in self._number
        ]
        self._aims: dict[int, tuple[float, int]] = {}

    def put(self, reference: Reference, about_mm: tuple[float, float]) -> None:
        """Have a reference put near a place."""
        self._table.put(reference, about_mm)

    def clear(self) -> None:
        """Have the table cleared."""
        self._table.clear()

    def touch(self, grip: Sequence[Probe], placing: int) -> list[TouchMeasurement | None]:
        """Close fingers on approaches, all at once."""
        self._take_up_play(grip)
        approaches = [self._to_contact(probe)[0] for probe in grip]
        ways = [self._way(self.approaches[probe.approach]) for probe in grip]
        done = carry_out_grip(self._hand, approaches, self._tell, measure_quasi_statically)
        touches = {touch.finger_index: touch for touch in done}
        found = [touches[item.finger_index] for item in approaches]
        return [self._touched(touch, placing, way) for touch, way in zip(found, ways, strict=True)]

    def press(self, contacts: Sequence[Probe], placing: int) -> list[PressMeasurement]:
        """Press with fingers on contacts, all at once."""
        self._take_up_play(contacts)
        self._note(contacts)
        return press(self._hand, [self._to_contact(item) for item in contacts], placing)

    def stop(self, contacts: Sequence[Probe], speed_mm_s: float) -> list[StopMeasurement]:
        """Run into contacts, all at once."""
        self._note(contacts)
        return stop_at_speed(self._hand, [self._to_contact(item) for item in contacts], speed_mm_s)

    def swing(self) -> list[float]:
        """Turn all aims a little either way and back."""
        return swing(self._hand)

    def idle(self, seconds: float) -> list[IdleMeasurement]:
        """Read all arrays for a time, fingers waiting."""
        hand = self._hand
        rate = hand.rig.closing.sample_rate_hz
        for finger in hand.fingers:
            finger.array.start(rate)
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
        return stall(self._hand, self._hand.fingers[finger], stop_mm)

    def _to_contact(self, probe: Probe) -> tuple[FingerApproach, float]:
        """The approach up to where the probe ends, and how far that is."""
        item = self.approaches[probe.approach]
        travel = (probe.end_rad - item.start_rad) * self._kinematics[item.finger].mm_per_rad
        return self._reach.approaches[self._number[probe.approach]].up_to(travel), travel

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
        turn = planned_turn(self._hand.rig.stage, 0.0)
        aim(
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
            self._way(self.approaches[number])
        self._hand.disarm()

    def _may_push_aim(self, probe: Probe) -> bool:
        spec = self._hand.fingers[self.approaches[probe.approach].finger].spec
        return isinstance(spec, SlideFingerConfig) and spec.aim.backlash_holds_n is not None

    def _beside(self, probe: Probe) -> int | None:
        """The next approach of its finger on the side to come from; None at the end of the aim's range."""
        item = self.approaches[probe.approach]
        gear = self._kinematics[item.finger].gear_ratio
        before = [
            (probe.side * (item.aim_rad - other.aim_rad) / gear, number)
            for number, other in enumerate(self.approaches)
            if other.finger == item.finger and probe.side * (item.aim_rad - other.aim_rad) / gear > 1e-6
        ]
        return min(before)[1] if before else None

    def _note(self, probes: Sequence[Probe]) -> None:
        for probe in probes:
            self._way(self.approaches[probe.approach])

    def _way(self, approach: SlideApproach) -> int:
        """From which side the aim will come to its angle, as far as that is sure; noted for the next."""
        before, way = self._aims.get(approach.finger, (math.nan, 0))
        moved = (approach.aim_rad - before) / self._kinematics[approach.finger].gear_ratio
        sure = abs(approach.aim_rad - before) > _SURE_MOVE_RAD
        if sure:
            way = 1 if moved > 0 else -1
        elif approach.aim_rad != before:
            way = 0
        self._aims[approach.finger] = (approach.aim_rad, way)
        return way

    def _touched(self, touch: Touch, placing: int, way: int) -> TouchMeasurement | None:
        patch = touch.patch
        if patch is None:
            return None
        return TouchMeasurement(
            self._hand.fingers[touch.finger_index].name,
            placing,
            touch.servos,
            way,
            patch.angle_rad,
            patch.angle_half_range_rad,
            patch.force_n,
            patch.force_bound_n,
        )


def approaches_of(rig: RigFile) -> list[SlideApproach]:
    """Every way that the slides of a rig can go; InputError for a finger that is not a slide."""
    reach = reach_of(rig, aims=_AIMS)
    kinematics = [slide_kinematics(finger) for finger in rig.fingers if isinstance(finger, SlideFingerConfig)]
    return [_approach(reach, index, kinematics) for index in reach.of_stage(reach.middle_rad)]


def _approach(reach: Reach, index: int, kinematics: Sequence[SlideKinematics]) -> SlideApproach:
    item = reach.approaches[index]
    own, line = kinematics[item.finger_index], line_of(item)
    aim, start = own.servos_rad(line, 0.0)
    end = own.servos_rad(line, item.travel_mm)[1]
    return SlideApproach(item.finger_index, aim, start, end)
