"""The baud rate of a client on a pseudo-terminal, however it was set, is the one that counts."""

import fcntl
import os
import struct
import termios
import threading
import tty
from collections.abc import Iterator

import pytest
import serial

from palpate.drivers.emulators.device_server import baud_rate, serve_pty
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.wire import Emission


@pytest.fixture
def pty() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, slave
    os.close(master)
    os.close(slave)


def set_by_number(fd: int, rate: int) -> None:
    """As clients do that use the system's BOTHER for every rate (Rust's serialport)."""
    get, put, bother, cbaud = 0x802C542A, 0x402C542B, 0o10000, 0o10017
    layout = struct.Struct("4I20s2I")
    iflag, oflag, cflag, lflag, rest, _, _ = layout.unpack(fcntl.ioctl(fd, get, bytes(44)))
    fcntl.ioctl(fd, put, layout.pack(iflag, oflag, cflag & ~cbaud | bother, lflag, rest, rate, rate))


@pytest.mark.parametrize("rate", [9600, 57_600, 1_000_000, 4_000_000])
def test_named_rate(pty: tuple[int, int], rate: int) -> None:
    master, slave = pty
    flags = termios.tcgetattr(slave)
    flags[4] = flags[5] = getattr(termios, f"B{rate}")
    termios.tcsetattr(slave, termios.TCSANOW, flags)
    assert baud_rate(master) == rate


@pytest.mark.parametrize("rate", [57_600, 250_000, 1_000_000, 4_500_000])
def test_rate_set_by_number(pty: tuple[int, int], rate: int) -> None:
    master, slave = pty
    set_by_number(slave, rate)
    assert baud_rate(master) == rate


class Echo:
    def feed(self, data: bytes, now: float) -> list[Emission]:
        return [(now, data)]

    def poll(self, now: float) -> list[Emission]:  # noqa: ARG002
        return []

    def next_due(self) -> float | None:
        return None


@pytest.mark.parametrize("rate", [1_000_000, 4_500_000])
def test_a_served_device_is_understood_at_its_rate_only(rate: int) -> None:
    with (
        serve_pty({"echo": (Echo(), rate)}, MonotonicClock(), threading.Event()) as service,
        serial.Serial(service.paths["echo"], 115_200, timeout=0.05) as port,
    ):
        port.write(b"slow")
        assert port.read(4) == b""
        port.timeout = 2.0
        port.baudrate = rate
        port.write(b"fast")
        assert port.read(4) == b"fast"
        set_by_number(port.fileno(), rate)
        port.write(b"again")
        assert port.read(5) == b"again"
