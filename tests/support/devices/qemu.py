"""The firmware on emulated boards."""

import json
import mmap
import os
import shutil
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from palpate.base.geometry import Counts, Floats
from palpate.config import RigFile
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.pseudo_terminal import serve_pty
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.description import Description
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.wire import Device, Emission
from palpate.rig.emulated.devices import emulate
from palpate.rig.emulated.scene import Placement
from support.benches.rigs import quick_bench
from support.commands.command import PATIENCE_S
from support.devices.firmware import build_firmware

# ----------------------------------------------------------------------------------------------------
# The firmware on a processor that QEMU emulates (`firmware/qemu/`): built, run, reset, and looked into.
#
# A board's serial line is a pseudo-terminal, or a pair of pipes: a terminal holds some 12 kB for a host
# that is
# late, a pipe a MiB. `path` is what a host opens. What the board keeps about itself is read out of its memory
# through QEMU's own control socket (QMP), so that the firmware need not help.


ROWS, COLUMNS, DEPTH = 8, 20, 12
_TOOLS = {"arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
_LIBRARY = "libnewlib-arm-none-eabi"
_PIPES = "line"
_UNTOUCHED = 0xC5C5C5C5
_RAM_BYTES = 16 << 20

_COUNTERS = struct.Struct("<4I")
_ACCOUNT = struct.Struct("<7I")


class Source:
    """What the board samples: `matrix_source` of firmware/qemu/matrix.h."""

    PATTERN, QUIET, FED = range(3)


@dataclass(frozen=True)
class Machine:
    """A board that QEMU knows, and where the firmware looks for what it shall sample."""

    name: str
    board: str
    core: str
    matrix_at: int
    is_feedable: bool


MPS2 = Machine("mps2", "mps2-an385", "Cortex-M3", 0x21000000, True)
MICROBIT = Machine("microbit", "microbit", "Cortex-M0", 0x20003C00, False)


def missing_tools() -> str:
    """Which Debian packages are missing to build and run the boards, for a message; empty if none."""
    packages = [package for tool, package in _TOOLS.items() if shutil.which(tool) is None]
    if "gcc-arm-none-eabi" not in packages:
        found = subprocess.run(
            ["arm-none-eabi-gcc", "-print-file-name=nano.specs"], capture_output=True, text=True, check=True
        )
        packages += [] if "/" in found.stdout else [_LIBRARY]
    return ", ".join(packages)


@dataclass(frozen=True)
class Account:
    """How it went on the board since its last reset; `stack_bytes` is the deepest the stack has been."""

    faults: int
    requests: int
    frames: int
    given_up: int
    overruns: int
    frame_polls: int
    frame_us: int
    longest_us: int
    asleep_us: int
    clock_us: int
    stack_bytes: int


class QemuBoard:
    """A running board. `icount`: nanoseconds of the board's time for an instruction are 2 to this power.

    Without `icount` the processor is as fast as this computer can make it. With it, and on pipes, time in
    which the board sleeps is skipped: nothing that keeps this computer busy can make it late. A terminal
    holds too little for that, and there the board sleeps in real time.
    """

    def __init__(
        self,
        machine: Machine,
        folder: Path,
        source: int = Source.PATTERN,
        serial: int = 1,
        icount: int | None = None,
        is_piped: bool = False,
    ) -> None:
        self.machine = machine
        self.is_piped = is_piped
        self._elf = build_firmware("qemu") / machine.name / "firmware.elf"
        self._symbols = _symbols(self._elf)
        self._folder, self._pipes = folder, folder / _PIPES
        control = folder / "control"
        self._process = subprocess.Popen(
            [*self._command(source, serial, icount, is_piped), "-qmp", f"unix:{control},server=on,wait=off"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            self._control = _connected(control, self._process)
            self._answers = self._control.makefile("r", encoding="utf-8")
            self._answers.readline()  # a greeting
            self._ask("qmp_capabilities")
            (told,) = (found for found in self._ask("query-chardev") if found["label"] == "line")
        except BaseException:
            self.kill()
            raise
        self.path = str(self._pipes) if is_piped else str(told["filename"]).removeprefix("pty:")
        self._turn = 0

    def _command(self, source: int, serial: int, icount: int | None, is_piped: bool) -> list[str]:
        at = self.machine.matrix_at
        command = ["qemu-system-arm", "-machine", self.machine.board, "-kernel", str(self._elf)]
        if self.machine.is_feedable:
            memory = self._folder / "memory"
            with memory.open("w+b") as file:
                file.truncate(_RAM_BYTES)
                self._shared = mmap.mmap(file.fileno(), mmap.PAGESIZE)
            backend = f"memory-backend-file,id=mem,size={_RAM_BYTES},mem-path={memory},share=on"
            command[2] += ",memory-backend=mem"
            command += ["-object", backend]
        for place, value in ((at, source), (at + 4, serial)):
            command += ["-device", f"loader,addr={place:#x},data={value},data-len=4"]
        if is_piped:
            board_pipes(self._folder)
        line = f"pipe,id=line,path={self._pipes}" if is_piped else "pty,id=line"
        command += ["-chardev", line, "-serial", "chardev:line", "-display", "none"]
        command += ["-monitor", "none"]
        if icount is not None:
            command += ["-icount", f"shift={icount},sleep={'off' if is_piped else 'on'}"]
        return command

    def feed(self, counts: Counts) -> None:
        """Have all taxels, shape (rows, columns), sampled as this from now on; for `Source.FED`."""
        self._turn += 1
        struct.pack_into("<I", self._shared, 8, 2 * self._turn - 1)
        self._shared[12 : 12 + 2 * counts.size] = counts.astype("<u2").tobytes()
        struct.pack_into("<I", self._shared, 8, 2 * self._turn)

    def reset(self) -> None:
        """Press the board's reset button."""
        self._ask("system_reset")

    def account(self) -> Account:
        """What the board knows of itself. A stream that runs goes on meanwhile."""
        counters_at, overruns_at, *rest = _ACCOUNT.unpack(
            self._memory(self._symbols["account"], _ACCOUNT.size)
        )
        faults, requests, frames, given_up = _COUNTERS.unpack(self._memory(counters_at, _COUNTERS.size))
        (overruns,) = struct.unpack("<I", self._memory(overruns_at, 4))
        return Account(faults, requests, frames, given_up, overruns, *rest, stack_bytes=self._stack_bytes())

    def _stack_bytes(self) -> int:
        bottom, top = self._symbols["link_stack"], self._symbols["link_stack_top"]
        words = np.frombuffer(self._memory(bottom, top - bottom), "<u4")
        return 4 * (words.size - int(np.argmax(words != _UNTOUCHED)))

    def _memory(self, address: int, size: int) -> bytes:
        path = self._folder / "dump"
        self._ask("memsave", val=address, size=size, filename=str(path))
        return path.read_bytes()

    def _ask(self, command: str, **arguments: object) -> Any:
        self._control.sendall(json.dumps({"execute": command, "arguments": arguments}).encode())
        while True:
            answer = json.loads(self._answers.readline())
            assert "error" not in answer, answer
            if "return" in answer:  # all else is news
                return answer["return"]

    def kill(self) -> None:
        """End the emulator, whatever it does."""
        if hasattr(self, "_control"):
            self._control.close()
        if hasattr(self, "_answers"):
            self._answers.close()
        self._process.kill()
        self._process.communicate()


def board_pipes(folder: Path) -> Path:
    """Make the pipes of a serial line, one for each way; returns what both names begin with."""
    path = folder / _PIPES
    for way in ("in", "out"):
        os.mkfifo(f"{path}.{way}")
    return path


def _connected(path: Path, process: subprocess.Popen[str]) -> socket.socket:
    end = time.monotonic() + PATIENCE_S
    control = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    control.settimeout(PATIENCE_S)
    while True:
        try:
            control.connect(str(path))
        except OSError:
            if process.poll() is not None:
                control.close()
                raise AssertionError(process.communicate()[0]) from None
            assert time.monotonic() < end, "QEMU does not come up"
            time.sleep(0.02)
        else:
            return control


def _symbols(elf: Path) -> dict[str, int]:
    listed = subprocess.run(["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True)
    rows = (line.split() for line in listed.stdout.splitlines())
    return {row[-1]: int(row[0], 16) for row in rows if len(row) == 3}


@contextmanager
def qemu_board(
    machine: Machine,
    folder: Path,
    source: int = Source.PATTERN,
    serial: int = 1,
    icount: int | None = None,
    is_piped: bool = False,
) -> Iterator[QemuBoard]:
    """A board that runs until the block ends; `folder` is for its sockets and memory, and should be short."""
    board = QemuBoard(machine, folder, source, serial, icount, is_piped)
    try:
        yield board
    finally:
        board.kill()


# ----------------------------------------------------------------------------------------------------
# The emulated bench with boards of QEMU in place of its arrays: palpate's skin, and the real firmware.
#
# What an emulated array would have sampled is written into the board's memory, where the firmware finds it as
# the counts of its matrix. Servos are served on a pseudo-terminal, in real time; every board has its own.

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
def board_bench(
    rig: RigFile, placements: Sequence[Placement], seed: int, folder: Path
) -> Iterator[BoardBench]:
    """Serve the rig until the block ends. `folder` should be short: sockets are made in it."""
    emulated = emulate(rig, placements, seed)
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
