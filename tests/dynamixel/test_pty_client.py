"""The vendor's SDK, unmodified and in a process of its own, moves an emulated servo on a pty."""

import json
import subprocess
import sys
import threading

import pytest

from palpate.drivers.dynamixel import Bus, PortFailed, Servo, torque_off_all
from palpate.drivers.emulators.chain import ServoChain
from palpate.drivers.emulators.serve import serve_pty
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.port import open_port

pytestmark = pytest.mark.realtime

CLIENT = """
import json, sys, time
from dynamixel_sdk import COMM_SUCCESS, PacketHandler, PortHandler

port, packets = PortHandler(sys.argv[1]), PacketHandler(2.0)
assert port.openPort() and port.setBaudRate(1_000_000)
model, result, error = packets.ping(port, 5)
assert (result, error) == (COMM_SUCCESS, 0), (result, error)
assert packets.ping(port, 6)[1] != COMM_SUCCESS
start = packets.read4ByteTxRx(port, 5, 132)[0]
assert packets.write4ByteTxRx(port, 5, 112, 150) == (COMM_SUCCESS, 0)
assert packets.write1ByteTxRx(port, 5, 64, 1) == (COMM_SUCCESS, 0)
assert packets.write4ByteTxRx(port, 5, 116, 2600) == (COMM_SUCCESS, 0)
seen = []
end = time.monotonic() + 10
while time.monotonic() < end and (not seen or abs(seen[-1] - 2600) > 3):
    position, result, error = packets.read4ByteTxRx(port, 5, 132)
    assert (result, error) == (COMM_SUCCESS, 0), (result, error)
    seen.append(position)
packets.write1ByteTxRx(port, 5, 64, 0)
port.closePort()
json.dump({"model": model, "start": start, "seen": seen}, sys.stdout)
"""


@pytest.mark.timeout(60)
def test_unmodified_sdk_in_another_process() -> None:
    clock = MonotonicClock()
    servo = EmulatedServo(5)
    stepped = clock.now()

    def advance(now: float) -> None:
        nonlocal stepped
        while stepped + 1e-3 <= now:
            servo.step(1e-3, 0.0)
            stepped += 1e-3

    with serve_pty({"bus": (ServoChain([servo], advance), 1_000_000)}, clock, threading.Event()) as service:
        for _ in range(2):  # a client may come, go, and come again
            client = subprocess.run(
                [sys.executable, "-c", CLIENT, service.paths["bus"]],
                capture_output=True,
                text=True,
                timeout=50,
                check=False,
            )
            assert client.returncode == 0, client.stderr
            told = json.loads(client.stdout)
            assert told["model"] == 1020
            assert abs(told["seen"][-1] - 2600) <= 3
        assert abs(servo.shaft_rad / 6.283185307 * 4096 + 2048 - 2600) < 4


@pytest.mark.timeout(30)
def test_a_port_that_goes_away_is_reported_by_name() -> None:
    clock = MonotonicClock()
    service = serve_pty(
        {"bus": (ServoChain([EmulatedServo(5)], lambda _: None), 1_000_000)}, clock, threading.Event()
    )
    path = service.paths["bus"]
    bus = Bus(open_port(path, 1_000_000), clock, 1_000_000)
    assert bus.ping(5).model_number == 1020
    service.stop()
    for _ in range(2):
        with pytest.raises(PortFailed, match=f"{path} failed"):
            bus.ping(5)
    assert [type(error) for error in torque_off_all(bus, [Servo(bus, 5)])] == [PortFailed]
    bus.close()
