"""Talking to one emulated servo without a wire, in addresses and numbers."""

from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, StatusPacket
from palpate.drivers.emulators.servo import EmulatedServo


class Console:
    """Talks to a servo in addresses and numbers."""

    def __init__(self, **options: object) -> None:
        self.servo = EmulatedServo(1, **options)  # type: ignore[arg-type]

    def send(self, instruction: int, params: bytes = b"") -> StatusPacket | None:
        self.servo.heard()
        return self.servo.handle(InstructionPacket(1, instruction, params))

    def write(self, address: int, value: int, size: int) -> int:
        raw = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
        answer = self.send(Instruction.WRITE, address.to_bytes(2, "little") + raw)
        assert answer is not None
        return answer.error

    def read(self, address: int, size: int) -> int:
        answer = self.send(Instruction.READ, address.to_bytes(2, "little") + size.to_bytes(2, "little"))
        assert answer is not None
        assert answer.error_number == 0
        return int.from_bytes(answer.params, "little", signed=True)

    def run(self, seconds: float, load_nm: float = 0.0, dt: float = 1e-3) -> None:
        for _ in range(round(seconds / dt)):
            self.servo.step(dt, load_nm)

    def start(self, mode: int, **settings_: int) -> None:
        assert self.write(11, mode, 1) == 0
        if "current" in settings_:
            assert self.write(102, settings_["current"], 2) == 0
        assert self.write(108, settings_.get("acceleration", 0), 4) == 0
        assert self.write(112, settings_.get("velocity", 0), 4) == 0
        assert self.write(64, 1, 1) == 0
