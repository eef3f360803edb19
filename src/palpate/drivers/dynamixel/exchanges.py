"""Exchanges on a servo bus: their duration, and which answers may still arrive, until when.

Used by `transceiver` and `bus`, and to assess the rate of a loop. A byte takes ten bits. Return delay is the
time that a servo waits before it answers.

No packet of Protocol 2.0 says which instruction it answers, and an answer can come late, or twice. Two
answers of a servo can be distinguished only by their length. So a read is made a few bytes longer if an
answer of the same length to another request may still arrive. `transceiver` checks this here before it
sends.

Sources: ROBOTIS e-Manual, "DYNAMIXEL Protocol 2.0" (packet layouts) and Return Delay Time (9); the latency
timer is that of the FTDI chips in the vendor's adapters.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

from palpate.drivers.dynamixel.control_table import ITEMS
from palpate.drivers.dynamixel.packet import BROADCAST_ID
from palpate.drivers.transport.wire import wire_time_s

LONGEST_RETURN_DELAY_S = 254 * 2e-6
"""Largest value of Return Delay Time (9)."""

_USB_TRANSFER_S = 2e-3  # two USB frames and the way through the kernel


def latency_with_timer_s(timer_s: float) -> float:
    """Delay that an adapter with a latency timer may add: the timer before each of two parts, and USB."""
    return 2 * timer_s + _USB_TRANSFER_S


UNKNOWN_LATENCY_S = latency_with_timer_s(16e-3)
"""Latency where nothing is known of the adapter: the timer's usual 16 ms. The SDK always allows this much."""

RETRIES = 2
"""A lost or damaged answer is asked for so often again, at least; see `Timing.tries`."""

_INSTRUCTION_BYTES = 10  # header, ID, LEN, INST and CRC
_STATUS_BYTES = 11  # the same, and the error byte
_FAST_BLOCK_BYTES = 4  # of a fast read: error, ID and CRC


@dataclass(frozen=True, slots=True)
class Timing:
    """Delays that decide how long an answer may take.

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
        """Repetitions of a lost question, each patient or not."""
        if not retries:
            return [False]
        left_s = self.late_s - retries * self.latency_s
        return [False] * retries + [True] * max(1, ceil(left_s / max(self.patience_s, self.latency_s)))

    def timeout_s(self, sent: int, expected: int, return_delay_s: float) -> float:
        """Time to wait for an answer of `expected` bytes to the `sent` bytes that were just written."""
        return wire_time_s(sent + expected, self.baudrate) + return_delay_s + self.latency_s


def group_read_time_s(sizes: Sequence[int], baudrate: int) -> float:
    """Wire time of a sync read of blocks of `sizes` bytes, without return delays or latency.

    Bytes are counted before stuffing.
    """
    return wire_time_s(
        _INSTRUCTION_BYTES + 4 + len(sizes) + sum(_STATUS_BYTES + size for size in sizes), baudrate
    )


def fast_read_time_s(sizes: Sequence[int], baudrate: int) -> float:
    """Wire time of a fast sync read: one answer for all."""
    return wire_time_s(_INSTRUCTION_BYTES + 4 + len(sizes) + fast_frame_size(sizes), baudrate)


def fast_frame_size(sizes: Sequence[int]) -> int:
    """Bytes of the one answer to a fast read."""
    return _INSTRUCTION_BYTES - 2 + sum(_FAST_BLOCK_BYTES + size for size in sizes)


def sync_write_time_s(count: int, size: int, baudrate: int) -> float:
    """Wire time of a sync write of `size` bytes to each of `count` servos."""
    return wire_time_s(_INSTRUCTION_BYTES + 4 + count * (1 + size), baudrate)


TableBlock = tuple[int, int]
"""First address and number of bytes of a part of the control table."""

Query = tuple[tuple[int, TableBlock], ...]
"""What was read of which servos; one servo in all but fast reads."""

ACK_PARAMS = 0
PING_PARAMS = 3
"""Lengths of answers that cannot be varied: to a write, a reboot or a refusal; to a ping."""

_INDIRECT_START = 168  # from here on there are indirect addresses, then what they show
_MAX_EXTRA_BYTES, _MAX_EXTRA_INDIRECT_BYTES = 60, 40  # at least as many addresses follow, or come before
_SPARE_INDIRECT_BYTES = (
    6  # Indirect Data behind those of a servo's state; in front of them an old XL330 has a gap
)
_GOAL_ADDRESSES = range(
    ITEMS["Goal PWM"].address, ITEMS["Realtime Tick"].address
)  # changing these changes nothing else


@dataclass(slots=True)
class _OutstandingAnswer:
    question: Query | None  # None: more than one, or it would be answered otherwise by now
    until_s: float


class PendingAnswers:
    """Answers that may still arrive, by servo and number of parameters."""

    def __init__(self, horizon_s: float) -> None:
        """`horizon_s`: how long after an instruction its answer, or a copy of it, can come at most."""
        self._horizon_s = horizon_s
        self._owed: dict[tuple[int, int], _OutstandingAnswer] = {}

    def note(self, dxl_id: int, size: int, question: Query | None, now: float) -> None:
        """Note a question whose answer has `size` bytes of parameters."""
        owed = self._owed.get((dxl_id, size))
        if owed is None:
            owed = self._owed[dxl_id, size] = _OutstandingAnswer(question, now)
        owed.question = question if owed.until_s <= now or owed.question == question else None
        owed.until_s = now + self._horizon_s

    def expects(self, dxl_id: int, size: int, now: float) -> bool:
        """True if an answer of this length may come: if it was not asked for now, it was before."""
        owed = self._owed.get((dxl_id, size))
        return owed is not None and owed.until_s > now

    def clear_at(self, dxl_id: int) -> float:
        """Instant from which on nothing that was asked of a servo before can be answered."""
        return max((owed.until_s for (i, _), owed in self._owed.items() if i == dxl_id), default=0.0)

    def outdate(self, dxl_ids: Collection[int] | None, written: TableBlock) -> None:
        """Part of the control table was written: what was read of it before no longer holds.

        `dxl_ids`: of these servos, None for all. Goals change nothing but themselves; Operating Mode, Torque
        Enable and many others change goals and gains, and what indirect addresses show is not known here.
        """
        if written[0] in _GOAL_ADDRESSES:
            for owed in self._owed.values():
                if owed.question and any(
                    (dxl_ids is None or i in dxl_ids) and _overlap(block, written)
                    for i, block in owed.question
                ):
                    owed.question = None
            return
        for (dxl_id, _), owed in self._owed.items():
            asked = [dxl_id] if owed.question is None else [i for i, _ in owed.question]
            if dxl_ids is None or not set(asked).isdisjoint(dxl_ids):
                owed.question = None

    def wider(
        self, blocks: Mapping[int, TableBlock], now: float, *, variants: int = 1, fast: bool = False
    ) -> Mapping[int, TableBlock] | None:
        """Blocks with `blocks` in them, of lengths that tell their answers from all outstanding.

        Of the first `variants` such lengths the one that was used least recently. Blocks that are all alike
        stay so. `fast`: they are for a fast read, which has one answer. None if there are no such lengths.
        """
        if fast or len(set(blocks.values())) == 1:
            return self._all_wider(blocks, now, variants, fast)
        found: dict[int, TableBlock] = {}
        for dxl_id, block in blocks.items():
            alone = self._all_wider({dxl_id: block}, now, variants, fast)
            if alone is None:
                return None
            found |= alone
        return found

    def _all_wider(
        self, blocks: Mapping[int, TableBlock], now: float, variants: int, fast: bool
    ) -> Mapping[int, TableBlock] | None:
        """All of them wider by the same number of bytes."""
        spare = min(
            _MAX_EXTRA_BYTES if first < _INDIRECT_START else _MAX_EXTRA_INDIRECT_BYTES
            for first, _ in blocks.values()
        )
        asked = tuple(blocks.items())
        best: tuple[float, Mapping[int, TableBlock]] | None = None
        for extra in range(spare + 1):
            wide, owed = _widen(asked, extra, fast)
            last_s = self._last_use_s(owed, now)
            if last_s is None:
                continue
            if best is None or last_s < best[0]:
                best = last_s, wide
            variants -= 1
            if last_s == 0.0 or not variants:
                break
        return best and best[1]

    def _last_use_s(self, asked: Mapping[tuple[int, int], Query], now: float) -> float | None:
        """Time at which answers of these lengths were last asked for, 0 if none is outstanding; None: of
        other questions.
        """
        last_s = 0.0
        for key, question in asked.items():
            if key[1] == PING_PARAMS:
                return None
            owed = self._owed.get(key)
            if owed is None or owed.until_s <= now:
                continue
            if owed.question != question:
                return None
            last_s = max(last_s, owed.until_s)
        return last_s


def queries(blocks: Mapping[int, TableBlock], *, fast: bool = False) -> Mapping[tuple[int, int], Query]:
    """Queries of a read of blocks: the servo and the length of the answer."""
    return _queries(tuple(blocks.items()), fast)


@lru_cache(maxsize=1024)  # control loops ask the same a hundred times a second
def _queries(asked: Query, fast: bool) -> Mapping[tuple[int, int], Query]:
    if fast:
        return {(BROADCAST_ID, fast_frame_size([size for _, (_, size) in asked])): asked}
    return {(dxl_id, block[1]): ((dxl_id, block),) for dxl_id, block in asked}


@lru_cache(maxsize=1024)
def _widen(
    asked: Query, extra: int, fast: bool
) -> tuple[Mapping[int, TableBlock], Mapping[tuple[int, int], Query]]:
    """Blocks that are wider by some bytes, and the queries for them."""
    wide = tuple(
        (
            dxl_id,
            (
                first if first < _INDIRECT_START else first - max(0, extra - _SPARE_INDIRECT_BYTES),
                size + extra,
            ),
        )
        for dxl_id, (first, size) in asked
    )
    return dict(wide), _queries(wide, fast)


def extract_block(data: bytes, wide: TableBlock, block: TableBlock) -> bytes:
    """The bytes of a block among those of a wider one."""
    begin = block[0] - wide[0]
    return data[begin : begin + block[1]]


def _overlap(one: TableBlock, other: TableBlock) -> bool:
    return one[0] < other[0] + other[1] and other[0] < one[0] + one[1]
