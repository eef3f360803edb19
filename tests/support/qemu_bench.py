"""The emulated bench with boards of QEMU in place of its arrays: palpate's skin, and the real firmware.

What an emulated array would have sampled is written into the board's memory, where the firmware finds it as
the counts of its matrix. Servos are served on a pseudo-terminal, in real time; every board has its own.
"""

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import tomlkit
from qemu_board import MPS2, QemuBoard, Source, qemu_board
from quick_rig import quick_bench

from palpate.base.geometry import Floats
from palpate.config import RigFile
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.device_server import serve_pty
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.description import Description
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.wire import Device, Emission
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.scene import Placement

__all__ = ["BoardBench", "board_bench", "slow_bench", "write_real_rig"]

_LATENCY_MS = 1000  # six emulators share this computer: a servo's may have to wait for its turn
_SCAN_S = 4e-3  # how often the skin is looked at


class FedMatrix:
    """Sampled in place of an emulated array (`SampledArray`): hands counts to a board and says nothing."""

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

    def feed(self, _data: bytes, now: float) -> list[Emission]:
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


def slow_bench(folder: Path) -> tuple[Path, Path]:
    """Write a rig whose fingers come slowly, since what they feel is late, and a catalogue of small parts."""
    rig, parts = quick_bench(folder)
    text = rig.read_text(encoding="utf-8")
    quick, slow = "approach_speed_mm_s = 30.0", "approach_speed_mm_s = 5.0"
    assert quick in text
    rig.write_text(text.replace(quick, slow), encoding="utf-8")
    return rig, parts


def write_real_rig(rig: Path, paths: Mapping[str, str], path: Path) -> Path:
    """Write the rig file to `path` with the served ports, and nothing emulated in it; returns `path`."""
    document = tomlkit.parse(rig.read_text(encoding="utf-8"))
    document.pop("emulation")
    document["bus"]["port"] = paths[document["bus"]["port"]]
    document["bus"]["latency_ms"] = _LATENCY_MS
    for finger in document["fingers"]:
        finger["array"]["port"] = paths[finger["array"]["port"]]
    path.write_text(tomlkit.dumps(document), encoding="utf-8")
    return path
