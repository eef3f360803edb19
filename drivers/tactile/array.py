"""Host driver of an array that speaks `docs/tactile-protocol.md`. Stands between a port and the extractor.

Bytes in, frames out. `stream` does the waiting.
"""

from serial.serialutil import SerialBase

from palpate.drivers.tactile.frames import ArrayCounters, TactileFrame
from palpate.drivers.tactile.messages import (
    Ack,
    Body,
    Describe,
    Description,
    Frame,
    Hello,
    Message,
    Nack,
    Start,
    Stop,
)
from palpate.drivers.tactile.protocol import DELIMITER, Decoder, encode
from palpate.drivers.tactile.stream import FrameStream, Port
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError

__all__ = ["TactileArray"]

ANSWER_TIMEOUT_S = 0.5
COMMAND_TIMEOUT_S = 0.15  # short: servos whose Bus Watchdog is armed hear nothing meanwhile
ATTEMPTS = 3


class TactileArray:
    """A tactile array on a port, as an `ArrayDriver`. Call `connect` first."""

    def __init__(self, port: SerialBase | Port, clock: Clock, name: str) -> None:
        self._stream = FrameStream(port, clock, name, self._take)
        self._clock = clock
        self._decoder = Decoder()
        self._answers: list[Body] = []
        self._sequence = 0
        self._request = 0
        self._description: Description | None = None
        self._misshapen = 0

    @property
    def description(self) -> Description:
        """What the array said of itself; raises DeviceError before `connect`."""
        if self._description is None:
            raise DeviceError(f"{self._stream.where} has not been asked what it is; call connect() first")
        return self._description

    @property
    def counters(self) -> ArrayCounters:
        """Frames taken and everything that did not become a frame."""
        faults = sum(self._decoder.faults.values())
        stream = self._stream
        return ArrayCounters(stream.received, self._decoder.lost, faults, self._misshapen, stream.dropped)

    def connect(self) -> Description:
        """Ask the array what it is; a running stream stops. Raises DeviceError if nothing answers."""
        self._description = None
        for _ in range(ATTEMPTS):
            answer = self._ask(Hello(self._next_request()))
            if isinstance(answer, Describe):
                self._description = answer.description
                self._stream.clear()
                return answer.description
            if isinstance(answer, Nack):
                raise DeviceError(
                    f"{self._stream.where} refuses to describe itself ({answer.reason.name}); "
                    "power it off and on, then check its firmware"
                )
        raise DeviceError(
            f"{self._stream.where} does not answer; "
            "check its power, its cable and the port's name in the rig file"
        )

    def start(self, rate_hz: float) -> None:
        """Stream frames at `rate_hz`. Raises DeviceError if the array refuses the rate or does not answer."""
        limit = self.description.max_rate_hz
        if not 0 < rate_hz <= limit:
            raise DeviceError(
                f"{self._stream.where} cannot sample at {rate_hz:g} Hz; choose a rate up to {limit:g} Hz"
            )
        self._command(Start(self._next_request(), round(rate_hz * 1000)), "start")

    def stop(self) -> None:
        """Stop the stream; frames that were on their way stay readable."""
        self._command(Stop(self._next_request()), "stop")

    def frames(self) -> list[TactileFrame]:
        """Return every frame that has arrived, oldest first, without waiting."""
        return self._stream.frames()

    def wait_frame(self, timeout_s: float) -> TactileFrame:
        """Return the oldest unread frame, waiting up to `timeout_s`; raises DeviceError if none comes."""
        return self._stream.wait_frame(timeout_s)

    def _command(self, body: Start | Stop, verb: str) -> None:
        """Say it more than once: command or answer may get lost, and doing it twice does no harm."""
        answer = next(
            (said for _ in range(ATTEMPTS) if (said := self._ask(body, COMMAND_TIMEOUT_S)) is not None), None
        )
        where = self._stream.where
        if isinstance(answer, Nack):
            raise DeviceError(
                f"{where} refuses to {verb} ({answer.reason.name}); check the rate and the firmware"
            )
        if answer is None:
            raise DeviceError(f"{where} did not answer {verb.upper()}; check its power and its cable")

    def _ask(self, body: Hello | Start | Stop, timeout_s: float = ANSWER_TIMEOUT_S) -> Body | None:
        self._answers.clear()
        # A leading delimiter ends whatever noise the array's receiver holds.
        self._stream.write(DELIMITER + encode(Message(self._sequence, self._now_us(), body)))
        self._sequence = (self._sequence + 1) % (1 << 32)
        found: list[Body] = []

        def answered() -> bool:
            found.extend(
                answer
                for answer in self._answers
                if isinstance(answer, Ack | Nack | Describe) and answer.request_id == body.request_id
            )
            self._answers.clear()
            return bool(found)

        self._stream.wait_until(answered, timeout_s)
        return found[0] if found else None

    def _take(self, data: bytes) -> None:
        for item in self._decoder.feed(data):
            if isinstance(item, Message):
                self._sort(item)

    def _sort(self, message: Message) -> None:
        body = message.body
        if not isinstance(body, Frame):
            self._answers.append(body)
            return
        shape = self._description
        if shape is None:
            return
        if (body.rows, body.cols) != (shape.rows, shape.cols):
            self._misshapen += 1
            return
        self._stream.push(
            TactileFrame(message.sequence, message.time_us * 1e-6, self._clock.now(), body.counts)
        )

    def _next_request(self) -> int:
        self._request = self._request % 0xFFFF + 1
        return self._request

    def _now_us(self) -> int:
        return round(self._clock.now() * 1e6)
