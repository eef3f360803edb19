"""How long things take on a wire of servos: formulas for whole exchanges, and how long to wait.

Beneath `transceiver` and `bus`; known to whoever judges a loop's rate. A byte takes ten bits. Return delay is
what a servo waits before it answers. Sources: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0" (packet layouts) and
Return Delay Time (9); the latency timer is that of the FTDI chips in the vendor's adapters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

from palpate.drivers.transport.wire import wire_time_s

__all__ = [
    "LONGEST_RETURN_DELAY_S",
    "UNKNOWN_LATENCY_S",
    "Timing",
    "fast_read_time_s",
    "group_read_time_s",
    "latency_with_timer_s",
    "sync_write_time_s",
]

LONGEST_RETURN_DELAY_S = 254 * 2e-6
"""Largest value of Return Delay Time (9)."""

_USB_S = 2e-3  # two USB frames and the way through the kernel


def latency_with_timer_s(timer_s: float) -> float:
    """What an adapter with a latency timer may add: the timer before each of two parts, and USB."""
    return 2 * timer_s + _USB_S


UNKNOWN_LATENCY_S = latency_with_timer_s(16e-3)
"""Latency where nothing is known of the adapter: the timer's usual 16 ms. The SDK always allows this much."""

_PACKET = 10  # header, ID, LEN, INST and CRC
_STATUS = 11  # the same, and the error byte
_BLOCK = 4  # of a fast read: error, ID and CRC


@dataclass(frozen=True, slots=True)
class Timing:
    """What decides how long an answer may take.

    `latency_s`: what adapter, driver and system may add. `late_s`: how late an answer can be because the
    computer is busy; a question is repeated for as long. `patience_s`: how long each of the last tries waits
    at least. `horizon_s`: how long after an instruction its answer, or a copy of it, is believed to come;
    until then it must not be taken for the answer to something else.
    """

    baudrate: int
    latency_s: float
    late_s: float = 0.15
    patience_s: float = 0.03
    horizon_s: float = 0.3

    def tries(self, retries: int) -> list[bool]:
        """How often to ask for what gets lost, and whether patiently; all are the same question."""
        if not retries:
            return [False]
        left_s = self.late_s - retries * self.latency_s
        return [False] * retries + [True] * max(1, ceil(left_s / max(self.patience_s, self.latency_s)))

    def timeout_s(self, sent: int, expected: int, return_delay_s: float) -> float:
        """How long to wait for an answer of `expected` bytes to the `sent` bytes that were just written."""
        return wire_time_s(sent + expected, self.baudrate) + return_delay_s + self.latency_s


def group_read_time_s(sizes: Sequence[int], baudrate: int) -> float:
    """Wire time of a sync read of blocks of `sizes` bytes, without return delays or latency.

    Bytes are counted before stuffing.
    """
    return wire_time_s(_PACKET + 4 + len(sizes) + sum(_STATUS + size for size in sizes), baudrate)


def fast_read_time_s(sizes: Sequence[int], baudrate: int) -> float:
    """Wire time of a fast sync read: one answer for all."""
    return wire_time_s(_PACKET + 4 + len(sizes) + fast_frame_size(sizes), baudrate)


def fast_frame_size(sizes: Sequence[int]) -> int:
    """Bytes of the one answer to a fast read."""
    return _PACKET - 2 + sum(_BLOCK + size for size in sizes)


def sync_write_time_s(count: int, size: int, baudrate: int) -> float:
    """Wire time of a sync write of `size` bytes to each of `count` servos."""
    return wire_time_s(_PACKET + 4 + count * (1 + size), baudrate)
