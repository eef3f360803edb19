"""Serial ports of the host computer: owners, programs that use them, adapters and their latency timers.

What is known beside opening them is read from Linux's own files, below a root that tests may replace;
elsewhere nothing is known. A port is found by unplugging its adapter.
"""

import getpass
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from palpate.config.commissioning_results import SerialPortOut, SerialPortsOut
from palpate.drivers.transport import (
    LATENCY_TIMER,
    Clock,
    SerialPort,
    latency_timer_s,
    port_users,
)

with suppress(ImportError):  # Windows has no groups of this kind
    import grp


# Adapters that brltty takes for braille displays: docs/setting-up.md.
_BRAILLE_LIKE = {("1a86", "7523"), ("10c4", "ea60"), ("0403", "6001")}
_MODEM_MANAGER_EXCLUSIONS = ("ID_MM_DEVICE_IGNORE=1", "ID_MM_PORT_IGNORE=1")


@dataclass(frozen=True, slots=True)
class PortGroup:
    """The group that owns a port. `joined`: this user is in it, but perhaps not yet logged in again."""

    name: str
    joined: bool


@dataclass(frozen=True, slots=True)
class Computer:
    """The computer whose files are below `root`."""

    root: Path = Path("/")

    def user_of(self, port: str) -> str | None:
        """The program that has a port open, as far as this user may see."""
        device = os.path.realpath(port)
        return port_users(self.root / "proc", {device}).get(device)

    def runs(self, program: str) -> bool:
        """Return whether a program of that name is running."""
        return any(
            _read_text(folder / "comm") == program[:15] for folder in _process_folders(self.root / "proc")
        )

    def latency_timer_s(self, port: str) -> float | None:
        """The latency timer of a port's adapter, None if it is not known."""
        return latency_timer_s(port, self.root / "sys/class/tty")

    def latency_timer_path(self, port: str) -> str:
        """File in which it is set."""
        return f"/sys/class/tty/{Path(port).resolve().name}/device/{LATENCY_TIMER}"

    def may_be_probed(self, port: str) -> bool:
        """Return whether ModemManager is running and nothing tells it to leave a port alone."""
        if not self.runs("ModemManager"):
            return False
        number = _read_text(self.root / "sys/class/tty" / Path(port).resolve().name / "dev")
        known = _read_text(self.root / "run/udev/data" / f"c{number}") if number else ""
        return "ID_MM_CANDIDATE=1" in known and not any(word in known for word in _MODEM_MANAGER_EXCLUSIONS)

    def find_brltty_claim(self) -> str | None:
        """USB id of an adapter that has no port while brltty is running, which takes such; None without."""
        if not self.runs("brltty"):
            return None
        usb = self.root / "sys/bus/usb/devices"
        for device in _entries(usb):
            ids = _read_text(device / "idVendor"), _read_text(device / "idProduct")
            if ids in _BRAILLE_LIKE and not any(usb.glob(f"{device.name}:*/tty*")):
                return ":".join(ids)
        return None

    def group_of(self, port: str) -> PortGroup | None:
        """The group that owns a port; None where that is not known."""
        try:
            found = grp.getgrgid(os.stat(port).st_gid)
        except (OSError, KeyError, NameError):
            return None
        return PortGroup(found.gr_name, found.gr_gid not in os.getgroups() and _user() in found.gr_mem)


def _user() -> str:
    try:
        return getpass.getuser()
    except (OSError, KeyError, ImportError):
        return ""


def _process_folders(folder: Path) -> Iterator[Path]:
    return (entry for entry in _entries(folder) if entry.name.isdecimal())


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _read_text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""


_MAX_LATENCY_TIMER_S = 1e-3


def is_timer_long(timer_s: float | None) -> bool:
    """Return whether an adapter's latency timer, None if it is not known, holds answers back for too long."""
    return timer_s is not None and timer_s > _MAX_LATENCY_TIMER_S


_REAPPEARS_S = 5.0  # udev needs a moment for the name under by-id
_POLL_S = 0.2


def find_unplugged(
    look: Callable[[], Sequence[SerialPort]], ask: Callable[[str], bool], clock: Clock
) -> Sequence[SerialPort]:
    """The ports of the adapter that is unplugged and plugged in again, as they are then; none if none is.

    `ask` returns once that is done, False if the person gives up.
    """
    before = look()
    what = "unplug the adapter you look for"
    while True:
        if not ask(what):
            return ()
        left = {port.device for port in look()}
        gone = [port for port in before if port.device not in left]
        if gone:
            break
        what = "no port has gone; unplug the adapter's USB cable"
    if not ask(f"it was {', '.join(port.device for port in gone)}; plug it in again"):
        return gone
    deadline = clock.now() + _REAPPEARS_S
    while True:
        back = [port for port in look() if port.device not in left]
        named = all(port.by_id is not None for port in back) or all(port.by_id is None for port in gone)
        if (len(back) >= len(gone) and named) or clock.now() > deadline:
            return back or gone
        clock.sleep(_POLL_S)


def ports_out(ports: Sequence[SerialPort], found: SerialPort | None) -> SerialPortsOut:
    """The ports as a result; `found`: the one that was looked for."""
    return SerialPortsOut(
        ports=tuple(
            SerialPortOut.of(
                port,
                usb_id=usb_id(port),
                latency_timer_ms=None if port.latency_timer_s is None else port.latency_timer_s * 1e3,
            )
            for port in ports
        ),
        found=None if found is None else found.name,
    )


def usb_id(port: SerialPort) -> str | None:
    """Vendor and product as people know them: "0403:6014"."""
    return None if port.usb_ids is None else f"{port.usb_ids[0]:04x}:{port.usb_ids[1]:04x}"
