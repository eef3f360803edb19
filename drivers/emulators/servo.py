"""An emulated XM430-W350: control table, instructions and shaft. Knows packets, but neither wire nor clock.

`ServoChain` puts servos on a wire and hands them the packets; the bench physics calls `step` with the torque
that the mechanics put on the shaft. Everything is written from the ROBOTIS e-Manual (pages "DYNAMIXEL
Protocol 2.0" and "XM430-W350"). What the manual leaves open is decided here and said where it is decided.

Acted on: Operating Modes 3, 4 and 5 (others are refused with Data Range Error), Position P Gain, PWM and
Current Limit, Goal PWM, Goal Current, both profile items, position limits, Homing Offset, Status Return
Level, Return Delay Time, Shutdown, Bus Watchdog. Stored but without effect: LED, the other gains, Goal
Velocity, Acceleration Limit, temperature and voltage limits. Clear, Factory Reset, backup and the fast reads
are not known to it (Instruction Error).

Position 2048 is shaft angle 0. At power-up, at a reboot and at a change of mode, the servo knows its angle
within one turn only (0…4095); the turns counted before are lost.
"""

from palpate.drivers.dynamixel.packet import (
    ALERT_BIT,
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    StatusErrorCode,
    StatusPacket,
)
from palpate.drivers.emulators.servo_drive import POSITION_MODE, ServoDrive
from palpate.drivers.emulators.servo_motion import MotorConstants, ShaftMotion
from palpate.drivers.emulators.servo_table import (
    XM430_W350,
    Area,
    ControlTable,
    Refused,
    TableItem,
)

__all__ = ["OVERLOAD_BIT", "EmulatedServo"]

OVERLOAD_BIT = 0x20  # Hardware Error Status, bit 5

_WATCHDOG_UNIT = 0.020  # s
_EXTENDED_RANGE = 1_048_575
_BUS_WATCHDOG_ERROR = -1

# The manual calls overload "persistent load that exceeds maximum output" and gives no numbers.
_OVERLOAD_FRACTION = 0.8  # of the stall current
_OVERLOAD_S = 1.0
_BOOT_S = 0.3  # deaf after a reboot; not in the manual

_ANSWER_LEVEL: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}  # others: 2

_GOALS = {"Goal PWM", "Goal Current", "Goal Velocity", "Goal Position"}
_DRIVE_SETTINGS = _GOALS | {
    "Position P Gain",
    "PWM Limit",
    "Current Limit",
    "Velocity Limit",
    "Profile Velocity",
    "Profile Acceleration",
}


class EmulatedServo:
    """One servo with its memory and shaft."""

    def __init__(
        self,
        dxl_id: int,
        *,
        firmware: int = 44,
        start_rad: float = 0.0,
        baud_rate_code: int = 3,
        constants: MotorConstants | None = None,
    ) -> None:
        """Power up at shaft angle `start_rad` with torque off.

        `baud_rate_code` is what item Baud Rate reads (3 is 1 Mbps); the wire itself sets the speed.
        """
        constants = constants or MotorConstants()
        self._table = ControlTable(XM430_W350)
        self._table.set("ID", dxl_id)
        self._table.set("Firmware Version", firmware)
        self._table.set("Baud Rate", baud_rate_code)
        self._motion = ShaftMotion(constants, start_rad)
        self._drive = ServoDrive(self._table, self._motion)
        self._overload_a = _OVERLOAD_FRACTION * constants.stall_current_a
        self._powered = True
        self._registered: tuple[int, bytes] | None = None
        self._overloaded_s = self._silence_s = self._watchdog_s = self._uptime_s = self._boot_left_s = 0.0
        self._start_up()

    # -- the mechanics' side ------------------------------------------------------------------------------

    @property
    def shaft_rad(self) -> float:
        """True angle of the output shaft in rad, turns counted, free of encoder steps."""
        return self._motion.shaft_rad

    @property
    def shaft_rad_s(self) -> float:
        """True angular velocity of the output shaft in rad/s."""
        return self._motion.velocity_rad_s

    def step(self, dt_s: float, load_nm: float) -> None:
        """Let `dt_s` pass with an outside torque on the shaft; positive pushes towards +position."""
        motion = self._motion
        motion.step(dt_s, load_nm)
        self._uptime_s += dt_s
        if self._boot_left_s > 0.0:
            self._boot_left_s -= dt_s
        if motion.driven:
            if self._watchdog_s > 0.0:
                self._silence_s += dt_s
                if self._silence_s >= self._watchdog_s:
                    self._trip_watchdog()
            current = motion.current_a
            if current >= self._overload_a or current <= -self._overload_a:
                self._overloaded_s += dt_s
                if self._overloaded_s >= _OVERLOAD_S:
                    self.report_hardware_error(OVERLOAD_BIT)
            else:
                self._overloaded_s = 0.0

    def report_hardware_error(self, bits: int) -> None:
        """Latch bits of Hardware Error Status until a reboot; torque goes off if Shutdown selects them.

        The servo's own protection calls it; so may a test, for causes that are not simulated.
        """
        self._table.set("Hardware Error Status", self._table.get("Hardware Error Status") | bits)
        self._overloaded_s = 0.0
        if bits & self._table.get("Shutdown"):
            self._set_torque(on=False)

    def power_off(self) -> None:
        """Cut the supply: no torque and no answers."""
        self._powered = False
        self._motion.release()

    def power_on(self) -> None:
        """Restore the supply; the servo starts as after a reboot."""
        self._powered = True
        self._start_up()

    # -- the wire's side ----------------------------------------------------------------------------------

    @property
    def dxl_id(self) -> int:
        """The ID that the servo answers to."""
        return self._table.get("ID")

    @property
    def listening(self) -> bool:
        """False without supply and while starting up."""
        return self._powered and self._boot_left_s <= 0.0

    @property
    def return_delay_s(self) -> float:
        """Time between the end of an instruction and the start of the answer."""
        return self._table.get("Return Delay Time") * 2e-6

    def heard(self) -> None:
        """Note that an instruction packet passed on the bus, whoever it was for; feeds Bus Watchdog."""
        self._silence_s = 0.0

    def handle(self, packet: InstructionPacket) -> StatusPacket | None:
        """Carry out an instruction for this servo or for all; return the answer it gives, if any."""
        code = StatusErrorCode.NONE
        params = b""
        try:
            params = self._carry_out(packet)
        except Refused as refusal:
            code = refusal.code
        level = self._table.get("Status Return Level")
        needed = _ANSWER_LEVEL.get(packet.instruction, 2)
        if level < needed or (packet.dxl_id == BROADCAST_ID and packet.instruction != Instruction.PING):
            return None
        return self._status(code, params)

    def answer_block(self, address: int, length: int) -> StatusPacket | None:
        """Answer this servo's part of a sync or bulk read; None if Status Return Level forbids it."""
        if self._table.get("Status Return Level") < 1:
            return None
        try:
            return self._status(StatusErrorCode.NONE, self._read(address, length))
        except Refused as refusal:
            return self._status(refusal.code, b"")

    def take_block(self, address: int, data: bytes) -> None:
        """Carry out this servo's part of a sync or bulk write, which is never answered."""
        try:
            self._write(address, data)
        except Refused:
            return

    # -- instructions -------------------------------------------------------------------------------------

    def _status(self, code: StatusErrorCode, params: bytes) -> StatusPacket:
        alert = ALERT_BIT if self._table.get("Hardware Error Status") else 0
        return StatusPacket(self.dxl_id, alert | code, params)

    def _carry_out(self, packet: InstructionPacket) -> bytes:
        params = packet.params
        match packet.instruction:
            case Instruction.PING:
                return self._read(0, 2) + self._read(6, 1)
            case Instruction.READ:
                if len(params) != 4:
                    raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
                return self._read(_word(params, 0), _word(params, 2))
            case Instruction.WRITE:
                self._write(*_split_write(params))
            case Instruction.REG_WRITE:
                address, data = _split_write(params)
                self._check(self._table.parse_write(address, data))
                self._registered = (address, data)
                self._table.set("Registered Instruction", 1)
            case Instruction.ACTION:
                if self._registered is None:
                    raise Refused(StatusErrorCode.INSTRUCTION_ERROR)
                address, data = self._registered
                self._registered = None
                self._table.set("Registered Instruction", 0)
                self._write(address, data)
            case Instruction.REBOOT:
                self._motion.release()
                self._start_up(boot_s=_BOOT_S)
            case _:
                raise Refused(StatusErrorCode.INSTRUCTION_ERROR)
        return b""

    def _read(self, address: int, length: int) -> bytes:
        if address + length > 120:
            self._table.set("Realtime Tick", int(self._uptime_s * 1000) % 32768)
            self._drive.refresh()
        return self._table.read(address, length)

    def _write(self, address: int, data: bytes) -> None:
        writes = self._table.parse_write(address, data)
        self._check(writes)
        for item, value in writes:
            self._apply(item.name, value)

    def _check(self, writes: list[tuple[TableItem, int]]) -> None:
        """Refuse what depends on the servo's state; a refused packet changes nothing."""
        for item, value in writes:
            if item.area is Area.EEPROM and self._motion.driven:
                raise Refused(StatusErrorCode.ACCESS_ERROR)
            if item.name in _GOALS:
                self._check_goal(item.name, value)
            elif item.name == "Bus Watchdog":
                tripped = self._table.get("Bus Watchdog") == _BUS_WATCHDOG_ERROR
                if value < 0 or (tripped and value != 0):
                    raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
            elif item.name == "Baud Rate" and value != self._table.get("Baud Rate"):
                raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
            elif item.name == "Torque Enable" and value and self._is_shut_down():
                raise Refused(StatusErrorCode.RESULT_FAIL)

    def _is_shut_down(self) -> bool:
        # the manual: a reboot is the only way back; with which error torque is refused it does not say
        return bool(self._table.get("Hardware Error Status") & self._table.get("Shutdown"))

    def _check_goal(self, name: str, value: int) -> None:
        table = self._table
        if table.get("Bus Watchdog") == _BUS_WATCHDOG_ERROR:
            raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
        if name == "Goal Position":
            if table.get("Operating Mode") == POSITION_MODE:
                if not table.get("Min Position Limit") <= value <= table.get("Max Position Limit"):
                    raise Refused(StatusErrorCode.DATA_LIMIT_ERROR)
            elif abs(value) > _EXTENDED_RANGE:
                raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
            return
        limit = {"Goal PWM": "PWM Limit", "Goal Current": "Current Limit", "Goal Velocity": "Velocity Limit"}
        if abs(value) > table.get(limit[name]):
            raise Refused(StatusErrorCode.DATA_LIMIT_ERROR)

    def _apply(self, name: str, value: int) -> None:
        table = self._table
        if name == "Torque Enable":
            self._set_torque(on=bool(value))
            return
        if name == "Operating Mode" and value != table.get(name):
            table.set(name, value)
            self._drive.reset_for_mode()
            return
        table.set(name, value)
        if name == "Bus Watchdog":
            self._watchdog_s = value * _WATCHDOG_UNIT
            self._silence_s = 0.0
        elif name == "Goal Position":
            self._drive.move_to(value)
        elif name in _DRIVE_SETTINGS:
            self._drive.configure()

    # -- state --------------------------------------------------------------------------------------------

    def _start_up(self, boot_s: float = 0.0) -> None:
        self._table.reset_ram()
        self._motion.release()
        self._boot_left_s = boot_s
        self._uptime_s = 0.0
        self._silence_s = 0.0
        self._watchdog_s = 0.0
        self._overloaded_s = 0.0
        self._registered = None
        self._drive.reset_for_mode()

    def _set_torque(self, *, on: bool) -> None:
        self._table.set("Torque Enable", int(on))
        self._overloaded_s = 0.0
        self._silence_s = 0.0
        if on:
            self._drive.engage()
        else:
            self._motion.release()

    def _trip_watchdog(self) -> None:
        self._watchdog_s = 0.0
        self._table.set("Bus Watchdog", _BUS_WATCHDOG_ERROR)
        self._drive.stop()


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _split_write(params: bytes) -> tuple[int, bytes]:
    if len(params) < 3:
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    return _word(params, 0), params[2:]
