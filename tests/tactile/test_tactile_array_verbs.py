"""The host driver's rate, tare, self-test, geometry and versions against the emulated array."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from memory_port import DESCRIPTION, bench, emulated, plugged
from tactile_vectors import PLACES, wire

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import encode
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.tactile.messages import (
    BadTaxel,
    Hello,
    Message,
    SelfTestReport,
    SelfTestResult,
    TaxelFault,
    TaxelPlaces,
)
from palpate.drivers.transport.wire import Emission


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
