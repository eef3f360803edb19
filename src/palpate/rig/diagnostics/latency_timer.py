"""Warnings about an adapter's latency timer."""

from pathlib import Path

from palpate.drivers.transport.adapter import LATENCY_TIMER, latency_timer_file

__all__ = ["timer_warnings"]

_GOOD_S = 1e-3


def timer_warnings(port: str, timer_s: float | None) -> list[str]:
    """What to do about an adapter that holds answers back; nothing if it does not, or if that is unknown."""
    if timer_s is None or timer_s <= _GOOD_S:
        return []
    known = latency_timer_file(port)
    file = f"/sys/class/tty/{Path(port).name}/device/{LATENCY_TIMER}" if known is None else known
    return [
        f"the adapter holds every answer back for up to {timer_s * 1e3:g} ms (its latency timer); "
        f"1 ms is set until it is unplugged by: echo 1 | sudo tee {file}"
    ]
