"""Ports, clocks and the seam to devices: bytes in, bytes out, nothing about what they mean."""

from palpate.drivers.transport.clock import Clock, MonotonicClock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import (
    EMULATED_LATENCY_S,
    LATENCY_TIMER,
    PORT_ERRORS,
    PortForbidden,
    PortMissing,
    PortTaken,
    SerialPort,
    has_baudrate,
    latency_timer_s,
    open_port,
    port_users,
    serial_ports,
)
from palpate.drivers.transport.recorder import Recorder, RecordItem, RecordSink
from palpate.drivers.transport.recording import (
    CALLS,
    Direction,
    ErrorRaised,
    PortBytes,
    PortOpened,
    RecordedEvent,
    RecordEntry,
    SessionEvent,
)
from palpate.drivers.transport.replay import PlaybackPort, RecordedBytes, RecordEnded, Replayer
from palpate.drivers.transport.replugging import FollowedPorts, ReopenedPort, SystemPlugs, describe_renaming
from palpate.drivers.transport.wire import Device, Emission, wire_time_s

__all__ = [
    "CALLS",
    "EMULATED_LATENCY_S",
    "LATENCY_TIMER",
    "PORT_ERRORS",
    "Clock",
    "Device",
    "Direction",
    "Emission",
    "ErrorRaised",
    "FollowedPorts",
    "MockHub",
    "MonotonicClock",
    "PlaybackPort",
    "PortBytes",
    "PortForbidden",
    "PortMissing",
    "PortOpened",
    "PortTaken",
    "RecordEnded",
    "RecordEntry",
    "RecordItem",
    "RecordSink",
    "RecordedBytes",
    "RecordedEvent",
    "Recorder",
    "ReopenedPort",
    "Replayer",
    "SerialPort",
    "SessionEvent",
    "SystemPlugs",
    "VirtualClock",
    "describe_renaming",
    "has_baudrate",
    "latency_timer_s",
    "open_port",
    "port_users",
    "serial_ports",
    "wire_time_s",
]
