"""The tactile driver on the mock transport: wire time is accounted and nothing is lost."""

import numpy as np
import pytest

from palpate.base.errors import DeviceError
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.array import TactileArray
from palpate.drivers.tactile.description import Description, Shape
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import wire_time_s

DESCRIPTION = Description(
    unique_id=b"test array no. 3",
    firmware="emulated 0.1",
    emulated=True,
    shape=Shape.CYLINDER,
    rows=8,
    cols=16,
    bit_depth=12,
    max_rate_hz=500.0,
    full_scale_n=1.0,
    counts_per_n=4095.0,
    tip_radius_mm=5.0,
    columns=tuple(float(np.float32(0.25 * (j - 7.5))) for j in range(16)),
    row_heights_mm=tuple(1.0 + 2.0 * i for i in range(8)),
)


class Still:
    """A world in which nothing touches."""

    def __init__(self) -> None:
        self.array = EmulatedArray(Taxels(DESCRIPTION, seed=1), self.advance)
        self.quiet = np.zeros((8, 16))

    def advance(self, now: float) -> None:
        while (due := self.array.next_sample_s()) is not None and due <= now:
            self.array.sample(due, self.quiet)


def test_a_session_over_the_mock_wire() -> None:
    clock = VirtualClock()
    hub = MockHub(clock, "tactile-session")
    world = Still()
    array = TactileArray(open_port(hub.attach("f1", world.array, 1_000_000), 1_000_000), clock, "f1")
    assert array.connect() == DESCRIPTION
    assert clock.now() < 0.05
    array.start(200.0)
    got = [array.wait_frame(0.1) for _ in range(50)]
    period = np.diff([f.device_time_s for f in got])
    np.testing.assert_allclose(period, 0.005, atol=2e-6)
    late = [f.host_time_s - f.device_time_s for f in got]
    assert min(late) >= wire_time_s(280, 1_000_000)
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
    port = open_port(hub.attach("f1", Still().array, 1_000_000), 115_200)
    with pytest.raises(DeviceError, match="tactile array f1 on mock://tactile-baud/f1 does not answer"):
        TactileArray(port, clock, "f1").connect()
