"""Request and answer: repeats requests until an array answers, detects its restarts, passes its frames on.

Every question is asked under a number of its own, more than once if need be: question or answer may get lost,
and every request of `docs/tactile-protocol.md` may be said twice without harm. After a reset numbers and
clock begin at 0 (section 1). A late copy of an old message has a number that is behind, too, but not a clock
that has run no longer than the array was not heard.
"""

from collections import Counter
from collections.abc import Callable
from typing import TypeVar

from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.drivers.tactile.codec import (
    DELIMITER,
    VERSION,
    DecodeFault,
    Decoder,
    FaultKind,
    encode,
    pack_payload,
)
from palpate.drivers.tactile.messages import (
    Describe,
    DeviceAnswer,
    Frame,
    Message,
    MessageBody,
    MessageType,
    Nack,
    Request,
)
from palpate.drivers.tactile.stream import FrameStream, Port
from palpate.drivers.transport.clock import Clock

_CLOCK_MARGIN_S = 0.05
_HALF_SEQUENCE_RANGE = 1 << 31


class RestartWatch:
    """Remembers the newest message of one array."""

    def __init__(self) -> None:
        self._last: Message | None = None
        self._heard_s = 0.0

    def note(self, message: Message, now: float) -> None:
        """A message that is in order, or begins a new order, was read at `now` (s)."""
        self._last, self._heard_s = message, now

    def behind(self, message: Message) -> str:
        """Relation of a message that is not ahead of the newest one to it, in words."""
        last = self._last or message
        return (
            f"number {message.sequence} at {message.time_us * 1e-6:.6g} s of its clock, "
            f"after number {last.sequence} at {last.time_us * 1e-6:.6g} s"
        )

    def is_restart(self, message: Message, now: float) -> bool:
        """True if a message that was read at `now` (s) shows a reset: number and clock are behind."""
        last = self._last
        if last is None or (message.sequence - last.sequence) % (1 << 32) < _HALF_SEQUENCE_RANGE:
            return False
        since_us = (now - self._heard_s + _CLOCK_MARGIN_S) * 1e6
        return message.time_us < last.time_us and message.time_us <= since_us


_Wanted = TypeVar("_Wanted", bound=DeviceAnswer)
_OUT_OF_ORDER = (FaultKind.SEQUENCE_GAP, FaultKind.STALE)
_UNUSABLE = (FaultKind.LENGTH, FaultKind.UNKNOWN_TYPE, FaultKind.PAYLOAD)


class ArrayExchange:
    """The port of one array: `ask` says a request until it is answered, `on_frame` is handed every frame.

    Raises DeviceError, which names field and value, for an answer whose CRC holds and that cannot be used:
    asking again would bring the same.
    """

    def __init__(
        self,
        port: SerialBase | Port,
        clock: Clock,
        name: str,
        on_frame: Callable[[Message, Frame], None],
    ) -> None:
        self.stream = FrameStream(port, clock, name, self._take, DELIMITER)
        self.decoder = Decoder()
        self._clock = clock
        self._on_frame = on_frame
        self._answers: list[Message] = []
        self._unusable: list[DecodeFault] = []
        self._restarts = RestartWatch()
        self._restarted = ""
        self._strays: list[int] = []
        self._other_version: int | None = None
        self._faults_before: Counter[FaultKind] = Counter()
        self._sequence = 0
        self._request = 0

    @property
    def noise(self) -> str:
        """Words for bytes since the last `ask` that are no message; "" if there are none."""
        found = self.decoder.faults - self._faults_before
        return ", ".join(f"{found[kind]} × {kind.value}" for kind in found if kind not in _OUT_OF_ORDER)

    def ask(
        self, make: Callable[[int], Request], wanted: type[_Wanted], timeout_s: float, attempts: int
    ) -> _Wanted | Nack | None:
        """Say the request that `make` makes of a number until it is answered; None if it never is.

        Raises DeviceError if the array speaks another version of the protocol, answers with something that
        cannot be used, or is gone.
        """
        self._answers.clear()
        self._unusable.clear()
        self._strays.clear()
        self._other_version = None
        self._faults_before = Counter(self.decoder.faults)
        numbers: set[int] = set()
        for _ in range(attempts):
            self._request = self._request % 0xFFFF + 1
            numbers.add(self._request)
            request = make(self._request)
            self._say(request)
            answer = self._await(request, numbers, wanted, timeout_s)
            if answer is not None:
                return answer
        if self._strays and wanted is Describe:
            raise DeviceError(
                f"{self.stream.where} answers under request number {self._strays[-1]} (allowed: "
                f"{min(numbers)} to {max(numbers)}, as asked); correct its firmware "
                "(docs/tactile-protocol.md, section 2)"
            )
        return None

    def _say(self, request: Request) -> None:
        # A leading delimiter ends whatever noise the array's receiver holds.
        now_us = round(self._clock.now() * 1e6)
        self.stream.write(DELIMITER + encode(Message(self._sequence, now_us, request)))
        self._sequence = (self._sequence + 1) % (1 << 32)

    def _await(
        self, request: Request, numbers: set[int], wanted: type[_Wanted], timeout_s: float
    ) -> _Wanted | Nack | None:
        found: list[_Wanted | Nack] = []
        refused: list[str] = []

        def answered() -> bool:
            for message in self._answers:
                body = message.body
                if not isinstance(body, DeviceAnswer):
                    continue
                if body.request_id not in numbers:
                    self._strays.append(body.request_id)
                elif isinstance(body, (wanted, Nack)):
                    found.append(body)
                else:
                    refused.append(_body_name(body))
            refused.extend(
                _describe_fault(fault)
                for fault in self._unusable
                if fault.request_id is None or fault.request_id in numbers
            )
            self._answers.clear()
            self._unusable.clear()
            return bool(found or refused) or self._other_version is not None

        self.stream.wait_until(answered, timeout_s)
        if self._restarted:
            how, self._restarted = self._restarted, ""
            raise self.stream.has_restarted(how)
        if found:
            return found[0]
        if refused:
            raise DeviceError(
                f"{self.stream.where} answers {_body_name(request)} with what cannot be used: "
                f"{refused[0]}; correct its firmware (docs/tactile-protocol.md, section 2)"
            )
        if self._other_version is not None:
            raise DeviceError(
                f"{self.stream.where} speaks version {self._other_version} of the tactile protocol, "
                f"palpate speaks version {VERSION}; put firmware for version {VERSION} on the array"
            )
        return None

    def _take(self, data: bytes) -> None:
        now = self._clock.now()
        for item in self.decoder.feed(data):
            if isinstance(item, DecodeFault):
                self._note(item, now)
            elif isinstance(item.body, Frame):
                self._restarts.note(item, now)
                self._on_frame(item, item.body)
            elif isinstance(item.body, DeviceAnswer):
                self.stream.note_answer()
                self._answers.append(item)
                self._look_for_restart(item, now)

    def _look_for_restart(self, answer: Message, now: float) -> None:
        if not isinstance(answer.body, Describe) and self._restarts.is_restart(answer, now):
            self._restarted = self._restarts.behind(answer)
        self._restarts.note(answer, now)

    def _note(self, fault: DecodeFault, now: float) -> None:
        """Remember what an array sent that cannot be used; requests, of another host, are ignored."""
        if fault.dropped is not None:
            restarted = self._restarts.is_restart(fault.dropped, now)
            self.stream.refuse(self._restarts.behind(fault.dropped), restarted=restarted)
        if fault.type_code is None or MessageType.is_request(fault.type_code):
            return
        if fault.kind is FaultKind.VERSION:
            self._other_version = fault.version
        elif fault.type_code == MessageType.FRAME:
            self.stream.refuse(fault.reason)
        elif fault.kind in _UNUSABLE:
            self._unusable.append(fault)


def _body_name(body: MessageBody) -> str:
    return pack_payload(body)[0].name


def _describe_fault(fault: DecodeFault) -> str:
    code = fault.type_code
    if code not in tuple(MessageType):
        return f"type {code:#04x}, which version {VERSION} does not have"
    return f"{MessageType(code).name} with {fault.reason}"
