"""A wire in virtual time with servos that are plugged in and out, and a person who does it when asked."""

import io
from collections.abc import Callable, Iterable, Sequence

from palpate.config import RigFile
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.rig.diagnostics.servo_bus import BusEndpoint

__all__ = ["MotorWire", "Person"]

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
