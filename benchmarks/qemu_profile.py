"""Which functions of the firmware an emulated board spends its instructions in, counted one by one."""

import re
import subprocess
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from support.devices.firmware import build_firmware
from support.devices.ports import PipePort
from support.devices.qemu import Machine, board_pipes
from support.oracles.array_messages import HELLO, START, request

__all__ = ["instructions_by_function"]

_TRACED = 1_500_000  # instructions, some thirty frames
_PLACE = re.compile(rb"/([0-9a-f]{8})/[0-9a-f]+/[0-9a-f]+\]")


def instructions_by_function(machine: Machine, rate_hz: float, folder: Path) -> dict[str, float]:
    """Instructions for a frame, by function, most first. What the board does between frames is among them."""
    elf = build_firmware("qemu") / machine.name / "firmware.elf"
    line = board_pipes(folder)
    command = ["qemu-system-arm", "-machine", machine.board, "-kernel", str(elf), "-display", "none"]
    command += ["-monitor", "none", "-chardev", f"pipe,id=line,path={line}", "-serial", "chardev:line"]
    command += ["-icount", "shift=6,sleep=off", "-singlestep", "-d", "exec,nochain"]
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            assert process.stderr is not None
            port = PipePort(str(line))
            port.write(b"\0" + request(HELLO, 1) + request(START, 2, round(rate_hz * 1000)))
            traced = _places(process.stderr, _address(elf, "palpate_port_sample"))
            port.close()
        finally:
            process.kill()
    counts = _by_function(elf, sum(traced, Counter()))
    return {name: count / len(traced) for name, count in counts.most_common()}


def _places(trace: Iterable[bytes], sample_at: int) -> list[Counter[int]]:
    """How often each instruction was carried out, from one sample to the next: a counter for each frame.

    One that reaches for a device is traced twice, as QEMU begins it anew to get the time right.
    """
    found: list[Counter[int]] = [Counter()]
    before = -1
    for text, _ in zip(trace, range(_TRACED), strict=False):
        match = _PLACE.search(text)
        place = before if match is None else int(match[1], 16)
        if place == before:
            continue
        before = place
        if place == sample_at:
            found.append(Counter())
        found[-1][place] += 1
    return found[1:-1]


def _address(elf: Path, function: str) -> int:
    listed = subprocess.run(["arm-none-eabi-nm", str(elf)], capture_output=True, text=True, check=True)
    (at,) = (row.split()[0] for row in listed.stdout.splitlines() if row.endswith(f" {function}"))
    return int(at, 16) & ~1


def _by_function(elf: Path, places: Counter[int]) -> Counter[str]:
    listed = subprocess.run(["arm-none-eabi-nm", "-n", str(elf)], capture_output=True, text=True, check=True)
    rows = [line.split() for line in listed.stdout.splitlines()]
    functions = [(int(at, 16) & ~1, name) for at, kind, name in rows if kind in "tTW"]
    starts = [at for at, _ in functions]
    counts: Counter[str] = Counter()
    for place, count in places.items():
        counts[functions[bisect_right(starts, place) - 1][1]] += count
    return counts
