"""Base of the host drivers of Weiss Robotics' tactile sensors: requests, answers, frames.

Neither device numbers its frames: numbers
and losses come from their stamps (`frame_times`). A texel at the matrix's full scale counts as the
largest count.
"""

from abc import abstractmethod
from collections.abc import Collection
from enum import IntEnum

import numpy as np
from serial.serialutil import SerialBase

from palpate.plugins import (
    Clock,
    Counts,
    Description,
    DeviceError,
    FrameStream,
    FrameTimes,
    Mounting,
    Port,
    StreamedArray,
    TactileFrame,
    printable_text,
)
from palpate_weiss.codec import (
    MAX_PAYLOAD,
    WeissDecoder,
    WeissDialect,
    WeissFault,
    WeissPacket,
    encode,
)
from palpate_weiss.messages import (
    FRAME,
    MAX_TEXEL,
    STATUS_SIZE,
    MatrixInfo,
    RawFrame,
    frame_size,
    parse_frame,
    status_of,
)

__all__ = ["BOOT_ATTEMPTS", "WeissArray", "text_of"]

_TIMEOUT_S = 0.5
_COMMAND_TIMEOUT_S = 0.15  # short: servos whose Bus Watchdog is armed hear nothing meanwhile
_ATTEMPTS = 4
BOOT_ATTEMPTS = 10  # a board that resets as its port opens is deaf for up to 3 s
_QUIET_S = 0.01
_LATE_S = 0.2
_LONGEST_ANSWER = 256  # bytes, other than frames: tags and descriptors are the longest
_BIT_DEPTH = 12


class WeissArray(StreamedArray):
    """An `ArrayDriver` but for what the two dialects say differently."""

    _dialect: WeissDialect
    _statuses: type[IntEnum]

    def __init__(
        self, port: SerialBase | Port, clock: Clock, name: str, mounting: Mounting, matrix: int = 0
    ) -> None:
        """`name` is the finger's. `matrix`: which one is on its tip, of a device that has several."""
        super().__init__(FrameStream(port, clock, name, self._take), clock)
        self._mounting = mounting
        self._matrix = matrix
        self._decoder = WeissDecoder(self._dialect)
        self._answers: list[WeissPacket] = []
        self._matrices: tuple[MatrixInfo, ...] = ()
        self._times: FrameTimes | None = None
        self._asked_again = False
        self._lost_before = 0

    @property
    def _lost_and_faults(self) -> tuple[int, int]:
        """`lost` is estimated from stamps."""
        lost = self._lost_before + (self._times.lost if self._times else 0)
        return lost, sum(self._decoder.faults.values())

    def connect(self) -> Description:
        """Ask the array what it is; a running stream stops. Raises DeviceError if nothing answers.

        What would take the zero off frames, thresholds and taring, is switched off: baselines are the
        host's.
        """
        self._description = None
        self._decoder.max_payload = MAX_PAYLOAD
        self._lost_before = self.counters.lost
        self._times = None
        try:
            description, tick_s = self._introduce()
        except ValueError as problem:
            raise DeviceError(
                f"{self._stream.where} says of itself what cannot be used: {problem}; check protocol and "
                "matrix in the rig file"
            ) from problem
        self._decoder.max_payload = max(frame_size(self._cells), _LONGEST_ANSWER)
        self._times = FrameTimes(tick_s)
        self._description = description
        self._stream.clear()
        self._stream.expect(0.0, frame_size(self._cells))
        return description

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`, or as near to it as the array can; DeviceError if it refuses."""
        self._check_rate(rate_hz)
        self._stream.expect(self._arriving_hz(rate_hz), frame_size(self._cells))
        self._begin(rate_hz)

    @abstractmethod
    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""

    def _arriving_hz(self, rate_hz: float) -> float:
        """Frames a second that may come where `rate_hz` are asked for."""
        return rate_hz

    @abstractmethod
    def _introduce(self) -> tuple[Description, float]:
        """Stop it, ask everything, set `_matrices`; description and the stamps' unit in s."""

    @abstractmethod
    def _begin(self, rate_hz: float) -> None:
        """Begin a stream; one that runs gets the new rate. Calls `_new_stream` before its first frame."""

    def _new_stream(self) -> None:
        if self._times is not None:
            self._times.restart()

    @property
    def _cells(self) -> int:
        return sum(matrix.cells for matrix in self._matrices)

    def _command(self, command: IntEnum, payload: bytes = b"", *, fine: Collection[int] = (0,)) -> None:
        """As `_request`, without waiting long: fingers may be under way."""
        self._request(command, payload, fine=fine, timeout_s=_COMMAND_TIMEOUT_S)

    def _request(
        self,
        command: IntEnum,
        payload: bytes = b"",
        *,
        fine: Collection[int] = (0,),
        timeout_s: float = _TIMEOUT_S,
    ) -> bytes:
        """What the answer to a command says behind its status, which has to be one of `fine`."""
        answer = self._ask(WeissPacket(command, payload), timeout_s=timeout_s)
        if answer is None:
            raise DeviceError(
                f"{self._stream.where} did not answer {_words(command)}; check its power and its cable"
            )
        status = status_of(answer)
        if status is None or status not in fine:
            raise DeviceError(
                f"{self._stream.where} refuses {_words(command)} ({self._status_name(status)}); "
                "power it off and on, then check its firmware"
            )
        return answer[STATUS_SIZE:]

    def _inquire(self, command: IntEnum, payload: bytes = b"") -> bytes:
        """As `_request`, but empty where the array does not know the command."""
        answer = self._ask(WeissPacket(command, payload))
        return answer[STATUS_SIZE:] if answer is not None and status_of(answer) == 0 else b""

    def _ask(
        self, packet: WeissPacket, attempts: int = _ATTEMPTS, timeout_s: float = _TIMEOUT_S
    ) -> bytes | None:
        """The answer's payload, asking again where none comes; everything asked may be said twice."""
        found: list[bytes] = []

        def answered() -> bool:
            # An answer without a status has no checksum either, so that it may be noise.
            found.extend(item.payload for item in self._answers if item.command == packet.command)
            self._answers.clear()
            return any(status_of(payload) is not None for payload in found)

        self._let_pass()
        for attempt in range(attempts):
            self._asked_again |= attempt > 0
            self._stream.write(encode(self._dialect, packet))
            if not self._stream.wait_until(answered, timeout_s):
                self._sort(self._decoder.give_up())
            if answered():
                return next(payload for payload in found if status_of(payload) is not None)
        return None

    def _let_pass(self) -> None:
        """Read what is under way: an answer names its command, not which of several requests it is for."""
        if self._description is None:
            self._stream.wait_until(lambda: False, _LATE_S if self._asked_again else _QUIET_S)
            self._asked_again = False
        self._stream.drain()
        self._answers.clear()

    def _status_name(self, status: int | None) -> str:
        return next((item.name for item in self._statuses if item == status), f"status {status}")

    def _silent(self) -> DeviceError:
        return DeviceError(
            f"{self._stream.where} does not answer; "
            "check its power, its cable, and the port's name and baud rate in the rig file"
        )

    def _take(self, data: bytes) -> None:
        self._sort(self._decoder.feed(data))

    def _sort(self, items: list[WeissPacket | WeissFault]) -> None:
        for item in items:
            if isinstance(item, WeissPacket):
                if item.command == FRAME:
                    self._frame(item.payload)
                else:
                    self._stream.note_answer()
                    self._answers.append(item)

    def _frame(self, payload: bytes) -> None:
        if self._times is None:
            return  # of a stream that ran before
        try:
            raw = parse_frame(payload, self._cells)
        except ValueError as problem:
            self._refuse(str(problem))
            return
        placed = self._times.place(raw.timestamp)
        if placed is None:
            self._refuse(f"its stamp {raw.timestamp} stands still, runs backwards or leaps")
            return
        host_s = self._clock.now()
        self._stream.push(TactileFrame(placed.sequence, placed.time_s, host_s, self._on_tip(raw)))

    def _on_tip(self, raw: RawFrame) -> Counts:
        number = self._matrix
        matrix = self._matrices[number]
        first = sum(other.cells for other in self._matrices[:number])
        cells = raw.texels[first : first + matrix.cells].reshape(matrix.cells_y, matrix.cells_x)
        if 0 < matrix.full_scale < MAX_TEXEL:
            cells = np.where(cells >= matrix.full_scale, MAX_TEXEL, cells).astype(np.uint16)
        return self._mounting.to_tip(cells)

    def _describe(self, unique_id: bytes, firmware: str, *, emulated: bool, limit_hz: float) -> Description:
        matrix = self._matrices[self._matrix]
        return self._mounting.describe(
            (matrix.cells_x, matrix.cells_y),
            (matrix.width_mm, matrix.height_mm),
            unique_id=unique_id,
            firmware=firmware,
            emulated=emulated,
            bit_depth=_BIT_DEPTH,
            max_rate_hz=limit_hz,
        )


def _words(command: IntEnum) -> str:
    return f"{command.name} ({command.value:02X}h)"


def text_of(payload: bytes) -> str:
    """Text of an answer that is one, as a terminal may show it."""
    return printable_text(payload.split(b"\0")[0].decode("latin-1").strip())
