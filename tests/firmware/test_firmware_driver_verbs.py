"""The Python driver's rarer verbs against the firmware over a pseudo-terminal."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from array_host import array_host, expected_counts

from palpate.base.errors import DeviceError
from palpate.drivers.tactile import Shape, TactileArray, TactileFrame
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import BadTaxel, SelfTestResult, TaxelFault
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port

ROWS, COLS, DEPTH = 4, 5, 12
LARGEST = (1 << DEPTH) - 1
SIZE = ("--rows", ROWS, "--cols", COLS, "--depth", DEPTH)
PATIENCE_S = 5.0


@contextmanager
def connected(built: Path, *options: object) -> Iterator[tuple[TactileArray, Description]]:
    """The driver on the checked host program, whose frames come in real time."""
    with array_host(built / "palpate-array-host-checked", *SIZE, *options) as host:
        port = open_port(host.path, 1_000_000)
        try:
            array = TactileArray(port, MonotonicClock(), "served")
            yield array, array.connect()
            array.stop()
        finally:
            port.close()


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
    with connected(built, option) as (array, _), pytest.raises(DeviceError, match=why):
        array.self_test()


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
