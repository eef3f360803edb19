"""The hand: all fingers of a rig, connected, limited, and switched off again whatever happens.

Joins servos, arrays, extractors and kinematics. Limits are written and read back before torque goes on; Bus
Watchdog is armed while anything moves; leaving the `with` block, by whatever way, switches every motor's
torque off, each by itself.
"""

import contextlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Self

import numpy as np
from serial.serialutil import SerialBase

from palpate.config import Finger as FingerFile
from palpate.config import RigFile
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import OperatingMode
from palpate.drivers.dynamixel.failures import DamagedAnswer
from palpate.drivers.dynamixel.servo import Servo, ServoState, read_states, torque_off_all
from palpate.drivers.finger import FingerKinematics
from palpate.drivers.tactile.array import TactileArray, TactileFrame
from palpate.drivers.tactile.contact import ContactExtractor, TipCalibration
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError
from palpate.rig.convert import kinematics_of

__all__ = ["Hand", "HostFinger", "OpenPort"]

OpenPort = Callable[[str, int], SerialBase]
"""Opens the port that a rig file names at a baud rate; raises DeviceError naming it."""

_AIM_CURRENT_A = 0.6
_AIM_SPEED_RAD_S = 3.0
_ACCELERATION_RAD_S2 = 6.0
_WATCHDOG_S = 0.5
_TARE_FRAMES = 16
_SETTLED_RAD_S = 0.03
_MOVE_TIMEOUT_S = 20.0
_POLL_S = 0.02
_FRAME_TIMEOUT_S = 1.0
_READS = 3


@dataclass(frozen=True, eq=False)
class HostFinger:
    """One finger as the host sees it: its part of the rig file, its devices and its kinematics."""

    spec: FingerFile
    kinematics: FingerKinematics
    aim: Servo
    slide: Servo
    array: TactileArray
    extractor: ContactExtractor

    @property
    def name(self) -> str:
        """The rig file's name of the finger."""
        return self.spec.name


class Hand:
    """All fingers, on their bus and their arrays' ports. Use as a context manager."""

    def __init__(self, rig: RigFile, clock: Clock, open_port: OpenPort) -> None:
        """Open every port and ask every device who it is.

        Raises DeviceError naming the port or the servo that is missing; what was opened is closed again, and
        torque is off on every servo that answers.
        """
        self.rig = rig
        self.clock = clock
        self._ports: list[SerialBase] = []
        self._arrays: list[TactileArray] = []
        self._servos: list[Servo] = []
        self.fingers: tuple[HostFinger, ...] = ()
        self.emulated = False
        try:
            self._connect(open_port)
        except BaseException as error:
            _warn(error, self.close())
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        failed = self.close()
        if error is not None:
            _warn(error, failed)
        elif failed:
            _warn(failed[0], failed)
            raise failed[0]

    def close(self) -> list[DeviceError]:
        """Torque off on every servo, arrays stopped, ports closed; returns what could not be switched off."""
        try:
            return self._switch_off()
        except BaseException:
            self._switch_off()  # an interrupt in the middle of it must not leave the other servos on
            raise
        finally:
            for port in self._ports:
                port.close()
            self._servos, self._arrays, self._ports = [], [], []

    def _switch_off(self) -> list[DeviceError]:
        failed = torque_off_all(self.bus, self._servos) if self._servos else []
        for array in self._arrays:
            try:
                array.stop()
            except DeviceError:
                continue  # an array that is gone moves nothing
        return failed

    def prepare(self) -> None:
        """Write and check limits, switch torque on where everything stands."""
        closing = self.rig.closing
        for finger in self.fingers:
            lever_m = abs(finger.kinematics.mm_per_rad) / 1000
            current = closing.max_force_n * lever_m / finger.slide.model.torque_per_current_nm_a
            finger.aim.prepare(OperatingMode.POSITION, _AIM_CURRENT_A)
            finger.slide.prepare(OperatingMode.CURRENT_BASED_POSITION, current)
            finger.slide.set_goal_current_a(current)
            finger.aim.set_profile(_AIM_SPEED_RAD_S, _ACCELERATION_RAD_S2)
            self.set_speed(finger, closing.approach_speed_mm_s)
            self._check_start(finger)
        for servo in self._servos:
            servo.torque(on=True)

    def arm(self) -> None:
        """Arm Bus Watchdog on every servo: if the host falls silent, everything stops by itself."""
        for servo in self._servos:
            servo.disarm_watchdog()  # clears one that has tripped
            servo.arm_watchdog(_WATCHDOG_S)

    def disarm(self) -> None:
        """Let the host be silent while nothing moves."""
        for servo in self._servos:
            servo.disarm_watchdog()

    def set_speed(self, finger: HostFinger, speed_mm_s: float) -> None:
        """Speed of a finger's slide from its next goal on."""
        finger.slide.set_profile(speed_mm_s / abs(finger.kinematics.mm_per_rad), _ACCELERATION_RAD_S2)

    def states(self, servos: Sequence[Servo]) -> dict[int, ServoState]:
        """What the servos measure now, by id.

        Where answers were late or damaged but every servo is there, asks again: reading changes nothing, and
        one stall of the computer must not end a run.
        """
        for _ in range(_READS - 1):
            with contextlib.suppress(DamagedAnswer):
                return read_states(self.bus, servos)
        return read_states(self.bus, servos)

    def wait_still(
        self, servos: Sequence[Servo], goals_rad: Mapping[int, float], tolerance_rad: float
    ) -> None:
        """Wait until servos stand within a tolerance of their goals; DeviceError names one that is late."""
        deadline = self.clock.now() + _MOVE_TIMEOUT_S
        while True:
            self.pause(_POLL_S)
            states = self.states(servos)
            late = [
                servo
                for servo in servos
                if abs(states[servo.dxl_id].velocity_rad_s) > _SETTLED_RAD_S
                or abs(states[servo.dxl_id].position_rad - goals_rad[servo.dxl_id]) > tolerance_rad
            ]
            if not late:
                return
            if self.clock.now() > deadline:
                servo = late[0]
                raise DeviceError(
                    f"servo {servo.dxl_id} on {self.bus.port_name} did not reach "
                    f"{goals_rad[servo.dxl_id]:.3f} rad within {_MOVE_TIMEOUT_S:g} s (it is at "
                    f"{states[servo.dxl_id].position_rad:.3f}); check what holds it; "
                    "if nothing does, raise max_force_n"
                )

    def tare(self) -> None:
        """Start every array and take its baseline; nothing may touch the tips."""
        for finger in self.fingers:
            finger.array.start(self.rig.closing.sample_rate_hz)
        for finger, frames in zip(self.fingers, self.collect(self.fingers, _TARE_FRAMES), strict=True):
            finger.extractor.tare(frames)

    def collect(self, fingers: Sequence[HostFinger], count: int) -> list[list[TactileFrame]]:
        """The next `count` frames of each finger, taken in turns so that no port waits for the others."""
        taken: list[list[TactileFrame]] = [[] for _ in fingers]
        for _ in range(count):
            for finger, frames in zip(fingers, taken, strict=True):
                frames.append(finger.array.wait_frame(_FRAME_TIMEOUT_S))
        return taken

    def pause(self, seconds: float) -> None:
        """Let time pass, and drop what the arrays send meanwhile.

        A port that nobody reads keeps the oldest frames, up to a second of them: they would be felt as now.
        """
        looks = math.ceil(seconds / _POLL_S)
        for _ in range(looks):
            self.clock.sleep(seconds / looks)
            for finger in self.fingers:
                finger.array.frames()

    def stop_arrays(self) -> None:
        """Let the arrays rest; what they sent and nobody looked at is dropped."""
        for finger in self.fingers:
            finger.array.stop()
            finger.array.frames()

    def _connect(self, open_port: OpenPort) -> None:
        rig = self.rig
        port = open_port(rig.bus.port, rig.bus.baudrate_bps)
        self._ports.append(port)
        self.bus = Bus(port, self.clock, rig.bus.baudrate_bps)
        pairs = []
        for spec in rig.fingers:
            pair = self._servo_pair(spec)
            self._servos += pair
            pairs.append(pair)
        for servo in self._servos:
            servo.check()
        self.fingers = tuple(
            self._finger(spec, pair, open_port) for spec, pair in zip(rig.fingers, pairs, strict=True)
        )
        self.emulated = any(finger.array.description.emulated for finger in self.fingers)

    def _servo_pair(self, spec: FingerFile) -> tuple[Servo, Servo]:
        kinematics = kinematics_of(spec)
        aims = [kinematics.aim_servo_rad(math.radians(value)) for value in spec.aim.range_deg]
        slides = [kinematics.slide_servo_rad(value) for value in spec.slide.range_mm]
        return (
            Servo(self.bus, spec.aim.dxl_id, spec.aim.model, range_rad=(min(aims), max(aims))),
            Servo(self.bus, spec.slide.dxl_id, spec.slide.model, range_rad=(min(slides), max(slides))),
        )

    def _finger(self, spec: FingerFile, pair: tuple[Servo, Servo], open_port: OpenPort) -> HostFinger:
        port = open_port(spec.array.port, spec.array.baudrate_bps)
        self._ports.append(port)
        array = TactileArray(port, self.clock, spec.name)
        self._arrays.append(array)
        description = array.connect()
        calibration = TipCalibration(
            gain=np.ones((description.rows, description.cols)),
            gain_spread=spec.array.gain_spread,
            contact_force_n=self.rig.closing.contact_force_n / 2,
            stiffness_n_per_mm=spec.tip.stiffness_n_per_mm,
            stiffness_bound=spec.tip.stiffness_spread,
        )
        extractor = ContactExtractor(description, calibration)
        return HostFinger(spec, kinematics_of(spec), *pair, array, extractor)

    def _check_start(self, finger: HostFinger) -> None:
        """A slide must be retracted at the start: its servo knows its angle within one turn only."""
        state = self.states([finger.slide])[finger.slide.dxl_id]
        distance = finger.kinematics.distance_mm(state.position_rad)
        lo, hi = finger.spec.slide.range_mm
        play = finger.spec.slide.backlash_mm
        if not lo - play <= distance <= hi + play:
            raise DeviceError(
                f"finger {finger.name}: its slide (servo {finger.slide.dxl_id}) stands at {distance:.1f} mm, "
                f"outside its range {lo:g} … {hi:g} mm; with torque off, push the finger back by hand until "
                "it is retracted within the servo's first turn, then start again"
            )


def _warn(error: BaseException, failed: Sequence[DeviceError]) -> None:
    """Add to what ends the run that some torque may still be on."""
    if failed:
        servos = "one servo" if len(failed) == 1 else f"{len(failed)} servos"
        error.add_note(
            f"warning: {servos} did not confirm that torque is off ({failed[0]}); "
            "cut the power before you reach in"
        )
