"""The firmware as a host program, by hand and by the driver's verbs."""

import os
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.base.errors import DeviceError
from palpate.base.geometry import Counts
from palpate.drivers.tactile import Shape, TactileArray, TactileFrame
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import BadTaxel, SelfTestResult, TaxelFault
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from support.commands.command import PATIENCE_S
from support.devices.firmware import (
    ArrayHost,
    Sips,
    array_host,
    exchange,
    expected_counts,
    read_quiet,
    read_until,
)
from support.oracles.array_messages import (
    ACK,
    DESCRIBE,
    FRAME,
    GEOMETRY,
    HELLO,
    RATE,
    REPORT,
    SELF_TEST,
    START,
    STOP,
    TARE,
    Reason,
    Said,
    frame_counts,
    request,
    said,
)

# ----------------------------------------------------------------------------------------------------
# The firmware in a process of its own and the Python driver: two implementations of one page.

SIP = 65536


@pytest.fixture
def checked(built: Path) -> Path:
    """The host program watched by sanitizers."""
    return built / "palpate-array-host-checked"


@contextmanager
def driven(host: ArrayHost) -> Iterator[tuple[TactileArray, Sips]]:
    port = open_port(host.path, 1_000_000)
    try:
        sips = Sips(port, SIP)
        yield TactileArray(sips, MonotonicClock(), "served"), sips
    finally:
        port.close()


@contextmanager
def opened(host: ArrayHost) -> Iterator[int]:
    descriptor = os.open(host.path, os.O_RDWR | os.O_NOCTTY)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def ask(descriptor: int, kind: int, number: int, *values: int) -> Said:
    """The answer to a request while no stream runs."""
    os.write(descriptor, b"\x00" + request(kind, number, *values))
    (answer,) = said(read_until(descriptor, 1))
    assert answer.request == number
    return answer


@pytest.mark.parametrize("shape", [Shape.FLAT, Shape.CYLINDER])
def test_the_driver_reads_the_description(checked: Path, shape: Shape) -> None:
    options = ("--rows", 3, "--cols", 20, "--depth", 12, "--rate-max", 250.5, "--shape", shape.name.lower())
    with array_host(checked, *options) as host, driven(host) as (array, _):
        found = array.connect()
        again = array.connect()
    assert (found.shape, found.rows, found.cols, found.bit_depth) == (shape, 3, 20, 12)
    assert (found.max_rate_hz, found.firmware, found.emulated) == (250.5, "palpate-array-host 1", True)
    assert found.tip_radius_mm == (8.0 if shape is Shape.CYLINDER else 0.0)
    assert again == found
    assert host.told["answers"] == 2


@pytest.mark.parametrize("shape", [Shape.FLAT, Shape.CYLINDER])
def test_places_told_one_by_one_are_those_of_the_description(checked: Path, shape: Shape) -> None:
    options = ("--rows", 4, "--cols", 5, "--shape", shape.name.lower())
    with array_host(checked, *options) as host:
        with driven(host) as (array, _):
            description = array.connect()
        with opened(host) as descriptor:
            payload = ask(descriptor, GEOMETRY, 1, 0).payload
    places = np.array(list(struct.iter_unpack("<6f", payload[5:])))
    np.testing.assert_allclose(places[:, :3], description.positions_mm().reshape(-1, 3), atol=1e-5)
    np.testing.assert_allclose(places[:, 3:], description.normals().reshape(-1, 3), atol=1e-6)


def test_every_request_over_the_line(checked: Path) -> None:
    bad = ("--stuck", "0,1,low", "--stuck", "7,7,high", "--stuck", "3,4,unsteady")
    with array_host(checked, *bad, "--rate-max", 100) as host, opened(host) as descriptor:
        assert ask(descriptor, HELLO, 1).type == DESCRIBE
        report = ask(descriptor, SELF_TEST, 2)
        assert report.type == REPORT
        assert report.payload[2:] == struct.pack("<HH", 16, 3) + bytes([0, 1, 1, 3, 4, 3, 7, 7, 2])
        assert ask(descriptor, RATE, 3, 1000).reason == Reason.BAD_STATE
        assert ask(descriptor, START, 4, 100_001).reason == Reason.BAD_RATE
        assert ask(descriptor, START, 5, 1).type == ACK  # a frame in 1000 s: answers only
        assert ask(descriptor, SELF_TEST, 6).reason == Reason.BAD_STATE
        assert ask(descriptor, RATE, 7, 2).type == ACK
        assert ask(descriptor, TARE, 8, 16, 64).type == ACK
        assert ask(descriptor, 0x33, 9).reason == Reason.UNKNOWN_TYPE
        assert ask(descriptor, STOP, 10).type == ACK
        assert ask(descriptor, SELF_TEST, 11).type == REPORT
    assert (host.told["answers"], host.told["faults"]) == (11, 0)


def collect(array: TactileArray, sips: Sips, wanted: int) -> tuple[NDArray[np.uint32], Counts]:
    """Numbers and counts of frames until so many have come or are known to be lost."""
    numbers, counts = [], []
    while array.counters.frames + array.counters.lost < wanted:
        sips.refill()
        frames = array.frames()
        frames = frames or [array.wait_frame(5.0)]
        numbers += [frame.sequence for frame in frames]
        counts += [frame.counts for frame in frames]
    rest = array.frames()  # that came while one was waited for
    numbers += [frame.sequence for frame in rest]
    counts += [frame.counts for frame in rest]
    return np.array(numbers, np.uint32), np.array(counts)


@pytest.mark.parametrize(("rows", "cols", "depth", "frames"), [(8, 8, 16, 20_000), (4, 5, 12, 2_000)])
def test_the_driver_loses_and_misreads_nothing(
    built: Path, rows: int, cols: int, depth: int, frames: int
) -> None:
    size = ("--rows", rows, "--cols", cols, "--depth", depth, "--frames", frames)
    with array_host(built / "palpate-array-host", "--fast", *size) as host, driven(host) as (array, sips):
        array.connect()
        array.start(1000)
        numbers, counts = collect(array, sips, frames)
        array.stop()
    # An answer takes a number, too: a request is repeated if a busy computer is late to read the first one.
    repeated = host.told["answers"] - 3
    assert (len(numbers), numbers[0]) == (frames, 2)
    assert np.all(np.diff(numbers.astype(np.int64)) > 0)
    assert numbers[-1] - 1 - frames <= repeated
    np.testing.assert_array_equal(counts, expected_counts(numbers, rows, cols, depth))
    found = array.counters
    assert (found.frames, found.lost, found.faults, found.dropped) == (frames, 0, 0, 0)
    assert (host.told["frames"], host.told["given_up"]) == (frames, 0)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_flipped_bytes_cost_messages_that_are_counted(built: Path, seed: int) -> None:
    """What came and what is missing are all numbers that were used, and no wrong frame is among them."""
    frames = 20_000
    options = ("--fast", "--frames", frames, "--flip", 1e-4, "--flip-in", 1e-4, "--seed", seed)
    with array_host(built / "palpate-array-host", *options) as host:
        taken, lost = exchange(host, 8, 8, frames)
    told = host.told
    assert (told["frames"], told["given_up"], taken.wrong) == (frames, 0, 0)
    assert taken.frames + taken.answers + lost == taken.last - taken.first, "no number is unaccounted for"
    assert taken.last + 1 == told["numbers"]
    answers_lost = told["answers"] - taken.first - 1 - taken.answers
    assert frames == taken.frames + lost - answers_lost
    assert len(taken.phases) == 1, "instants are one period apart"
    # A flipped delimiter costs the next message, too. Fewer lost than hit: a damaged one was taken.
    assert 200 < told["flipped_messages"] <= lost + taken.first
    assert lost + taken.first <= told["flipped_messages"] + told["flipped_delimiters"]


def test_a_host_that_does_not_read_misses_frames_that_are_counted(checked: Path) -> None:
    """The device goes on in real time: it sends what it had handed over, and the rest is a gap."""
    size = ("--rows", 32, "--cols", 32, "--frames", 400, "--rate-max", 2000)
    with array_host(checked, *size) as host, opened(host) as descriptor:
        os.write(descriptor, request(HELLO, 1) + request(START, 2, 2_000_000))
        time.sleep(0.3)
        stream = read_quiet(descriptor, 0.2)
        os.write(descriptor, request(STOP, 3))
        came = said(stream + read_until(descriptor, 1))
    told = host.told
    numbers = [found.sequence for found in came]
    frames = [found for found in came if found.type == FRAME]
    assert numbers == sorted(set(numbers))
    assert len(frames) == told["frames"]
    assert told["given_up"] > 100
    assert came[-1].type == ACK
    assert numbers[-1] + 1 == len(came) + told["given_up"], "each gap is of frames that were given up"
    for found in frames:
        (counts,) = expected_counts(np.array([found.sequence]), 32, 32)
        assert frame_counts(found) == counts.ravel().tolist()


def test_any_bytes_leave_it_listening(checked: Path) -> None:
    rng = np.random.default_rng(11)
    with array_host(checked, "--rows", 2, "--cols", 2) as host, opened(host) as descriptor:
        for number in range(1, 60):
            noise = rng.integers(0, 256, rng.integers(1, 400)).astype(np.uint8).tobytes()
            os.write(descriptor, noise + b"\x00" + request(HELLO, number))
            (answer,) = said(read_until(descriptor, 1))
            assert (answer.type, answer.request) == (DESCRIBE, number)
    assert host.told["faults"] >= 59


def test_clients_may_come_and_go(checked: Path) -> None:
    with array_host(checked) as host:
        for _ in range(3):
            with driven(host) as (array, _sips):
                assert array.connect().rows == 8


def test_it_ends_by_sigterm_too(checked: Path) -> None:
    with array_host(checked) as host:
        assert host.terminate()["numbers"] == 0


@pytest.mark.parametrize(
    "options",
    [
        ("--rows", "0"),
        ("--rows", "8x"),
        ("--flip", "2"),
        ("--shape", "round"),
        ("--depth", "17"),
        ("--stuck", "1,2"),
        ("--stuck", "9,9,low"),
        ("--rows", "255", "--cols", "255"),
        ("--nonsense",),
        ("more",),
    ],
)
def test_options_that_cannot_be_are_refused(checked: Path, options: tuple[str, ...]) -> None:
    ended = subprocess.run(
        [str(checked), *options],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
    )
    assert ended.returncode == 2
    assert ended.stdout == ""
    assert ended.stderr.count("\n") == 1


def test_the_largest_frames_fit_the_decoder(built: Path) -> None:
    with (
        array_host(
            built / "palpate-array-host", "--rows", 64, "--cols", 64, "--fast", "--frames", 300
        ) as host,
        driven(host) as (array, sips),
    ):
        array.connect()
        array.start(1000)
        numbers, counts = collect(array, sips, 300)
        array.stop()
    np.testing.assert_array_equal(counts, expected_counts(numbers, 64, 64))
    assert (len(numbers), array.counters.faults) == (300, 0)


# ----------------------------------------------------------------------------------------------------
# The Python driver's rarer verbs against the firmware over a pseudo-terminal.

ROWS, COLS, DEPTH = 4, 5, 12
LARGEST = (1 << DEPTH) - 1
SIZE = ("--rows", ROWS, "--cols", COLS, "--depth", DEPTH)


@contextmanager
def connected(built: Path, *options: object) -> Iterator[tuple[TactileArray, Description]]:
    """The driver on the checked host program, whose frames come in real time."""
    with (
        array_host(built / "palpate-array-host-checked", *SIZE, *options) as host,
        driven(host) as (array, _),
    ):
        yield array, array.connect()
        array.stop()


def take(array: TactileArray, wanted: int) -> list[TactileFrame]:
    return [array.wait_frame(PATIENCE_S) for _ in range(wanted)]


def raw(frames: list[TactileFrame]) -> np.ndarray:
    """What the host program sampled for these frames."""
    return expected_counts(np.array([frame.sequence for frame in frames]), ROWS, COLS, DEPTH).astype(int)


def test_a_new_rate_goes_on_with_the_phase_of_the_old_one(built: Path) -> None:
    """With --fast the device's time goes on exactly from frame to frame."""
    with connected(built, "--fast") as (array, _):
        array.start(50)
        frames = take(array, 3)
        array.set_rate(400)
        while frames[-1].device_time_s - frames[-2].device_time_s > 0.01:
            frames += take(array, 1)
        frames += take(array, 3)
        assert array.counters.lost == 0
    steps = np.diff([frame.device_time_s for frame in frames])
    np.testing.assert_allclose(steps[:2], 0.02, atol=1e-9)
    np.testing.assert_allclose(steps[steps < 0.01], 0.0025, atol=1e-9)
    assert (np.diff(steps) <= 1e-9).all(), "once it is quicker it stays so"
    np.testing.assert_array_equal([frame.counts for frame in frames], raw(frames))


def test_tare_and_untare(built: Path) -> None:
    with connected(built) as (array, _):
        array.tare(3, 64)
        array.start(200)
        averaged = take(array, 3)
        tared = take(array, 3)
        array.untare()
        frames = take(array, 1)
        while frames[-1].tared:
            frames += take(array, 1)
    assert [frame.tared for frame in averaged + tared] == [False] * 3 + [True] * 3
    zero = np.floor(raw(averaged).mean(axis=0) + 0.5)
    seen = raw(tared)
    want = np.where(seen == LARGEST, LARGEST, np.clip(seen - zero + 64, 0, LARGEST))
    np.testing.assert_array_equal([frame.counts for frame in tared], want)
    np.testing.assert_array_equal(frames[-1].counts, raw(frames[-1:])[0])


def test_self_test(built: Path) -> None:
    bad = (BadTaxel(0, 1, TaxelFault.STUCK_LOW), BadTaxel(3, 4, TaxelFault.UNSTEADY))
    with connected(built, "--stuck", "0,1,low", "--stuck", "3,4,unsteady") as (array, _):
        report = array.self_test()
        array.start(10)
        with pytest.raises(DeviceError, match="cannot test itself while it streams"):
            array.self_test()
    assert (report.result, report.bad_count, report.bad) == (SelfTestResult.TAXELS, 2, bad)


@pytest.mark.parametrize(
    ("option", "why"), [("--broken", r"HARDWARE\).*repair"), ("--plain", r"UNKNOWN_TYPE\).*do without")]
)
def test_a_self_test_that_cannot_be(built: Path, option: str, why: str) -> None:
    with connected(built, option) as (array, _):
        with pytest.raises(DeviceError, match=why):
            array.self_test()
        if option == "--broken":
            with pytest.raises(DeviceError, match=r"refuses to start.*HARDWARE"):
                array.start(10)


def test_a_free_array_tells_its_places_and_streams(built: Path) -> None:
    with connected(built, "--shape", "free") as (array, told):
        array.start(200)
        frames = take(array, 2)
    assert (told.shape, told.columns, told.row_heights_mm) == (Shape.FREE, (), ())
    np.testing.assert_allclose(np.linalg.norm(told.normals(), axis=-1), 1, atol=1e-6)
    # half a sphere: rows are circles of latitude, the lowest at its equator
    turn = 2 * np.pi * np.arange(COLS) / COLS
    rise = np.pi / 2 * np.arange(ROWS)[:, None] / ROWS
    want = np.stack(
        np.broadcast_arrays(np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)), -1
    )
    np.testing.assert_allclose(told.normals(), want, atol=1e-6)
    np.testing.assert_array_equal([frame.counts for frame in frames], raw(frames))


@pytest.mark.parametrize(
    "verb",
    [
        lambda array: array.set_rate(50),
        lambda array: array.set_rate(2000),
        lambda array: array.tare(1, LARGEST + 1),
    ],
)
def test_what_cannot_be_is_refused(built: Path, verb: Callable[[TactileArray], None]) -> None:
    with connected(built) as (array, _), pytest.raises(DeviceError, match=r"start it first|choose"):
        verb(array)
