"""Conformance of tactile arrays: what the driver of every protocol has to do, tried on its emulated device.

class TestBraille(ArrayConformance):
    protocol = "braille"
    keys = {"counts_per_n": 1000.0}
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, cast

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.config import ArrayConfig
from palpate.drivers.emulators.faults import FaultRates, FaultyWire, WireRates
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.mounting import Mounting
from palpate.drivers.tactile.stream import Port
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.port import open_port
from palpate.rig.arrays import ArrayPlugin, array_plugin

__all__ = ["ArrayBench", "ArrayConformance"]

_TIP_RADIUS_MM = 8.5
_COUNTS_PER_N = 1000.0


class ArrayBench:
    """An emulated array on a mock wire in virtual time, with its driver, as finger "f1".

    It has 5 x 7 taxels of 3.4 mm round a tip of radius 8.5 mm, 1000 counts per N, 12 bits, and reads 50
    counts at rest. `force_n` (5, 7) presses on it; tests may change it, `wire.rates` and `wire.unplugged`.
    """

    def __init__(
        self,
        protocol: str,
        keys: Mapping[str, Any],
        *,
        baudrate_bps: int = 1_000_000,
        plugin: ArrayPlugin[Any] | None = None,
    ) -> None:
        """`keys`: those of the rig file that only this protocol has.

        `plugin` takes the place of the registered one. Raises InputError or pydantic's ValidationError if
        there is no such protocol or its keys are wrong.
        """
        table = {"port": "mock://f1", "baudrate_bps": baudrate_bps, "protocol": protocol, "gain_spread": 0.0}
        self.config = ArrayConfig.model_validate(table | dict(keys))
        self.plugin = plugin or array_plugin(protocol)
        self.tip_radius_mm = _TIP_RADIUS_MM
        truth = Mounting(Shape.CYLINDER, _TIP_RADIUS_MM, _COUNTS_PER_N).describe(
            (7, 5),
            (3.4, 3.4),
            unique_id=b"conformance",
            firmware="conformance",
            emulated=True,
            bit_depth=12,
            max_rate_hz=100.0,
        )
        self.force_n = np.zeros((5, 7))
        self.force_n[3, 1] = 1.0
        taxels = Taxels(truth, seed=2, noise_counts=1.0, offset_counts=50)
        assert self.plugin.emulated is not None, f"arrays of protocol {protocol} cannot be emulated"
        self.device = self.plugin.emulated(taxels, self.advance, self.config, _TIP_RADIUS_MM)
        self.wire = FaultyWire(self.device, 7)
        self.clock = VirtualClock()
        self.hub = MockHub(self.clock, "any")
        self.port = open_port(self.hub.attach("f1", self.wire, baudrate_bps), baudrate_bps)
        self.array = self.plugin.driver(
            cast("Port", self.port), self.clock, "f1", self.config, _TIP_RADIUS_MM
        )

    def advance(self, now: float) -> None:
        """Let the device sample what is due until `now`."""
        while (due := self.device.next_sample_s()) is not None and due <= now:
            self.device.sample(due, self.force_n)


class ArrayConformance:
    """The suite: a subclass names `protocol` and the `keys` that a rig file has to give for it.

    `rate_hz`: a rate, at most 25, that the array can do at `baudrate_bps`. `keys` have to say 1000 counts
    per N where the array does not report it.
    """

    protocol: ClassVar[str]
    keys: ClassVar[Mapping[str, Any]] = {}
    baudrate_bps: ClassVar[int] = 1_000_000
    rate_hz: ClassVar[float] = 25.0

    @pytest.fixture
    def bench(self) -> ArrayBench:
        """A bench of its own for each test; not connected."""
        return ArrayBench(self.protocol, self.keys, baudrate_bps=self.baudrate_bps)

    @property
    def patience_s(self) -> float:
        """How long a frame may take."""
        return 5 / self.rate_hz

    def test_describes_itself_as_often_as_it_is_asked(self, bench: ArrayBench) -> None:
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ .*call connect\(\)"):
            _ = bench.array.description
        described = bench.array.connect()
        assert described.problem() is None
        assert (described.rows, described.cols) == (5, 7)
        assert (described.shape, described.emulated, described.max_count) == (Shape.CYLINDER, True, 4095)
        np.testing.assert_allclose(np.diff(described.columns), 0.4, rtol=1e-6)
        assert math.isclose(described.counts_per_n, _COUNTS_PER_N)
        assert bench.array.connect() == described == bench.array.description

    def test_streams_frames_of_its_taxels_in_order(self, bench: ArrayBench) -> None:
        bench.array.connect()
        assert bench.array.frames() == []
        bench.array.start(self.rate_hz)
        frames = [bench.array.wait_frame(self.patience_s) for _ in range(30)]
        for frame in frames:
            assert frame.counts.shape == (5, 7)
            assert frame.counts.dtype == np.uint16
            assert abs(int(frame.counts[3, 1]) - 1050) < 10
            assert abs(np.delete(frame.counts.astype(int).ravel(), 3 * 7 + 1) - 50).max() < 10
        assert np.diff([frame.sequence for frame in frames]).tolist() == [1] * 29
        steps = np.diff([frame.device_time_s for frame in frames])
        host_steps = np.diff([frame.host_time_s for frame in frames])
        assert steps.mean() == pytest.approx(host_steps.mean(), rel=0.03)
        assert np.ptp(steps) < 0.003
        assert 1 / steps.mean() > 0.96 * self.rate_hz
        counters = bench.array.counters
        assert counters.frames == 30
        assert counters.lost == counters.faults == counters.misshapen == counters.dropped == 0

    def test_verbs_may_be_repeated_and_stopping_stops(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.stop()
        for _ in range(2):
            bench.array.start(0.8 * self.rate_hz)
            bench.array.start(self.rate_hz)
            bench.array.wait_frame(self.patience_s)
            bench.array.stop()
            bench.array.stop()
        bench.clock.sleep(0.2)
        bench.array.frames()
        bench.clock.sleep(1.0)
        assert bench.array.frames() == []
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ sent no frame for 0\.1 s"):
            bench.array.wait_frame(0.1)

    @pytest.mark.parametrize("how", ["connect", "restart"])
    def test_connecting_and_a_restart_end_a_stream(self, bench: ArrayBench, how: str) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        bench.clock.sleep(0.5)
        if how == "connect":
            bench.array.connect()
        else:
            bench.device.restart(bench.clock.now())
        bench.clock.sleep(0.2)
        bench.array.frames()
        bench.clock.sleep(0.5)
        assert bench.array.frames() == []

    def test_lost_frames_are_counted_and_show_in_the_numbers(self, bench: ArrayBench) -> None:
        bench.array.connect()
        bench.array.start(self.rate_hz)
        before = [bench.array.wait_frame(self.patience_s) for _ in range(10)]
        bench.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
        bench.clock.sleep(5.25 / self.rate_hz)
        bench.array.frames()
        bench.wire.rates = WireRates()
        after = bench.array.wait_frame(self.patience_s)
        step_s = before[-1].device_time_s - before[-2].device_time_s
        missing = round((after.device_time_s - before[-1].device_time_s) / step_s) - 1
        assert missing >= 5
        assert bench.array.counters.lost == missing == after.sequence - before[-1].sequence - 1

    def test_rates_that_it_cannot_do_are_refused(self, bench: ArrayBench) -> None:
        limit = bench.array.connect().max_rate_hz
        for rate_hz in (0.0, -1.0, limit * 1.01):
            with pytest.raises(DeviceError, match=f"cannot sample at .* up to {limit:g} Hz"):
                bench.array.start(rate_hz)

    def test_silence_and_a_port_that_is_gone_are_named(self, bench: ArrayBench) -> None:
        bench.wire.rates = WireRates(to_host=FaultRates(lost=1.0))
        with pytest.raises(DeviceError, match=r"f1 on mock://\S+ does not answer; check"):
            bench.array.connect()
        assert bench.clock.now() < 12.0
        bench.wire.rates = WireRates()
        bench.array.connect()
        bench.array.start(self.rate_hz)
        bench.wire.unplugged = True
        array = bench.array
        for verb in (array.frames, array.stop, array.connect, lambda: array.wait_frame(0.1)):
            with pytest.raises(DeviceError, match=r"f1 on mock://\S+ is gone"):
                verb()
