"""What every driver of a tactile array has to do: checks against an emulated device of any protocol.

`tests/tactile/test_array_drivers.py` runs them for all that `palpate.drivers.tactile.devices` knows.
"""

import math
from collections.abc import Callable

import numpy as np
import pytest
from serial.serialutil import SerialBase

from palpate.drivers.emulators.bench import SampledArray
from palpate.drivers.emulators.faults import FaultRates, FaultyWire, WireRates
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.frames import ArrayDriver
from palpate.drivers.tactile.messages import Shape
from palpate.drivers.tactile.mounting import Mounting
from palpate.drivers.transport.clock import Clock, VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.port import open_port
from palpate.errors import DeviceError

__all__ = ["BAUD", "CHECKS", "MOUNTING", "Held", "MakeDevice", "MakeDriver"]

MOUNTING = Mounting(Shape.CYLINDER, 8.5, 1000.0)
BAUD = 1_000_000
MakeDevice = Callable[[Taxels, Callable[[float], None]], SampledArray]
MakeDriver = Callable[[SerialBase, Clock, str, Mounting], ArrayDriver]


class Held:
    """An emulated array, 5 x 7 taxels of 3.4 mm round a tip, with 1 N on one of them, and its driver."""

    def __init__(self, make_device: MakeDevice, make_driver: MakeDriver) -> None:
        truth = MOUNTING.describe(
            (7, 5),
            (3.4, 3.4),
            unique_id=b"any",
            firmware="any",
            emulated=True,
            bit_depth=12,
            max_rate_hz=100.0,
        )
        self.force_n = np.zeros((5, 7))
        self.force_n[3, 1] = 1.0
        self.device = make_device(Taxels(truth, seed=2, noise_counts=1.0, offset_counts=50), self.advance)
        self.wire = FaultyWire(self.device, 7)
        self.clock = VirtualClock()
        self.hub = MockHub(self.clock, "any")
        self.port = open_port(self.hub.attach("f1", self.wire, BAUD), BAUD)
        self.array = make_driver(self.port, self.clock, "f1", MOUNTING)

    def advance(self, now: float) -> None:
        while (due := self.device.next_sample_s()) is not None and due <= now:
            self.device.sample(due, self.force_n)


def it_says_what_it_is_as_often_as_it_is_asked(held: Held) -> None:
    with pytest.raises(
        DeviceError, match=r"f1 on mock://\S+ has not been asked what it is; call connect\(\)"
    ):
        _ = held.array.description
    told = held.array.connect()
    assert told.problem() is None
    assert (told.rows, told.cols, told.shape, told.emulated) == (5, 7, Shape.CYLINDER, True)
    assert told.max_count == 4095
    np.testing.assert_allclose(np.diff(told.columns), 0.4, rtol=1e-6)
    assert math.isclose(told.counts_per_n, 1000.0)
    assert held.array.connect() == told == held.array.description


def it_streams_frames_of_its_taxels_in_order(held: Held) -> None:
    held.array.connect()
    assert held.array.frames() == []
    held.array.start(25.0)
    got = [held.array.wait_frame(0.2) for _ in range(30)]
    for frame in got:
        assert frame.counts.shape == (5, 7)
        assert frame.counts.dtype == np.uint16
        assert abs(int(frame.counts[3, 1]) - 1050) < 10
        assert abs(np.delete(frame.counts.astype(int).ravel(), 3 * 7 + 1) - 50).max() < 10
    assert np.diff([frame.sequence for frame in got]).tolist() == [1] * 29
    steps = np.diff([frame.device_time_s for frame in got])
    assert steps.mean() == pytest.approx(np.diff([frame.host_time_s for frame in got]).mean(), rel=0.03)
    assert np.ptp(steps) < 0.003
    assert 1 / steps.mean() > 24
    counters = held.array.counters
    assert counters.frames == 30
    assert counters.lost == counters.faults == counters.misshapen == counters.dropped == 0


def verbs_may_be_repeated_and_stopping_stops(held: Held) -> None:
    held.array.connect()
    held.array.stop()
    for _ in range(2):
        held.array.start(20.0)
        held.array.start(25.0)
        held.array.wait_frame(0.2)
        held.array.stop()
        held.array.stop()
    held.clock.sleep(0.2)
    held.array.frames()
    held.clock.sleep(1.0)
    assert held.array.frames() == []
    with pytest.raises(DeviceError, match=r"f1 on mock://\S+ sent no frame for 0\.1 s"):
        held.array.wait_frame(0.1)


def a_stream_that_somebody_left_running_is_ended(held: Held) -> None:
    held.array.connect()
    held.array.start(25.0)
    held.clock.sleep(0.5)
    held.array.connect()
    held.clock.sleep(0.2)
    assert held.array.frames() == []


def lost_frames_are_counted_and_show_in_the_numbers(held: Held) -> None:
    held.array.connect()
    held.array.start(25.0)
    before = [held.array.wait_frame(0.2) for _ in range(10)]
    missed = 0.21
    held.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
    held.clock.sleep(missed)
    held.array.frames()
    held.wire.rates = WireRates()
    after = held.array.wait_frame(0.2)
    step_s = before[-1].device_time_s - before[-2].device_time_s
    gone = round((after.device_time_s - before[-1].device_time_s) / step_s) - 1
    assert gone >= 5
    assert held.array.counters.lost == gone == after.sequence - before[-1].sequence - 1


def rates_that_it_cannot_do_are_refused(held: Held) -> None:
    limit = held.array.connect().max_rate_hz
    for rate_hz in (0.0, -1.0, limit * 1.01):
        with pytest.raises(DeviceError, match=f"cannot sample at .* Hz; choose a rate up to {limit:g} Hz"):
            held.array.start(rate_hz)


def silence_and_a_port_that_is_gone_are_named(held: Held) -> None:
    held.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
    with pytest.raises(DeviceError, match=r"f1 on mock://\S+ does not answer; check"):
        held.array.connect()
    assert held.clock.now() < 12.0
    held.wire.rates = WireRates()
    held.array.connect()
    held.array.start(25.0)
    held.wire.unplugged = True
    for verb in (held.array.frames, held.array.stop, held.array.connect, lambda: held.array.wait_frame(0.1)):
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ is gone"):
            verb()


CHECKS: tuple[Callable[[Held], None], ...] = (
    it_says_what_it_is_as_often_as_it_is_asked,
    it_streams_frames_of_its_taxels_in_order,
    verbs_may_be_repeated_and_stopping_stops,
    a_stream_that_somebody_left_running_is_ended,
    lost_frames_are_counted_and_show_in_the_numbers,
    rates_that_it_cannot_do_are_refused,
    silence_and_a_port_that_is_gone_are_named,
)
