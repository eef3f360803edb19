"""Boards that reset as their port opens: they are waited for, and one that answers at once costs no time."""

import numpy as np
import pytest
from array_contract import BAUD, MOUNTING
from memory_port import DESCRIPTION, emulated

from palpate.drivers.emulators.booting import BootingBoard
from palpate.drivers.emulators.faults import FaultyWire
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.weiss import EmulatedWts
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.devices import open_array
from palpate.drivers.tactile.weiss_messages import MatrixInfo
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.port import open_port
from palpate.errors import DeviceError

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


def test_other_protocols_are_waited_for_too() -> None:
    truth = MOUNTING.describe(
        (7, 5),
        (3.4, 3.4),
        unique_id=b"any",
        firmware="any",
        emulated=True,
        bit_depth=12,
        max_rate_hz=100.0,
    )

    def advance(now: float) -> None:
        while (due := device.next_sample_s()) is not None and due <= now:
            device.sample(due, np.zeros((5, 7)))

    device = EmulatedWts(Taxels(truth, seed=2), MatrixInfo(7, 5, 3.4, 3.4, 4095.0), advance, baudrate=BAUD)
    clock = VirtualClock()
    hub = MockHub(clock, "wts")
    board = BootingBoard(device, 2.5, lambda _: None, TEXT)
    array = open_array("weiss-wts", open_port(hub.attach("f1", board, BAUD), BAUD), clock, "f1", MOUNTING)
    assert array.connect().rows == 5
    assert clock.now() < 4.5
