"""Many frames from the firmware's host program to the Python decoder, each one checked and accounted for."""

import os
import select
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from array_host import ArrayHost, expected_counts
from wire_messages import HELLO, START, STOP, request

from palpate.drivers.tactile.codec import Decoder
from palpate.drivers.tactile.messages import Ack, Describe, Frame, Message, MessageBody

__all__ = ["Exchange", "Taken", "exchange"]

RATE_MHZ = 1_000_000
PERIOD_US = 1000
_ATTEMPTS = 20
_ANSWER_S = 1.0
_STALL_S = 5.0
_TAIL = 100  # frames, at most so many are thought lost at the end
_QUIET_S = 0.3  # nothing for so long: there are none


@dataclass
class Taken:
    """What came, from DESCRIBE on."""

    frames: int = 0
    answers: int = 0
    wrong: int = 0  # frames whose counts are not what the array sampled
    first: int = -1  # number of DESCRIBE
    last: int = -1  # number of the last message
    phases: set[int] = field(default_factory=set)  # instant less number times the period: one for each START


class Exchange:
    """One conversation over a pseudo-terminal. Questions are said again until they are answered."""

    def __init__(self, descriptor: int, rows: int, columns: int) -> None:
        self._descriptor = descriptor
        self._size = (rows, columns)
        self._request = 0
        self.decoder = Decoder()
        self.taken = Taken()

    def describe(self) -> Describe:
        """HELLO, until there is an answer. What the array used up before is not counted."""
        found = self._ask(HELLO, lambda body: isinstance(body, Describe))
        assert isinstance(found, Describe)
        return found

    def start(self) -> None:
        """START; its answer or frames must come."""
        self._ask(START, lambda body: isinstance(body, Ack | Frame), RATE_MHZ)

    def read(self, frames: int) -> None:
        """Take all that comes: so many frames, but for those that are lost."""
        while self.taken.frames + self.decoder.lost < frames - _TAIL:
            assert self._step(_STALL_S) is not None, f"nothing after {self.taken.frames} frames"
        while self._step(_QUIET_S) is not None:
            pass

    def stop(self) -> None:
        """STOP; the number of its answer tells what is missing at the end."""
        self._ask(STOP, lambda body: isinstance(body, Ack))

    def _ask(self, kind: int, is_wanted: Callable[[MessageBody], bool], *values: int) -> MessageBody:
        for _ in range(_ATTEMPTS):
            self._request += 1
            os.write(self._descriptor, b"\x00" + request(kind, self._request, *values))
            end = time.monotonic() + _ANSWER_S
            while time.monotonic() < end:
                for body in self._step(_ANSWER_S) or ():
                    if is_wanted(body):
                        return body
        raise AssertionError(f"no answer to request {kind}")

    def _step(self, patience_s: float) -> list[MessageBody] | None:
        """Take what is there now; None if nothing comes for a while."""
        ready, _, _ = select.select([self._descriptor], [], [], patience_s)
        if not ready:
            return None
        items = self.decoder.feed(os.read(self._descriptor, 1 << 16))
        came = [item for item in items if isinstance(item, Message)]
        self._check([item for item in came if isinstance(item.body, Frame)])
        for message in came:
            if isinstance(message.body, Describe):
                self.taken = Taken(first=message.sequence)
                self.decoder.lost = 0
            elif not isinstance(message.body, Frame):
                self.taken.answers += 1
            self.taken.last = message.sequence
        return [message.body for message in came]

    def _check(self, messages: list[Message]) -> None:
        if not messages:
            return
        rows, columns = self._size
        numbers = np.array([message.sequence for message in messages], np.uint32)
        bodies = b"".join(message.body.taxels for message in messages if isinstance(message.body, Frame))
        counts = np.frombuffer(bodies, "<u2").reshape(-1, rows, columns)
        wrong = (counts != expected_counts(numbers, rows, columns)).any(axis=(1, 2))
        self.taken.wrong += int(np.count_nonzero(wrong))
        self.taken.frames += len(messages)
        self.taken.phases |= {message.time_us - PERIOD_US * message.sequence for message in messages}


def exchange(host: ArrayHost, rows: int, columns: int, frames: int) -> tuple[Taken, int]:
    """Have the frames sent that `host` was told to sample, `frames` in all.

    Returns what came, and how many messages are missing (`Decoder.lost`): numbers between DESCRIBE and the
    answer to STOP that never came, of frames and of answers.
    """
    descriptor = os.open(host.path, os.O_RDWR | os.O_NOCTTY)
    try:
        talk = Exchange(descriptor, rows, columns)
        talk.describe()
        talk.start()
        talk.read(frames)
        talk.stop()
    finally:
        os.close(descriptor)
    return talk.taken, talk.decoder.lost
