"""Emulated servos on a wire in memory, behind a console or on a pseudo-terminal."""

import io
import math
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from dynamixel_sdk import PortHandler
from serial.serialutil import SerialBase

from palpate.config import RigFile
from palpate.drivers.dynamixel.packet import Instruction, InstructionPacket, StatusPacket
from palpate.drivers.emulators.device_server import DeviceServer
from palpate.drivers.emulators.pseudo_terminal import serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.rig.diagnostics.servo_bus import BusEndpoint

# ----------------------------------------------------------------------------------------------------
# A wire in virtual time with servos that are plugged in and out, and a person who does it when asked.

_STEP_S = 5e-3
_LATENCY_S = 1e-3


class MotorWire:
    """Servos on a wire; all are plugged in at first."""

    def __init__(self, servos: Sequence[EmulatedServo]) -> None:
        self.servos = list(servos)
        self.clock = VirtualClock()
        self._hub = MockHub(self.clock, "motors")
        self._stepped = 0.0
        self.url = self._hub.attach("bus", ServoChain(self.servos, self._advance), 1_000_000)

    def plug(self, *servos: EmulatedServo) -> None:
        """Plug in these and unplug all others."""
        for servo in self.servos:
            servo.power_off()
        for servo in servos:
            servo.power_on()

    def place(self, rig: RigFile | None = None) -> BusEndpoint:
        """The bus as commands take it."""
        rate = None if rig is None else rig.bus.baudrate_bps
        return BusEndpoint(self.url, self.clock, _LATENCY_S, rate, rig, devices=self)

    def _advance(self, now: float) -> None:
        while self._stepped + _STEP_S <= now:
            for servo in self.servos:
                servo.step(_STEP_S, 0.0)
            self._stepped += _STEP_S


class Person(io.TextIOBase):
    """Stdin of somebody who does something and then types a line, each time that a line is asked for."""

    def __init__(self, deeds: Iterable[tuple[Callable[[], object] | None, str]]) -> None:
        self._deeds = iter(deeds)
        self.asked = 0

    def readable(self) -> bool:
        return True

    def readline(self, size: int = -1, /) -> str:  # type: ignore[override]
        """The next line; the end of input once there are no more deeds."""
        del size
        for deed, line in self._deeds:
            self.asked += 1
            if deed is not None:
                deed()
            return line + "\n"
        return ""


# ----------------------------------------------------------------------------------------------------
# Talking to one emulated servo without a wire, in addresses and numbers.


class Console:
    """Talks to a servo in addresses and numbers; `dxl_id` is the ID that it calls."""

    def __init__(self, **options: object) -> None:
        self.servo = EmulatedServo(1, **options)  # type: ignore[arg-type]
        self.dxl_id = 1

    def send(self, instruction: int, params: bytes = b"") -> StatusPacket | None:
        self.servo.note_packet()
        return self.servo.handle(InstructionPacket(self.dxl_id, instruction, params))

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


# ----------------------------------------------------------------------------------------------------
# A few emulated servos, alone on a wire, on a pseudo-terminal for clients in other processes.

BAUD = 1_000_000
_SERVED_STEP_S = 1e-3


@dataclass(frozen=True)
class Served:
    """What is served, and where."""

    service: DeviceServer
    servos: dict[int, EmulatedServo]

    @property
    def path(self) -> str:
        return self.service.paths["bus"]

    def ticks(self) -> dict[int, float]:
        """Where each shaft really is, in units of Present Position."""
        with self.service.lock:
            return {
                dxl_id: servo.shaft_rad / (2 * math.pi) * 4096 + 2048 for dxl_id, servo in self.servos.items()
            }


@contextmanager
def served_servos(dxl_ids: Sequence[int]) -> Iterator[Served]:
    """Unloaded servos with firmware 46, served until the block ends."""
    servos = {dxl_id: EmulatedServo(dxl_id, firmware=46) for dxl_id in dxl_ids}
    clock = MonotonicClock()
    stepped = clock.now()

    def advance(now: float) -> None:
        nonlocal stepped
        while stepped + _SERVED_STEP_S <= now:
            for servo in servos.values():
                servo.step(_SERVED_STEP_S, 0.0)
            stepped += _SERVED_STEP_S

    chain = ServoChain(list(servos.values()), advance, baudrate=BAUD)
    with serve_pty({"bus": (chain, BAUD)}, clock, threading.Event()) as service:
        yield Served(service, servos)


# ----------------------------------------------------------------------------------------------------
# The vendor's SDK on a port that is open already.


class SdkPort(PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's own port handler, but for where its port comes from and whose time it is."""

    def __init__(self, port: SerialBase, clock: Clock | None = None) -> None:
        super().__init__(port.port)
        self.ser = port
        self.is_open = True
        self.tx_time_per_byte = 1e4 / port.baudrate
        self._clock = clock

    def getCurrentTime(self) -> float:
        now: float = super().getCurrentTime()
        return now if self._clock is None else self._clock.now() * 1e3
