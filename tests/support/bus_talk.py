"""A host that reads and writes at random over a bad wire, and is judged by what the servos really held.

For `benchmarks/bench_bad_wires.py`, which does it ten million times, and its short version among the tests.
"""

import random
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields

from spoiling_wire import Kind, Spoil, SpoilingPort

from palpate.base.errors import DeviceError
from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.dynamixel.errors import StatusError
from palpate.drivers.transport.clock import VirtualClock

__all__ = ["KINDS", "LOOPS", "Tally", "loop", "talk"]

_ITEMS = {
    item.address: item
    for item in (
        ct.ITEMS["Goal PWM"],
        ct.ITEMS["Goal Current"],
        ct.ITEMS["Goal Velocity"],
        ct.ITEMS["Profile Acceleration"],
        ct.ITEMS["Profile Velocity"],
        ct.ITEMS["Goal Position"],
    )
}
_IDS = (1, 2, 3)
_HEADER_LIKE = 0x00FDFFFF
_REFUSED = 0x40 << 8
_TELLING_S = 1.0  # how long a packet that was damaged unnoticed may be to blame for what is wrong
_FRESH_S = 2e-3

_FLIPS, _LOSSES = Spoil(flipped=0.003), Spoil(lost=0.1, cut=0.05)
_GARBLED = Spoil(garbled=0.2)
_LATE = Spoil(late=0.1, late_s=(0.0, 0.12))
_TWICE = Spoil(twice=0.2)
_TWICE_LATE = Spoil(twice=0.2, twice_s=(0.0005, 0.04))
_ALL = Spoil(0.0005, 0.01, 0.01, 0.01, (0.0, 0.12), 0.03, (0.0, 0.04))
_FINE = Spoil()

KINDS = (
    Kind("nothing", _FINE, _FINE),
    Kind("bits flip", _FLIPS, _FLIPS),
    Kind("garbled", _GARBLED, _GARBLED),
    Kind("lost or cut", _LOSSES, _LOSSES),
    Kind("instructions late", _LATE, _FINE),
    Kind("answers late", _FINE, _LATE),
    Kind("instructions twice", _TWICE, _FINE),
    Kind("answers twice", _FINE, _TWICE),
    Kind("instructions twice, late", _TWICE_LATE, _FINE),
    Kind("answers twice, late", _FINE, _TWICE_LATE),
    Kind("all of it", _ALL, _ALL),
)
LOOPS = tuple(
    Kind(f"loop: {kind.name}", kind.out, kind.back)
    for kind in KINDS
    if kind.back in (_LATE, _TWICE_LATE, _ALL)
)
"""Wires on which a control loop, which always asks the same, may be told what was true before."""


@dataclass
class Tally:
    """What came of it.

    `instructions`: packets sent by the host, each with its answers. `values`: values that it was told.
    `wrong`: those that the register did not hold at any time between the call and its return. `unconfirmed`:
    writes that were confirmed and not done. `misled`: refusals of what was not refused, and the other way
    round. `let_through`: what is wrong, but follows a damaged packet whose CRC is right. `undone`: values
    that are right and not what was last written, because a late copy of an earlier write came. `old`: values
    of a clock in the servo that were older than the question. `failed`: calls that ended in an error.
    """

    instructions: int = 0
    values: int = 0
    wrong: int = 0
    unconfirmed: int = 0
    misled: int = 0
    let_through: int = 0
    undone: int = 0
    old: int = 0
    clock_values: int = 0
    damaged_packets_let_through: int = 0
    calls: int = 0
    failed: int = 0

    def add(self, other: "Tally") -> None:
        for item in fields(self):
            setattr(self, item.name, getattr(self, item.name) + getattr(other, item.name))

    def as_dict(self) -> dict[str, int]:
        return asdict(self)


class _Talk:
    def __init__(self, kind: Kind, seed: int) -> None:
        self.tally = Tally()
        self.clock = VirtualClock()
        self.port = SpoilingPort(self.clock, Kind(kind.name, _FINE, _FINE), seed)
        self.bus = Bus(self.port, self.clock, 1_000_000, latency_s=1e-3)  # type: ignore[arg-type]
        self.port.kind = kind
        self.chance = random.Random(seed + 1)
        self.last: dict[tuple[int, int], int] = {}

    def step(self) -> None:
        chance = self.chance
        if chance.random() < 0.2:
            self.clock.sleep(chance.random() ** 3 * 0.03)
        self.tally.calls += 1
        begin = self.clock.now()
        try:
            self._call(chance.random(), chance.choice(_IDS), chance.choice(list(_ITEMS.values())), begin)
        except StatusError:
            self._count_wrong("misled")
        except DeviceError:
            self.tally.failed += 1
        self.tally.instructions = self.bus.counts.instructions

    def cycle(self, number: int) -> None:
        """One cycle of a control loop: a measurement of all, and a goal for all."""
        self.clock.sleep((0.0, 0.001, 0.005)[number % 3])
        self.tally.calls += 1
        self._read_clocks(fast=number % 1000 < 500)
        self.bus.sync_write(ct.ITEMS["Goal Position"], dict.fromkeys(_IDS, 5))
        self.tally.instructions = self.bus.counts.instructions

    def _call(self, draw: float, dxl_id: int, item: Item, begin: float) -> None:
        if draw < 0.35:
            self._judge(dxl_id, item, self.bus.read(dxl_id, item), begin)
        elif draw < 0.42:
            self._judge_clock(self.bus.read(dxl_id, ct.ITEMS["Realtime Tick"]), begin)
        elif draw < 0.60:
            self._write(dxl_id, item, begin)
        elif draw < 0.70:
            self._write_some(item)
        elif draw < 0.95:
            self._read_some(draw, item, begin)
        else:
            answer = self.bus.ping(dxl_id)
            self.tally.values += 1
            if (answer.model_number, answer.firmware) != (1020, 44):
                self._count_wrong("wrong")

    def _read_some(self, draw: float, item: Item, begin: float) -> None:
        if draw < 0.85:
            found = self.bus.sync_read(_IDS, item, fast=draw < 0.75)
            items = dict.fromkeys(_IDS, item)
        elif draw < 0.87:
            self._read_clocks(fast=False)
            return
        else:
            items = {i: self.chance.choice(list(_ITEMS.values())) for i in _IDS}
            found = self.bus.bulk_read(items)
        self._count_failed(found.errors.values())
        for i, value in found.values.items():
            self._judge(i, items[i], value, begin)

    def _read_clocks(self, *, fast: bool) -> None:
        begin = self.clock.now()
        clocks = self.bus.sync_read(_IDS, ct.ITEMS["Realtime Tick"], fast=fast)
        self._count_failed(clocks.errors.values())
        for value in clocks.values.values():
            self._judge_clock(value, begin)

    def _write_some(self, item: Item) -> None:
        ids = self.chance.sample(_IDS, self.chance.randint(1, 3))
        self.bus.sync_write(item, {i: self._value(item) for i in ids})
        for i in ids:
            self.last.pop((i, item.address), None)  # servos do not confirm it

    def _write(self, dxl_id: int, item: Item, begin: float) -> None:
        value = self._value(item)
        self.last.pop((dxl_id, item.address), None)
        refused = self.chance.random() < 0.02
        if refused:
            value |= _REFUSED << (8 * item.size - 16)
        try:
            self.bus.write(dxl_id, item, value)
        except StatusError:
            if not refused:
                self._count_wrong("misled")
            return
        if refused:
            self._count_wrong("misled")
            return
        if value not in self.port.written(dxl_id, item.address, begin):
            self._count_wrong("unconfirmed")
        self.last[dxl_id, item.address] = value

    def _value(self, item: Item) -> int:
        if item.size == 4 and self.chance.random() < 0.1:
            return _HEADER_LIKE
        return self.chance.randrange(1 << (8 * item.size - 2))

    def _judge(self, dxl_id: int, item: Item, value: int, begin: float) -> None:
        self.tally.values += 1
        if value not in self.port.held(dxl_id, item.address, begin):
            self._count_wrong("wrong")
        elif value != self.last.get((dxl_id, item.address), value):
            self.tally.undone += 1
            self.last[dxl_id, item.address] = value

    def _judge_clock(self, value: int, begin: float) -> None:
        """Realtime Tick goes round after 32.8 s."""
        self.tally.clock_values += 1
        age_ms = (int(begin * 1000) - value) % 32768
        self.tally.old += _FRESH_S * 1000 < age_ms < 16384
        if 1000 < age_ms < 16384:
            self._count_wrong("wrong")

    def _count_failed(self, errors: Iterable[DeviceError]) -> None:
        kinds = {type(error) for error in errors}
        self.tally.failed += bool(kinds)
        if StatusError in kinds:
            self._count_wrong("misled")

    def _count_wrong(self, what: str) -> None:
        told = self.port.let_through_s
        if told and self.clock.now() - told[-1] < _TELLING_S:
            what = "let_through"
        setattr(self.tally, what, getattr(self.tally, what) + 1)


def talk(kind: Kind, seed: int, instructions: int) -> Tally:
    """Exchange so many instructions over a wire of a kind, all chance from the seed."""
    talking = _Talk(kind, seed)
    while talking.tally.instructions < instructions:
        talking.step()
    talking.tally.damaged_packets_let_through = len(talking.port.let_through_s)
    return talking.tally


def loop(kind: Kind, seed: int, instructions: int) -> Tally:
    """The same with a control loop, in which only the age of what is measured is judged."""
    looping = _Talk(kind, seed)
    number = 0
    while looping.tally.instructions < instructions:
        looping.cycle(number)
        number += 1
    return looping.tally
