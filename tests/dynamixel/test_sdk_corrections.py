"""Every correction of the vendor's SDK: the defect on the plain SDK, and its absence on ours.

When a test of the plain SDK fails one day, the vendor has mended it and our correction can go.
"""

from typing import Any

import pytest
import serial
from dynamixel_sdk import COMM_PORT_BUSY, COMM_SUCCESS, PortHandler, Protocol2PacketHandler
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.exchanges import LONGEST_RETURN_DELAY_S, Timing
from palpate.drivers.dynamixel.packet import InstructionPacket, Parser, StatusPacket, encode_status
from palpate.drivers.dynamixel.sdk import ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission

BAUD = 1_000_000
LATENCY_S = 2e-3
HEADER_LIKE = [0xFF, 0xFF, 0xFD, 0xFD]
LOST_BY_SDK = bytes.fromhex("fffffdfffdfd")


class Listener:
    """Keeps what it hears and confirms every packet that is addressed to servo 1."""

    def __init__(self) -> None:
        self.heard = b""
        self.packets: list[InstructionPacket | StatusPacket] = []
        self.broken = False
        self._parser = Parser()

    def feed(self, data: bytes, now: float) -> list[Emission]:
        if self.broken:
            raise serial.SerialException("device disconnected")
        self.heard += data
        found = self._parser.feed(data)
        self.packets += found
        return [(now, encode_status(StatusPacket(1))) for packet in found if packet.dxl_id == 1]

    def poll(self, now: float) -> list[Emission]:  # noqa: ARG002
        return []

    def next_due(self) -> float | None:
        return None


class PlainPortHandler(PortHandler):  # type: ignore[misc]
    """The SDK's handler with nothing changed but the port object, which has no device file to open."""

    def __init__(self, port: serial.SerialBase) -> None:
        super().__init__(port.port)
        self.ser = port
        self.is_open = True
        self.tx_time_per_byte = 0.01


@pytest.fixture
def world() -> tuple[Listener, serial.SerialBase, VirtualClock, MockHub]:
    device, clock = Listener(), VirtualClock()
    hub = MockHub(clock, "sdk")
    return device, open_port(hub.attach("bus", device, BAUD), BAUD), clock, hub


def ours(port: serial.SerialBase, clock: VirtualClock) -> ClockedPortHandler:
    handler = ClockedPortHandler(port, clock, Timing(BAUD, LATENCY_S))
    assert handler.openPort()
    return handler


def write(packets: Any, handler: Any) -> tuple[int, int]:
    result, error = packets.writeTxRx(handler, 1, 116, 4, HEADER_LIKE)
    return result, error


def test_plain_sdk_sends_header_bytes_unstuffed(world: Any) -> None:
    device, port, _, _ = world
    write(Protocol2PacketHandler(), PlainPortHandler(port))
    assert bytes.fromhex("7400FFFFFDFD") in device.heard
    assert device.packets == [InstructionPacket(1, 3, bytes.fromhex("7400FFFFFD"))]  # one byte is gone


def test_ours_stuffs_what_goes_on_the_wire(world: Any) -> None:
    device, port, clock, _ = world
    assert write(StuffingPacketHandler(), ours(port, clock)) == (COMM_SUCCESS, 0)
    assert bytes.fromhex("7400FFFFFDFDFD") in device.heard
    assert device.packets == [InstructionPacket(1, 3, bytes.fromhex("7400FFFFFDFD"))]


def test_ours_stuffs_a_sync_write_of_small_negative_values(world: Any) -> None:
    device, port, clock, _ = world
    block = list((-1).to_bytes(2, "little", signed=True) + (-3).to_bytes(4, "little", signed=True))
    StuffingPacketHandler().syncWriteTxOnly(ours(port, clock), 102, 6, [1, *block], 7)
    assert [packet.params for packet in device.packets] == [bytes([102, 0, 6, 0, 1, *block])]


def unstuffed(packets: Any, data: bytes) -> bytes:
    packet = packets.removeStuffing(list(encode_status(StatusPacket(1, 0, data))))
    length = packet[5] | packet[6] << 8
    return bytes(packet[9 : 9 + length - 4])


def test_plain_sdk_loses_data_when_unstuffing() -> None:
    assert unstuffed(Protocol2PacketHandler(), LOST_BY_SDK) != LOST_BY_SDK


def test_ours_unstuffs_that() -> None:
    assert unstuffed(StuffingPacketHandler(), LOST_BY_SDK) == LOST_BY_SDK


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00]), max_size=24).map(bytes))
@settings(max_examples=200)
def test_ours_unstuffs_anything(data: bytes) -> None:
    assert unstuffed(StuffingPacketHandler(), data) == data


def test_plain_sdk_stays_busy_after_the_port_broke(world: Any) -> None:
    device, port, _, _ = world
    handler, packets = PlainPortHandler(port), Protocol2PacketHandler()
    device.broken = True
    with pytest.raises(serial.SerialException):
        write(packets, handler)
    device.broken = False
    assert write(packets, handler)[0] == COMM_PORT_BUSY


def test_ours_is_free_after_the_port_broke(world: Any) -> None:
    device, port, clock, _ = world
    handler, packets = ours(port, clock), StuffingPacketHandler()
    device.broken = True
    with pytest.raises(serial.SerialException):
        write(packets, handler)
    device.broken = False
    assert write(packets, handler) == (COMM_SUCCESS, 0)


def test_plain_sdk_cannot_open_a_url(world: Any) -> None:
    _, port, _, _ = world
    with pytest.raises(serial.SerialException):
        PortHandler(port.port).openPort()


def test_plain_sdk_refuses_the_fastest_rate_of_the_series() -> None:
    assert PortHandler("/dev/null").setBaudRate(4_500_000) is False


def test_ours_takes_any_rate() -> None:
    clock, device = VirtualClock(), Listener()
    hub = MockHub(clock, "fast")
    port = open_port(hub.attach("bus", device, 4_500_000), 4_500_000)
    handler = ClockedPortHandler(port, clock, Timing(4_500_000, LATENCY_S))
    assert handler.openPort()
    assert write(StuffingPacketHandler(), handler) == (COMM_SUCCESS, 0)


def test_plain_sdk_waits_34_ms_whatever_the_rate() -> None:
    handler = PortHandler("nowhere")
    handler.tx_time_per_byte = 0.01
    handler.setPacketTimeout(11)
    assert handler.packet_timeout == pytest.approx(34.11)


def test_ours_waits_as_long_as_the_wire_needs_on_the_given_clock(world: Any) -> None:
    _, port, clock, _ = world
    begin = clock.now()
    _, result, _ = StuffingPacketHandler().ping(ours(port, clock), 7)
    assert result != COMM_SUCCESS
    wire = (10 + 11) * 10 / BAUD
    waited = clock.now() - begin - 10 * 10 / BAUD  # the mock port's write returns after the wire time
    assert waited == pytest.approx(wire + LONGEST_RETURN_DELAY_S + LATENCY_S, abs=1.1e-3)


def test_ours_looks_once_more_when_the_computer_has_slept(world: Any) -> None:
    """What arrived while this process did not run is an answer, not a time-out."""
    _, port, clock, _ = world
    handler, packets = ours(port, clock), StuffingPacketHandler()
    tx = [0, 0, 0, 0, 1, 3, 0, 1, 0, 0]
    assert packets.txPacket(handler, tx) == COMM_SUCCESS
    handler.setPacketTimeout(11)
    clock.sleep(1.0)
    assert packets.rxPacket(handler, False)[1] == COMM_SUCCESS


@given(st.binary(max_size=300), st.integers(0, 300), st.integers(0, 0xFFFF))
def test_our_crc_is_the_sdks(data: bytes, size: int, before: int) -> None:
    size = min(size, len(data))
    plain = Protocol2PacketHandler().updateCRC(before, list(data), size)
    assert StuffingPacketHandler().updateCRC(before, list(data), size) == plain
