"""Serial ports: opening by name or URL, listing, their users, latency of their adapters.

A port is anything that pyserial's `serial_for_url` takes: a device path, `socket://host:port`, or the
`mock://HUB/NAME` of an emulated rig. Here pyserial's errors become ours. Names under /dev/serial/by-id come
from the adapter's serial number and survive replugging; names such as /dev/ttyUSB0 are given in the order of
plugging in.

FTDI chips, as in the vendor's U2D2, collect bytes until a buffer is full or their latency timer runs out: 16
ms unless somebody has set it. On Linux it can be read and set under /sys (FTDI application note AN232B-04).

*Replugging.* Names such as /dev/ttyUSB0 are given in the order of plugging in. An adapter that was unplugged
for a moment may come back as /dev/ttyUSB1, and another one may take its old name; its serial number stays.
`ReopenedPort` is a port that can be opened again while somebody keeps using it.
"""

import errno
import os
from collections.abc import Callable, Hashable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import serial
from serial.serialutil import SerialBase
from serial.tools.list_ports import comports
from serial.tools.list_ports_common import ListPortInfo

from palpate.base.errors import DeviceError
from palpate.drivers.transport.port_sharing import connection_of

try:
    from termios import error as _terminal_error
except ImportError:  # Windows has no terminals of this kind
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError,)
else:
    PORT_ERRORS = (OSError, _terminal_error)
"""What a pyserial port may raise when its device goes away: SerialException is an OSError, and flushing an
unplugged port lets the terminal's own error through."""

_OPENING_ERRORS: tuple[type[Exception], ...] = (*PORT_ERRORS, ValueError)
_TAKEN = (errno.EAGAIN, errno.EBUSY)
_FORBIDDEN = (errno.EACCES, errno.EPERM)
_MISSING = (errno.ENOENT, errno.ENODEV, errno.ENXIO)
_PORT_HINT = "check the cable and the port's name (palpate find-port lists what is there)"


class PortTaken(DeviceError):
    """Another program has the port for itself."""


class PortForbidden(DeviceError):
    """This user may not open the port."""


class PortMissing(DeviceError):
    """There is no such port."""


def open_port(url: str, baudrate: int, *, timeout_s: float = 0.0, shared: bool = False) -> SerialBase:
    """Open a port (8N1), for this process alone, whose reads wait for at most `timeout_s`.

    `shared`: also if another program has it, which loses what is read here; for an emergency stop only.
    Raises PortTaken if another program uses the port, PortForbidden if this user may not, PortMissing if it
    does not exist, another DeviceError naming it if it refuses the baud rate.
    """
    handlers = __package__ or "palpate.drivers.transport"
    if handlers not in serial.protocol_handler_packages:
        serial.protocol_handler_packages.insert(
            0, handlers
        )  # before pyserial's own: ours correct one of them
    try:
        port: SerialBase = serial.serial_for_url(
            url, baudrate=baudrate, timeout=timeout_s, exclusive=None if shared else True
        )
    except _OPENING_ERRORS as error:
        if isinstance(error, OSError) and error.errno in _TAKEN:
            raise PortTaken(
                f"port {url} is in use: another program is using it; close that program, then try again"
            ) from error
        if isinstance(error, OSError) and error.errno in _FORBIDDEN:
            raise PortForbidden(
                f"port {url} may not be opened by this user; join the group that owns it "
                "(sudo usermod -aG dialout $USER), then log in again"
            ) from error
        missing = isinstance(error, OSError) and error.errno in _MISSING
        what = "does not exist" if missing else f"does not exist or cannot be opened at {baudrate} baud"
        raise (PortMissing if missing else DeviceError)(
            f"port {url} {what}: {_reason(error)}; {_PORT_HINT}"
        ) from error
    return port


def has_baudrate(url: str) -> bool:
    """True if a port sends at the rate with which it is opened; of `socket://` the other end decides."""
    return not url.lower().startswith("socket://")


def _reason(error: Exception) -> str:
    """Reason that the system gave, without the layers that pyserial wraps around it."""
    code = error.errno if isinstance(error, OSError) else None
    return os.strerror(code).lower() if code else str(error)


EMULATED_LATENCY_S = 1e-3
"""Of a `mock://` port: nothing but the bytes takes time, and this much is patience enough."""

LATENCY_TIMER = "latency_timer"

_TTYS = Path("/sys/class/tty")
"""Where Linux tells of its serial ports."""


def latency_timer_s(port: str, ttys: Path = _TTYS) -> float | None:
    """A port's latency timer, None if it is not known."""
    if "://" in port:
        return None
    file = ttys / Path(connection_of(port)).resolve().name / "device" / LATENCY_TIMER
    try:
        return int(file.read_text(encoding="ascii")) / 1e3
    except (OSError, ValueError):
        return None


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
        """Kind of the adapter as far as it is known, else its own words."""
        return _KINDS.get(self.usb_ids or (0, 0), self.description)


def serial_ports() -> list[SerialPort]:
    """All ports of this computer, in order of their names."""
    return describe_ports(comports())


def describe_ports(
    found: Iterable[ListPortInfo],
    by_id: Path = _BY_ID,
    ttys: Path = _TTYS,
    processes: Path = _PROCESSES,
) -> list[SerialPort]:
    """Ports that pyserial found, with what the system adds; the folders are those of Linux."""
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
    """Name and number of the program that has each device open."""
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
                users[target] = f"{_read_text(process / 'comm') or 'a program'} (process {process.name})"
    return users


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []  # not there, or another user's


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""


class Plugs(Protocol):
    """Map between ports and the adapters behind them."""

    def adapter_of(self, port: str) -> Hashable | None:
        """Identity of the adapter among all others; None if it has none."""
        ...

    def port_of(self, adapter: Hashable) -> str | None:
        """The port at which it is now; None if it is not plugged in."""
        ...


class SystemPlugs:
    """Plugs as this computer reports them: an adapter's vendor, product, serial number and channel."""

    def adapter_of(self, port: str) -> Hashable | None:
        """Identity of the adapter; None without a serial number."""
        path = _resolve(port)
        return next((adapter for device, adapter in _adapters() if _resolve(device) == path), None)

    def port_of(self, adapter: Hashable) -> str | None:
        """Port of the adapter; None also if two adapters have the same number."""
        found = [device for device, other in _adapters() if other == adapter]
        return found[0] if len(found) == 1 else None


class FollowedPorts:
    """Opens ports; one that was opened before is opened where its adapter is now."""

    def __init__(self, plugs: Plugs) -> None:
        self._plugs = plugs
        self._adapters: dict[str, Hashable] = {}

    def open(self, url: str, baudrate: int) -> SerialBase:
        """Open like `open_port`. Raises PortMissing if neither the name nor the adapter is there."""
        adapter = self._adapters.get(url)
        if adapter is None:
            port = open_port(url, baudrate)
            found = self._plugs.adapter_of(url)
            if found is not None:
                self._adapters[url] = found
            return port
        now_at = self._plugs.port_of(adapter)
        if now_at is None and self._plugs.adapter_of(url) not in (None, adapter):
            raise PortMissing(f"port {url} belongs to another adapter now; plug the adapter in that it had")
        if now_at is None or _resolve(now_at) == _resolve(url):
            return open_port(url, baudrate)
        try:
            return open_port(now_at, baudrate)
        except DeviceError as error:
            raise DeviceError(f"the adapter of port {url} has come back as {now_at}: {error}") from error


def describe_renaming(before: str, now_at: str) -> str:
    """Advice for a rig file that names a port which has another name now."""
    return (
        f"{before} has come back as {now_at}: write its name under /dev/serial/by-id, which stays the same "
        "(palpate find-port prints it), into the rig file"
    )


def _adapters() -> list[tuple[str, Hashable]]:
    """Ports of this computer whose adapters have serial numbers."""
    return [
        (info.device, (info.vid, info.pid, info.serial_number, (info.location or "").partition(":")[2]))
        for info in comports()
        if info.serial_number
    ]


def _resolve(port: str) -> str:
    return port if "://" in port else str(Path(port).resolve())


class ReopenedPort:
    """The part of pyserial's port that drivers of arrays use, on whatever was opened last."""

    def __init__(self, reopen: Callable[[], SerialBase]) -> None:
        """Open it. Raises what `reopen` raises."""
        self._reopen = reopen
        self._port = reopen()

    def reopen(self) -> None:
        """Close it and open it again. Raises what opening raises; the old one is closed then, too."""
        self.close()
        self._port = self._reopen()

    def close(self) -> None:
        """Close it; closing twice is harmless."""
        with suppress(Exception):  # an adapter that is gone cannot be closed properly
            self._port.close()

    @property
    def port(self) -> str | None:
        """Name or URL."""
        name: str | None = self._port.port
        return name

    @property
    def timeout(self) -> float | None:
        """Time that a read waits, s."""
        timeout: float | None = self._port.timeout
        return timeout

    @timeout.setter
    def timeout(self, seconds: float | None) -> None:
        self._port.timeout = seconds

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read without waiting."""
        waiting: int = self._port.in_waiting  # type: ignore[attr-defined]
        return waiting

    def read(self, size: int = 1, /) -> bytes:
        """Read up to `size` bytes, waiting up to `timeout`."""
        return self._port.read(size)

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        return self._port.write(data)
