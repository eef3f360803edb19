"""Which serial ports there are, and what the system tells of each. Beside `port` and `adapter`; opens none.

Names under /dev/serial/by-id come from the adapter's serial number and survive replugging; names such as
/dev/ttyUSB0 are given in the order of plugging in.
"""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from palpate.drivers.transport.adapter import TTYS, latency_timer_s

__all__ = ["SerialPort", "describe", "port_users", "serial_ports"]

_BY_ID = Path("/dev/serial/by-id")
_PROCESSES = Path("/proc")

_KINDS = {
    (0x0403, 0x6014): "FTDI FT232H, as in ROBOTIS U2D2",
    (0x0403, 0x6001): "FTDI FT232R, as in ROBOTIS USB2DYNAMIXEL",
    (0x2F5D, 0x2202): "ROBOTIS OpenRB-150",
}
"""USB vendor and product id of adapters that servos often hang on."""


@dataclass(frozen=True, slots=True)
class SerialPort:
    """A port. What the system does not tell is None.

    `used_by`: a program that has it open, as far as this user may see. `permitted`: this user may open it.
    """

    device: str
    by_id: str | None
    description: str | None
    usb_ids: tuple[int, int] | None
    serial_number: str | None
    latency_timer_s: float | None
    used_by: str | None
    permitted: bool

    @property
    def name(self) -> str:
        """The name that survives replugging where there is one: what belongs into a rig file."""
        return self.by_id or self.device

    @property
    def kind(self) -> str | None:
        """What is known of the adapter, else what it says of itself."""
        return _KINDS.get(self.usb_ids or (0, 0), self.description)


def serial_ports() -> list[SerialPort]:
    """All ports of this computer, in order of their names."""
    return describe(comports())


def describe(
    found: Iterable[ListPortInfo],
    by_id: Path = _BY_ID,
    ttys: Path = TTYS,
    processes: Path = _PROCESSES,
) -> list[SerialPort]:
    """What pyserial found, with what the system tells besides; the folders are those of Linux."""
    names = {str(link.resolve()): str(link) for link in _entries(by_id)}
    ports = sorted(found, key=lambda info: info.device)
    users = port_users(processes, {info.device for info in ports})
    return [
        SerialPort(
            info.device,
            names.get(str(Path(info.device).resolve())),
            None if info.description in (None, "n/a") else info.description,
            None if info.vid is None or info.pid is None else (info.vid, info.pid),
            info.serial_number,
            latency_timer_s(info.device, ttys),
            users.get(info.device),
            os.access(info.device, os.R_OK | os.W_OK),
        )
        for info in ports
    ]


def port_users(processes: Path, devices: set[str]) -> dict[str, str]:
    """For each device that is open somewhere: the program's name and number."""
    users: dict[str, str] = {}
    for process in _entries(processes):
        if not process.name.isdecimal() or int(process.name) == os.getpid():
            continue
        for handle in _entries(process / "fd"):
            try:
                target = os.readlink(handle)
            except OSError:
                continue
            if target in devices:
                users[target] = f"{_text(process / 'comm') or 'a program'} (process {process.name})"
    return users


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []  # not there, or another user's


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
