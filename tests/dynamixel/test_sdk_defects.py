"""Defects of the vendor's SDK that our bus is built around: each shown on the plain SDK.

Those that are mended by subclassing are in `test_sdk_corrections.py`. When a test here fails one day, the
vendor has mended it. Nothing of the SDK is changed but the port object and, where time counts, the clock it
looks at.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import dynamixel_sdk.port_handler
import pytest
import serial
from dynamixel_easy_sdk.connector import Connector
from dynamixel_sdk import (
    COMM_RX_TIMEOUT,
    COMM_SUCCESS,
    GroupBulkRead,
    GroupSyncRead,
    PortHandler,
    Protocol2PacketHandler,
)

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
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port
from palpate.drivers.transport.wire import Emission

BAUD = 1_000_000
POSITION = (132, 4)


@dataclass
class Answering:
    """Gives the same answers to every packet, one after the other."""

    answers: Sequence[StatusPacket] = ()
    heard: list[InstructionPacket] = field(default_factory=list)
    parser: Parser = field(default_factory=Parser)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        found = [packet for packet in self.parser.feed(data) if isinstance(packet, InstructionPacket)]
        self.heard += found
        return [(now, encode_status(answer)) for _ in found for answer in self.answers]

    def poll(self, now: float) -> list[Emission]:  # noqa: ARG002
        return []

    def next_due(self) -> float | None:
        return None


@dataclass
class World:
    device: Answering
    clock: VirtualClock
    port: serial.SerialBase

    def handler(self) -> PortHandler:
        return Virtual(self.port, self.clock)


class Virtual(PortHandler):  # type: ignore[misc]
    """The SDK's handler with an open port and the port's own clock."""

    def __init__(self, port: serial.SerialBase, clock: VirtualClock) -> None:
        super().__init__(port.port)
        self.ser = port
        self.is_open = True
        self.tx_time_per_byte = 0.01
        self.clock = clock

    def getCurrentTime(self) -> float:
        return self.clock.now() * 1e3


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
    """Servo 12 is silent; the answers of 11 and 13 are on the wire, whole."""
    world.device.answers = [position(11, 1111), position(13, 1313)]
    group = group_read(world.handler(), [11, 12, 13])
    assert group.txRxPacket() != COMM_SUCCESS
    assert world.device.heard[0].dxl_id == BROADCAST_ID
    assert [group.isAvailable(dxl_id, *POSITION) for dxl_id in (11, 12, 13)] == [False] * 3


def test_what_a_sync_read_has_not_got_reads_as_0(world: World) -> None:
    world.device.answers = [position(11, 1111), position(13, 1313)]
    group = sync_read(world.handler(), [11, 12, 13])
    group.txRxPacket()
    assert [group.getData(dxl_id, *POSITION) for dxl_id in (11, 12, 13)] == [0, 0, 0]


@both_groups
def test_a_missing_servo_costs_34_ms_at_any_rate(world: World, group_read: GroupRead) -> None:
    world.device.answers = [position(11, 1111)]
    group = group_read(world.handler(), [11, 12])
    group.txRxPacket()
    assert 0.034 < world.clock.now() < 0.036, "15 bytes at 1 Mbps take 0.15 ms"


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


def test_the_easy_sdk_fails_on_an_alert(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dynamixel_sdk.port_handler.serial, "Serial", lambda **_: world.port)
    connector = Connector("port", BAUD)
    world.device.answers = [position(11, 1111)]
    assert connector.read4ByteData(11, 132) == 1111
    world.device.answers = [position(11, 1111, ALERT_BIT)]
    with pytest.raises(ValueError, match="128 is not a valid DxlError"):
        connector.read4ByteData(11, 132)


@dataclass
class WallClock:
    """Stands in for `time` where the SDK looks at it; each look takes 10 µs."""

    now: float = 1e9
    looks: int = 0

    def time(self) -> float:
        self.now += 1e-5
        self.looks += 1
        return self.now


@dataclass
class FakeSerial:
    """A port on which an answer lies after so many reads; keeps how it was opened."""

    answer: bytes = b""
    ready_after: int = 0
    reads: int = 0
    options: dict[str, Any] = field(default_factory=dict)
    on_write: Callable[[], None] = lambda: None

    def __call__(self, **options: Any) -> "FakeSerial":
        self.options = options
        return self

    def reset_input_buffer(self) -> None:
        """Nothing there."""

    def write(self, data: bytes) -> int:
        self.on_write()
        return len(data)

    def read(self, size: int) -> bytes:
        self.reads += 1
        if self.reads <= self.ready_after:
            return b""
        part, self.answer = self.answer[:size], self.answer[size:]
        return part


@pytest.fixture
def walled(monkeypatch: pytest.MonkeyPatch) -> tuple[PortHandler, FakeSerial, WallClock]:
    """The SDK's own port handler, whole, on a fake port and a fake wall clock."""
    port, clock = FakeSerial(), WallClock()
    monkeypatch.setattr(dynamixel_sdk.port_handler.serial, "Serial", port)
    monkeypatch.setattr(dynamixel_sdk.port_handler, "time", clock)
    handler = PortHandler("port")
    assert handler.setBaudRate(BAUD)
    return handler, port, clock


def test_waiting_is_looking_again_and_again(walled: tuple[PortHandler, FakeSerial, WallClock]) -> None:
    handler, port, clock = walled
    assert Protocol2PacketHandler().ping(handler, 11)[1] == COMM_RX_TIMEOUT
    assert port.options["timeout"] == 0, "a read never waits in the port"
    assert port.reads > 3000, "34 ms, with nothing between two reads but a look at the clock"
    assert clock.looks < port.reads + 10


def test_an_answer_is_lost_when_the_wall_clock_is_set(
    walled: tuple[PortHandler, FakeSerial, WallClock],
) -> None:
    handler, port, clock = walled
    packets = Protocol2PacketHandler()
    port.answer, port.ready_after = encode_status(StatusPacket(11, 0, b"\x04\x06\x26")), 3
    assert packets.ping(handler, 11)[1] == COMM_SUCCESS
    port.answer, port.ready_after = encode_status(StatusPacket(11, 0, b"\x04\x06\x26")), port.reads + 3
    handler.setPacketTimeout = late_by_an_hour(handler, clock)
    assert packets.ping(handler, 11)[1] == COMM_RX_TIMEOUT


def late_by_an_hour(handler: PortHandler, clock: WallClock) -> Callable[[int], None]:
    """Starts the SDK's time-out, and sets the clock right afterwards."""
    start = handler.setPacketTimeout

    def begin(length: int) -> None:
        start(length)
        clock.now += 3600.0

    return begin
