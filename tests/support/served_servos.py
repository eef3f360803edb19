"""A few emulated servos, alone on a wire, on a pseudo-terminal for clients in other processes."""

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from palpate.drivers.emulators.device_server import DeviceServer, serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import MonotonicClock

__all__ = ["BAUD", "Served", "served_servos"]

BAUD = 1_000_000
_STEP_S = 1e-3


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
        while stepped + _STEP_S <= now:
            for servo in servos.values():
                servo.step(_STEP_S, 0.0)
            stepped += _STEP_S

    chain = ServoChain(list(servos.values()), advance, baudrate=BAUD)
    with serve_pty({"bus": (chain, BAUD)}, clock, threading.Event()) as service:
        yield Served(service, servos)
