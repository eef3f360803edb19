"""Doctor, servos: reads each sound servo once, and all of them over and over. Judged in `doctor_servo_steps`.

Nothing is written to EEPROM, and torque stays as it is.
"""

from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace

from palpate.base.errors import DeviceError, InputError
from palpate.config.check_result import LoopOut
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import RETURN_DELAY_UNIT_S
from palpate.drivers.dynamixel.errors import PortFailed, StatusError
from palpate.drivers.dynamixel.health import Health, read_health
from palpate.drivers.dynamixel.models import Model
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.dynamixel.state import ServoState
from palpate.rig.diagnostics.doctor_steps import Case
from palpate.rig.diagnostics.servo_check import check_loop
from palpate.rig.servo_settings import ServoSettings, finger_settings, servo_settings
from palpate.rig.wiring import start_problem

__all__ = ["EXTRA_ITEMS", "ServoSeen", "ServosSeen", "look_at_servos"]

EXTRA_ITEMS = ("Homing Offset", "Secondary(Shadow) ID", "Shutdown")
"""Items that runs do not write, and that can spoil them."""


@dataclass(frozen=True, eq=False)
class ServoSeen:
    """A servo: its health with its settings beside those that are wanted.

    `health` is None if it could not be read, and `failure` says why: `old` firmware without some item, a
    model `unable` to keep the rig file's limits, or lost answers.
    """

    owner: str
    dxl_id: int
    model: Model
    wanted: Mapping[str, int]
    firmware: int | None = None
    health: Health | None = None
    failure: str | None = None
    old: bool = False
    unable: bool = False

    @property
    def name(self) -> str:
        """How findings call it."""
        return f"servo {self.dxl_id} ({self.owner})"

    @property
    def differing(self) -> dict[str, tuple[int, int]]:
        """Items that are not as they are wanted: found and wanted."""
        if self.health is None:
            return {}
        found = self.health.settings
        return {name: (found[name], value) for name, value in self.wanted.items() if found[name] != value}

    def setting(self, item: str) -> int | None:
        """An item's value, None if it was not read or the model has none."""
        return None if self.health is None else self.health.settings.get(item)

    @property
    def return_delay_s(self) -> float:
        """How long it waits before it answers."""
        return (self.setting("Return Delay Time") or 0) * RETURN_DELAY_UNIT_S


@dataclass(frozen=True, eq=False)
class ServosSeen:
    """All servos that were looked at. `lost`: answers lost or damaged, of `asked` questions.
    `starts`: for each finger whose servos could be read, why a run would not start from where it stands.
    `failure` of the bus as a whole; then nothing else is known.
    """

    servos: tuple[ServoSeen, ...]
    states: Mapping[int, ServoState]
    loop: LoopOut | None
    asked: int
    lost: int
    stale: int
    starts: Mapping[str, str | None]
    failure: str | None = None


def look_at_servos(case: Case, sound: frozenset[int]) -> ServosSeen:
    """Read the servos whose ids are `sound`."""
    rate = case.rig.bus.baudrate_bps
    try:
        port = case.place.open(rate)
        with closing(Bus(port, case.place.clock, rate, latency_s=case.place.latency_s)) as bus:
            return _read(case, bus, sound)
    except DeviceError as error:
        return ServosSeen((), {}, None, 0, 0, 0, {}, str(error))


def _read(case: Case, bus: Bus, sound: frozenset[int]) -> ServosSeen:
    items = [item for item in servo_settings(case.rig, bus) if item.servo.dxl_id in sound]
    seen = []
    for item in items:
        case.tell(f"servo {item.servo.dxl_id} ({item.owner})")
        seen.append(_look(bus, item))
    case.tell("reading all servos")
    able = [
        (item.servo, servo)
        for item, servo in zip(items, seen, strict=True)
        if servo.health is not None and not servo.health.hardware_error
    ]
    loop: LoopOut | None = None
    states: Mapping[int, ServoState] = {}
    if able:
        delays = [servo.return_delay_s for _, servo in able]
        try:
            loop, states = check_loop(
                bus, case.place.clock, [servo for servo, _ in able], case.rig.bus.baudrate_bps, delays
            )
        except PortFailed:
            raise
        except (DeviceError, InputError):  # what was lost is counted
            pass
    counts = bus.counts
    return ServosSeen(
        tuple(seen),
        states,
        loop,
        counts.instructions,
        counts.damaged + counts.silent,
        counts.stale,
        _starts(case, bus, states),
    )


def _starts(case: Case, bus: Bus, states: Mapping[int, ServoState]) -> dict[str, str | None]:
    starts: dict[str, str | None] = {}
    for finger in finger_settings(case.rig, bus):
        near, far = (item.servo for item in finger.servos)
        if near.dxl_id in states and far.dxl_id in states:
            at = states[near.dxl_id].position_rad, states[far.dxl_id].position_rad
            starts[finger.spec.name] = start_problem(finger.spec, case.rig, (near, far), at)
    return starts


def _look(bus: Bus, item: ServoSettings) -> ServoSeen:
    servo = item.servo
    seen = ServoSeen(item.owner, servo.dxl_id, servo.model, {})
    try:
        seen = replace(seen, firmware=servo.check().firmware, model=servo.model)
        wanted = item.eeprom()
    except PortFailed:
        raise
    except InputError as error:
        return replace(seen, failure=str(error), unable=True)
    except DeviceError as error:
        return replace(seen, failure=str(error))
    try:
        return replace(seen, wanted=wanted, health=_health(bus, servo, wanted))
    except PortFailed:
        raise
    except (InputError, StatusError) as error:  # of an item that it does not have yet
        return replace(seen, failure=str(error), old=True)
    except DeviceError as error:
        return replace(seen, failure=str(error))


def _health(bus: Bus, servo: Servo, wanted: Mapping[str, int]) -> Health:
    there = [name for name in EXTRA_ITEMS if name in servo.model.items]
    return read_health(bus, servo, [*wanted, *there])
