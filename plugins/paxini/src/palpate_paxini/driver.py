"""Host driver of a fingertip on a board: what is there is asked, what presses comes by itself.

Several fingertips are on one board and its connection. Each has a driver of its own, which asks what the
others ask, hears the answers to all, and picks its own from what is pushed. So nothing that one of them
orders may disturb the others: pushing is never switched off.
"""

from typing import NoReturn

from palpate.plugins import (
    Clock,
    DecodedFrame,
    Description,
    DeviceError,
    FreeRunningArray,
    Port,
)
from palpate_paxini.codec import (
    MODULES,
    Answer,
    BoardDecoder,
    Function,
    Layout,
    Push,
    Register,
    Request,
    encode,
)
from palpate_paxini.fingertip import Fingertip

__all__ = ["PaxiniArray"]

_TIMEOUT_S = 0.3
_ATTEMPTS = 4
_ZERO_S = 1.0
_MAX_FRAME_BYTES = 8192  # of any board
_TAXELS_ONLY = 2
_REFUSED = 0x80
_ORCA = b"ORCA"
_READ = {Register.VERSION: 15, Register.ACTIVE: 4, Register.TAXELS: 2 * len(MODULES), Register.KINDS: 1}


class _Board:
    """Decoder of the frames of one fingertip; keeps the newest answer of each register."""

    def __init__(self, tip: Fingertip, module: int) -> None:
        self._tip, self._module = tip, module
        self._decoder = BoardDecoder()
        self.faults = self._decoder.faults
        self.answers: dict[int, Answer] = {}
        self.layout: Layout | None = None
        self.pushed = 0

    def feed(self, data: bytes) -> list[DecodedFrame]:
        """Take bytes as they came; return the frames that they complete."""
        frames = []
        for item in self._decoder.feed(data):
            if isinstance(item, Answer):
                self._note(item)
            elif isinstance(item, Push):
                self.pushed += 1
                frames += self._frames(item)
        return frames

    def forget(self) -> None:
        """Forget what the board carries, until it has said so again."""
        self.answers.clear()
        self.layout = self._decoder.push_size = None

    @property
    def frame_bytes(self) -> int:
        """Size of what is pushed at once; of the largest that may be as long as that is not known."""
        return _MAX_FRAME_BYTES if self.layout is None else 7 + self.layout.size

    def _note(self, answer: Answer) -> None:
        self.answers[answer.register] = answer
        if answer.function != Function.READ or answer.register not in _READ:
            return
        said = [self.answers.get(key) for key in (Register.ACTIVE, Register.KINDS, Register.TAXELS)]
        active, kinds, taxels = (
            item.data if item and item.function == Function.READ else b"" for item in said
        )
        if (len(active), len(kinds), len(taxels)) == (4, 1, _READ[Register.TAXELS]):
            self.layout = Layout.of(active, kinds[0], taxels)
            self._decoder.push_size = self.layout.size

    def _frames(self, push: Push) -> list[DecodedFrame]:
        layout = self.layout
        if layout is None or self.problem or len(push.data) != layout.size:
            return []  # of a stream that somebody else began
        if push.error:
            self.faults[f"error {push.error:#04x} of the board"] += 1
            return []
        return [DecodedFrame(self._tip.pressed(layout.forces(push.data, self._module)))]

    @property
    def problem(self) -> str:
        """What is wrong with the fingertip by what the board says; empty if nothing is."""
        layout, name = self.layout, MODULES[self._module]
        if layout is None or not layout.has_taxels:
            return "pushes no taxels"
        if self._module not in layout.active:
            there = ", ".join(MODULES[module] for module in layout.active) or "none"
            return f"has no sensor at {name}; there are: {there}"
        if layout.taxels[self._module] != self._tip.taxels:
            return f"has {layout.taxels[self._module]} taxels at {name}, and the sensor {self._tip.taxels}"
        return ""


class PaxiniArray(FreeRunningArray):
    """A fingertip at one of a board's places, on an open port.

    Each `start` lets a board of PaXini take the zero of all its fingertips anew: nothing may touch them then.
    """

    def __init__(
        self,
        port: Port,
        clock: Clock,
        finger: str,
        description: Description,
        tip: Fingertip,
        module: int,
        delay_s: float,
    ) -> None:
        self._board = _Board(tip, module)
        super().__init__(port, clock, finger, description, self._board, _MAX_FRAME_BYTES, delay_s)
        self._takes_zero = False

    def connect(self) -> Description:
        """Ask the board what it carries, and let it push taxels; see that they come as fast as is stated."""
        self._description = None
        self._board.forget()
        self._stream.expect(self._stated.max_rate_hz, _MAX_FRAME_BYTES)
        version = self._read(Register.VERSION).strip(b"\0 ")
        # ORCA's connector board says so, or nothing at all if its firmware is old, and takes no such order.
        self._takes_zero = bool(version) and not version.startswith(_ORCA)
        self._order(Function.WRITE, Register.KINDS, bytes((_TAXELS_ONLY,)))
        for register in (Register.ACTIVE, Register.TAXELS, Register.KINDS):
            self._read(register)
        if self._board.problem:
            raise DeviceError(
                f"{self._stream.where}: its board {self._board.problem}; correct sensor or module in the "
                "rig file, or plug the fingertip in and power the board off and on"
            )
        self._frame_bytes = self._board.frame_bytes
        before = self._board.pushed
        for _ in range(_ATTEMPTS):  # some boards answer this, others just push
            self._stream.write(encode(Request(Function.WRITE, Register.PUSHING, b"\1")))
            if self._stream.wait_until(lambda: self._board.pushed > before, _TIMEOUT_S):
                break
        return super().connect()

    def start(self, rate_hz: float) -> None:
        """Take a zero, and frames from then on; of a stream that runs already, as it is."""
        self._check_rate(rate_hz)
        if self._since_s is None and self._takes_zero:
            self._order(Function.ZERO, Register.ZERO, b"\1", _ZERO_S)
        super().start(rate_hz)

    def _read(self, register: Register) -> bytes:
        return self._ask(Request(Function.READ, register, wanted=_READ[register]), _TIMEOUT_S)

    def _order(
        self, function: Function, register: Register, data: bytes, timeout_s: float = _TIMEOUT_S
    ) -> None:
        if any(status := self._ask(Request(function, register, data), timeout_s)):
            self._refuse_order(function, register, f"status {status.hex()}")

    def _ask(self, request: Request, timeout_s: float) -> bytes:
        """Data of the answer to a request, which may be said twice."""
        answers, register = self._board.answers, request.register

        def is_answered() -> bool:
            found = answers.get(register)
            return found is not None and (found.function == request.function or found.function >= _REFUSED)

        answers.pop(register, None)
        for _ in range(_ATTEMPTS):
            self._stream.write(encode(request))
            if self._stream.wait_until(is_answered, timeout_s):
                break
        else:
            raise DeviceError(
                f"{self._stream.where} does not answer; check its power, its cable, its port and baud rate"
            )
        if answers[register].function >= _REFUSED:
            self._refuse_order(request.function, register, f"error {answers[register].function - _REFUSED}")
        return answers[register].data

    def _refuse_order(self, function: int, register: int, why: str) -> NoReturn:
        raise DeviceError(
            f"{self._stream.where} refuses function {function:#04x} at register {register:#06x} ({why}); "
            "power the board off and on, then check its firmware"
        )
