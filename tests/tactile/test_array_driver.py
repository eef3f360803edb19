"""The driver of an array: answers, verbs, mock port, boards that boot."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.emulators.wire_faults import BootingBoard, FaultyWire
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    BadTaxel,
    Frame,
    Hello,
    Message,
    SelfTestReport,
    SelfTestResult,
    Start,
    TaxelFault,
    TaxelPlaces,
)
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission, wire_time_s
from palpate.testing import ArrayBench
from support.devices.array_wire import DESCRIPTION, MemoryPort, bench, emulated, plugged
from support.oracles.array_messages import PLACES, wire

# ----------------------------------------------------------------------------------------------------
# The host driver against the emulated array over a wire in memory, in virtual time.


def test_description_comes_over_the_wire() -> None:
    array, *_ = bench()
    got = array.connect()
    assert got == DESCRIPTION
    assert array.description is got


def test_frames_come_at_the_rate_asked_for_with_both_times() -> None:
    array, _, clock, _ = bench(noise_counts=0.0)
    array.connect()
    array.start(200.0)
    began = clock.now()
    clock.sleep(0.1001)
    frames = array.frames()
    assert len(frames) == 20
    np.testing.assert_allclose([f.device_time_s - began for f in frames], np.arange(1, 21) / 200, atol=2e-6)
    assert all(f.host_time_s == clock.now() for f in frames)
    assert [f.sequence for f in frames] == list(range(frames[0].sequence, frames[0].sequence + 20))
    assert frames[0].counts.shape == (8, 20)
    assert frames[0].counts.dtype == np.uint16
    array.stop()
    clock.sleep(1.0)
    assert array.frames() == []
    assert array.counters.lost == array.counters.faults == 0


def test_waiting_for_a_frame_passes_virtual_time() -> None:
    array, _, clock, _ = bench()
    array.connect()
    array.start(50.0)
    began = clock.now()
    array.wait_frame(0.1)
    assert 0.02 <= clock.now() - began < 0.03
    array.stop()
    with pytest.raises(DeviceError, match=r"f1 on mem://f1 sent no frame for 0\.1 s"):
        array.wait_frame(0.1)


def test_a_silent_port_is_named() -> None:
    clock = VirtualClock()
    array = TactileArray(MemoryPort(None, clock), clock, "f1")
    with pytest.raises(DeviceError, match="tactile array f1 on mem://f1 does not answer; check its power"):
        array.connect()
    assert 3.5 < clock.now() < 5.5  # boards that reset as their port opens are waited for
    with pytest.raises(DeviceError, match="call connect"):
        array.start(10.0)


def test_an_unplugged_port_is_named() -> None:
    array, port, _, _ = bench()
    array.connect()
    port.unplugged = True
    with pytest.raises(DeviceError, match="f1 on mem://f1 is gone"):
        array.frames()


def test_rates_out_of_range_are_refused_by_both_ends() -> None:
    array, _, _, emulated = bench()
    array.connect()
    with pytest.raises(DeviceError, match="cannot sample at 501 Hz; choose a rate up to 500 Hz"):
        array.start(501.0)
    answer = emulated.feed(encode(Message(9, 0, Start(77, 600_000))), 1.0)
    (item,) = Decoder().feed(answer[0][1])
    assert isinstance(item, Message)
    assert "BAD_RATE" in repr(item.body)
    assert emulated.next_sample_s() is None


def test_damage_on_the_wire_is_counted_and_survived() -> None:
    array, port, clock, _ = bench()
    array.connect()
    array.start(200.0)
    size = 347
    port.damage = {port.received + size * 3 + 100, port.received + size * 7 + 10}
    clock.sleep(0.1001)
    assert len(array.frames()) == 18
    assert array.counters.lost == 2
    assert array.counters.faults == 4  # two broken frames, two gaps
    assert array.counters.frames == 18


def test_hello_ends_a_stream_left_running() -> None:
    array, _, clock, emulated = bench()
    array.connect()
    array.start(200.0)
    clock.sleep(0.05)
    array.connect()
    assert emulated.next_sample_s() is None
    assert array.frames() == []


def test_same_seed_same_bytes_and_every_fault_shows() -> None:
    force = np.zeros((8, 20))
    force[3, 10] = 0.4
    force[2, 2] = 9.0
    force[5, 5] = 0.2
    taken = []
    for _ in range(2):
        array, _, _, _ = bench(
            force, gain_spread=0.2, offset_counts=30, crosstalk=0.1, dead=[(5, 5)], hot=[(0, 0)]
        )
        array.connect()
        array.start(100.0)
        taken.append(array.wait_frame(0.1).counts)
    np.testing.assert_array_equal(taken[0], taken[1])
    counts = taken[0].astype(float)
    assert counts[5, 5] == 0
    assert counts[0, 0] == 4095
    assert counts[2, 2] == 4095
    assert 0.48 * 0.4 * 4095 < counts[3, 10] - 30 < 0.72 * 0.4 * 4095
    assert 0.07 * 0.4 * 4095 < counts[3, 11] - 30 < 0.13 * 0.4 * 4095
    assert abs(counts[7, 19] - 30) < 12


# ----------------------------------------------------------------------------------------------------
# The host driver's rate, tare, self-test, geometry and versions against the emulated array.


def free(rows: int, cols: int) -> Description:
    """A dome: every taxel somewhere else, facing away from the middle."""
    rng = np.random.default_rng(11)
    normals = rng.normal(size=(rows * cols, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    places = np.concatenate((7 * normals, normals), axis=1).astype(np.float32)
    return replace(
        DESCRIPTION,
        shape=Shape.FREE,
        rows=rows,
        cols=cols,
        tip_radius_mm=0.0,
        columns=(),
        row_heights_mm=(),
        geometry=tuple(map(float, places.ravel())),
    )


class Told:
    """A device that answers what it is told to, `late_s` after the question."""

    def __init__(self, answer: Callable[[bytes, float], bytes], late_s: float = 0.0) -> None:
        self.answer = answer
        self.late_s = late_s
        self.queue: list[Emission] = []

    def feed(self, data: bytes, now: float) -> list[Emission]:
        self.queue.append((now + self.late_s, self.answer(data, now)))
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        due = [item for item in self.queue if item[0] <= now]
        self.queue = [item for item in self.queue if item[0] > now]
        return due

    def next_due(self) -> float | None:
        return self.queue[0][0] if self.queue else None


def always(answer: bytes) -> Told:
    return Told(lambda *_: answer)


def test_a_free_array_tells_where_its_taxels_are() -> None:
    truth = free(9, 31)
    array, port, _ = plugged(emulated(Taxels(truth, seed=1)))
    told = array.connect()
    assert told == truth
    assert told.positions_mm().shape == (9, 31, 3)
    np.testing.assert_allclose(told.positions_mm(), 7 * told.normals(), atol=1e-5)
    assert len(port.written) == 1 + 5  # 279 taxels, 64 in an answer


def test_lost_questions_about_places_are_asked_again() -> None:
    truth = free(4, 40)
    array, port, _ = plugged(emulated(Taxels(truth, seed=1)))
    port.deaf = {0, 1, 3, 5}  # two times HELLO, and two times GEOMETRY
    assert array.connect() == truth
    assert len(port.written) == 3 + 2 * 2 + 1


@pytest.mark.parametrize(("first", "places"), [(1, PLACES[:6]), (0, PLACES * 2)])
def test_places_that_do_not_fit_are_refused(first: int, places: tuple[float, ...]) -> None:
    device = emulated(Taxels(free(1, 2), seed=1))
    places_told = encode(Message(1, 0, TaxelPlaces(2, first, places)))
    describe = device.feed(encode(Message(0, 0, Hello(1))), 0.0)[0][1]
    answers = iter((describe, places_told))
    array, _, clock = plugged(Told(lambda *_: next(answers)))
    with pytest.raises(DeviceError, match=r"was asked .* from number 0 on, .* it has 2: check"):
        array.connect()
    assert clock.now() < 0.1
    with pytest.raises(DeviceError, match="call connect"):
        array.start(10.0)


def test_a_new_rate_goes_on_where_the_stream_was() -> None:
    array, _, clock, _ = bench()
    array.connect()
    array.start(100.0)
    clock.sleep(0.0305)
    array.set_rate(50.0)
    clock.sleep(0.05)
    times = [frame.device_time_s for frame in array.frames()]
    np.testing.assert_allclose(np.diff(times), [0.01, 0.01, 0.02, 0.02], atol=2e-6)
    array.stop()
    with pytest.raises(DeviceError, match=r"refuses to change the rate \(BAD_STATE\); .* start it first"):
        array.set_rate(50.0)
    with pytest.raises(DeviceError, match="cannot sample at 501 Hz"):
        array.set_rate(501.0)


def test_tared_frames_are_marked_and_say_what_changed() -> None:
    array, _, clock, device = bench(offset_counts=300, noise_counts=0.0, hot=[(0, 0)])
    array.connect()
    array.start(100.0)
    array.tare(4, pedestal=64)
    clock.sleep(0.0605)
    frames = array.frames()
    assert [frame.tared for frame in frames] == [False] * 4 + [True] * 2
    assert np.unique(frames[3].counts).tolist() == [300, 4095]
    assert np.unique(frames[4].counts).tolist() == [64, 4095]
    array.untare()
    frame = array.wait_frame(0.1)
    assert not frame.tared
    assert frame.counts[3, 3] == 300
    assert device.next_sample_s() is not None


@pytest.mark.parametrize(("samples", "pedestal"), [(0, 0), (1025, 0), (16, -1), (16, 4096)])
def test_a_tare_that_no_array_can_do_is_not_sent(samples: int, pedestal: int) -> None:
    array, port, _, _ = bench()
    array.connect()
    with pytest.raises(DeviceError, match=r"cannot tare .* choose 1 to 1024 samples and 0 to 4095 counts"):
        array.tare(samples, pedestal)
    assert len(port.written) == 1


def test_the_self_test_reports_bad_taxels() -> None:
    array, _, clock, _ = bench(dead=[(1, 2)])
    array.connect()
    report = array.self_test()
    assert report.bad == (BadTaxel(1, 2, TaxelFault.STUCK_LOW),)
    assert report.result == SelfTestResult.TAXELS
    assert 0.2 < clock.now() < 0.4
    array.start(100.0)
    with pytest.raises(DeviceError, match="cannot test itself while it streams; stop it first"):
        array.self_test()


def test_a_self_test_that_an_array_does_not_know_is_none() -> None:
    array, port, _, _ = bench()
    array.connect()
    assert array.self_test_if_known() == SelfTestReport(2, SelfTestResult(0), 0, ())
    number = len(port.written) + 1
    port.device = always(wire(0x83, 1, 0, bytes((number, 0, 1))))
    assert array.self_test_if_known() is None
    port.device = always(wire(0x83, 1, 0, bytes((number + 1, 0, 4))))
    with pytest.raises(DeviceError, match=r"refuses to test itself \(HARDWARE\)"):
        array.self_test_if_known()


def test_a_self_test_may_take_two_seconds_and_is_asked_for_once_more() -> None:
    array, port, clock = plugged(emulated(Taxels(DESCRIPTION, seed=1), self_test_s=2.0))
    array.connect()
    port.deaf = {1}
    assert array.self_test().bad_count == 0
    assert len(port.written) == 3
    assert clock.now() < 5.0
    port.deaf = {3, 4}
    with pytest.raises(DeviceError, match="did not answer a request to test itself; check its power"):
        array.self_test()


def test_a_broken_array_says_so() -> None:
    device = emulated(Taxels(DESCRIPTION, seed=1), broken=SelfTestResult.CONVERTER)
    array, _, _ = plugged(device)
    array.connect()
    with pytest.raises(DeviceError, match=r"refuses to start \(HARDWARE\); something in it is broken"):
        array.start(100.0)
    assert array.self_test().result == SelfTestResult.CONVERTER


VERBS: list[Callable[[TactileArray], object]] = [
    lambda array: array.start(10.0),
    lambda array: array.set_rate(10.0),
    lambda array: array.stop(),
    lambda array: array.tare(1),
    lambda array: array.untare(),
    lambda array: array.self_test(),
]


@pytest.mark.parametrize("verb", VERBS)
def test_an_older_array_that_does_not_know_a_verb_is_named(verb: Callable[[TactileArray], object]) -> None:
    array, port, _, _ = bench()
    array.connect()
    number = len(port.written) + 1
    port.device = always(wire(0x83, 1, 0, bytes((number, 0, 1))))
    with pytest.raises(DeviceError, match=r"f1 on mem://f1 refuses to .* \(UNKNOWN_TYPE\); its firmware"):
        verb(array)


def test_an_array_of_another_version_is_named_at_once() -> None:
    array, _, clock = plugged(emulated(Taxels(DESCRIPTION, seed=1), version=2))
    with pytest.raises(DeviceError, match=r"f1 on mem://f1 speaks version 2 .* speaks version 1; put"):
        array.connect()
    assert clock.now() < 0.1


def test_frames_of_another_version_name_it_too_but_requests_do_not() -> None:
    array, port, clock = plugged(always(wire(0x90, 5, 0, b"\x01\x01\x00\x00", version=3)))
    with pytest.raises(DeviceError, match="speaks version 3"):
        array.connect()
    port.device = always(wire(0x01, 5, 0, b"\x01\x00", version=3))  # an echo of another host's
    with pytest.raises(DeviceError, match="does not answer"):
        array.connect()
    assert clock.now() > 1.0


def test_an_answer_that_comes_late_is_still_one() -> None:
    device = emulated(Taxels(DESCRIPTION, seed=1))
    array, port, _ = plugged(
        Told(lambda data, now: b"".join(said for _, said in device.feed(data, now)), 0.2)
    )
    array.connect()
    array.start(100.0)
    assert len(port.written) == 3  # START had to be said twice
    numbers = {data[-10:] for data in port.written}
    assert len(numbers) == 3


def test_an_echo_of_one_s_own_request_is_no_answer() -> None:
    array, port, _, _ = bench()
    array.connect()
    port.device = Told(lambda data, _: data)
    with pytest.raises(DeviceError, match="did not answer a request to stop"):
        array.stop()


# ----------------------------------------------------------------------------------------------------
# The tactile driver on the mock transport: wire time is accounted and nothing is lost.

BAUD = 1_000_000


def test_a_session_over_the_mock_wire() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "tactile-session")
    device = emulated(Taxels(DESCRIPTION, seed=1))
    array = TactileArray(open_port(hub.attach("f1", device, BAUD), BAUD), clock, "f1")
    assert array.connect() == DESCRIPTION
    assert clock.now() < 0.02, "it is not waited for as boards are that reset"
    array.start(200.0)
    got = [array.wait_frame(0.1) for _ in range(50)]
    period = np.diff([f.device_time_s for f in got])
    np.testing.assert_allclose(period, 0.005, atol=2e-6)
    late = [f.host_time_s - f.device_time_s for f in got]
    shortest = encode(Message(0, 0, Frame(8, 20, bytes(320))))
    assert min(late) >= wire_time_s(len(shortest), BAUD) - 1e-12
    assert max(late) < 0.012
    array.stop()
    clock.sleep(0.1)
    array.frames()
    with pytest.raises(DeviceError, match="sent no frame"):
        array.wait_frame(0.05)
    assert array.counters.lost == array.counters.faults == 0


def test_the_wrong_baud_rate_is_a_silent_array() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "tactile-baud")
    port = open_port(hub.attach("f1", emulated(Taxels(DESCRIPTION, seed=1)), BAUD), 115_200)
    with pytest.raises(DeviceError, match="tactile array f1 on mock://tactile-baud/f1 does not answer"):
        TactileArray(port, clock, "f1").connect()


# ----------------------------------------------------------------------------------------------------
# Boards that reset as their port opens: they are waited for, and one that answers at once costs no time.

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


def test_once_connected_silence_is_told_sooner() -> None:
    bench = OnABoard(0.5)
    array = bench.open()
    array.connect()
    bench.board.boot_s = 60.0
    bench.board.note_opened(bench.clock.now())  # another program opens the port
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
    bench.board.note_opened(bench.clock.now())
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
