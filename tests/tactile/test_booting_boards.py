"""Boards that reset as their port opens: they are waited for, and one that answers at once costs no time."""

import pytest
from memory_port import DESCRIPTION, emulated

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.wire_faults import BootingBoard, FaultyWire
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.testing import ArrayBench

BAUD = 1_000_000
TEXT = b"\r\nets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET),boot:0x13\r\n"


class OnABoard:
    """An emulated array on a board that resets, and its driver on a port that was just opened."""

    def __init__(self, boot_s: float, says: bytes = TEXT) -> None:
        device = emulated(Taxels(DESCRIPTION, seed=5))
        self.board = BootingBoard(device, boot_s, device.restart, says)
        self.clock = VirtualClock()
        self.hub = MockHub(self.clock, "board")
        self.url = self.hub.attach("f1", FaultyWire(self.board, 1), BAUD)

    def open(self) -> TactileArray:
        return TactileArray(open_port(self.url, BAUD), self.clock, "f1")


@pytest.mark.parametrize("boot_s", [0.001, 0.4, 0.501, 1.0, 1.7, 2.0, 3.0, 3.4])
@pytest.mark.parametrize("says", [b"", TEXT, TEXT + b"\0", b"\0" * 50])
def test_a_board_that_boots_is_waited_for(boot_s: float, says: bytes) -> None:
    bench = OnABoard(boot_s, says)
    array = bench.open()
    assert array.connect() == DESCRIPTION
    assert boot_s <= bench.clock.now() < boot_s + 1.2
    array.start(200.0)
    assert len([array.wait_frame(0.1) for _ in range(20)]) == 20
    assert bench.board.resets == 1


def test_an_array_that_answers_at_once_is_not_waited_for() -> None:
    bench = OnABoard(0.0, b"")
    bench.open().connect()
    assert bench.clock.now() < 0.02


def test_a_board_that_never_boots_is_an_error_within_seconds() -> None:
    bench = OnABoard(60.0)
    with pytest.raises(DeviceError, match=r"tactile array f1 on mock://\S+ does not answer; check its power"):
        bench.open().connect()
    assert 4.0 < bench.clock.now() < 6.0


def test_once_connected_silence_is_told_sooner() -> None:
    bench = OnABoard(0.5)
    array = bench.open()
    array.connect()
    bench.board.boot_s = 60.0
    bench.board.opened(bench.clock.now())  # another program opens the port
    began = bench.clock.now()
    with pytest.raises(DeviceError, match="does not answer"):
        array.connect()
    assert bench.clock.now() - began < 1.6


def test_a_board_that_another_program_resets_in_a_stream_is_told_as_restarted() -> None:
    bench = OnABoard(0.5)
    array = bench.open()
    array.connect()
    array.start(100.0)
    for _ in range(100):
        array.wait_frame(0.1)
    array.frames()
    bench.board.opened(bench.clock.now())
    with pytest.raises(DeviceError, match=r"sent no frame for 0\.15 s"):
        array.wait_frame(0.15)
    bench.clock.sleep(1.0)
    with pytest.raises(DeviceError, match=r"f1 on mock://\S+ has restarted \(number \d+ at .* s of its"):
        array.start(100.0)
    array.start(100.0)
    assert array.wait_frame(0.1).device_time_s < 2.0


@pytest.mark.parametrize("protocol", ["weiss-wts", "weiss-dsa"])
def test_other_protocols_are_waited_for_too(protocol: str) -> None:
    bench = ArrayBench(protocol, {"counts_per_n": 1000.0})
    board = BootingBoard(bench.device, 2.5, bench.device.restart, TEXT)
    hub = MockHub(bench.clock, "booting")
    port = open_port(hub.attach("f1", board, BAUD), BAUD)
    array = bench.plugin.driver(port, bench.clock, "f1", bench.config, bench.tip_radius_mm)
    assert array.connect().rows == 5
    assert bench.clock.now() < 4.5
