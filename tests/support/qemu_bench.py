"""The emulated bench with boards of QEMU in place of its arrays: the skin is palpate's, the firmware is the real one.

What an emulated array would have sampled is written into the board's memory, where the firmware finds it as the
counts of its matrix. Servos are served on a pseudo-terminal, in real time; every board has one of its own.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from qemu_board import MPS2, QemuBoard, Source, qemu_board

from palpate.config import RigFile
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.serve import serve_pty
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.messages import Description
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.wire import Device, Emission
from palpate.geometry import Floats
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.scene import Placement

__all__ = ["BoardBench", "board_bench"]

_SCAN_S = 4e-3  # how often the skin is looked at


class FedMatrix:
    """What is sampled in place of an emulated array (`SampledArray`): hands counts to a board, says nothing."""

    def __init__(self, taxels: Taxels, board: QemuBoard, advance: Callable[[float], None]) -> None:
        self._taxels, self._board, self._advance = taxels, board, advance
        self._scans = 0

    @property
    def description(self) -> Description:
        return self._taxels.description

    def next_sample_s(self) -> float | None:
        return self._scans * _SCAN_S

    def sample(self, now: float, force_n: Floats) -> None:
        self._scans += 1
        self._board.feed(self._taxels.counts(force_n, now))

    def restart(self, now: float) -> None:
        """Nothing is remembered."""

    def feed(self, data: bytes, now: float) -> list[Emission]:
        return self.poll(now)

    def poll(self, now: float) -> list[Emission]:
        self._advance(now)
        return []

    def next_due(self) -> float | None:
        return self.next_sample_s()


@dataclass(frozen=True)
class BoardBench:
    """`paths`: what a host opens for each port of the rig file. `boards`: by finger."""

    paths: Mapping[str, str]
    boards: Mapping[str, QemuBoard]


@contextmanager
def board_bench(rig: RigFile, placement: Placement | None, seed: int, folder: Path) -> Iterator[BoardBench]:
    """Serve the rig until the block ends. `folder` should be short: sockets are made in it."""
    emulated = emulate(rig, placement, seed)
    devices: dict[str, tuple[Device, int]] = dict(emulated.devices)
    paths: dict[str, str] = {}
    boards: dict[str, QemuBoard] = {}
    with ExitStack() as stack:
        for number, (spec, finger) in enumerate(zip(rig.fingers, emulated.bench.fingers, strict=True)):
            own = folder / spec.name
            own.mkdir()
            board = stack.enter_context(qemu_board(MPS2, own, Source.FED, serial=number))
            assert isinstance(finger.array, EmulatedArray)
            matrix = FedMatrix(finger.array.taxels, board, emulated.bench.advance)
            finger.array = matrix
            devices[spec.array.port] = (matrix, spec.array.baudrate_bps)
            boards[spec.name], paths[spec.array.port] = board, board.path
        service = stack.enter_context(serve_pty(devices, MonotonicClock(), threading.Event()))
        yield BoardBench({**service.paths, **paths}, boards)
