"""Questions to an array and their answers, among its frames. Stands between `stream` and `array`.

Every question is asked under a number of its own, more than once if need be: question or answer may get lost,
and every request of `docs/tactile-protocol.md` may be said twice without harm.
"""

from collections.abc import Callable
from typing import TypeVar

from serial.serialutil import SerialBase

from palpate.drivers.tactile.messages import Answer, Frame, Message, MessageType, Nack, Request
from palpate.drivers.tactile.protocol import DELIMITER, VERSION, DecodeFault, Decoder, FaultKind, encode
from palpate.drivers.tactile.stream import FrameStream, Port
from palpate.drivers.transport.clock import Clock
from palpate.errors import DeviceError

__all__ = ["Exchange"]

_Wanted = TypeVar("_Wanted", bound=Answer)


class Exchange:
    """The port of one array: `ask` says a request until it is answered, `on_frame` is handed every frame."""

    def __init__(
        self,
        port: SerialBase | Port,
        clock: Clock,
        name: str,
        on_frame: Callable[[Message, Frame], None],
    ) -> None:
        self.stream = FrameStream(port, clock, name, self._take)
        self.decoder = Decoder()
        self._clock = clock
        self._on_frame = on_frame
        self._answers: list[Answer] = []
        self._other_version: int | None = None
        self._sequence = 0
        self._request = 0

    def ask(
        self, make: Callable[[int], Request], wanted: type[_Wanted], timeout_s: float, attempts: int
    ) -> _Wanted | Nack | None:
        """Say the request that `make` makes of a number until it is answered; None if it never is.

        Raises DeviceError if the array speaks another version of the protocol, or is gone.
        """
        self._answers.clear()
        self._other_version = None
        numbers: set[int] = set()
        for _ in range(attempts):
            self._request = self._request % 0xFFFF + 1
            numbers.add(self._request)
            self._say(make(self._request))
            answer = self._await(numbers, wanted, timeout_s)
            if answer is not None:
                return answer
        return None

    def _say(self, request: Request) -> None:
        # A leading delimiter ends whatever noise the array's receiver holds.
        now_us = round(self._clock.now() * 1e6)
        self.stream.write(DELIMITER + encode(Message(self._sequence, now_us, request)))
        self._sequence = (self._sequence + 1) % (1 << 32)

    def _await(self, numbers: set[int], wanted: type[_Wanted], timeout_s: float) -> _Wanted | Nack | None:
        found: list[_Wanted | Nack] = []

        def answered() -> bool:
            found.extend(
                answer
                for answer in self._answers
                if isinstance(answer, (wanted, Nack)) and answer.request_id in numbers
            )
            self._answers.clear()
            return bool(found) or self._other_version is not None

        self.stream.wait_until(answered, timeout_s)
        if not found and self._other_version is not None:
            raise DeviceError(
                f"{self.stream.where} speaks version {self._other_version} of the tactile protocol, "
                f"palpate speaks version {VERSION}; put firmware for version {VERSION} on the array"
            )
        return found[0] if found else None

    def _take(self, data: bytes) -> None:
        for item in self.decoder.feed(data):
            if isinstance(item, DecodeFault):
                self._note(item)
            elif isinstance(item.body, Frame):
                self._on_frame(item, item.body)
            elif isinstance(item.body, Answer):
                self._answers.append(item.body)

    def _note(self, fault: DecodeFault) -> None:
        """Remember the version of what an array sent; a request of another version is somebody else's."""
        if (
            fault.kind is FaultKind.VERSION
            and fault.type_code is not None
            and not MessageType.is_request(fault.type_code)
        ):
            self._other_version = fault.version
