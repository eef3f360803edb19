"""The loop of a rig over the vendor's plain SDK, and a tape of what ports answered."""

from collections.abc import Iterator, Sequence

from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PortHandler, Protocol2PacketHandler
from serial.serialutil import SerialBase

from palpate.drivers.transport.clock import Clock
from support.oracles.bus_loop import GOALS_RAD, LoopCase

_STATE = ((0, 2), (2, 4), (6, 4), (10, 1), (11, 1), (12, 1), (13, 1))  # items of the block of 14 bytes


class _Port(PortHandler):
    """The SDK's own port handler, but for where its port comes from and whose time it is."""

    def __init__(self, port: SerialBase, clock: Clock | None) -> None:
        super().__init__(port.port)
        self.ser = port
        if clock is not None:
            self.getCurrentTime = lambda: clock.now() * 1e3

    def setupPort(self, cflag_baud: int) -> bool:
        self.ser.baudrate = cflag_baud
        self.ser.timeout = 0
        self.is_open = True
        self.tx_time_per_byte = 1e4 / cflag_baud
        return True


class SdkLoop:
    """The same with nothing but the SDK, on servos that a `BusLoop` has set up."""

    def __init__(
        self, case: LoopCase, block: int, fast: bool, port: SerialBase, clock: Clock | None = None
    ) -> None:
        """`block`: where the state is shown. `clock`: None for the wall clock, which the SDK reads itself."""
        self.port = _Port(port, clock)
        assert self.port.setBaudRate(case.baudrate)
        packets = Protocol2PacketHandler()
        self._block = block
        self._ids: Sequence[int] = case.ids
        self._read = GroupSyncRead(self.port, packets, block, 14)
        self._write = GroupSyncWrite(self.port, packets, 116, 4)
        for dxl_id in case.ids:
            self._read.addParam(dxl_id)
            self._write.addParam(dxl_id, bytes(4))
        self._ask = self._read.fastSyncRead if fast else self._read.txRxPacket
        self.lost = 0

    def cycle(self, number: int) -> None:
        if self._ask() != COMM_SUCCESS:
            self.lost += 1
        for dxl_id in self._ids:
            for first, size in _STATE:
                self._read.getData(dxl_id, self._block + first, size)
        goal = (round(GOALS_RAD[number % len(GOALS_RAD)] * 651.9) + 2048).to_bytes(4, "little")
        for dxl_id in self._ids:
            self._write.changeParam(dxl_id, goal)
        self._write.txPacket()


# ----------------------------------------------------------------------------------------------------
# What a port and a clock answered, kept and given again from a list, so that nothing but host code runs.
#
# For measuring what the host's own code costs: first with taping ones, in front of a mock port with emulated
# servos, then with playing ones. The host must ask the same again in the same order. Shorter and quicker than
# the session log's replay, which compares everything; here only writes are compared.

Tape = list[object]


class TapingClock:
    """A clock whose readings go to a tape."""

    def __init__(self, clock: Clock, tape: Tape) -> None:
        self._clock = clock
        self._tape = tape

    def now(self) -> float:
        instant = self._clock.now()
        self._tape.append(instant)
        return instant

    def sleep(self, seconds: float) -> None:
        self._clock.sleep(seconds)


class TapingPort:
    """An open port whose answers go to a tape; it has what the host uses of pyserial's."""

    def __init__(self, port: SerialBase, tape: Tape) -> None:
        self._inner = port
        self._tape = tape
        self.port = port.port
        self.is_open = True

    def read(self, size: int = 1) -> bytes:
        return self._kept(self._inner.read(size))

    def write(self, data: bytes) -> int:
        self._tape.append(bytes(data))
        return self._kept(self._inner.write(bytes(data)))

    @property
    def in_waiting(self) -> int:
        return self._kept(self._inner.in_waiting)

    def reset_input_buffer(self) -> None:
        self._inner.reset_input_buffer()

    def close(self) -> None:
        self._inner.close()

    def __setattr__(self, name: str, value: object) -> None:
        if name in ("baudrate", "timeout"):
            setattr(self._inner, name, value)
        object.__setattr__(self, name, value)

    def _kept(self, answer):
        self._tape.append(answer)
        return answer


class PlayingClock:
    """Gives the readings from a tape again."""

    def __init__(self, answers: Iterator[object]) -> None:
        self.now = answers.__next__

    def sleep(self, seconds: float) -> None:
        """Nothing to wait for."""


class PlayingPort:
    """Gives a port's answers from a tape again. AssertionError if other bytes are written than then."""

    def __init__(self, port: str, answers: Iterator[object]) -> None:
        self.port = port
        self.is_open = True
        self._next = answers.__next__

    def read(self, size: int = 1) -> bytes:  # noqa: ARG002
        return self._next()

    def write(self, data: bytes) -> int:
        then = self._next()
        now = bytes(data)
        assert now == then, f"writes {now!r}, when the tape was made {then!r}"
        return self._next()

    @property
    def in_waiting(self) -> int:
        return self._next()

    def reset_input_buffer(self) -> None:
        """Nothing to drop."""

    def close(self) -> None:
        """Nothing to close."""
