"""The vendor's SDK: its defects, what corrects them, quick status."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest
import serial
from dynamixel_sdk import (
    COMM_PORT_BUSY,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupSyncRead,
    PortHandler,
    Protocol2PacketHandler,
)
from hypothesis import event, given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.exchanges import LONGEST_RETURN_DELAY_S, Timing
from palpate.drivers.dynamixel.packet import (
    ALERT_BIT,
    BROADCAST_ID,
    InstructionPacket,
    Parser,
    StatusErrorCode,
    StatusPacket,
    crc16,
    encode_status,
)
from palpate.drivers.dynamixel.sdk import ClockedPortHandler, StuffingPacketHandler
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission
from support.devices.servo_wire import SdkPort
from support.devices.simple import Quiet

# ----------------------------------------------------------------------------------------------------
# Defects of the vendor's SDK that our bus is built around: each shown on the plain SDK.
#
# Those that are mended by subclassing are below. When a test here fails one day, the
# vendor has mended it. Nothing of the SDK is changed but the port object and, where time counts, the clock it
# looks at.

BAUD = 1_000_000
POSITION = (132, 4)


@dataclass
class Answering(Quiet):
    """Gives the same answers to every packet, one after the other."""

    answers: Sequence[StatusPacket] = ()
    heard: list[InstructionPacket] = field(default_factory=list)
    parser: Parser = field(default_factory=Parser)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        found = [packet for packet in self.parser.feed(data) if isinstance(packet, InstructionPacket)]
        self.heard += found
        return [(now, encode_status(answer)) for _ in found for answer in self.answers]


@dataclass
class World:
    device: Answering
    clock: VirtualClock
    port: serial.SerialBase

    def handler(self) -> PortHandler:
        return SdkPort(self.port, self.clock)


@pytest.fixture
def world() -> Iterator[World]:
    device, clock = Answering(), VirtualClock()
    hub = MockHub(clock, "defects")
    yield World(device, clock, open_port(hub.attach("bus", device, BAUD), BAUD, timeout_s=0))
    hub.close()


def position(dxl_id: int, value: int, error: int = 0) -> StatusPacket:
    return StatusPacket(dxl_id, error, value.to_bytes(4, "little"))


def sync_read(handler: PortHandler, dxl_ids: Sequence[int]) -> Any:
    group = GroupSyncRead(handler, Protocol2PacketHandler(), *POSITION)
    for dxl_id in dxl_ids:
        assert group.addParam(dxl_id)
    return group


def bulk_read(handler: PortHandler, dxl_ids: Sequence[int]) -> Any:
    group = GroupBulkRead(handler, Protocol2PacketHandler())
    for dxl_id in dxl_ids:
        assert group.addParam(dxl_id, *POSITION)
    return group


both_groups = pytest.mark.parametrize("group_read", [sync_read, bulk_read])
GroupRead = Callable[[PortHandler, Sequence[int]], Any]


@both_groups
def test_one_missing_servo_fails_a_whole_group_read(world: World, group_read: GroupRead) -> None:
    """Servo 12 is silent; the answers of 11 and 13 are on the wire, whole. It takes 34 ms at any rate."""
    world.device.answers = [position(11, 1111), position(13, 1313)]
    group = group_read(world.handler(), [11, 12, 13])
    assert group.txRxPacket() != COMM_SUCCESS
    assert world.device.heard[0].dxl_id == BROADCAST_ID
    assert [group.isAvailable(dxl_id, *POSITION) for dxl_id in (11, 12, 13)] == [False] * 3
    assert 0.034 < world.clock.now() < 0.036, "30 bytes at 1 Mbps take 0.3 ms"


@both_groups
def test_a_group_read_keeps_nothing_of_an_alert(world: World, group_read: GroupRead) -> None:
    kept = []
    for error in (0, ALERT_BIT):
        world.device.answers = [position(11, 1111, error), position(12, 1212)]
        group = group_read(world.handler(), [11, 12])
        assert group.txRxPacket() == COMM_SUCCESS
        assert group.getData(11, *POSITION) == 1111
        kept.append({name: value for name, value in vars(group).items() if name not in ("port", "ph")})
    assert kept[0] == kept[1]
    assert len(kept[0]["data_dict"]) == 2


def test_a_refused_sync_read_succeeds_with_the_crc_for_a_value(world: World) -> None:
    """Servo 11 answers with Access Error and without data."""
    refusal = StatusPacket(11, StatusErrorCode.ACCESS_ERROR)
    world.device.answers = [refusal]
    group = GroupSyncRead(world.handler(), Protocol2PacketHandler(), 126, 2)
    assert group.addParam(11)
    assert group.txRxPacket() == COMM_SUCCESS
    assert group.getData(11, 126, 2) == crc16(encode_status(refusal)[:-2]) != 0


def test_a_broadcast_ping_takes_four_fifths_of_a_second(world: World) -> None:
    world.device.answers = [StatusPacket(dxl_id, 0, bytes([0xFC, 3, 46])) for dxl_id in (11, 12, 13)]
    found, result = Protocol2PacketHandler().broadcastPing(world.handler())
    assert (sorted(found), result) == ([11, 12, 13], COMM_SUCCESS)
    assert 0.80 < world.clock.now() < 0.82, "the last answer was there after 0.5 ms"


# ----------------------------------------------------------------------------------------------------
# Every correction of the vendor's SDK: the defect on the plain SDK, and its absence on ours.
#
# When a test of the plain SDK fails one day, the vendor has mended it and our correction can go.

LATENCY_S = 2e-3
HEADER_LIKE = [0xFF, 0xFF, 0xFD, 0xFD]
LOST_BY_SDK = bytes.fromhex("fffffdfffdfd")


class Listener(Quiet):
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


@pytest.fixture
def listening_world() -> tuple[Listener, serial.SerialBase, VirtualClock, MockHub]:
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


@pytest.mark.parametrize(
    ("packets", "sent"), [(Protocol2PacketHandler, "7400FFFFFDFD"), (StuffingPacketHandler, "7400FFFFFDFDFD")]
)
def test_only_ours_stuffs_what_goes_on_the_wire(listening_world: Any, packets: Any, sent: str) -> None:
    device, port, clock, _ = listening_world
    stuffs = packets is StuffingPacketHandler
    assert write(packets(), ours(port, clock) if stuffs else SdkPort(port)) == (COMM_SUCCESS, 0)
    assert bytes.fromhex(sent) in device.heard
    whole_data = bytes.fromhex("7400FFFFFDFD")
    assert device.packets == [InstructionPacket(1, 3, whole_data if stuffs else whole_data[:-1])]


def test_ours_stuffs_a_sync_write_of_small_negative_values(listening_world: Any) -> None:
    device, port, clock, _ = listening_world
    block = list((-1).to_bytes(2, "little", signed=True) + (-3).to_bytes(4, "little", signed=True))
    StuffingPacketHandler().syncWriteTxOnly(ours(port, clock), 102, 6, [1, *block], 7)
    assert [packet.params for packet in device.packets] == [bytes([102, 0, 6, 0, 1, *block])]


def unstuffed(packets: Any, data: bytes) -> bytes:
    packet = packets.removeStuffing(list(encode_status(StatusPacket(1, 0, data))))
    length = packet[5] | packet[6] << 8
    return bytes(packet[9 : 9 + length - 4])


def test_only_ours_unstuffs_what_looks_like_a_header() -> None:
    assert unstuffed(Protocol2PacketHandler(), LOST_BY_SDK) != LOST_BY_SDK
    assert unstuffed(StuffingPacketHandler(), LOST_BY_SDK) == LOST_BY_SDK


@given(st.lists(st.sampled_from([0xFF, 0xFD, 0x00]), max_size=24).map(bytes))
@settings(max_examples=200)
def test_ours_unstuffs_anything(data: bytes) -> None:
    assert unstuffed(StuffingPacketHandler(), data) == data


@pytest.mark.parametrize("packets", [Protocol2PacketHandler(), StuffingPacketHandler()])
def test_only_ours_is_free_after_the_port_broke(listening_world: Any, packets: Any) -> None:
    device, port, clock, _ = listening_world
    mended = isinstance(packets, StuffingPacketHandler)
    handler = ours(port, clock) if mended else SdkPort(port)
    device.broken = True
    with pytest.raises(serial.SerialException):
        write(packets, handler)
    device.broken = False
    assert write(packets, handler)[0] == (COMM_SUCCESS if mended else COMM_PORT_BUSY)


def test_only_ours_takes_the_fastest_rate_of_the_series() -> None:
    assert PortHandler("/dev/null").setBaudRate(4_500_000) is False
    clock, device = VirtualClock(), Listener()
    hub = MockHub(clock, "fast")
    port = open_port(hub.attach("bus", device, 4_500_000), 4_500_000)
    handler = ClockedPortHandler(port, clock, Timing(4_500_000, LATENCY_S))
    assert handler.openPort()
    assert write(StuffingPacketHandler(), handler) == (COMM_SUCCESS, 0)


def test_plain_sdk_cannot_open_a_url(listening_world: Any) -> None:
    _, port, _, _ = listening_world
    with pytest.raises(serial.SerialException):
        PortHandler(port.port).openPort()


def test_ours_waits_as_long_as_the_wire_needs_on_the_given_clock(listening_world: Any) -> None:
    _, port, clock, _ = listening_world
    begin = clock.now()
    _, result, _ = StuffingPacketHandler().ping(ours(port, clock), 7)
    assert result != COMM_SUCCESS
    wire = (10 + 11) * 10 / BAUD
    waited = clock.now() - begin - 10 * 10 / BAUD  # the mock port's write returns after the wire time
    assert waited == pytest.approx(wire + LONGEST_RETURN_DELAY_S + LATENCY_S, abs=1.1e-3)


def test_ours_looks_once_more_when_the_computer_has_slept(listening_world: Any) -> None:
    """What arrived while this process did not run is an answer, not a time-out."""
    _, port, clock, _ = listening_world
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


# ----------------------------------------------------------------------------------------------------
# Whole status packets are taken quickly, with the result, and the looks at the port, that the SDK has.

_PATIENCE = 5  # reads that bring nothing, until the time is up


class ScriptedPort:
    """Hands out what has arrived; a read that finds nothing lets the next piece arrive."""

    def __init__(self, pieces: list[bytes]) -> None:
        self._pieces = iter(pieces)
        self._there = self._again = b""
        self.empty_reads = 0
        self.is_using = True

    def readPort(self, length: int) -> bytes:
        """Up to `length` bytes."""
        if self._again:
            data, self._again = self._again[:length], self._again[length:]
            return data
        if not self._there:
            self.empty_reads += 1
            self._there = next(self._pieces, b"")
            return b""
        data, self._there = self._there[:length], self._there[length:]
        return data

    def push_back(self, data: bytes) -> None:
        """Let these bytes be read once more."""
        self._again = bytes(data) + self._again

    def isPacketTimeout(self) -> bool:
        """Whether too many reads brought nothing."""
        return self.empty_reads > _PATIENCE


class PlainHandler(StuffingPacketHandler):
    """Ours, but that it takes every packet in the SDK's way."""

    def _status_packet(self, port: Any) -> tuple[list[int], int]:
        packet, result = Protocol2PacketHandler.rxPacket(self, port, False)
        return packet, result


def results(handler: StuffingPacketHandler, pieces: list[bytes]) -> list[tuple[list[int], int, bool, int]]:
    """Packets, the SDK's results, whether the port is free, and reads that brought nothing, until silence."""
    port, found = ScriptedPort(pieces), []
    for _ in range(12):
        port.empty_reads, port.is_using = 0, True
        packet, result = handler.rxPacket(port, False)
        found.append((list(packet), result, port.is_using, port.empty_reads))
    return found


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = [0, *sorted(place % (len(data) + 1) for place in places), len(data)]
    return [data[one:two] for one, two in itertools.pairwise(ends)]


whole = st.builds(
    lambda dxl_id, error, params: encode_status(StatusPacket(dxl_id, error, params)),
    st.integers(0, 252),
    st.integers(0, 0xFF),
    st.one_of(st.binary(max_size=40), st.lists(st.sampled_from([0xFF, 0xFD, 0]), max_size=40).map(bytes)),
)
damaged = st.tuples(whole, st.integers(0, 99), st.integers(1, 255)).map(
    lambda item: bytes(
        byte ^ (item[2] if k == item[1] % len(item[0]) else 0) for k, byte in enumerate(item[0])
    )
)
short = st.tuples(whole, st.integers(1, 60)).map(lambda item: item[0][: -item[1]])
streams = st.lists(st.one_of(whole, whole, damaged, short, st.binary(max_size=20)), max_size=5).map(b"".join)


@settings(max_examples=400)
@given(streams, st.lists(st.integers(0, 400), max_size=6))
def test_it_takes_what_the_sdk_takes(stream: bytes, places: list[int]) -> None:
    pieces = cut(stream, places)
    found = results(StuffingPacketHandler(), pieces)
    assert found == results(PlainHandler(), pieces)
    event(f"{sum(item[1] == COMM_SUCCESS for item in found)} packets")
