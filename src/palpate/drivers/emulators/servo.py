"""Emulated servo of the X series, or of a plug-in: handles packets, and is independent of wire and clock.

`ServoChain` puts servos on a wire and hands them the packets; the bench physics calls `step` with the torque
that the mechanics put on the shaft. Everything is written from the ROBOTIS e-Manual (pages "DYNAMIXEL
Protocol 2.0" and those of the models). What the manual leaves open is decided in the modules `servo_…` and
said where it is decided.
"""

from collections.abc import Callable
from dataclasses import replace

from palpate.drivers.dynamixel.control_table import BAUD_RATES, BROADCAST_RESET_FIRMWARE
from palpate.drivers.dynamixel.models import MotorConstants, specification
from palpate.drivers.dynamixel.packet import (
    ALERT_BIT,
    BROADCAST_ID,
    Instruction,
    InstructionPacket,
    StatusErrorCode,
    StatusPacket,
)
from palpate.drivers.emulators.servo_firmware import BOOT_S, ServoUnit
from palpate.drivers.emulators.servo_motion import ShaftMotion
from palpate.drivers.emulators.servo_table import Refused

_SECONDARY_INSTRUCTIONS = frozenset(
    {
        Instruction.WRITE,
        Instruction.REG_WRITE,
        Instruction.ACTION,
        Instruction.REBOOT,
        Instruction.CLEAR,
    }
)
"""What Secondary ID can have carried out: it cannot change EEPROM, and nothing is answered to it."""

_RESET_ALL = 0xFF
_KEPT_BY_RESET: dict[int, frozenset[str]] = {
    _RESET_ALL: frozenset(),
    0x01: frozenset({"ID"}),
    0x02: frozenset({"ID", "Baud Rate"}),
}
_CLEAR_TURNS = bytes.fromhex("01 44 58 4C 22")
_STORE = bytes.fromhex("01 43 54 52 4C")
_RESTORE = bytes.fromhex("02 43 54 52 4C")


def execute(unit: ServoUnit, packet: InstructionPacket, *, secondary: bool = False) -> bytes:
    """Carry out an instruction; returns the answer's parameters. Raises Refused.

    `secondary`: it came to the servo's Secondary ID, which reaches RAM only.
    """
    params = packet.params
    match packet.instruction:
        case Instruction.PING:
            return unit.read(0, 2) + unit.read(6, 1)
        case Instruction.READ:
            if len(params) != 4:
                raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
            return unit.read(_word(params, 0), _word(params, 2))
        case Instruction.WRITE:
            unit.write(*_split_write(params), ram_only=secondary)
        case Instruction.REG_WRITE:
            address, data = _split_write(params)
            unit.check_write(address, data, ram_only=secondary)
            unit.registered = (address, data)
            unit.table.set("Registered Instruction", 1)
        case Instruction.ACTION:
            _act(unit, secondary=secondary)
        case _:
            _change_unit(unit, packet)
    return b""


def _change_unit(unit: ServoUnit, packet: InstructionPacket) -> None:
    """Carry out an instruction that concerns the servo as a whole."""
    match packet.instruction:
        case Instruction.FACTORY_RESET:
            _factory_reset(unit, packet)
        case Instruction.REBOOT:
            unit.start(BOOT_S)
        case Instruction.CLEAR:
            _clear(unit, packet.params)
        case Instruction.CONTROL_TABLE_BACKUP if unit.extended:
            _control_table_backup(unit, packet.params)
        case _:
            raise Refused(StatusErrorCode.INSTRUCTION_ERROR)


def _act(unit: ServoUnit, *, secondary: bool) -> None:
    if unit.registered is None:
        raise Refused(StatusErrorCode.INSTRUCTION_ERROR)
    registered, unit.registered = unit.registered, None
    unit.table.set("Registered Instruction", 0)
    unit.write(*registered, ram_only=secondary)


def _factory_reset(unit: ServoUnit, packet: InstructionPacket) -> None:
    if len(packet.params) != 1:
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    option = packet.params[0]
    if option not in _KEPT_BY_RESET:
        raise Refused(StatusErrorCode.DATA_RANGE_ERROR)
    if option == _RESET_ALL and packet.dxl_id == BROADCAST_ID and unit.firmware >= BROADCAST_RESET_FIRMWARE:
        # a whole bus of servos with ID 1 at 57,600 bps could not be told apart any more
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.factory_reset(_KEPT_BY_RESET[option])


def _clear(unit: ServoUnit, params: bytes) -> None:
    _expect(params, _CLEAR_TURNS)
    if unit.drive.moving:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.drive.clear_turns()


def _control_table_backup(unit: ServoUnit, params: bytes) -> None:
    _expect(params, _STORE, _RESTORE)
    if unit.motion.driven:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    if params == _STORE:
        unit.back_up()
        return
    if not unit.has_backup:
        raise Refused(StatusErrorCode.RESULT_FAIL)
    unit.restore()


def _expect(params: bytes, *allowed: bytes) -> None:
    """Refuse other parameters than these; the manual calls them reserved and names no error."""
    if len(params) != len(allowed[0]):
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    if params not in allowed:
        raise Refused(StatusErrorCode.DATA_RANGE_ERROR)


def _word(params: bytes, at: int) -> int:
    return params[at] | params[at + 1] << 8


def _split_write(params: bytes) -> tuple[int, bytes]:
    if len(params) < 3:
        raise Refused(StatusErrorCode.DATA_LENGTH_ERROR)
    return _word(params, 0), params[2:]


_ANY_STEPS = 1 << 30
_ANSWER_LEVEL: dict[int, int] = {Instruction.PING: 0, Instruction.READ: 1}  # others: 2


class EmulatedServo:
    """One servo with its memory and shaft."""

    def __init__(
        self,
        dxl_id: int,
        *,
        model: str = "XM430-W350",
        firmware: int | None = None,
        start_rad: float = 0.0,
        baud_rate_code: int = 3,
        constants: MotorConstants | None = None,
        homing_offset: int = 0,
    ) -> None:
        """Power up at shaft angle `start_rad` with torque off.

        `homing_offset`: Homing Offset with which it reads 2048 at shaft angle 0.
        `firmware`: Firmware Version, None for the model's usual one. `baud_rate_code`: item Baud Rate, 3 is
        1 Mbps. `constants` replace the model's motor. Raises InputError for an unknown model.
        """
        built = specification(model)
        if constants is not None:
            built = replace(built, motor=constants)
        self._inner = ServoUnit(
            built, built.firmware if firmware is None else firmware, ShaftMotion(built.motor, start_rad)
        )
        self._catch_up: Callable[[], None] | None = None
        self._held_by: Callable[[float, float], float] | None = None
        self._unit.table.set("ID", dxl_id)
        self._unit.table.set("Baud Rate", baud_rate_code)
        self._unit.table.set("Homing Offset", homing_offset)
        self._inner.drive.zero_tick -= homing_offset
        self._powered = True
        self._inner.start()

    @property
    def _unit(self) -> ServoUnit:
        """Memory, drive and protection, as they are now."""
        self.catch_up()
        return self._inner

    # -- the mechanics' side ------------------------------------------------------------------------------

    def lag(self, catch_up: Callable[[], None]) -> None:
        """Let `catch_up` be called before anybody looks at the servo or interferes: mechanics may lag."""
        self._catch_up = catch_up

    def catch_up(self) -> None:
        """Let mechanics that lag behind step to now."""
        if self._catch_up is not None:
            self._catch_up()

    @property
    def motion(self) -> ShaftMotion:
        """The shaft as mechanics have stepped it; `shaft_rad` and `shaft_rad_s` are up to date."""
        return self._inner.motion

    @property
    def shaft_rad(self) -> float:
        """True angle of the output shaft in rad, turns counted, free of encoder steps."""
        return self._unit.motion.shaft_rad

    @property
    def shaft_rad_s(self) -> float:
        """True angular velocity of the output shaft in rad/s."""
        return self._unit.motion.velocity_rad_s

    def step(self, dt_s: float, load_nm: float) -> None:
        """Let `dt_s` pass with an outside torque on the shaft; positive pushes towards +position."""
        if self._held_by is not None:
            load_nm += self._held_by(self._inner.motion.shaft_rad, self._inner.motion.velocity_rad_s)
        if self._powered:
            self._inner.step(dt_s, load_nm)
        else:
            self._inner.motion.step(dt_s, load_nm)

    def hold(self, torque_nm: Callable[[float, float], float] | None) -> None:
        """Let something else act on the shaft from now on, such as a clamp: torque (N·m) by rad and rad/s."""
        self.catch_up()
        self._held_by = torque_nm

    def quiet_steps(self, dt_s: float) -> int:
        """Number of steps of `dt_s` that `run` may take at once; none while something else acts on
        the shaft.
        """
        if self._held_by is not None:
            return 0
        return self._inner.quiet_steps(dt_s) if self._powered else _ANY_STEPS

    def run(self, dt_s: float, steps: int) -> list[float]:
        """So many times `step` without a torque from outside, within `quiet_steps`, and quicker.

        Returns the shaft's angle (rad) after each step, to where it stands still.
        """
        return self._inner.run(dt_s, steps) if self._powered else self._inner.motion.run(dt_s, steps)[0]

    def set_encoder(self, *waves: tuple[float, float]) -> None:
        """Let its encoder be off as `ServoDrive.set_encoder`."""
        self._unit.drive.set_encoder(*waves)

    def read_rad(self, shaft_rad: float) -> float:
        """Angle that its encoder says of the shaft, before it is rounded."""
        return self._unit.drive.read_rad(shaft_rad)

    def angle_rad(self, read_rad: float) -> float:
        """Angle of the shaft of which its encoder says `read_rad`."""
        return self._unit.drive.angle_rad(read_rad)

    def report_hardware_error(self, bits: int) -> None:
        """Latch bits of Hardware Error Status until a reboot; torque goes off if Shutdown selects them.

        The servo's own protection does the same; a test may call it for causes that are not simulated.
        """
        self._unit.report(bits)

    def set_supply(self, volts: float) -> None:
        """Set the voltage at the servo's plug.

        Outside its limits the servo reports it. So low that the controller fails, the servo is off; it
        starts anew when the voltage is back.
        """
        unit = self._unit
        unit.protection.supply_v = volts
        if volts < unit.model.brown_out_v:
            self.power_off()
            return
        unit.motion.set_supply(volts / unit.model.nominal_v)
        if not self._powered:
            self._powered = True
            unit.start(BOOT_S)

    @property
    def nominal_v(self) -> float:
        """Recommended supply of its model."""
        return self._inner.model.nominal_v

    @property
    def motor_power_w(self) -> float:
        """Power that the motor takes from the supply now, W."""
        motion = self._inner.motion
        volts = self._inner.protection.supply_v
        return abs(motion.duty * motion.current_a) * volts if self._powered else 0.0

    def set_temperature(self, celsius: float) -> None:
        """Set the temperature inside; it goes on from there with what the motor heats."""
        self._unit.protection.temperature_c = celsius

    def power_off(self) -> None:
        """Cut the supply: no torque and no answers."""
        self._unit.motion.release()
        self._powered = False

    def power_on(self) -> None:
        """Restore the supply; the servo starts as after a reboot."""
        self._unit.start()
        self._powered = True

    # -- the wire's side ----------------------------------------------------------------------------------

    @property
    def dxl_id(self) -> int:
        """The ID that the servo answers to."""
        return self._inner.table.get("ID")

    @property
    def baudrate(self) -> int:
        """The rate in bps that the servo understands."""
        return BAUD_RATES[self._inner.table.get("Baud Rate")]

    @property
    def listening(self) -> bool:
        """False without supply and while starting up."""
        return self._unit.deaf_s <= 0.0 and self._powered

    @property
    def return_delay_s(self) -> float:
        """Time between the end of an instruction and the start of the answer."""
        return self._inner.table.get("Return Delay Time") * 2e-6

    def note_packet(self) -> None:
        """Note that an instruction packet passed on the bus, whoever it was for; feeds Bus Watchdog."""
        self._unit.note_packet()

    def handle(self, packet: InstructionPacket) -> StatusPacket | None:
        """Carry out an instruction if it is for this servo or for all; return the answer it gives, if any.

        The answer has the ID that was asked, even if the instruction changed it: clients wait for that one.
        """
        dxl_id = self.dxl_id
        if packet.dxl_id not in (dxl_id, BROADCAST_ID):
            self._handle_as_secondary(packet)
            return None
        code = StatusErrorCode.NONE
        params = b""
        try:
            params = execute(self._unit, packet)
        except Refused as refusal:
            code = refusal.code
        needed = _ANSWER_LEVEL.get(packet.instruction, 2)
        if self._level < needed or (packet.dxl_id == BROADCAST_ID and packet.instruction != Instruction.PING):
            return None
        return StatusPacket(dxl_id, self._alert | code, params)

    def answer_damaged(self) -> StatusPacket | None:
        """Answer an instruction whose CRC was wrong; None if Status Return Level forbids it."""
        if self._level < 2:
            return None
        return StatusPacket(self.dxl_id, self._alert | StatusErrorCode.CRC_ERROR)

    def answer_block(self, address: int, length: int) -> StatusPacket | None:
        """Answer this servo's part of a sync or bulk read; None if Status Return Level forbids it."""
        unit = self._unit
        if self._level < 1:
            return None
        try:
            data, code = unit.read(address, length), StatusErrorCode.NONE
        except Refused as refusal:
            data, code = b"", refusal.code
        return StatusPacket(self.dxl_id, self._alert | code, data)

    def answer_fast(self, address: int, length: int) -> StatusPacket | None:
        """Answer this servo's part of a fast read; None if it takes no part.

        Older firmware does not know the instruction. A part has its length, even if the servo refuses: it
        is filled with zeros then, which the manual does not say.
        """
        answer = self.answer_block(address, length) if self._inner.extended else None
        if answer is None or len(answer.params) >= length:
            return answer
        return answer._replace(params=answer.params.ljust(length, b"\0"))

    def take_block(self, address: int, data: bytes) -> None:
        """Carry out this servo's part of a sync or bulk write, which is never answered."""
        try:
            self._unit.write(address, data)
        except Refused:
            return

    def _handle_as_secondary(self, packet: InstructionPacket) -> None:
        secondary = packet.dxl_id == self._unit.table.get("Secondary(Shadow) ID")
        if secondary and packet.instruction in _SECONDARY_INSTRUCTIONS:
            try:
                execute(self._unit, packet, secondary=True)
            except Refused:
                return

    @property
    def _level(self) -> int:
        return self._inner.table.get("Status Return Level")

    @property
    def _alert(self) -> int:
        return ALERT_BIT if self._inner.table.get("Hardware Error Status") else 0
