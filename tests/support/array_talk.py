"""Talking to an emulated array message by message, and arrays whose counts are known beforehand."""

from collections.abc import Sequence

import numpy as np
from memory_port import emulated
from tactile_vectors import SMALL

from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.codec import Decoder, encode
from palpate.drivers.tactile.description import Description
from palpate.drivers.tactile.messages import Frame, Message, MessageBody

RATE = 100_000  # thousandths of a frame per second: one frame in 10 ms


class Scripted(Taxels):
    """Taxels that count what the script says, sample by sample; the last one again and again."""

    def __init__(self, description: Description, script: Sequence[Sequence[int]]) -> None:
        super().__init__(description, seed=0)
        shape = (description.rows, description.cols)
        self.script = [np.array(counts, "<u2").reshape(shape) for counts in script]

    def counts(self, _force_n: np.ndarray, _now: float = 0.0) -> np.ndarray:
        return self.script.pop(0) if len(self.script) > 1 else self.script[0]


def heard(array: EmulatedArray, data: bytes, now: float = 0.0, version: int = 1) -> list[Message]:
    """What an array answers at `now` to bytes, all of it well formed."""
    items = Decoder(version).feed(b"".join(sent for _, sent in array.feed(data, now)))
    assert all(isinstance(item, Message) for item in items)
    return [item for item in items if isinstance(item, Message)]


def told(array: EmulatedArray, body: MessageBody, now: float = 0.0) -> MessageBody:
    """What an array answers to one request at `now`."""
    *frames, answer = heard(array, encode(Message(0, 0, body)), now)
    assert all(isinstance(frame.body, Frame) for frame in frames)
    return answer.body


def stream(array: EmulatedArray, until: float) -> list[Message]:
    """The frames up to `until`."""
    return heard(array, b"", until)


def small(script: Sequence[Sequence[int]] = ((0,) * 6,)) -> EmulatedArray:
    """A small array that counts what the script says."""
    return emulated(Scripted(SMALL, script))
