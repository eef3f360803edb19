"""Our bus against a device that was not written here: the vendor's library for devices, compiled."""

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from vendor_device_process import compiled_device, vendor_device

from palpate.drivers.dynamixel import Bus, Servo
from palpate.drivers.dynamixel.control_table import Item
from palpate.drivers.dynamixel.errors import NotAnswering
from palpate.drivers.dynamixel.models import model_by_name
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(120)]

BAUD = 1_000_000
MODEL = model_by_name("XM430-W350", 46)
OWN = range(10)  # addresses that the library keeps for itself
ITEMS = [
    item
    for name, item in MODEL.items.items()
    if item.address not in OWN and not name.startswith(("Indirect", "External"))
]
STUFFED = (0xFFFFFF, 0xFDFFFFFF, 0xFFFDFFFF, 0xFFFFFDFF)  # what looks like a header has to be stuffed


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled_device(tmp_path_factory.mktemp("vendor"))


@pytest.fixture
def bus(program: Path) -> Iterator[Bus]:
    with vendor_device(program, MODEL.number, 46, 7, ITEMS) as path:
        opened = Bus(open_port(path, BAUD), MonotonicClock(), BAUD, latency_s=0.1)
        yield opened
        opened.close()


def value_of(rng: random.Random, item: Item) -> int:
    """Any value of the item's size, often one that has to be stuffed."""
    bits = 8 * item.size
    raw = rng.choice([rng.getrandbits(bits), rng.choice(STUFFED) & (2**bits - 1)])
    return raw - 2**bits if item.signed and raw >> (bits - 1) else raw


def test_it_is_found_and_known(bus: Bus) -> None:
    assert (bus.ping(7).model_number, bus.ping(7).firmware) == (MODEL.number, 46)
    Servo(bus, 7).check()
    with pytest.raises(NotAnswering):
        bus.ping(8)


def test_whatever_is_written_is_read_back(bus: Bus) -> None:
    rng = random.Random(1)
    held: dict[Item, int] = dict.fromkeys(ITEMS, 0)
    for _ in range(400):
        item = rng.choice(ITEMS)
        if rng.random() < 0.5:
            held[item] = value_of(rng, item)
            bus.write(7, item, held[item])
        assert bus.read(7, item) == held[item], item.name
    assert {item: bus.read(7, item) for item in ITEMS} == held
    assert (bus.counts.damaged, bus.counts.retries) == (0, 0)
