"""What is known of the adapter behind a port: how long it may hold an answer back. Beside `port`.

FTDI chips, as in the vendor's U2D2, collect bytes until a buffer is full or their latency timer runs out:
16 ms unless somebody has set it. On Linux it can be read and set under /sys (FTDI application note
AN232B-04).
"""

from pathlib import Path

__all__ = ["EMULATED_LATENCY_S", "LATENCY_TIMER", "TTYS", "latency_timer_file", "latency_timer_s"]

EMULATED_LATENCY_S = 1e-3
"""Of a `mock://` port: nothing but the bytes takes time, and this much is patience enough."""

LATENCY_TIMER = "latency_timer"

TTYS = Path("/sys/class/tty")
"""Where Linux tells of its serial ports."""


def latency_timer_file(port: str, ttys: Path = TTYS) -> Path | None:
    """The file that holds a port's latency timer in ms; None if it has none, or the system does not tell."""
    file = ttys / Path(port).resolve().name / "device" / LATENCY_TIMER
    return file if "://" not in port and file.is_file() else None


def latency_timer_s(port: str, ttys: Path = TTYS) -> float | None:
    """A port's latency timer, None if it is not known."""
    file = latency_timer_file(port, ttys)
    if file is None:
        return None
    try:
        return int(file.read_text(encoding="ascii")) / 1e3
    except (OSError, ValueError):
        return None
