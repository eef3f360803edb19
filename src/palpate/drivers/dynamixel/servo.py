"""Servos in rad, rad/s and A: settings, goals, stopping, torque off, health. Built on `bus`.

Zero is the model's middle tick (2048 of the X series), in extended modes of the turn in which the servo was
powered up: after power-up, a reboot or a change of mode, a servo knows its angle within one turn only.
Positive is the servo's own direction, counter-clockwise seen from the horn. Angles are rounded to the nearest
tick; limits of velocity, acceleration and current are rounded down.

Torque off is a broadcast to all, then confirmed by each. The broadcast needs no answer, so it also works
beside a program that is using the wire; its traffic may spoil a packet, therefore an emergency stop repeats
it. Confirmation reads, and needs exclusive use of the wire. Health is only read; the caller judges it.
"""

import contextlib
import copy
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from palpate.base.errors import DeviceError, InputError, SafetyStop
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE, HardwareError, Item, OperatingMode
from palpate.drivers.dynamixel.errors import (
    DamagedAnswer,
    HardwareAlert,
    NotAnswering,
    NotConfirmed,
    PortFailed,
    ServoError,
    raise_first,
)
from palpate.drivers.dynamixel.models import Model, model_by_name, model_by_number
from palpate.drivers.transport.clock import Clock

_GAINS = ct.GAINS[:5], ct.GAINS[5:]  # each without a gap between addresses
_MAX_GOAL_WRITES = 5  # how often goals are written before they count as refused by the wire


class Servo:
    """One servo on a bus."""

    def __init__(
        self,
        bus: Bus,
        dxl_id: int,
        model: str = "XM430-W350",
        *,
        range_rad: tuple[float, float] = (-math.pi, math.pi - ct.RAD_PER_TICK),
        homing_offset: int = 0,
    ) -> None:
        """`range_rad`: the angles (lowest, highest) that may be commanded.

        The default is the turn of Position Control Mode. `homing_offset`: Homing Offset that angles are meant
        with. Raises InputError for an unknown model.
        """
        self.dxl_id = dxl_id
        self.model: Model = model_by_name(model)
        self.range_rad = range_rad
        self.homing_offset = homing_offset
        self.turns = 0
        """Whole turns that Present Position is ahead of `range_rad`'s angles; homing finds them."""
        self._bus = bus

    @property
    def zero_tick(self) -> int:
        """Present Position at 0 rad, in the turn that the servo counts in."""
        return self.model.zero_tick + self.turns * round(2 * math.pi / self.model.rad_per_tick)

    def with_range(self, range_rad: tuple[float, float]) -> "Servo":
        """The same servo for a move that may go further, such as homing against a hard stop."""
        other = copy.copy(self)
        other.range_rad = range_rad
        return other

    def check(self) -> Ping:
        """Ping, and take note of the firmware; see to it that the servo answers.

        Raises NotAnswering, or DeviceError if the servo is of another model.
        """
        answer = self._bus.ping(self.dxl_id)
        if answer.model_number != self.model.number:
            raise ServoError(
                [self.dxl_id],
                self._bus.port_name,
                f"servo {self.dxl_id} on {self._bus.port_name} answers as "
                f"{_model_label(answer.model_number)} (model number {answer.model_number}), "
                f"not {self.model.name}; check ids and `model` in the rig file",
            )
        self.model = model_by_name(self.model.name, answer.firmware)
        level = self.item("Status Return Level")
        self._bus.sync_write(level, {self.dxl_id: ct.ANSWERS_ALL})  # unasked: it may answer pings alone
        try:
            quiet = self._bus.read(self.dxl_id, level, alert=False) < ct.ANSWERS_ALL
        except NotAnswering:
            quiet = True  # it answers pings alone
        if quiet:
            self._bus.write_unconfirmed(self.dxl_id, level, ct.ANSWERS_ALL)
            self._bus.read(self.dxl_id, level, alert=False)
        return answer

    def item(self, name: str) -> Item:
        """Item of this model's table. Raises InputError if it has none of that name."""
        return self.model.item(name)

    def read(self, name: str) -> int:
        """Read an item by its e-Manual name."""
        return self._bus.read(self.dxl_id, self.item(name))

    def write(self, name: str, value: int) -> None:
        """Write an item by its e-Manual name. Raises ValueError for a value that the model does not take."""
        self.model.check(name, value)
        self._bus.write(self.dxl_id, self.item(name), value)

    def ensure(self, name: str, value: int) -> bool:
        """See to it that an item has a value, and read it back; True if it had to be written.

        A Velocity Limit above it is left; a hardware error does not keep it from being written. Writes EEPROM
        only if it differs: it wears out. Raises DeviceError if the item does not stay written.
        """
        before = self._bus.read(self.dxl_id, self.item(name), alert=False)
        if before == value or (name == "Velocity Limit" and before > value):
            return False
        with contextlib.suppress(NotConfirmed, HardwareAlert):  # what it holds then says more
            self.write(name, value)
        found = self._bus.read(self.dxl_id, self.item(name), alert=False)
        if found != value:
            raise ServoError(
                [self.dxl_id],
                self._bus.port_name,
                f"servo {self.dxl_id} on {self._bus.port_name} keeps {name} at {found} instead of {value}; "
                "check its firmware",
            )
        return True

    def prepare(self, mode: OperatingMode, current_limit_a: float) -> None:
        """Torque off, then `eeprom` written and read back; items that are right are not written.

        Gains and Goal PWM that are not the e-Manual's are reset: by a change of Operating Mode, because only
        the firmware knows the gains of Current-based Position Control Mode. Raises ValueError for limits that
        the model cannot keep, DeviceError if an item does not stay written.
        """
        wanted = self.eeprom(mode, current_limit_a)
        self.disable_torque()
        if self.read("Operating Mode") == mode and not self._has_usual_gains():
            other = OperatingMode.EXTENDED_POSITION  # it keeps the turns
            self.write("Operating Mode", other if mode is not other else OperatingMode.CURRENT_BASED_POSITION)
        for name, value in wanted.items():
            self.ensure(name, value)

    def _has_usual_gains(self) -> bool:
        table = self.model.table or {}
        for names in _GAINS:
            items = {name: table[name].default for name in names if name in table}
            block = _block_of([self.item(name) for name in items])
            if not _holds_values(self, items, block, self._bus.read(self.dxl_id, block)):
                return False
        return self.read("Goal PWM") == self.read("PWM Limit")

    def eeprom(self, mode: OperatingMode, current_limit_a: float) -> dict[str, int]:
        """Values that `prepare` writes, by item.

        Operating Mode, Current Limit (rounded down), Velocity Limit where it is below the model's, Position
        Limits in Position Control Mode (to `range_rad`), Drive Mode 0 (normal direction, velocity-based
        profile), Return Delay Time 0 and Startup Configuration 0 (torque stays off, RAM is not restored).
        Raises ValueError for limits that the model cannot keep.
        """
        wanted: dict[str, int] = {
            "Return Delay Time": 0,
            "Drive Mode": 0,
            "Operating Mode": int(mode),
            "Current Limit": self.current_units(current_limit_a),
        }
        if mode is OperatingMode.POSITION:
            # a goal inside range_rad is at most half a tick outside of it once it is rounded
            low, high = (
                round(angle / self.model.rad_per_tick) + self.model.zero_tick for angle in self.range_rad
            )
            wanted |= {"Min Position Limit": low, "Max Position Limit": high}
        for name in ("Velocity Limit", "Startup Configuration"):
            if self.model.table is not None and name in self.model.table:
                wanted[name] = self.model.table[name].default
        return wanted

    def set_profile(self, velocity_rad_s: float, acceleration_rad_s2: float) -> None:
        """Set the trapezoid of the next moves, rounded down to the servo's units (0.024 rad/s, 0.37 rad/s²).

        Raises ValueError for values that would round to 0, which the servo takes for "unlimited".
        """
        velocity = _round_down(velocity_rad_s, self.model.velocity_unit_rad_s, "profile velocity")
        acceleration = _round_down(acceleration_rad_s2, ct.ACCELERATION_UNIT_RAD_S2, "profile acceleration")
        wanted = {"Profile Acceleration": acceleration, "Profile Velocity": velocity}
        _write_all(self._bus, {self: wanted}, confirm=True)

    def clear_profile(self) -> None:
        """Follow every goal at once, as streamed goals need it."""
        self.write("Profile Acceleration", 0)
        self.write("Profile Velocity", 0)

    def enable_torque(self) -> None:
        """Switch torque on."""
        self.write("Torque Enable", 1)

    def disable_torque(self) -> None:
        """Switch torque off."""
        self.write("Torque Enable", 0)

    def set_goal_current_a(self, current_a: float) -> None:
        """Set the current of Current Control Mode, or the largest of Current-based Position Control Mode.

        Rounded towards 0. Raises ValueError above the model's largest; the servo refuses more than Current
        Limit.
        """
        units = self.current_units(abs(current_a))
        self.write("Goal Current", int(math.copysign(units, current_a)))

    def nearest_rad(self, angle_rad: float) -> float:
        """The angle in `range_rad` that is nearest: where to hold a servo that stands a little beyond."""
        low, high = self.range_rad
        return min(max(angle_rad, low), high)

    def goal_ticks(self, goal_rad: float) -> int:
        """Goal Position for an angle in `range_rad`; SafetyStop outside it."""
        low, high = self.range_rad
        if not low <= goal_rad <= high:
            raise SafetyStop(
                f"servo {self.dxl_id} on {self._bus.port_name} was to go to {goal_rad:.4f} rad, outside "
                f"its range {low:.4f} … {high:.4f} rad; nothing was sent: "
                "check the plan or the range in the rig file"
            )
        return round(goal_rad / self.model.rad_per_tick) + self.zero_tick

    def arm_watchdog(self, timeout_s: float) -> None:
        """Let the servo stop by itself if it hears nothing for `timeout_s`.

        0.02 … 2.54 s, rounded up to 20 ms; ValueError beyond.

        While it is tripped the servo refuses goals with Data Range Error; `disarm_watchdog` clears it.
        """
        units = math.ceil(timeout_s / ct.WATCHDOG_UNIT_S - 1e-9)
        if not 1 <= units <= 127:
            raise ValueError(f"Bus Watchdog takes 0.02 … 2.54 s, not {timeout_s} s")
        self._bus.write(self.dxl_id, self.item("Bus Watchdog"), units)

    def disarm_watchdog(self) -> None:
        """Switch Bus Watchdog off, and clear it if it has tripped."""
        self._bus.write(self.dxl_id, self.item("Bus Watchdog"), 0)

    def current_units(self, current_a: float) -> int:
        """A current in the model's units, rounded down. ValueError if negative or above the largest."""
        torque = self.model.known_torque
        if not 0 <= current_a <= self.model.largest_current_a * (1 + 1e-9):
            raise ValueError(
                f"a current of {current_a} A is outside 0 … {self.model.largest_current_a:.3f} A "
                f"of a {self.model.name} (servo {self.dxl_id})"
            )
        return min(torque.largest_current, int(current_a / torque.current_unit_a + 1e-6))


def write_goals(bus: Bus, goals_rad: Mapping[Servo, float], *, confirm: bool = False) -> None:
    """Move several servos in one sync write, which servos do not confirm by themselves.

    `confirm`: read the goals back, and write those again that did not arrive. Raises SafetyStop if any goal
    is outside its servo's range, and sends nothing then; NotConfirmed if one does not arrive however often
    it is sent.
    """
    _write_all(
        bus, {servo: {"Goal Position": servo.goal_ticks(rad)} for servo, rad in goals_rad.items()}, confirm
    )


def stop_at(bus: Bus, goals_rad: Mapping[Servo, float]) -> None:
    """Stop several servos at once at the given angles, without a profile, so that none slows down first.

    Confirmed: a stop that gets lost on the wire must not be lost. The profile must be set again before the
    next move. Raises as `write_goals` does.
    """
    wanted = {
        servo: {"Profile Velocity": 0, "Goal Position": servo.goal_ticks(rad)}
        for servo, rad in goals_rad.items()
    }
    _write_all(bus, wanted, confirm=True)


def _write_all(bus: Bus, wanted: Mapping[Servo, Mapping[str, int]], confirm: bool) -> None:
    left = dict(wanted)
    if not left:
        return
    lost: NotAnswering | DamagedAnswer | None = None
    for _ in range(_MAX_GOAL_WRITES):
        for item, values in _group_by_item(left).items():
            bus.sync_write(item, values)
        if not confirm:
            return
        blocks = {servo: _block_of([servo.item(name) for name in items]) for servo, items in left.items()}
        found = bus.bulk_read({servo.dxl_id: block for servo, block in blocks.items()})
        silent = {k: e for k, e in found.errors.items() if isinstance(e, NotAnswering | DamagedAnswer)}
        raise_first([error for dxl_id, error in found.errors.items() if dxl_id not in silent])
        lost = next(iter(silent.values()), lost)
        left = {
            servo: items
            for servo, items in left.items()
            if servo.dxl_id in silent
            or not _holds_values(servo, items, blocks[servo], found.values[servo.dxl_id])
        }
        if not left:
            return
    raise lost or NotConfirmed(
        [servo.dxl_id for servo in left], bus.port_name, list(next(iter(left.values())))
    )


def _group_by_item(wanted: Mapping[Servo, Mapping[str, int]]) -> dict[Item, dict[int, int]]:
    """Values by item and id: models may have an item in different places."""
    found: dict[Item, dict[int, int]] = {}
    for servo, values in wanted.items():
        for name, value in values.items():
            found.setdefault(servo.item(name), {})[servo.dxl_id] = value
    return found


def _block_of(items: Sequence[Item]) -> Item:
    """Items that stand beside each other, as one: all servos are then asked in one instruction."""
    first, end = min(item.address for item in items), max(item.address + item.size for item in items)
    return Item(" and ".join(item.name for item in items), first, end - first)


def _holds_values(servo: Servo, values: Mapping[str, int], block: Item, found: int) -> bool:
    """True if a block that was read has these values."""
    raw = block.encode(found)
    items = {servo.item(name): value for name, value in values.items()}
    return all(
        item.decode(raw[item.address - block.address :][: item.size]) == value
        for item, value in items.items()
    )


def _model_label(model_number: int) -> str:
    try:
        return model_by_number(model_number).name
    except InputError:
        return "unknown model"


def _round_down(value: float, unit: float, what: str) -> int:
    units = int(value / unit + 1e-6) if math.isfinite(value) else 0
    if not 1 <= units <= 32767:
        raise ValueError(f"{what} {value} is outside {unit:.4f} … {32767 * unit:.1f}")
    return units


_INPUT_VOLTAGE_UNIT_V = 0.1


@dataclass(frozen=True, slots=True)
class Health:
    """Condition that a servo reports. `settings`: the values of the items that were asked for."""

    voltage_v: float
    voltage_limits_v: tuple[float, float]
    temperature_c: int
    temperature_limit_c: int
    hardware_error: HardwareError
    torque_on: bool
    settings: Mapping[str, int]

    @property
    def outside_limits(self) -> HardwareError:
        """Errors whose cause is there now: a voltage or a temperature outside the servo's own limits."""
        low, high = self.voltage_limits_v
        hot = self.temperature_c >= self.temperature_limit_c
        found = HardwareError.OVERHEATING if hot else HardwareError(0)
        return found if low <= self.voltage_v <= high else found | HardwareError.INPUT_VOLTAGE


def read_health(bus: Bus, servo: Servo, items: Iterable[str] = ()) -> Health:
    """Ask a servo whose firmware is known already (`Servo.check`). Raises what the bus raises."""

    def read(name: str) -> int:
        return bus.read(servo.dxl_id, servo.item(name), alert=False)

    low, high = read("Min Voltage Limit"), read("Max Voltage Limit")
    return Health(
        voltage_v=read("Present Input Voltage") * _INPUT_VOLTAGE_UNIT_V,
        voltage_limits_v=(low * _INPUT_VOLTAGE_UNIT_V, high * _INPUT_VOLTAGE_UNIT_V),
        temperature_c=read("Present Temperature"),
        temperature_limit_c=read("Temperature Limit"),
        hardware_error=bus.hardware_error(servo.dxl_id),
        torque_on=bool(read("Torque Enable")),
        settings=read_items(bus, servo, items),
    )


def read_items(bus: Bus, servo: Servo, items: Iterable[str]) -> dict[str, int]:
    """The values of some items, also of a servo that reports a hardware error."""
    return {name: bus.read(servo.dxl_id, servo.item(name), alert=False) for name in items}


_BROADCAST_PAUSE_S = (
    0.013  # no multiple of a usual loop's period, so that not every packet meets the same traffic
)
_TORQUE_OFF_ROUNDS = 4


def disable_torque(bus: Bus, servos: Iterable[Servo]) -> list[DeviceError]:
    """Switch torque off on every servo, each by itself whatever happens to the others.

    One broadcast to all servos on the wire comes first; then each is asked to confirm, and one that does not
    is written again, with the others in between. Returns one error for every servo whose torque may still be
    on. A servo that confirms while it reports a hardware error is off, and is not listed.
    """
    with contextlib.suppress(DeviceError):  # a port that fails here is reported by what follows
        bus.broadcast_torque_off()
    failed: dict[Servo, DeviceError | None] = dict.fromkeys(servos)
    for _ in range(_TORQUE_OFF_ROUNDS):
        tried = {servo: _write_off(bus, servo.dxl_id, servo.item("Torque Enable")) for servo in failed}
        failed = {servo: error for servo, error in tried.items() if error is not None}
    return [error for error in failed.values() if error is not None]


def broadcast_torque_off(bus: Bus, clock: Clock, times: int) -> None:
    """Broadcast torque off `times` times. Reads nothing. Raises PortFailed."""
    for _ in range(times):
        bus.broadcast_torque_off()
        clock.sleep(_BROADCAST_PAUSE_S)


def confirm_torque_off(bus: Bus, dxl_ids: Iterable[int]) -> dict[int, DeviceError | None]:
    """Write Torque Enable 0 to every servo and read it back; by id None if torque is off, else why not.

    Each by itself, whatever happens to the others; one that does not answer is asked again last.
    """
    asked = list(dxl_ids)
    with contextlib.suppress(DeviceError):  # one that is set to answer pings alone confirms nothing
        bus.sync_write(ct.ITEMS["Status Return Level"], dict.fromkeys(asked, ct.ANSWERS_ALL))
    found = {dxl_id: _read_off(bus, dxl_id) for dxl_id in asked}
    for _ in range(_TORQUE_OFF_ROUNDS - 1):
        for dxl_id, problem in found.items():
            if problem is not None and not isinstance(problem, PortFailed):
                found[dxl_id] = _read_off(bus, dxl_id)
    return found


def _write_off(bus: Bus, dxl_id: int, item: Item) -> DeviceError | None:
    """Problem that may have left torque on."""
    try:
        bus.write(dxl_id, item, 0)
    except HardwareAlert as alert:
        return None if alert.carried_out else alert
    except DeviceError as error:
        return error
    return None


def _read_off(bus: Bus, dxl_id: int) -> DeviceError | None:
    """The same, confirmed by reading."""
    problem = _write_off(bus, dxl_id, TORQUE_ENABLE)
    if problem is not None:
        return problem
    try:
        on = bus.read(dxl_id, TORQUE_ENABLE, alert=False)
    except DeviceError as error:
        return error
    return DeviceError(f"servo {dxl_id} on {bus.port_name} says that its torque is on") if on else None
