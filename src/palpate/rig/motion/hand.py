"""The hand: all fingers of a rig, connected, limited, and switched off whatever happens.

Limits are written and read back before torque goes on; Bus Watchdog is armed while anything moves; leaving
the `with` block in any way switches every motor's torque off individually. All waiting with torque on is
done in `pause`, where arrays are guarded. An `Environment` provides a hand with clock and ports, of a bench
or of a recording.
"""

import gc
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Self, TypeVar

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError, SafetyStop
from palpate.config import RigFile
from palpate.drivers.dynamixel import (
    TORQUE_OFF_PACKET,
    Bus,
    MoveEnd,
    Mover,
    NotAnswering,
    Restarted,
    Servo,
    ServoError,
    ServoGoals,
    ServoMover,
    ServoState,
    StateReader,
    StateSampler,
    WatchdogTripped,
    guarded_loop,
    hold,
    refuse_foreign_settings,
)
from palpate.drivers.kinematics import Servos, Turn
from palpate.drivers.tactile import ArrayDriver, ArrayLost, ContactExtractor, TactileFrame
from palpate.drivers.transport import Clock, describe_renaming
from palpate.rig.arrays import extractor_of, threshold_problem
from palpate.rig.fingers import HostFinger, HostStage, drive_of
from palpate.rig.mechanisms import mechanism_of
from palpate.rig.mechanisms.mechanism import Drive, Mechanism
from palpate.rig.motion.array_guard import (
    ArrayGuard,
    ArrayReading,
    HandArrays,
    despite_interruptions,
    name_owners,
    note_other_causes,
    note_what_is_on,
    switch_off,
)
from palpate.rig.motion.current_sensing import CurrentExtractor, CurrentSensor
from palpate.rig.motion.dead_man import DeadManSwitch
from palpate.rig.motion.homing import (
    HomingPolicy,
    forget_turn,
    home_slides,
    homing_problem,
    is_within_stops,
    recall_turn,
)
from palpate.rig.motion.load_meter import LoadMeter
from palpate.rig.motion.reading_checks import ReadingChecks
from palpate.rig.motion.servo_causes import explain_servo_error, explain_silence, weakness
from palpate.rig.motion.standby import come_to_standby, stage_problem
from palpate.rig.workers import ProgramEnd

OpenPort = Callable[[str, int], SerialBase]
"""Opens the port that a rig file names at a baud rate; raises DeviceError naming it."""

WATCHDOG_S = 0.5
BUS_KEEPALIVE_S = WATCHDOG_S / 3
"""How long servos may hear nothing while Bus Watchdog is armed, with room for a lost packet or two."""

_TARE_FRAMES = 64
_POLL_S = 0.02
_FRAME_TIMEOUT_S = 1.0

_M = TypeVar("_M", bound=Mover)


class Hand:
    """All fingers, on their bus and their arrays' ports. Use as a context manager."""

    def __init__(
        self,
        rig: RigFile,
        clock: Clock,
        open_port: OpenPort,
        *,
        latency_s: float,
        notice: Callable[[str], None] = lambda _: None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """Open every port and ask every device who it is.

        `latency_s`: what the bus's adapter may add to an answer. `notice` is told what the operator should
        do, and must neither raise nor wait. `check` is called at every look of a move, and may raise to end
        the run. Raises DeviceError naming the port or the servo that is missing; what was opened is closed
        again, and torque is off on every servo that answers.
        """
        self.rig = rig
        self.clock = clock
        self._latency_s = latency_s
        self.notice = notice
        self._check = check
        self._program_end = ProgramEnd()
        self._dead_man: DeadManSwitch | None = None
        self._array_guard = ArrayGuard(clock, rig.closing)
        self.checks = ReadingChecks(notice)
        self._ports: list[SerialBase] = []
        self._arrays = HandArrays(clock)
        self._servos: list[Servo] = []
        self.fingers: tuple[HostFinger, ...] = ()
        self.proven: set[HostFinger] = set()
        self.emulated = False
        self._driven = False
        try:
            self._connect(open_port)
        except BaseException as error:
            note_what_is_on(error, self.close())
            bus = rig.bus
            if not isinstance(error, NotAnswering) or not explain_silence(
                error, partial(open_port, bus.port), bus.baudrate_bps, clock, latency_s
            ):
                note_other_causes(error)
            name_owners(error, rig)
            raise

    def __repr__(self) -> str:
        return f"<Hand of rig {self.rig.name}: {', '.join(finger.name for finger in self.rig.fingers)}>"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        before = self.bus.port_name
        failed = self.close(error)
        if isinstance(error, Exception):
            self.checks.explain(error, self._array_guard.seen)
        if error is not None:
            name_owners(error, self.rig)
            if self.bus.port_name != before:
                error.add_note(describe_renaming(before, self.bus.port_name))
            if not isinstance(error, Exception) and not failed:
                error.add_note("torque is off")
        elif failed:
            note_what_is_on(failed[0], failed)
            raise failed[0]

    def close(self, error: BaseException | None = None) -> list[DeviceError]:
        """Torque off on every servo, arrays stopped, ports closed; returns what could not be switched off.

        `error`: why; it is told what may still be on, and its words become the cause that is found.
        """
        self._driven = False
        try:
            failed = despite_interruptions(self._switch_off)
            if error is not None:
                note_what_is_on(error, failed)
                if not self._explain(error):
                    note_other_causes(error)
            return failed
        finally:
            for port in self._ports:
                with suppress(Exception):  # torque is what matters, and the next port
                    port.close()
            self._arrays.close()
            if self._servos:
                with suppress(Exception):
                    self.bus.close()  # on a port of its own, if the adapter was plugged in again
            self._servos, self._ports = [], []
            gc.unfreeze()
            self._program_end.finish()

    def _explain(self, error: BaseException) -> bool:
        with suppress(DeviceError):
            return isinstance(error, ServoError) and explain_servo_error(
                error, self._reader, self._servos, self.clock
            )
        return False

    def _switch_off(self) -> list[DeviceError]:
        failed = switch_off(self.bus, self._servos, self.clock, self.notice) if self._servos else []
        if self._dead_man is not None:
            self._dead_man.release()
        self._arrays.stop()
        return failed

    def set_dead_man(self) -> None:
        """Have torque switched off, should this program be killed; for real ports. Call before `prepare`."""
        try:
            self._dead_man = DeadManSwitch(self.bus.port_name, self.rig.bus.baudrate_bps, TORQUE_OFF_PACKET)
        except OSError as error:
            self.notice(
                f"no process watches over this one ({error.strerror}): if it is killed, torque stays on"
            )

    def prepare(self, *, home: HomingPolicy = HomingPolicy.UNKNOWN) -> None:
        """Write and check limits, switch torque on where everything stands, home slides, come to standby.

        `home`: which of the slides with `stops_mm`. Where none is, nothing moves: those whose turn is unknown
        must be retracted in their first turn, as slides without stops, and arms be where they wait.
        """
        self._driven = False
        # Garbage collections pass over what is there now: one takes up to 0.1 s, and nobody looks at arrays.
        gc.freeze()
        refuse_foreign_settings(self.bus, self._servos)
        self.disarm()  # one that has tripped in an earlier run refuses goals
        self._reader.arrange()
        self.stage.prepare()
        wrong = stage_problem(self.rig, self.turn)
        if wrong is not None:
            raise DeviceError(wrong)
        unknown = []
        for finger in self.fingers:
            recalled = (
                finger.mechanism.homing is not None
                and home is not HomingPolicy.ALL
                and recall_turn(self.bus, finger)
            )
            finger.drive.prepare()
            if home is HomingPolicy.NONE or finger.mechanism.homing is None:
                self._check_start(finger, is_homed=home is not HomingPolicy.NONE)
            elif not (recalled and is_within_stops(finger, self.servos_of([finger])[finger][1])):
                unknown.append(finger)
        for finger in unknown:
            forget_turn(self.bus, finger)
            wrong = homing_problem(finger, self.servos_of([finger])[finger])
            if wrong is not None:
                raise DeviceError(f"finger {finger.name}: {wrong}")
        for servo in self._servos:
            servo.enable_torque()
        self._driven = True
        home_slides(self, unknown)
        if home is not HomingPolicy.NONE:
            come_to_standby(self)

    @property
    def servos(self) -> Sequence[Servo]:
        """All servos, the stage's first."""
        return self._servos

    @property
    def turn(self) -> Turn:
        """Turn of the stage now; raises DeviceError if it does not answer."""
        return self.stage.turn(self.states(self.stage.servos))

    def servos_of(self, fingers: Sequence[HostFinger]) -> dict[HostFinger, Servos]:
        """Angles of some fingers' servos now."""
        states = self.states([servo for finger in fingers for servo in finger.drive.servos])
        return {
            finger: (states[near.dxl_id].position_rad, states[far.dxl_id].position_rad)
            for finger in fingers
            for near, far in (finger.drive.servos,)
        }

    def arm(self) -> None:
        """Arm Bus Watchdog on every servo: if the host falls silent, everything stops by itself."""
        for servo in self._servos:
            servo.disarm_watchdog()  # clears one that has tripped
            servo.arm_watchdog(WATCHDOG_S)

    def disarm(self) -> None:
        """Let the host be silent while nothing moves."""
        for servo in self._servos:
            servo.disarm_watchdog()

    def states(self, servos: Sequence[Servo]) -> dict[int, ServoState]:
        """States of the servos now, by id, read at one instant.

        Raises NotAnswering for silent ones, HardwareAlert for one with a hardware error, Restarted for one
        that has lost its power meanwhile, WatchdogTripped for one that heard nothing for too long.
        """
        if not servos:
            return {}
        try:
            states = self._reader.read(servos).all()
        except Restarted as error:
            raise Restarted(error.dxl_ids[0], self.bus.port_name, self._after_restart(error)) from None
        for dxl_id, state in states.items():
            if state.watchdog_tripped:
                raise WatchdogTripped(dxl_id, self.bus.port_name, WATCHDOG_S)
            if self._driven and not state.torque_on:
                (own,) = (servo for servo in servos if servo.dxl_id == dxl_id)
                raise SafetyStop(
                    f"servo {dxl_id} on {self.bus.port_name} ({self._owner(own)}) has its torque off, and "
                    "this run did not switch it off: something else on the bus did; fingers were stopped"
                )
        return states

    def guarded(
        self, movers: Sequence[_M], *, period_s: float = _POLL_S, read_every: int = 1
    ) -> dict[_M, MoveEnd]:
        """Carry out a guarded move of these movers; returns how each ended. Raises as `guarded_loop` does.

        Torque stays on, also after an error: the end of the hand's `with` block switches it off.
        """
        return guarded_loop(
            self.bus,
            self.states,
            self.clock.now,
            self.pause,
            movers,
            period_s=period_s,
            read_every=read_every,
        )

    def move_servos(self, goals_rad: ServoGoals, tolerance_rad: Callable[[Servo], float]) -> None:
        """Send servos to goals through free space; DeviceError names one that does not arrive."""
        self.require_arrival(
            self.guarded([ServoMover(s, goal, tolerance_rad(s)) for s, goal in goals_rad.items()])
        )

    def require_arrival(self, ends: Mapping[_M, MoveEnd]) -> None:
        """Raise DeviceError naming a servo of the first mover that has not reached its goal."""
        held = [mover for mover, end in ends.items() if end is not MoveEnd.REACHED]
        if held:
            servo = held[0].driven[0]
            at_rad = self.states([servo])[servo.dxl_id].position_rad
            position = round(at_rad / servo.model.rad_per_tick) + servo.zero_tick
            closing = {own for finger in self.fingers for own in finger.drive.closing_servos}
            remedy = (
                "raise max_force_n if it goes easily, else loosen it"
                if servo in closing
                else "loosen what it turns if it goes hard"
            )
            weak = weakness(self.bus, servo)
            raise DeviceError(
                f"servo {servo.dxl_id} on {self.bus.port_name} ({self._owner(servo)}) did not reach its goal "
                f"in free space: its Present Position stays at {position}; "
                + (weak or f"move it by hand, and {remedy}")
            )

    def _owner(self, servo: Servo) -> str:
        """Name of a servo in the rig file."""
        (own,) = (item for item in self.rig.servos if item.dxl_id == servo.dxl_id)
        return "the stage" if own.finger is None else f"finger {own.finger}, {own.joint}"

    def tare(self) -> None:
        """Start every array and take its baseline; nothing may touch the tips."""
        self.start_arrays()
        for finger, frames in zip(self.fingers, self.collect(self.fingers, _TARE_FRAMES), strict=True):
            if isinstance(finger.array, CurrentSensor):
                finger.array.check_free()
            self._array_guard.tare(finger, frames)
            self.checks.check_tare(finger, frames)
            if (wrong := threshold_problem(finger.extractor, self.rig.closing, finger.spec.tip)) is not None:
                jumps = self.checks.note_disturbance(finger, frames)
                why = f": {wrong}" if jumps is None else f" {jumps}"
                raise DeviceError(f"tactile array {finger.name}{why}")

    def finish_grip(self) -> None:
        """Let the arrays rest at the end of a grip, and compare what they have sent with what is declared."""
        for finger, frames in self._array_guard.seen.items():
            self.checks.check_grip(finger, frames)
        self.stop_arrays()

    def is_changing(self, finger: HostFinger, window_s: float) -> bool:
        """Return whether the force of a finger that rests in contact has changed within the last seconds."""
        frames = self._array_guard.seen.get(finger, [])
        ages = [frames[-1].device_time_s - frame.device_time_s for frame in frames]
        later = [frame for frame, age in zip(frames, ages, strict=True) if age < window_s / 2]
        earlier = [frame for frame, age in zip(frames, ages, strict=True) if window_s / 2 <= age < window_s]
        return bool(earlier) and finger.extractor.is_changing(earlier, later)

    def start_arrays(self) -> None:
        """Let every array stream; from now on silence counts. Servos are looked at where that takes long."""
        spoken_s = self.clock.now()
        for finger in self.fingers:
            self._array_guard.start([finger])
            spoken_s = self._speak(spoken_s)

    def _speak(self, spoken_s: float) -> float:
        """Look at the servos if they have heard nothing for long; returns when they heard last."""
        if self.clock.now() - spoken_s <= BUS_KEEPALIVE_S:
            return spoken_s
        self.states(self._servos)
        return self.clock.now()

    def meter(self, meters: Mapping[HostFinger, LoadMeter]) -> None:
        """Have every frame's force metered from now on, until the arrays rest."""
        self._array_guard.meters.update(meters)

    def stop_arrays(self) -> None:
        """Let the arrays rest; unread frames are dropped."""
        self._array_guard.stop(self.fingers)

    def collect(self, fingers: Sequence[HostFinger], count: int) -> list[list[TactileFrame]]:
        """The next `count` frames of each finger, taken in turns so that no port waits for the others.

        Servos are looked at now and then: frames of slow arrays take longer than Bus Watchdog waits.
        """
        taken: list[list[TactileFrame]] = [[] for _ in fingers]
        spoken_s = self.clock.now()
        for _ in range(count):
            spoken_s = self._speak(spoken_s)
            for finger, frames in zip(fingers, taken, strict=True):
                frames.append(finger.array.wait_frame(_FRAME_TIMEOUT_S))
        self._array_guard.note_heard(fingers)
        for finger, frames in zip(fingers, taken, strict=True):
            self._array_guard.feel(finger, frames)
        return taken

    def pause(self, seconds: float) -> None:
        """Let time pass, and look at every array that streams, every 20 ms at least.

        What they sent meanwhile is `felt` until the next pause. Raises SafetyStop for a force above
        max_force_n, DeviceError for an array that has fallen silent, and what `check` raises.
        """
        looks = math.ceil(seconds / _POLL_S)
        self._array_guard.forget()
        for _ in range(looks):
            self.clock.sleep(seconds / looks)
            self._program_end.check()
            self._check()
            self._array_guard.look()

    def settle(self, fingers: Sequence[HostFinger], seconds: float) -> None:
        """Let so much time pass, and then all frames come that these fingers' arrays have sampled in it.

        Whatever holds them back, frames that are read next were sampled afterwards. Raises as `pause`.
        """
        spoken_s = self.clock.now()
        rested_s = spoken_s + seconds
        while (left_s := rested_s - self.clock.now()) > BUS_KEEPALIVE_S:
            self.pause(BUS_KEEPALIVE_S)
            spoken_s = self._speak(spoken_s)
        self.pause(left_s)
        while any(self.sampled_s(finger) < rested_s for finger in fingers):
            spoken_s = self._speak(spoken_s)
            self.pause(1 / self.rig.closing.sample_rate_hz)

    def reading(self, finger: HostFinger) -> ArrayReading:
        """Reading of an array that streams, of the last pause."""
        return self._array_guard.reading(finger)

    def sampled_s(self, finger: HostFinger) -> float:
        """Instant up to which, at least, all has been read that an array has sampled."""
        return self._array_guard.sampled_s(finger)

    def take_reading(self, finger: HostFinger) -> ArrayReading:
        """Frames of an array that were not taken before, up to now: for what belongs to a read just made."""
        return self._array_guard.take(finger)

    def take_up_again(self, lost: ArrayLost) -> None:
        """Stop all fingers where they are, and let an array that was lost stream again once it is back.

        Raises `lost` if it does not come back or was lost too often in this run, DeviceError if another
        array is there.
        """
        hold(self.bus, self.states, self._servos)
        self.disarm()
        finger = next(finger for finger in self.fingers if finger.name == lost.finger)
        self._array_guard.stop([other for other in self.fingers if other is not finger])
        moved = self._arrays.reconnect(finger, lost)
        self.notice(f"{lost}; it is back, and the grip is begun again")
        if moved is not None:
            self.notice(moved)
        self.start_arrays()

    def _connect(self, open_port: OpenPort) -> None:
        rig = self.rig
        port = open_port(rig.bus.port, rig.bus.baudrate_bps)
        self._ports.append(port)
        self.bus = Bus(
            port,
            self.clock,
            rig.bus.baudrate_bps,
            latency_s=self._latency_s,
            reopen=lambda: open_port(rig.bus.port, rig.bus.baudrate_bps),
        )
        self.stage = HostStage.of(rig, self.bus)
        mechanisms = [mechanism_of(spec) for spec in rig.fingers]
        drives = [drive_of(mechanism, rig, self.bus) for mechanism in mechanisms]
        self._servos += [*self.stage.servos, *(servo for drive in drives for servo in drive.servos)]
        for servo in self._servos:
            servo.check()
        self._reader = StateReader(self.bus, self._servos)
        # All ports first: boards that reset when their port opens then boot at the same time.
        sampler = StateSampler(self._reader, self.clock)
        arrays = [
            self._arrays.open(spec, open_port)
            if spec.array.has_device
            else CurrentSensor(rig, spec, drive.servos, sampler)
            for spec, drive in zip(rig.fingers, drives, strict=True)
        ]
        self.fingers = tuple(map(self._finger, mechanisms, drives, arrays))
        self.proven |= {finger for finger in self.fingers if not finger.spec.array.has_device}
        self.emulated = any(finger.array.description.emulated for finger in self.fingers)

    def _finger(self, mechanism: Mechanism, drive: Drive, array: ArrayDriver) -> HostFinger:
        described = array.connect()
        if isinstance(array, CurrentSensor):
            extractor: ContactExtractor = CurrentExtractor(described)
        else:
            extractor = extractor_of(self.rig, mechanism.spec, described)
        return HostFinger(mechanism, drive, mechanism.home(self.rig.clear_radius_mm), array, extractor)

    def _after_restart(self, error: Restarted) -> str:
        """Advice about a servo that has lost its turns."""
        for finger in self.fingers:
            if finger.drive.servos[1].dxl_id == error.dxl_ids[0]:
                return finger.mechanism.restart_advice
        return Mechanism.restart_advice

    def _check_start(self, finger: HostFinger, *, is_homed: bool) -> None:
        """Raise DeviceError if a finger stands where it must not start."""
        near, far = (servo.dxl_id for servo in finger.drive.servos)
        at = self.servos_of([finger])[finger]
        wrong = finger.mechanism.start_problem(self.rig.clear_radius_mm, (near, far), at, is_homed=is_homed)
        if wrong is not None:
            raise DeviceError(f"finger {finger.name}: {wrong}")


@dataclass(frozen=True, eq=False)
class Environment:
    """A clock, what opens ports, and what the bus's adapter may add to an answer (s). Nothing else steers.

    `check` raises OutputError if the run should end because its recording has failed. `is_real`: there are
    servos whose torque must not stay on if this program is killed.
    """

    clock: Clock
    open_port: OpenPort
    latency_s: float
    check: Callable[[], None] = lambda: None
    is_real: bool = False

    def hand(self, rig: RigFile, notice: Callable[[str], None] = lambda _: None) -> Hand:
        """The rig's hand, connected; `notice` is told what the operator should do. Raises as `Hand` does."""
        hand = Hand(
            rig, self.clock, self.open_port, latency_s=self.latency_s, notice=notice, check=self.check
        )
        if self.is_real:
            hand.set_dead_man()
        return hand
