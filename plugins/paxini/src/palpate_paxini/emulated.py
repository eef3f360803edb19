"""The emulated board and the fingertips on it, written from the protocol, not from the driver.

A fingertip's skin shares what presses on it among the taxels near by. Each shows its share in axes of its
own, so that beside the middle of a contact it shows shear, of either sign; with a gain of its own, noise,
creep and a zero that wanders, in steps of 0.1 N. What is below 0 along the normal it cannot show.

Decided, because the sources leave it open: a board measures its fingertips one after the other and pushes
after the last; it answers within 1 ms; damaged requests are not answered, unknown functions and writes to
other registers than these are refused with error 3 and 6 of its sibling, the serial converter board; a
register that nothing is known of reads 0; orders to push are answered.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.plugins import Description, Emission, Floats
from palpate_paxini.codec import (
    COUNTS_PER_N,
    Answer,
    BoardDecoder,
    Forces,
    Function,
    Push,
    Register,
    Request,
    encode,
    pack_resultant,
    pack_taxels,
)
from palpate_paxini.fingertip import Fingertip

__all__ = ["EmulatedFingertip", "TaxelTruth", "ThreeAxisSkin"]

_ANSWER_S = 1e-3
_ZERO_S = 0.02
_NO_FUNCTION, _NO_PARAMETER = 0x83, 0x86
_BOTH_KINDS = 3


@dataclass(frozen=True)
class TaxelTruth:
    """Truth of one fingertip. `blur_mm`: how far skin spreads a force; of it `creep_share` comes late.

    Zeros wander within `wander_n` about where they were taken, and by `zero_n` before that.
    """

    gain_spread: float = 0.1
    blur_mm: float = 1.8
    noise_n: float = 0.02
    wander_n: float = 0.03
    zero_n: float = 0.4
    creep_share: float = 0.06
    creep_s: float = 0.4


class ThreeAxisSkin:
    """Taxels of one fingertip, in the board's order, below the cells on which the bench presses."""

    def __init__(self, cells: Description, tip: Fingertip, truth: TaxelTruth, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._truth, self._rng = truth, rng
        self._response = _responses(cells, tip, truth.blur_mm)
        self._response *= 1 + truth.gain_spread * rng.uniform(-1, 1, (tip.taxels, 1, 1))
        shape = (tip.taxels, 3)
        self._phase, self._period_s = rng.uniform(0, 2 * np.pi, shape), rng.uniform(60.0, 180.0, shape)
        self._off_n = truth.zero_n * rng.uniform(-1, 1, shape)
        self._crept = np.zeros(cells.rows * cells.cols)
        self._true_n = np.zeros(shape)
        self._last_s = 0.0

    def read(self, now: float, force_n: Floats) -> Forces:
        """Forces (taxels, 3) in counts at `now` (s), for forces on the cells (N)."""
        truth, force = self._truth, force_n.ravel()
        step_s, self._last_s = max(now - self._last_s, 0.0), now
        self._crept += (force - self._crept) * -np.expm1(-step_s / truth.creep_s)
        pressed = (1 - truth.creep_share) * force + truth.creep_share * self._crept
        wander = truth.wander_n * np.sin(2 * np.pi * now / self._period_s + self._phase)
        self._true_n = self._response @ pressed + wander
        noise = truth.noise_n * self._rng.standard_normal(wander.shape)
        counts = np.rint(COUNTS_PER_N * (self._true_n + self._off_n + noise)).astype(np.int64)
        return np.clip(counts, (-128, -128, 0), (127, 127, 255))

    def take_zero(self) -> None:
        """Take what is read now for zero, whatever presses."""
        self._off_n = -self._true_n


def _responses(cells: Description, tip: Fingertip, blur_mm: float) -> Floats:
    """Force (N) on each taxel in its axes by 1 N on each cell, (taxels, 3, cells); none at the round end.

    The emulated tip is a cylinder: a taxel sits where that faces as the taxel does, at the taxel's height.
    """
    at, outward = cells.positions_mm().reshape(-1, 3), cells.normals().reshape(-1, 3)
    level = tip.normal * (1, 1, 0)
    facing = (level / np.linalg.norm(level, axis=2, keepdims=True)).reshape(-1, 3)
    place = np.hypot(at[0, 0], at[0, 1]) * facing
    place[:, 2] = tip.place_mm[..., 2].ravel()
    away = np.linalg.norm(place[:, None] - at, axis=2)
    near = np.exp(-((away / blur_mm) ** 2) / 2)
    share = near / np.maximum(near.sum(axis=0), 1.0)  # what is beside all taxels is not felt by any
    across = np.cross([0.0, 0.0, 1.0], facing)
    axes = np.stack([-across, np.zeros_like(across), facing], axis=1)
    out = np.zeros((tip.taxels, 3, len(at)))
    out[tip.matrix.ravel()] = (axes @ outward.T) * share[:, None]
    return out


class EmulatedFingertip:
    """A fingertip at one of a board's places; at first alone on a board of its own."""

    def __init__(
        self,
        module: int,
        skin: ThreeAxisSkin,
        cells: Description,
        taxels: int,
        advance: Callable[[float], None],
        rate_hz: float,
    ) -> None:
        self.module, self.skin, self.taxels = module, skin, taxels
        self.forces = np.zeros((taxels, 3), np.int64)
        self.next_s = 0.0
        self._cells = cells
        self.board = _Board([self], advance, 1 / rate_hz)

    @classmethod
    def join(cls, tips: Sequence["EmulatedFingertip"]) -> "EmulatedFingertip":
        """Put fingertips on one board, the first one's; returns that."""
        board = tips[0].board
        for tip in tips:
            tip.board = board
        board.carry(tips)
        return tips[0]

    @property
    def description(self) -> Description:
        """The cells on which the bench presses."""
        return self._cells

    def restart(self, now: float) -> None:
        """Begin anew, as when power comes on."""
        self.board.restart(now)

    def next_sample_s(self) -> float | None:
        """Instant of the next sample."""
        return self.next_s

    def sample(self, now: float, force_n: Floats) -> None:
        """Measure forces (N, rows x cols)."""
        self.forces = self.skin.read(now, force_n)
        self.board.note_sample(self, now)

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes for the board; return what it sends up to `now`."""
        return self.board.feed(data, now)

    def poll(self, now: float) -> list[Emission]:
        """Return what the board sends up to `now`."""
        return self.board.poll(now)

    def next_due(self) -> float | None:
        """Instant of the board's next emission."""
        return self.board.next_due()


class _Board:
    """A High-Speed Communication Board: registers, answers, and what it pushes."""

    def __init__(
        self, tips: Sequence[EmulatedFingertip], advance: Callable[[float], None], period_s: float
    ) -> None:
        self._advance, self._period_s = advance, period_s
        self.version = b"emulated 02.22"
        self.carry(tips)

    def carry(self, tips: Sequence[EmulatedFingertip]) -> None:
        """Carry other fingertips, in the order of their places, and begin anew."""
        self._tips = sorted(tips, key=lambda tip: tip.module)
        self.restart(0.0)

    def restart(self, now: float) -> None:
        """Begin anew at `now`: nothing is pushed."""
        self._decoder = BoardDecoder(from_board=False)
        self._queue: list[Emission] = []
        self._kinds, self._pushing = _BOTH_KINDS, False
        for number, tip in enumerate(self._tips, 1):
            tip.next_s = now + number / len(self._tips) * self._period_s

    def note_sample(self, tip: EmulatedFingertip, now: float) -> None:
        """A fingertip was measured at `now`; after the last one the board pushes."""
        tip.next_s += self._period_s
        if self._pushing and tip is self._tips[-1]:
            self._queue.append((now, encode(Push(0, self._pushed()))))

    def feed(self, data: bytes, now: float) -> list[Emission]:
        """Take bytes that arrived at `now`; return what is due."""
        self._advance(now)
        for item in self._decoder.feed(data):
            if isinstance(item, Request):
                answer, after_s = self._obey(item)
                self._queue.append((now + after_s, encode(answer)))
        return self._due(now)

    def poll(self, now: float) -> list[Emission]:
        """Return what is due at `now`."""
        self._advance(now)
        return self._due(now)

    def next_due(self) -> float | None:
        """Instant of the next emission, None if there is none in sight."""
        pushed = [self._tips[-1].next_s] if self._pushing else []
        return min([at for at, _ in self._queue] + pushed, default=None)

    def _due(self, now: float) -> list[Emission]:
        self._queue.sort(key=lambda item: item[0])
        due = [item for item in self._queue if item[0] <= now]
        del self._queue[: len(due)]
        return due

    def _obey(self, request: Request) -> tuple[Answer, float]:
        """Answer to a request, and how long it takes."""
        register, data = request.register, request.data
        if request.function == Function.READ:
            return Answer(Function.READ, register, self._registers(register, request.wanted)), _ANSWER_S
        if request.function == Function.ZERO and (register, data) == (Register.ZERO, b"\1"):
            for tip in self._tips:
                tip.skin.take_zero()
            return Answer(Function.ZERO, register, b"\0"), _ZERO_S
        if request.function not in tuple(Function):
            return Answer(_NO_FUNCTION, register, b""), _ANSWER_S
        if request.function == Function.ZERO or len(data) != 1 or not self._write(register, data[0]):
            return Answer(_NO_PARAMETER, register, b""), _ANSWER_S
        return Answer(Function.WRITE, register, b"\0"), _ANSWER_S

    def _write(self, register: int, value: int) -> bool:
        """Write a register; False if it cannot be, or not that."""
        if register == Register.KINDS and 1 <= value <= _BOTH_KINDS:
            self._kinds = value
        elif register == Register.PUSHING and value <= 1:
            self._pushing = bool(value)
        else:
            return False
        return True

    def _registers(self, first: int, count: int) -> bytes:
        """Values of some registers, a byte each."""
        there = sum(1 << tip.module for tip in self._tips)
        blocks: dict[int, bytes] = {
            Register.VERSION: self.version,
            Register.ACTIVE: there.to_bytes(4, "little"),
            Register.KINDS: bytes((self._kinds, self._pushing)),
        }
        for tip in self._tips:
            blocks[Register.TAXELS + 2 * tip.module] = tip.taxels.to_bytes(2, "little")
            blocks[Register.RESULTANTS + 6 * tip.module] = pack_resultant(_resultant(tip))
        out = bytearray(count)
        for at, block in blocks.items():
            for address, value in enumerate(block, at - first):
                if 0 <= address < count:
                    out[address] = value
        return bytes(out)

    def _pushed(self) -> bytes:
        parts = []
        for tip in self._tips:
            parts += [pack_resultant(_resultant(tip))] * (self._kinds & 1)
            parts += [pack_taxels(tip.forces)] * (self._kinds >> 1)
        return b"".join(parts)


def _resultant(tip: EmulatedFingertip) -> Forces:
    """Sum over a fingertip's taxels (1, 3), each in its own axes: sensors may do better."""
    total: Forces = tip.forces.sum(axis=0, keepdims=True)
    return total
