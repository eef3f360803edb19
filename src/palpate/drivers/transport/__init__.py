"""Ports, clocks and the seam to devices: bytes in, bytes out, nothing about what they mean."""

from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.port import open_port
from palpate.drivers.transport.recording import Direction
from palpate.drivers.transport.wire import Device, Emission

__all__ = [
    "Clock",
    "Device",
    "Direction",
    "Emission",
    "MockHub",
    "MonotonicClock",
    "VirtualClock",
    "open_port",
]
