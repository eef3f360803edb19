"""What the computer tells about its serial ports beside opening them: owners, programs, adapters.

All of it is read from Linux's own files, below a root that tests may replace; elsewhere nothing is known.
"""

import getpass
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from palpate.drivers.transport.adapter import LATENCY_TIMER, latency_timer_s
from palpate.drivers.transport.serial_ports import port_users

with suppress(ImportError):  # Windows has no groups of this kind
    import grp

__all__ = ["Computer", "PortGroup"]

# Adapters that brltty takes for braille displays: docs/setting-up.md.
_BRAILLE_LIKE = {("1a86", "7523"), ("10c4", "ea60"), ("0403", "6001")}
_IGNORED = ("ID_MM_DEVICE_IGNORE=1", "ID_MM_PORT_IGNORE=1")


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
        """Whether a program of that name is running."""
        return any(_text(folder / "comm") == program[:15] for folder in _numbered(self.root / "proc"))

    def latency_timer_s(self, port: str) -> float | None:
        """The latency timer of a port's adapter, None if it is not known."""
        return latency_timer_s(port, self.root / "sys/class/tty")

    def latency_timer_path(self, port: str) -> str:
        """Where it is set."""
        return f"/sys/class/tty/{Path(port).resolve().name}/device/{LATENCY_TIMER}"

    def may_be_probed(self, port: str) -> bool:
        """Whether ModemManager is running and nothing tells it to leave a port alone."""
        if not self.runs("ModemManager"):
            return False
        number = _text(self.root / "sys/class/tty" / Path(port).resolve().name / "dev")
        known = _text(self.root / "run/udev/data" / f"c{number}") if number else ""
        return "ID_MM_CANDIDATE=1" in known and not any(word in known for word in _IGNORED)

    def taken_by_brltty(self) -> str | None:
        """USB id of an adapter that has no port while brltty is running, which takes such; None without."""
        if not self.runs("brltty"):
            return None
        usb = self.root / "sys/bus/usb/devices"
        for device in _entries(usb):
            ids = _text(device / "idVendor"), _text(device / "idProduct")
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


def _numbered(folder: Path) -> Iterator[Path]:
    return (entry for entry in _entries(folder) if entry.name.isdecimal())


def _entries(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:
        return []


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
