"""Firmware of an emulated servo: effects of reads, writes and time, and its protective shutdowns.

Used by `servo`, the interface to packets, mechanics and wire. `servo_table` checks addresses and values;
this module contains everything that depends on the servo's state. Protection is checked at every step:
overload, overheating, a supply voltage outside its limits. The e-Manual gives the limits ("Shutdown",
"Temperature Limit", "Min/Max Voltage Limit"), but not the duration of an overload or how a servo warms up.
Those are estimates.
"""

from collections.abc import Sequence
from itertools import chain, repeat

from palpate.drivers.dynamixel.control_table import GAINS, Access, Area, OperatingMode, TableItem
from palpate.drivers.dynamixel.models import ServoSpecification
from palpate.drivers.dynamixel.packet import StatusErrorCode
from palpate.drivers.emulators.servo_drive import (
    GOAL_OF_MODE,
    REVERSE,
    TORQUE_ON_BY_GOAL,
    ServoDrive,
)
from palpate.drivers.emulators.servo_motion import ShaftMotion
from palpate.drivers.emulators.servo_table import ControlTable, Refused

# bits of Hardware Error Status and Shutdown
INPUT_VOLTAGE_BIT = 0x01
OVERHEATING_BIT = 0x04
ENCODER_BIT = 0x08
ELECTRICAL_SHOCK_BIT = 0x10
OVERLOAD_BIT = 0x20

# The manual calls overload "persistent load that exceeds maximum output" and gives no numbers.
_OVERLOAD_FRACTION = 0.8  # of the stall current
_OVERLOAD_S = 1.0
_CHECK_PERIOD_S = 0.1  # temperature and voltage are looked at this often

# One lump that copper losses warm and air cools: 100 K above the air with the stall current for ever.
_AMBIENT_C = 30.0
_STALL_RISE_K = 100.0
_COOLING_TIME_CONSTANT_S = 120.0


class Protection:
    """Watches current, temperature and supply. `temperature_c` and `supply_v` may be set from outside."""

    def __init__(self, model: ServoSpecification, table: ControlTable) -> None:
        self.temperature_c = _AMBIENT_C
        self.supply_v = model.nominal_v
        self._table = table
        self._stall_a = model.motor.stall_current_a
        self._overload_a = _OVERLOAD_FRACTION * self._stall_a
        self._overloaded_s = 0.0
        self._since_look_s = 0.0
        self._charge = 0.0  # A²·s since the last look

    def forget_overload(self) -> None:
        """Begin anew to count how long an overload lasts."""
        self._overloaded_s = 0.0

    def watch(self, dt_s: float, current_a: float, *, driven: bool) -> int:
        """Let `dt_s` pass at a motor current; the bits of Hardware Error Status that it sets."""
        bits = 0
        if driven:
            self._charge += current_a * current_a * dt_s
            if current_a >= self._overload_a or current_a <= -self._overload_a:
                self._overloaded_s += dt_s
                if self._overloaded_s >= _OVERLOAD_S:
                    self._overloaded_s = 0.0
                    bits = OVERLOAD_BIT
            else:
                self._overloaded_s = 0.0
        self._since_look_s += dt_s
        if self._since_look_s >= _CHECK_PERIOD_S:
            bits |= self._look()
        return bits

    def quiet_steps(self, dt_s: float, *, driven: bool) -> int:
        """Number of steps of `dt_s` that `watch_all` may take at once: only the last can set a bit."""
        left_s = _CHECK_PERIOD_S - self._since_look_s
        if driven:
            left_s = min(left_s, _OVERLOAD_S - self._overloaded_s)
        return max(int(left_s / dt_s), 1)

    def watch_all(
        self, dt_s: float, steps: int, currents: Sequence[float], last_a: float, *, driven: bool
    ) -> int:
        """So many times `watch`, within `quiet_steps`: at `currents` (A), and at `last_a` after them."""
        bits = 0
        if driven:
            charge, overloaded_s, most_a = self._charge, 0.0, self._overload_a
            for current_a in currents:
                charge += current_a * current_a * dt_s
            self._charge = _repeated_sum(charge, last_a * last_a * dt_s, steps - len(currents))
            if abs(last_a) >= most_a or max(map(abs, currents), default=0.0) >= most_a:
                overloaded_s = self._overloaded_s
                for current_a in chain(currents, repeat(last_a, steps - len(currents))):
                    overloaded_s = overloaded_s + dt_s if abs(current_a) >= most_a else 0.0
            if overloaded_s >= _OVERLOAD_S:
                overloaded_s, bits = 0.0, OVERLOAD_BIT
            self._overloaded_s = overloaded_s
        self._since_look_s = _repeated_sum(self._since_look_s, dt_s, steps)
        if self._since_look_s >= _CHECK_PERIOD_S:
            bits |= self._look()
        return bits

    def _look(self) -> int:
        load = self._charge / self._since_look_s / self._stall_a**2
        rise = _STALL_RISE_K * load - (self.temperature_c - _AMBIENT_C)
        self.temperature_c += rise * self._since_look_s / _COOLING_TIME_CONSTANT_S
        self._since_look_s = self._charge = 0.0
        table = self._table
        bits = OVERHEATING_BIT if round(self.temperature_c) > table.get("Temperature Limit") else 0
        low, high = table.get("Min Voltage Limit"), table.get("Max Voltage Limit")
        return bits | (0 if low <= round(10 * self.supply_v) <= high else INPUT_VOLTAGE_BIT)


def _repeated_sum(value: float, step: float, times: int) -> float:
    """`value` after so many steps, rounded at each of them."""
    for _ in range(times):
        value += step
    return value


BOOT_S = 0.3
"""How long a servo is deaf after a reboot; not in the manual."""

_WATCHDOG_UNIT = 0.020  # s
_EXTENDED_RANGE = 1_048_575
_BUS_WATCHDOG_ERROR = -1
_STARTUP_TORQUE_ON, _STARTUP_RAM_RESTORE = 0x01, 0x02  # bits of Startup Configuration

_LIMIT_OF_GOAL = {
    "Goal PWM": "PWM Limit",
    "Goal Current": "Current Limit",
    "Goal Velocity": "Velocity Limit",
}
_BACKED_UP_RAM = {*GAINS, "Profile Acceleration", "Profile Velocity"}
_GOALS = {*_LIMIT_OF_GOAL, "Goal Position"}
_DRIVE_SETTINGS = _GOALS | {
    "Drive Mode",
    "Position D Gain",
    "Position I Gain",
    "Position P Gain",
    "Feedforward 1st Gain",
    "Velocity I Gain",
    "Velocity P Gain",
    "PWM Limit",
    "Current Limit",
    "Velocity Limit",
    "Profile Velocity",
    "Profile Acceleration",
}


class ServoUnit:
    """A servo without its wire. `deaf_s`: how long it will not listen, because it boots."""

    def __init__(self, model: ServoSpecification, firmware: int, motion: ShaftMotion) -> None:
        """Factory-new and not yet started: call `start`."""
        self.model = model
        self.motion = motion
        self.table = ControlTable(model.items(firmware))
        self.drive = ServoDrive(self.table, motion, model.current_unit_a)
        self.protection = Protection(model, self.table)
        self._backup: dict[TableItem, int] = {}
        self.extended = firmware >= model.extended_firmware
        self.firmware = firmware
        self.registered: tuple[int, bytes] | None = None
        self.deaf_s = 0.0
        self._silence_s = self._watchdog_s = self._uptime_s = 0.0

    # -- life ---------------------------------------------------------------------------------------------

    def start(self, boot_s: float = 0.0) -> None:
        """Begin as after a reboot, deaf for `boot_s`: RAM at its defaults, torque off, turns forgotten."""
        self.table.reset_ram()
        self.motion.release()
        self.deaf_s = boot_s
        self._uptime_s = self._silence_s = self._watchdog_s = 0.0
        self.protection.forget_overload()
        self.registered = None
        self.drive.power_up()
        if "Backup Ready" in self.table:
            self.table.set("Backup Ready", int(self.has_backup))
        if self._startup() & _STARTUP_RAM_RESTORE:
            self._restore(Area.RAM)
            self.drive.configure()
        if boot_s <= 0.0:
            self._finish_boot()

    def factory_reset(self, keep: frozenset[str]) -> None:
        """Put all that can be written back to its defaults, but for the items in `keep`, and reboot."""
        for item in self.table:
            if item.area is Area.EEPROM and item.access is Access.RW and item.name not in keep:
                self.table.reset(item.name)
        self.start(BOOT_S)

    def step(self, dt_s: float, load_nm: float) -> None:
        """Let `dt_s` pass with an outside torque on the shaft."""
        motion = self.motion
        motion.step(dt_s, load_nm)
        self._uptime_s += dt_s
        if self.deaf_s > 0.0:
            self.deaf_s -= dt_s
            if self.deaf_s <= 0.0:
                self._finish_boot()
        driven = motion.driven
        if driven and self._watchdog_s > 0.0:
            self._silence_s += dt_s
            if self._silence_s >= self._watchdog_s:
                self._trip_watchdog()
        bits = self.protection.watch(dt_s, motion.current_a, driven=driven)
        if bits:
            self.report(bits)

    def quiet_steps(self, dt_s: float) -> int:
        """Number of steps of `dt_s` that `run` may take at once: only in the last can more happen than
        motion.
        """
        driven = self.motion.driven
        steps = self.protection.quiet_steps(dt_s, driven=driven)
        if driven and self._watchdog_s > 0.0:
            steps = min(steps, int((self._watchdog_s - self._silence_s) / dt_s))
        if self.deaf_s > 0.0:
            steps = min(steps, int(self.deaf_s / dt_s))
        return max(steps, 1)

    def run(self, dt_s: float, steps: int) -> list[float]:
        """So many times `step` without a load, within `quiet_steps`; returns what `servo.run` does."""
        motion = self.motion
        angles, currents = motion.run(dt_s, steps)
        self._uptime_s = _repeated_sum(self._uptime_s, dt_s, steps)
        if self.deaf_s > 0.0:
            self.deaf_s = _repeated_sum(self.deaf_s, -dt_s, steps)
            if self.deaf_s <= 0.0:
                self._finish_boot()
        driven = motion.driven
        if driven and self._watchdog_s > 0.0:
            self._silence_s = _repeated_sum(self._silence_s, dt_s, steps)
            if self._silence_s >= self._watchdog_s:
                self._trip_watchdog()
        bits = self.protection.watch_all(dt_s, steps, currents, motion.current_a, driven=driven)
        if bits:
            self.report(bits)
        return angles

    def note_packet(self) -> None:
        """Note that an instruction packet passed: Bus Watchdog counts from here."""
        self._silence_s = 0.0

    def report(self, bits: int) -> None:
        """Latch bits of Hardware Error Status until a reboot; torque goes off if Shutdown selects them."""
        self.table.set("Hardware Error Status", self.table.get("Hardware Error Status") | bits)
        self.protection.forget_overload()
        if bits & self.table.get("Shutdown"):
            self.set_torque(on=False)

    def set_torque(self, *, on: bool) -> None:
        """Switch torque, as Torque Enable does."""
        self.table.set("Torque Enable", int(on))
        self.protection.forget_overload()
        self._silence_s = 0.0
        if on:
            self.drive.engage()
        else:
            self.motion.release()

    def _finish_boot(self) -> None:
        if self._startup() & _STARTUP_TORQUE_ON:
            self.set_torque(on=True)

    def _startup(self) -> int:
        return self.table.get("Startup Configuration") if "Startup Configuration" in self.table else 0

    def _trip_watchdog(self) -> None:
        self._watchdog_s = 0.0
        self.table.set("Bus Watchdog", _BUS_WATCHDOG_ERROR)
        self.drive.stop()

    # -- Control Table Backup, page "DYNAMIXEL Protocol 2.0" ------------------------------------------------

    @property
    def has_backup(self) -> bool:
        """True once something is stored: item Backup Ready."""
        return bool(self._backup)

    def back_up(self) -> None:
        """Store all of EEPROM that can be written, and the RAM items that the manual lists.

        It survives power and, though the manual does not say so, Factory Reset.
        """
        self._backup = {
            item: self.table.get(item.name)
            for item in self.table
            if (item.area is Area.EEPROM and item.access is Access.RW)
            or item.name in _BACKED_UP_RAM
            or item.name.startswith("Indirect Address")
        }
        self.table.set("Backup Ready", 1)

    def restore(self) -> None:
        """Put EEPROM back as it was stored, and reboot."""
        self._restore(Area.EEPROM)
        self.start(BOOT_S)

    def _restore(self, area: Area) -> None:
        for item, value in self._backup.items():
            if item.area is area:
                self.table.set(item.name, value)

    # -- memory -------------------------------------------------------------------------------------------

    def read(self, address: int, length: int) -> bytes:
        """Bytes of the control table as they are now; raises Refused."""
        if address + length > 120:
            self.table.show(
                {
                    "Realtime Tick": int(self._uptime_s * 1000) % 32768,
                    "Present Input Voltage": round(10 * self.protection.supply_v),
                    "Present Temperature": max(0, min(255, round(self.protection.temperature_c))),
                }
            )
            self.drive.refresh()
        return self.table.read(address, length)

    def write(self, address: int, data: bytes, *, ram_only: bool = False) -> None:
        """Write items; raises Refused, and then nothing is changed."""
        for item, value in self.check_write(address, data, ram_only=ram_only):
            self._apply(item.name, value)

    def check_write(
        self, address: int, data: bytes, *, ram_only: bool = False
    ) -> list[tuple[TableItem, int]]:
        """Values that a write would set; raises Refused if it may not be carried out now."""
        writes = self.table.parse_write(address, data)
        for item, value in writes:
            if item.area is Area.EEPROM and (ram_only or self.motion.driven):
                raise Refused(StatusErrorCode.ACCESS_ERROR)
            self._check(item, value)
        return writes

    def _check(self, item: TableItem, value: int) -> None:
        name, possible = item.name, True
        if name in _GOALS:
            self._check_goal(name, value)
        elif name == "Bus Watchdog":
            tripped = self.table.get("Bus Watchdog") == _BUS_WATCHDOG_ERROR
            possible = value >= 0 and not (tripped and value != 0)
        elif name == "Operating Mode":
            possible = value in GOAL_OF_MODE
        elif name == "Drive Mode":
            possible = value & ~item.high == 0  # bits that are "unused, always 0"
        elif name == "Protocol Type":
            possible = value in self.model.protocol_types
        elif name == "Torque Enable" and value:
            self._check_torque()
        if not possible:
            raise Refused(StatusErrorCode.DATA_RANGE_ERROR)

    def _check_torque(self) -> None:
        # the manual: a reboot is the only way back; with which error torque is refused it does not say
        if self.table.get("Hardware Error Status") & self.table.get("Shutdown"):
            raise Refused(StatusErrorCode.RESULT_FAIL)

    def _check_goal(self, name: str, value: int) -> None:
        table = self.table
        if "Bus Watchdog" in table and table.get("Bus Watchdog") == _BUS_WATCHDOG_ERROR:
            raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
        if self._switches_on(name):
            self._check_torque()
        if name != "Goal Position":
            if abs(value) > table.get(_LIMIT_OF_GOAL[name]):
                raise Refused(StatusErrorCode.DATA_LIMIT_ERROR)
        elif table.get("Operating Mode") == OperatingMode.POSITION:
            if not table.get("Min Position Limit") <= value <= table.get("Max Position Limit"):
                raise Refused(StatusErrorCode.DATA_LIMIT_ERROR)
        elif abs(value) > _EXTENDED_RANGE:
            raise Refused(StatusErrorCode.DATA_RANGE_ERROR)

    def _switches_on(self, name: str) -> bool:
        """True if writing this goal switches torque on by itself: bit Torque On by Goal Update."""
        table = self.table
        return (
            not self.motion.driven
            and "Drive Mode" in table
            and bool(table.get("Drive Mode") & TORQUE_ON_BY_GOAL)
            and GOAL_OF_MODE[table.get("Operating Mode")] == name
        )

    def _apply(self, name: str, value: int) -> None:
        table, before = self.table, self.table.get(name)
        if name == "Torque Enable":
            self.set_torque(on=bool(value))
            return
        if self._switches_on(name):
            self.set_torque(on=True)
        table.set(name, value)
        if name == "Operating Mode" and value != before:
            self.drive.change_mode()
        elif name == "Drive Mode" and (value ^ before) & REVERSE:
            self.drive.change_direction()
        elif name == "Bus Watchdog":
            self._watchdog_s = value * _WATCHDOG_UNIT
            self._silence_s = 0.0
        elif name == GOAL_OF_MODE[table.get("Operating Mode")]:
            self.drive.command()
        elif name in _DRIVE_SETTINGS:
            self.drive.configure()
