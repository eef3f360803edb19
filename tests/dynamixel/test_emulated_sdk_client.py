"""The vendor's SDK on emulated servos, in virtual time: every model, rarer instructions to three of them."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pytest
from dynamixel_sdk import (
    COMM_SUCCESS,
    GroupBulkRead,
    GroupBulkWrite,
    GroupSyncRead,
    GroupSyncWrite,
    PortHandler,
    Protocol2PacketHandler,
)

from palpate.drivers.dynamixel.x_series import MODEL_NAMES, X_SERIES
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.servo_chain import ServoChain
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.mock import MockHub
from palpate.drivers.transport.ports import open_port

BAUD = 1_000_000
MODELS = {3: ("XM430-W350", 45, 1020), 7: ("XL330-M288", 52, 1200), 4: ("XC330-M288", 52, 1240)}
DONE = (COMM_SUCCESS, 0)


class VirtualPort(PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's own port handler, but for where it opens its port and looks at the time."""

    def __init__(self, url: str, clock: VirtualClock) -> None:
        super().__init__(url)
        self.clock = clock

    def setupPort(self, cflag_baud: int) -> bool:
        self.ser = open_port(self.port_name, cflag_baud)
        self.is_open = True
        self.tx_time_per_byte = 1e4 / cflag_baud
        return True

    def getCurrentTime(self) -> float:
        return self.clock.now() * 1e3


@dataclass
class Client:
    port: VirtualPort
    packets: Protocol2PacketHandler
    servos: dict[int, EmulatedServo]

    def run(self, seconds: float) -> None:
        for servo in self.servos.values():
            for _ in range(round(seconds / 1e-3)):
                servo.step(1e-3, 0.0)


def client_of(servos: dict[int, EmulatedServo]) -> Client:
    clock = VirtualClock()
    hub = MockHub(clock, "sdk")
    url = hub.attach("bus", ServoChain(list(servos.values()), lambda _: None), BAUD)
    port = VirtualPort(url, clock)
    assert port.setBaudRate(BAUD)
    return Client(port, Protocol2PacketHandler(), servos)


@pytest.fixture
def client() -> Iterator[Client]:
    servos = {
        k: EmulatedServo(k, model=model, firmware=firmware, start_rad=0.1 * k)
        for k, (model, firmware, _) in MODELS.items()
    }
    made = client_of(servos)
    yield made
    made.port.closePort()


@pytest.mark.parametrize("number", MODEL_NAMES)
def test_every_model_by_the_vendors_sdk(number: int) -> None:
    """Ping, fast read, its own voltage and limits, and a goal that it moves to."""
    model = X_SERIES[number]
    client = client_of({1: EmulatedServo(1, model=model.name)})
    port, sdk = client.port, client.packets
    assert sdk.ping(port, 1) == (number, *DONE)
    group = GroupSyncRead(port, sdk, 132, 4)
    group.addParam(1)
    assert group.fastSyncRead() == COMM_SUCCESS
    assert group.getData(1, 132, 4) == 2048
    assert sdk.read2ByteTxRx(port, 1, 144)[0] == round(10 * model.family.supply_v[1])
    highest = model.current_limit
    assert sdk.read2ByteTxRx(port, 1, 38) == (highest, *DONE)
    assert sdk.write2ByteTxRx(port, 1, 38, highest + 1) == (COMM_SUCCESS, 4)  # Data Range Error
    assert sdk.write2ByteTxRx(port, 1, 38, highest // 2) == DONE
    assert sdk.write1ByteTxRx(port, 1, 64, 1) == DONE
    assert sdk.write4ByteTxRx(port, 1, 116, 2600) == DONE
    client.run(2.0)
    assert sdk.read4ByteTxRx(port, 1, 132)[0] == pytest.approx(2600, abs=10)
    assert sdk.write2ByteTxRx(port, 1, 38, 9) == (COMM_SUCCESS, 7)  # EEPROM is locked while torque is on
    port.closePort()


@pytest.mark.parametrize("fast", [False, True])
def test_sync_reads(client: Client, fast: bool) -> None:
    group = GroupSyncRead(client.port, client.packets, 132, 4)
    for dxl_id in MODELS:
        group.addParam(dxl_id)
    assert (group.fastSyncRead() if fast else group.txRxPacket()) == COMM_SUCCESS
    for dxl_id in MODELS:
        wanted = 2048 + round(0.1 * dxl_id / (2 * math.pi) * 4096)
        assert group.getData(dxl_id, 132, 4) == wanted


@pytest.mark.parametrize("fast", [False, True])
def test_bulk_reads(client: Client, fast: bool) -> None:
    group = GroupBulkRead(client.port, client.packets)
    for dxl_id, (address, size) in zip(MODELS, ((0, 2), (144, 2), (146, 1)), strict=True):
        group.addParam(dxl_id, address, size)
    assert (group.fastBulkRead() if fast else group.txRxPacket()) == COMM_SUCCESS
    assert [group.getData(3, 0, 2), group.getData(7, 144, 2), group.getData(4, 146, 1)] == [1020, 50, 30]


def test_group_writes_and_indirect_addresses(client: Client) -> None:
    write = GroupSyncWrite(client.port, client.packets, 168, 2)
    for dxl_id in MODELS:
        write.addParam(dxl_id, [65, 0])  # Indirect Address 1: LED
    assert write.txPacket() == COMM_SUCCESS
    bulk = GroupBulkWrite(client.port, client.packets)
    for dxl_id, data in ((3, 224), (7, 208), (4, 208)):
        bulk.addParam(dxl_id, data, 1, [1])
    assert bulk.txPacket() == COMM_SUCCESS
    assert [client.packets.read1ByteTxRx(client.port, dxl_id, 65)[0] for dxl_id in MODELS] == [1, 1, 1]


def test_broadcast_ping_finds_all(client: Client) -> None:
    found, result = client.packets.broadcastPing(client.port)
    assert result == COMM_SUCCESS
    assert found == {dxl_id: [number, firmware] for dxl_id, (_, firmware, number) in MODELS.items()}


def test_clear_reboot_and_factory_reset(client: Client) -> None:
    assert client.packets.clearMultiTurn(client.port, 3) == DONE
    assert client.packets.write2ByteTxRx(client.port, 4, 38, 700) == DONE
    assert client.packets.reboot(client.port, 4) == DONE
    client.run(0.5)
    assert client.packets.read2ByteTxRx(client.port, 4, 38)[0] == 700
    assert client.packets.factoryReset(client.port, 4, 0x02) == DONE
    client.run(0.5)
    assert client.packets.read2ByteTxRx(client.port, 4, 38)[0] == 2352


def test_a_changed_id_answers_at_once(client: Client) -> None:
    assert client.packets.write1ByteTxRx(client.port, 3, 7, 9) == DONE
    assert client.packets.ping(client.port, 9) == (1020, *DONE)
