"""Whole status packets are taken quickly, with the result, and the looks at the port, that the SDK has."""

import itertools
from typing import Any

from dynamixel_sdk import COMM_SUCCESS, Protocol2PacketHandler
from hypothesis import event, given, settings
from hypothesis import strategies as st

from palpate.drivers.dynamixel.packet import StatusPacket, encode_status
from palpate.drivers.dynamixel.sdk import StuffingPacketHandler

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


@settings(max_examples=1500, deadline=None)
@given(streams, st.lists(st.integers(0, 400), max_size=6))
def test_it_takes_what_the_sdk_takes(stream: bytes, places: list[int]) -> None:
    pieces = cut(stream, places)
    found = results(StuffingPacketHandler(), pieces)
    assert found == results(PlainHandler(), pieces)
    event(f"{sum(item[1] == COMM_SUCCESS for item in found)} packets")
