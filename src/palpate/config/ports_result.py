"""Result of `palpate find-port`: `palpate/serial-ports@1`."""

from typing import Literal

from palpate.config.results import Out, Rounded

__all__ = ["SerialPortOut", "SerialPortsOut"]


class SerialPortOut(Out):
    """A serial port. `name` is what to write into a rig file; what the system does not tell is null."""

    name: str
    device: str
    by_id: str | None
    description: str | None
    usb_id: str | None
    serial_number: str | None
    latency_timer_ms: Rounded | None
    used_by: str | None
    permitted: bool


class SerialPortsOut(Out):
    """All serial ports. `found`: the one that was unplugged and plugged in again, null if nobody did."""

    format: Literal["palpate/serial-ports@1"] = "palpate/serial-ports@1"
    ports: tuple[SerialPortOut, ...]
    found: str | None
