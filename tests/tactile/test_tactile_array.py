"""The host driver against the emulated array over a wire in memory, in virtual time."""

import numpy as np
import pytest
from memory_port import DESCRIPTION, MemoryPort, bench

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.messages import Message, Start
from palpate.drivers.transport.clock import VirtualClock


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
