"""Adapters that are plugged in again: followed to the name under which they come back, and reopened.

Names such as /dev/ttyUSB0 are given in the order of plugging in. An adapter that was unplugged for a moment
may come back as /dev/ttyUSB1, and another one may take its old name; its serial number stays. `ReopenedPort`
is a port that can be opened again while somebody keeps using it.
"""

from collections.abc import Callable, Hashable
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from serial.serialutil import SerialBase
from serial.tools.list_ports import comports

from palpate.base.errors import DeviceError
from palpate.drivers.transport.ports import PortMissing, open_port


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
