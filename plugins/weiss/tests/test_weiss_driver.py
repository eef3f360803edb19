"""The drivers of WTS and DSA against the emulated devices on a mock wire: every quirk, and faults."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.wire_faults import FaultRates, WireRates
from palpate.drivers.tactile.description import Corner, Mounting, Shape
from palpate.drivers.transport.wire import wire_time_s
from palpate_weiss.arrays import DsaArray, WtsArray
from palpate_weiss.codec import WeissDialect, WeissPacket, encode
from palpate_weiss.commands import DsaCommand, WtsCommand
from palpate_weiss.emulated_arrays import EmulatedDsa
from support.devices.weiss import Bench

BOTH = ["weiss-wts", "weiss-dsa"]


def say(bench: Bench, command: int, payload: bytes = b"") -> None:
    dialect = WeissDialect.WTS if isinstance(command, WtsCommand) else WeissDialect.DSA
    bench.device.feed(encode(dialect, WeissPacket(command, payload)), bench.clock.now())


def test_what_a_wts_is() -> None:
    bench = Bench("weiss-wts")
    told = bench.array.connect()
    assert bench.array.description is told
    assert (told.rows, told.cols, told.bit_depth, told.shape) == (4, 8, 12, Shape.CYLINDER)
    assert (told.firmware, told.unique_id[:8], told.emulated) == ("WTS 2.1.4.0", b"WTSg\x12\0\0\x10", True)
    assert (told.counts_per_n, told.full_scale_n, told.tip_radius_mm) == (1000.0, 4.095, 8.5)
    np.testing.assert_allclose(told.columns, 0.4 * (np.arange(8) - 3.5))
    np.testing.assert_allclose(told.row_heights_mm, 3.8 * (np.arange(4) + 0.5))
    assert bench.clock.now() < 0.3
    assert not Bench("weiss-wts", tag="my left finger").array.connect().emulated


def test_what_a_dsa_is_and_which_of_its_matrices_it_feels() -> None:
    bench = Bench("weiss-dsa", matrix=2)
    told = bench.array.connect()
    assert (told.rows, told.cols, told.firmware, told.emulated) == (4, 8, "DSACON32 R290", True)
    assert told.unique_id[:8] == b"DSA/\x03\0\0\x02"
    bench.world.force_n[1, 6] = 1.5
    bench.array.start(30.0)
    counts = bench.array.wait_frame(0.2).counts
    assert counts[1, 6] == 1520
    assert (np.delete(counts.ravel(), 8 + 6) == 20).all()


@pytest.mark.parametrize("protocol", BOTH)
def test_frames_are_as_the_tip_is_whatever_the_mounting(protocol: str) -> None:
    for first in Corner:
        for upright in (False, True):
            mounting = Mounting(Shape.CYLINDER, 8.5, 1000.0, first=first, upright=upright)
            bench = Bench(protocol, mounting)
            told = bench.array.connect()
            assert (told.rows, told.cols) == ((8, 4) if upright else (4, 8))
            bench.world.force_n[2, 1] = 0.7
            bench.world.force_n[0, 3] = 9.0
            bench.array.start(20.0)
            counts = bench.array.wait_frame(0.2).counts
            assert (counts[2, 1], counts[0, 3], counts[3, 3]) == (720, 4095, 20)


@pytest.mark.parametrize("tick_s", [1e-3, 1e-4, 1e-5, 1e-6])
def test_a_wts_whose_stamps_have_any_of_the_usual_units(tick_s: float) -> None:
    wrap_s = 2**32 * tick_s
    bench = Bench("weiss-wts", tick_s=tick_s, powered_s=0.4 - wrap_s)  # stamps wrap in the first second
    bench.array.connect()
    bench.array.start(100.0)
    got = [bench.array.wait_frame(0.1) for _ in range(50)]
    np.testing.assert_allclose(np.diff([f.device_time_s for f in got]), 0.01, atol=1.1e-3)
    assert [f.sequence for f in got] == list(range(50))
    late = [f.host_time_s - f.device_time_s for f in got]
    assert np.ptp(late) < 0.01
    assert bench.array.counters.lost == bench.array.counters.misshapen == 0


def test_a_wts_streams_at_the_rate_asked_for_and_no_faster_than_scan_and_wire() -> None:
    bench = Bench("weiss-wts")
    bench.array.connect()
    for asked, period_s in ((50.0, 0.02), (100.0, 0.01), (1000.0, wire_time_s(8 + 5 + 64, 115_200))):
        bench.array.start(asked)
        got = [bench.array.wait_frame(0.1) for _ in range(20)]
        bench.array.stop()
        bench.array.frames()
        assert (got[-1].device_time_s - got[0].device_time_s) / 19 == pytest.approx(period_s, abs=1e-4)
    bench.clock.sleep(0.5)
    assert bench.array.frames() == []
    assert bench.array.counters.lost == bench.array.counters.faults == 0
    with pytest.raises(DeviceError, match="cannot sample at 1001 Hz; choose a rate up to 1000 Hz"):
        bench.array.start(1001.0)


def test_a_dsa_streams_compressed_at_its_own_rate() -> None:
    bench = Bench("weiss-dsa")
    bench.array.connect()
    sent = len(bench.device.poll(bench.clock.now()))
    bench.array.start(5.0)
    got = [bench.array.wait_frame(0.2) for _ in range(20)]
    np.testing.assert_allclose(np.diff([f.device_time_s for f in got]), 1 / 30, atol=1e-3)
    assert sent == 0
    uncompressed_s = wire_time_s(8 + 5 + 2 * (32 + 84), 115_200)
    assert got[5].host_time_s - got[5].device_time_s < uncompressed_s / 2, "at rest there is little to send"


def test_a_dsa_that_has_just_been_switched_on_is_waited_for() -> None:
    bench = Bench("weiss-dsa", powered_s=0.0)
    bench.array.connect()
    assert 8.0 < bench.clock.now() < 9.5
    assert bench.array.counters.faults >= 1, "boot noise"
    bench.array.start(30.0)
    assert bench.array.wait_frame(0.2).sequence == 0


@pytest.mark.parametrize(("protocol", "limit_s"), [("weiss-wts", 5.1), ("weiss-dsa", 10.1)])
def test_silence_has_an_end(protocol: str, limit_s: float) -> None:
    bench = Bench(protocol, powered_s=1e6)
    with pytest.raises(
        DeviceError, match=r"tactile array f1 on mock://weiss\S*/f1 does not answer; check its"
    ):
        bench.array.connect()
    assert bench.clock.now() < limit_s
    with pytest.raises(DeviceError, match=r"call connect\(\) first"):
        bench.array.start(10.0)


@pytest.mark.parametrize("protocol", BOTH)
def test_a_stream_that_ran_before_is_ended_and_its_zero_taken_back(protocol: str) -> None:
    bench = Bench(protocol)
    if protocol == "weiss-wts":
        say(bench, WtsCommand.TARE, b"\x01")
        bench.clock.sleep(0.1)
        say(bench, WtsCommand.SET_THRESHOLD, b"\x64\x00")
        say(bench, WtsCommand.START, b"\x01\x05\x00")
    else:
        say(bench, DsaCommand.SET_THRESHOLD, b"\x02\x00\x64\x00")
        say(bench, DsaCommand.ACQUIRE, b"\x81\x1e\x00")
    bench.clock.sleep(0.5)
    bench.array.connect()
    assert not bench.device.streaming
    assert bench.array.frames() == []
    bench.array.start(20.0)
    assert (bench.array.wait_frame(0.2).counts == 20).all()


def test_a_dsa_without_thresholds_and_one_without_the_matrix() -> None:
    assert Bench("weiss-dsa", release=218).array.connect().firmware == "DSACON32 R218"
    bench = Bench("weiss-dsa")
    array = DsaArray(bench.port, bench.clock, "f1", bench.mounting, matrix=9)
    with pytest.raises(
        DeviceError, match="it has 2 matrices, counted from 0, and no matrix 9; check protocol"
    ):
        array.connect()


def test_a_matrix_that_does_not_fit_the_tip_is_refused() -> None:
    bench = Bench("weiss-wts")
    array = WtsArray(bench.port, bench.clock, "f1", Mounting(Shape.CYLINDER, 3.0, 1000.0))
    with pytest.raises(DeviceError, match=r"8 columns of 3\.40 mm do not fit round a tip of radius 3 mm"):
        array.connect()


def test_a_refusal_is_named() -> None:
    bench = Bench("weiss-wts")
    del bench.device._commands[WtsCommand.MATRIX_INFO]
    with pytest.raises(DeviceError, match=r"refuses MATRIX_INFO \(30h\) \(FEATURE_NOT_SUPPORTED\); power"):
        bench.array.connect()


def test_the_other_dialect_is_silence() -> None:
    bench = Bench("weiss-dsa")
    with pytest.raises(DeviceError, match="does not answer"):
        WtsArray(bench.port, bench.clock, "f1", bench.mounting).connect()


@pytest.mark.parametrize("protocol", BOTH)
def test_faults_on_the_wire_cost_frames_that_are_counted_and_nothing_else(protocol: str) -> None:
    bench = Bench(protocol)
    bench.array.connect()
    bench.world.force_n[1, 2] = 1.0
    bench.array.start(30.0)
    got = [bench.array.wait_frame(0.2) for _ in range(6)]  # how long steps are is known from here on
    bench.wire.rates = WireRates(FaultRates(), FaultRates(flipped=0.002, lost=0.03, cut=0.03))
    for _ in range(300):
        bench.clock.sleep(0.1)
        got += bench.array.frames()
    bench.wire.rates = WireRates()
    spoiled = bench.wire.counts.to_host
    assert spoiled.lost > 10
    assert spoiled.cut > 10
    assert spoiled.flipped > 20
    assert all(frame.counts[1, 2] == 1020 and frame.counts[0, 0] == 20 for frame in got), "none misread"
    steps = np.diff([frame.sequence for frame in got])
    assert (steps >= 1).all()
    counters = bench.array.counters
    assert counters.lost == (steps - 1).sum()
    times = np.diff([frame.device_time_s for frame in got])
    usual_s = float((times / steps).mean())
    np.testing.assert_allclose(times / steps, usual_s, atol=1.1e-3)
    # every frame that came through whole is there: only spoiled ones are missing
    assert counters.lost <= spoiled.lost + spoiled.cut + spoiled.flipped
    assert len(got) + counters.lost == 1 + round((got[-1].device_time_s - got[0].device_time_s) / usual_s)
    bench.array.stop()


@pytest.mark.parametrize("protocol", BOTH)
def test_answers_and_commands_that_get_lost_are_asked_for_again(protocol: str) -> None:
    bench = Bench(protocol)
    bad = FaultRates(flipped=0.0005, lost=0.04, duplicated=0.1)
    bench.wire.rates = WireRates(bad, bad)
    for _ in range(3):
        bench.array.connect()
        bench.array.start(20.0)
        frames = [bench.array.wait_frame(1.0) for _ in range(20)]
        assert all((frame.counts == 20).all() for frame in frames)
        assert len({frame.sequence for frame in frames}) == 20, "a repeated packet is one frame"
        bench.array.stop()
    assert bench.wire.counts.to_device.lost + bench.wire.counts.to_host.lost > 0


def test_a_texel_at_the_full_scale_of_its_matrix_has_the_largest_count() -> None:
    bench = Bench("weiss-dsa")
    assert isinstance(bench.device, EmulatedDsa)
    bench.device.matrices = (replace(bench.device.matrices[0], full_scale=3000.0), *bench.device.matrices[1:])
    bench.array.connect()
    bench.world.force_n[0, :3] = 2.979, 2.98, 3.5
    bench.array.start(30.0)
    assert bench.array.wait_frame(0.2).counts[0, :4].tolist() == [2999, 4095, 4095, 20]


@pytest.mark.parametrize("protocol", BOTH)
def test_a_damaged_size_in_a_stream_holds_up_one_frame_at_most(protocol: str) -> None:
    bench = Bench(protocol)
    bench.array.connect()
    bench.array.start(30.0)
    for _ in range(5):
        bench.array.wait_frame(0.2)
    bench.device._queue.append((bench.clock.now(), b"\xaa\xaa\xaa\x00\x00\x1f"))
    bench.clock.sleep(0.5)
    assert len(bench.array.frames()) == 15
    assert bench.array.counters.faults == 1


@pytest.mark.parametrize("protocol", BOTH)
def test_a_rest_between_streams_is_no_loss(protocol: str) -> None:
    bench = Bench(protocol)
    bench.array.connect()
    sequences = []
    for _ in range(2):
        bench.array.start(30.0)
        sequences += [bench.array.wait_frame(0.2).sequence for _ in range(8)]
        bench.array.stop()
        bench.clock.sleep(30.0)
        sequences += [frame.sequence for frame in bench.array.frames()]
    assert sequences == list(range(len(sequences)))
    assert bench.array.counters.lost == bench.array.counters.misshapen == 0


def test_a_start_whose_answer_gets_lost_is_a_start() -> None:
    bench = Bench("weiss-wts")
    bench.array.connect()
    commands = bench.device._commands
    usual = commands[WtsCommand.START]

    def start_silently(data: bytes, now: float) -> None:
        commands[WtsCommand.START] = usual
        bench.device._start(data[1] * 1e-3, now, compressed=False)

    commands[WtsCommand.START] = (3, start_silently)
    bench.array.start(50.0)
    assert bench.array.wait_frame(0.1).counts.shape == (4, 8)


@pytest.mark.parametrize("protocol", BOTH)
def test_garbage_before_an_answer_that_looks_like_a_long_packet(protocol: str) -> None:
    bench = Bench(protocol)
    command = {"weiss-wts": WtsCommand.STOP, "weiss-dsa": DsaCommand.ACQUIRE}[protocol]
    bench.device._queue.append((0.0, b"\x1b[5n\xaa\xaa\xaa" + bytes((command,)) + b"\x00\x1f"))
    bench.array.connect()
    assert bench.clock.now() < 1.5


def test_an_unplugged_port_is_named() -> None:
    bench = Bench("weiss-wts")
    bench.array.connect()
    bench.array.start(50.0)
    bench.wire.unplugged = True
    with pytest.raises(DeviceError, match=r"f1 on mock://weiss\S*/f1 is gone"):
        bench.array.wait_frame(0.5)
