"""Examination of servos without moving them: each by itself, and the read loop over all.

Torque stays as it is found, and nothing is written to EEPROM.
"""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace

import numpy as np

from palpate.base.errors import DeviceError, InputError
from palpate.config.diagnosis_results import BusCountsOut, BusLoopOut
from palpate.drivers.dynamixel import (
    RETURN_DELAY_UNIT_S,
    Bus,
    Health,
    ItemChange,
    Model,
    PortFailed,
    Servo,
    ServoState,
    StateReader,
    StatusError,
    differences,
    items_to_compare,
    read_health,
)
from palpate.drivers.transport import Clock
from palpate.rig.diagnostics.steps import DiagnosisCase, NamedDevice, name_servo
from palpate.rig.fingers import ServoSettings, finger_settings, servo_settings, start_problems

_LOOP_S = 1.0
"""How long servos are read over and over."""


def _check_loop(
    bus: Bus, clock: Clock, servos: Sequence[Servo], baudrate: int, return_delays_s: Sequence[float]
) -> tuple[BusLoopOut, dict[int, ServoState]]:
    """Read the state of all servos for a second, as a run does; also the last state of each.

    Raises what the bus raises, for instance of servos without enough indirect addresses.
    """
    reader = StateReader(bus, servos)
    reader.arrange()
    begin = before = clock.now()
    times_s: list[float] = []
    states: dict[int, ServoState] = {}
    while before - begin < _LOOP_S:
        states.update(reader.read(servos).values)
        now = clock.now()
        times_s.append(now - before)
        before = now
    loop = BusLoopOut(
        servos=len(servos),
        cycles=len(times_s),
        fast=reader.is_fast,
        rate_hz=len(times_s) / (before - begin),
        median_ms=float(np.median(times_s)) * 1e3,
        p99_ms=float(np.quantile(times_s, 0.99)) * 1e3,
        wire_ms=reader.wire_time_s(baudrate, return_delays_s) * 1e3,
    )
    return loop, states


def rate_in_run_hz(loop: BusLoopOut, return_delays_s: Sequence[float]) -> float:
    """Rate at which a run can read all servos: it sets their Return Delay Times, here included, to 0."""
    delay_s = max(return_delays_s, default=0.0) if loop.fast else sum(return_delays_s)
    return 1 / max(1 / loop.rate_hz - delay_s, 1e-6)


@dataclass(frozen=True, eq=False)
class ExaminedServo:
    """A servo: its health with its settings beside those that are wanted, and those of a person's beside what
    is expected.

    `health` is None if it could not be read, and `failure` says why: `old` firmware without some item, a
    model `unable` to keep the rig file's limits, or lost answers.
    """

    owner: str
    dxl_id: int
    model: Model
    wanted: Mapping[str, int]
    expected: Mapping[str, int] = field(default_factory=dict)
    firmware: int | None = None
    health: Health | None = None
    failure: str | None = None
    old: bool = False
    unable: bool = False

    @property
    def device(self) -> NamedDevice:
        """The servo as findings call it."""
        return name_servo(self.owner, self.dxl_id)

    @property
    def differing(self) -> list[ItemChange]:
        """Items that the next run writes."""
        return [] if self.health is None else differences(self.health.settings, self.wanted)

    @property
    def foreign(self) -> list[ItemChange]:
        """Items that are not as expected, and that no run writes."""
        return [] if self.health is None else differences(self.health.settings, self.expected)

    def setting(self, item: str) -> int | None:
        """An item's value, None if it was not read or the model has none."""
        return None if self.health is None else self.health.settings.get(item)

    @property
    def return_delay_s(self) -> float:
        """Time that it waits before it answers."""
        return (self.setting("Return Delay Time") or 0) * RETURN_DELAY_UNIT_S


@dataclass(frozen=True, eq=False)
class ExaminedServos:
    """All servos that were examined, and what the bus has been through.

    `loop_failure`: why they could not be read together. `starts`: for each finger whose servos could be read,
    why a run would not start from where it stands.
    """

    servos: tuple[ExaminedServo, ...]
    loop: BusLoopOut | None
    loop_failure: str | None
    counts: BusCountsOut
    starts: Mapping[str, str | None]

    @property
    def lost(self) -> int:
        """Answers that were lost or damaged."""
        return self.counts.damaged + self.counts.silent

    @property
    def delays_s(self) -> list[float]:
        """Time that each servo that could be read waits before it answers."""
        return [item.return_delay_s for item in self.servos if item.health is not None]


def examine_servos(case: DiagnosisCase, sound: frozenset[int]) -> ExaminedServos:
    """Read the servos whose ids are `sound`. Raises DeviceError if the port fails."""
    rate = case.rig.bus.baudrate_bps
    port = case.place.open(rate)
    with closing(Bus(port, case.place.clock, rate, latency_s=case.place.latency_s)) as bus:
        return _read(case, bus, sound)


def _read(case: DiagnosisCase, bus: Bus, sound: frozenset[int]) -> ExaminedServos:
    items = [item for item in servo_settings(case.rig, bus) if item.servo.dxl_id in sound]
    seen = []
    for item in items:
        case.tell(f"servo {item.servo.dxl_id} ({item.owner})")
        seen.append(_examine_servo(bus, item))
    case.tell("reading all servos")
    able = [
        (item.servo, servo)
        for item, servo in zip(items, seen, strict=True)
        if servo.health is not None and not servo.health.hardware_error
    ]
    loop: BusLoopOut | None = None
    loop_failure: str | None = None
    states: Mapping[int, ServoState] = {}
    if able:
        delays = [servo.return_delay_s for _, servo in able]
        try:
            loop, states = _check_loop(
                bus, case.place.clock, [servo for servo, _ in able], case.rig.bus.baudrate_bps, delays
            )
        except PortFailed:
            raise
        except (DeviceError, InputError) as error:
            loop_failure = str(error)
    counts = BusCountsOut(**bus.counts.as_dict())
    return ExaminedServos(
        tuple(seen),
        loop,
        loop_failure,
        counts,
        start_problems(case.rig, finger_settings(case.rig, bus), states),
    )


def _examine_servo(bus: Bus, item: ServoSettings) -> ExaminedServo:
    servo = item.servo
    seen = ExaminedServo(item.owner, servo.dxl_id, servo.model, {})
    try:
        seen = replace(seen, firmware=servo.check().firmware, model=servo.model)
        wanted = item.limits.eeprom(servo)
    except PortFailed:
        raise
    except InputError as error:
        return replace(seen, failure=str(error), unable=True)
    except DeviceError as error:
        return replace(seen, failure=str(error))
    try:
        expected = items_to_compare(servo)
        health = read_health(bus, servo, [*wanted, *expected])
        return replace(seen, wanted=wanted, expected=expected, health=health)
    except PortFailed:
        raise
    except (InputError, StatusError) as error:  # of an item that it does not have yet
        return replace(seen, failure=str(error), old=True)
    except DeviceError as error:
        return replace(seen, failure=str(error))
