"""Adapter of the vendor's SDK, with corrections only where necessary. It sits between `bus` and the port.

Host traffic goes through dynamixel_sdk's own packet handler. Corrected, each with a test that fails on the
plain SDK 4.1:

- it opens only `serial.Serial` by device name, and knows no baud rate above 4 Mbps: ours takes any open
  pyserial port and any rate;
- it times out after a fixed 34 ms and busy-waits on the wall clock: ours takes the clock, lets the port wait,
  is given how long an answer may take, and looks once more when the time is up, because the computer may
  have slept;
- an exception from the port leaves the handler marked busy for ever: ours releases it;
- `rxPacket` throws away all that was received behind a false header: ours searches it again;
- `txPacket` computes the byte stuffing and sends the packet without it;
- `removeStuffing` reads bytes that it has already overwritten, and loses data.

Quicker, with the same answers: the CRC, whose table the SDK builds anew for every packet.
"""

from collections.abc import Sequence

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_RX_TIMEOUT, COMM_SUCCESS, PortHandler, Protocol2PacketHandler
from serial.serialutil import SerialBase

from palpate.drivers.dynamixel.exchanges import LONGEST_RETURN_DELAY_S, Timing
from palpate.drivers.dynamixel.packet import MAX_ID, crc16, stuff, unstuff
from palpate.drivers.transport.clock import Clock
from palpate.drivers.transport.wire import wire_time_s

_READ_WAIT_S = 1e-3
"""How long a read may wait in the port before the SDK looks at its packet timeout again."""

_MAX_LATE_READS = 8  # a wire full of noise must not be listened to for ever
_HEADER = b"\xff\xff\xfd\x00"
_ID_INDEX, _BODY_INDEX = 4, 7  # indices of ID, and of INST: behind header, ID and length
_STATUS_INSTRUCTION = 0x55
_MIN_STATUS_BYTES = 11  # bytes of a status packet
_MAX_QUICK_STATUS_BYTES = 256  # of one that is taken the quick way


class ClockedPortHandler(PortHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's port handler on any open pyserial port and any clock."""

    def __init__(self, port: SerialBase, clock: Clock, timing: Timing) -> None:
        """Use `port`, which is open; closing the handler closes it."""
        super().__init__(port.port)
        self._port = port
        self._clock = clock
        self._timing = timing
        self._sent = 0
        self._late_looks = 0
        self._again = b""
        self.dropped = False
        self.baudrate = timing.baudrate
        self.return_delay_s = LONGEST_RETURN_DELAY_S

    def setupPort(self, cflag_baud: int) -> bool:
        """Set the port up instead of opening one."""
        self.ser = self._port
        self._port.baudrate = cflag_baud
        self._port.timeout = _READ_WAIT_S
        self.is_open = True
        self.clearPort()
        self.tx_time_per_byte = wire_time_s(1, cflag_baud) * 1e3
        return True

    def getCFlagBaud(self, baudrate: int) -> int:
        """Leave the judgement of a baud rate to the port."""
        return baudrate

    def getCurrentTime(self) -> float:
        """Milliseconds on the clock that was given."""
        return self._clock.now() * 1e3

    def setPacketTimeout(self, packet_length: int) -> None:
        """Wait as long as an answer of `packet_length` bytes may take after what was sent last."""
        seconds = self._timing.timeout_s(self._sent, packet_length, self.return_delay_s)
        self._sent = 0  # a further answer to the same packet does not wait for it again
        self._late_looks = _MAX_LATE_READS
        self.setPacketTimeoutMillis(seconds * 1e3)

    def isPacketTimeout(self) -> bool:
        """True if the time is up and nothing has arrived meanwhile: this process may have slept."""
        if self.getTimeSinceStart() <= self.packet_timeout:
            return False
        self._late_looks -= 1
        return self._late_looks < 0 or not self.getBytesAvailable()

    def clearPort(self) -> None:
        """Drop received bytes; `dropped` says whether there were any."""
        try:
            self.dropped = bool(self.getBytesAvailable())
            super().clearPort()
        except BaseException:
            self._release()
            raise

    def push_back(self, data: bytes) -> None:
        """Let these bytes, which were read from the port, be read once more."""
        self._again = data + self._again

    def readPort(self, length: int) -> bytes:
        """Read what is there, waiting for `READ_WAIT_S` at most."""
        if self._again:
            data, self._again = self._again[:length], self._again[length:]
            return data
        try:
            return bytes(super().readPort(length))
        except BaseException:
            self._release()
            raise

    def writePort(self, packet: list[int]) -> int:
        """Write a packet, given as the SDK's list of bytes."""
        self._sent = len(packet)
        self._again = b""
        try:
            return int(super().writePort(bytes(packet)))
        except BaseException:
            self._release()
            raise

    def _release(self) -> None:
        """An interrupted transfer, too, must leave a port that can switch torque off."""
        self.is_using = False


class StuffingPacketHandler(Protocol2PacketHandler):  # type: ignore[misc]  # the SDK has no types
    """The SDK's packet handler with byte stuffing that reaches the wire and comes off it whole."""

    def rxPacket(self, port: ClockedPortHandler, fast_option: bool) -> tuple[list[int], int]:
        """The next packet and the SDK's result; as much as there is of it if it is broken."""
        packet, result = super().rxPacket(port, True) if fast_option else self._status_packet(port)
        broken = packet
        while result == COMM_RX_CORRUPT and (start := bytes(packet).find(_HEADER, 1)) > 0:
            port.push_back(bytes(packet[start:]))
            packet, result = super().rxPacket(port, fast_option)
        return (broken if result == COMM_RX_CORRUPT else packet), result

    def _status_packet(self, port: ClockedPortHandler) -> tuple[list[int], int]:
        """Receive like the SDK's `rxPacket`, and quicker for packets that come whole, as nearly all do.

        It goes on where this has ended: what was read is pushed back. A read that brought nothing is followed
        by a look at the time, as in the SDK.
        """
        data = port.readPort(_MIN_STATUS_BYTES)
        nothing = not data
        if (
            len(data) == _MIN_STATUS_BYTES
            and data[:_ID_INDEX] == _HEADER
            and data[_ID_INDEX] <= MAX_ID
            and data[_BODY_INDEX] == _STATUS_INSTRUCTION
        ):
            size = _BODY_INDEX + (data[5] | data[6] << 8)
            if _MIN_STATUS_BYTES < size <= _MAX_QUICK_STATUS_BYTES:
                more = port.readPort(size - _MIN_STATUS_BYTES)
                data += more
                nothing = not more
            if len(data) == size and crc16(data[:-2]) == data[-2] | data[-1] << 8:
                port.is_using = False
                return self.removeStuffing(list(data)), COMM_SUCCESS
        if nothing and port.isPacketTimeout():
            port.is_using = False
            return list(data), COMM_RX_CORRUPT if data else COMM_RX_TIMEOUT
        port.push_back(data)
        packet, result = super().rxPacket(port, False)
        return packet, result

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff in place: the SDK's `txPacket` goes on with the list that it passed in."""
        length = packet[5] | packet[6] << 8
        body = stuff(bytes(packet[_BODY_INDEX : _BODY_INDEX + length - 2]))
        if len(body) != length - 2:
            _replace_body(packet, length, body)
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """Take the stuffing out of a packet whose CRC was found right."""
        length = packet[5] | packet[6] << 8
        body = unstuff(bytes(packet[_BODY_INDEX : _BODY_INDEX + length - 2]))
        if len(body) != length - 2:
            _replace_body(packet, length, body)
        return packet

    def updateCRC(self, crc_accum: int, data_blk_ptr: Sequence[int], data_blk_size: int) -> int:
        """The CRC of some of a packet's bytes, going on from `crc_accum`."""
        return crc16(bytes(data_blk_ptr[:data_blk_size]), crc_accum)


def _replace_body(packet: list[int], old_length: int, body: bytes) -> None:
    packet[_BODY_INDEX : _BODY_INDEX + old_length - 2] = body
    packet[5:7] = (len(body) + 2).to_bytes(2, "little")
