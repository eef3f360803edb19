"""A program that knows the vendor's SDK only, from 3.8 on. Run with a port: tells what it did as JSON.

The SDK waits 34 ms for an answer, and one cannot ask it to wait longer. Where the computer is busy for
longer than that, an answer is late: what has failed is therefore tried again, after a rest and with the old
answer drained.
"""

import importlib.metadata
import json
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import dynamixel_sdk as sdk

TRIES = 10
TORQUE_ENABLE, PROFILE_VELOCITY, GOAL_POSITION, PRESENT_POSITION = 64, 112, 116, 132
VOLTAGE, TEMPERATURE, MODEL_NUMBER = 144, 146, 0

IDS = (5, 6, 7)
NOBODY = 9
GOALS = {5: 2600, 6: 1500, 7: 2300}


def word(value: int, size: int = 4) -> list[int]:
    return list(value.to_bytes(size, "little"))


class Client:
    def __init__(self, path: str) -> None:
        self.port = sdk.PortHandler(path)
        self.packets = sdk.PacketHandler(2.0)
        self.again = 0
        assert self.port.openPort()
        assert self.port.setBaudRate(1_000_000)

    def persist(self, call: Callable[..., Any], *args: Any) -> Any:
        """The call's result once communication succeeded; its status error is returned with it."""
        told: Any = None
        for _ in range(TRIES):
            told = call(self.port, *args)
            if (told[-2] if isinstance(told, tuple) else told) == sdk.COMM_SUCCESS:
                return told
            self.rest()
        raise AssertionError(f"{call.__name__}{args}: {told} after {TRIES} tries")

    def rest(self) -> None:
        self.again += 1
        time.sleep(0.2)
        self.port.readPort(4096)

    def group_read(self, group: Any, wanted: dict[int, tuple[int, int]]) -> dict[int, int]:
        """Values by id of a group read, `wanted` by id as (address, size)."""
        self.persist(lambda _: group.txRxPacket())
        for dxl_id, place in wanted.items():
            assert group.isAvailable(dxl_id, *place), dxl_id
        return {dxl_id: group.getData(dxl_id, *place) for dxl_id, place in wanted.items()}

    def sync_read(self, address: int, size: int, ids: Sequence[int] = IDS) -> dict[int, int]:
        group = sdk.GroupSyncRead(self.port, self.packets, address, size)
        for dxl_id in ids:
            assert group.addParam(dxl_id)
        return self.group_read(group, dict.fromkeys(ids, (address, size)))

    def bulk_read(self, wanted: dict[int, tuple[int, int]]) -> dict[int, int]:
        group = sdk.GroupBulkRead(self.port, self.packets)
        for dxl_id, (address, size) in wanted.items():
            assert group.addParam(dxl_id, address, size)
        return self.group_read(group, wanted)

    def sync_write(self, address: int, size: int, values: dict[int, int]) -> None:
        group = sdk.GroupSyncWrite(self.port, self.packets, address, size)
        for dxl_id, value in values.items():
            assert group.addParam(dxl_id, word(value, size))
        assert group.txPacket() == sdk.COMM_SUCCESS

    def bulk_write(self, values: dict[int, tuple[int, int, int]]) -> None:
        """`values` by id as (address, size, value)."""
        group = sdk.GroupBulkWrite(self.port, self.packets)
        for dxl_id, (address, size, value) in values.items():
            assert group.addParam(dxl_id, address, size, word(value, size))
        assert group.txPacket() == sdk.COMM_SUCCESS

    def move(self, goals: dict[int, int], write: Callable[[], None]) -> list[dict[int, int]]:
        """Positions seen on the way to goals that `write` sets."""
        write()
        seen = []
        end = time.monotonic() + 600
        while time.monotonic() < end:
            seen.append(self.sync_read(PRESENT_POSITION, 4))
            if all(abs(seen[-1][dxl_id] - goal) <= 3 for dxl_id, goal in goals.items()):
                break
        return seen


def basics(path: str) -> dict[str, Any]:
    client = Client(path)
    packets = client.packets
    told: dict[str, Any] = {}
    told["ping"] = [client.persist(packets.ping, dxl_id) for dxl_id in IDS]
    told["nobody"] = packets.ping(client.port, NOBODY)[1] != sdk.COMM_SUCCESS
    told["everybody"] = client.persist(lambda port: reversed_result(packets.broadcastPing(port)))[0]
    told["read"] = client.persist(packets.read4ByteTxRx, 6, PRESENT_POSITION)
    told["write"] = client.persist(packets.write4ByteTxRx, 6, PROFILE_VELOCITY, 150)
    told["read back"] = client.persist(packets.read4ByteTxRx, 6, PROFILE_VELOCITY)
    told["read only"] = client.persist(packets.write2ByteTxRx, 6, MODEL_NUMBER, 7)
    client.sync_write(PROFILE_VELOCITY, 4, dict.fromkeys(IDS, 200))
    told["sync write"] = client.sync_read(PROFILE_VELOCITY, 4)
    client.sync_write(TORQUE_ENABLE, 1, dict.fromkeys(IDS, 1))
    told["torque"] = client.sync_read(TORQUE_ENABLE, 1)
    told["moved"] = client.move(GOALS, lambda: client.sync_write(GOAL_POSITION, 4, GOALS))
    told["bulk read"] = client.bulk_read({5: (VOLTAGE, 2), 6: (TEMPERATURE, 1), 7: (PROFILE_VELOCITY, 4)})
    client.bulk_write({5: (TORQUE_ENABLE, 1, 0), 6: (PROFILE_VELOCITY, 4, 99)})
    told["bulk write"] = client.bulk_read({5: (TORQUE_ENABLE, 1), 6: (PROFILE_VELOCITY, 4)})
    told["registered"] = client.persist(packets.regWriteTxRx, 7, GOAL_POSITION, 4, word(2048))
    told["before action"] = client.sync_read(PRESENT_POSITION, 4)
    told["moved by action"] = client.move({7: 2048}, lambda: act(client))
    client.sync_write(TORQUE_ENABLE, 1, dict.fromkeys(IDS, 0))
    told["reboot"] = client.persist(packets.reboot, 5)
    told["again"] = client.again
    client.port.closePort()
    return told


def reversed_result(answer: tuple[Any, int]) -> tuple[Any, int, int]:
    """A broadcast ping's models by id, its result, and no status error, in the order of other calls."""
    return answer[0], answer[1], 0


def act(client: Client) -> None:
    client.persist(client.packets.action, 7)


def fast(path: str) -> dict[str, Any]:
    """Fast sync and bulk read, which SDKs from 4.0 on have."""
    client = Client(path)
    told: dict[str, Any] = {}
    sync = sdk.GroupSyncRead(client.port, client.packets, PRESENT_POSITION, 4)
    for dxl_id in IDS:
        assert sync.addParam(dxl_id)
    client.persist(lambda _: sync.fastSyncRead())
    told["sync"] = {dxl_id: sync.getData(dxl_id, PRESENT_POSITION, 4) for dxl_id in IDS}
    bulk = sdk.GroupBulkRead(client.port, client.packets)
    places = {7: (VOLTAGE, 2), 5: (TEMPERATURE, 1), 6: (PRESENT_POSITION, 4)}
    for dxl_id, place in places.items():
        assert bulk.addParam(dxl_id, *place)
    client.persist(lambda _: bulk.fastBulkRead())
    told["bulk"] = {dxl_id: bulk.getData(dxl_id, *place) for dxl_id, place in places.items()}
    client.port.closePort()
    return told


def model(path: str) -> dict[str, Any]:
    client = Client(path)
    found = client.persist(client.packets.ping, IDS[0])[0]
    client.port.closePort()
    return {"model": found}


if __name__ == "__main__":
    told = {"basics": basics, "fast": fast, "model": model}[sys.argv[2]](sys.argv[1])
    json.dump(told | {"version": importlib.metadata.version("dynamixel-sdk")}, sys.stdout)
