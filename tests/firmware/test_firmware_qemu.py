"""The firmware on emulated boards, alone and on a rig."""

import json
import math
import os
import re
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from palpate.base.errors import DeviceError
from palpate.base.geometry import Counts
from palpate.config import load_objects, load_rig
from palpate.drivers.tactile import TactileArray
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from palpate.rig.bench import choose_placements
from support.campaign.sampling import sample
from support.commands.command import run
from support.devices.firmware import FIRMWARE, build_firmware, expected_counts, read_quiet, read_until
from support.devices.ports import NoisyPort, PipePort
from support.devices.qemu import (
    COLUMNS,
    DEPTH,
    MICROBIT,
    MPS2,
    ROWS,
    Machine,
    QemuBoard,
    Source,
    board_bench,
    missing_tools,
    qemu_board,
    slow_bench,
    write_real_rig,
)
from support.oracles.array_messages import (
    ACK,
    DESCRIBE,
    FRAME,
    HELLO,
    START,
    STOP,
    frame_counts,
    request,
    said,
)

# ----------------------------------------------------------------------------------------------------
# The firmware on a Cortex-M3 and a Cortex-M0 that QEMU emulates, instruction by instruction.
#
# The boards' time follows their instructions (`-icount`), so that a busy computer costs them nothing. QEMU
# carries a byte at once, whatever the baud rate.

MISSING = missing_tools()
BOTH = pytest.mark.parametrize("machine", [MPS2, MICROBIT], ids=lambda machine: machine.core)
BOTH_AT_LENGTH = pytest.mark.parametrize(
    "machine", sample([MPS2, MICROBIT], [MPS2]), ids=lambda machine: machine.core
)
ICOUNT = 6  # 64 ns an instruction: 16 million a second
RATE_HZ = 200.0


@contextmanager
def driven(board: QemuBoard) -> Iterator[TactileArray]:
    port = PipePort(board.path) if board.is_piped else open_port(board.path, 1_000_000)
    try:
        yield TactileArray(port, MonotonicClock(), "board")
    finally:
        port.close()


def patiently(verb: Callable[[], object]) -> None:
    """Ask again: on a busy computer the emulators of board and line may take longer than a host waits."""
    for _ in range(10):
        try:
            verb()
        except DeviceError:
            continue
        return
    verb()


def collect(array: TactileArray, wanted: int) -> tuple[NDArray[np.uint32], Counts]:
    """Numbers and counts of so many frames, and of those that came with the last one."""
    numbers: list[int] = []
    counts = []
    while len(numbers) < wanted:
        for frame in array.frames() or [array.wait_frame(5.0)]:
            numbers.append(frame.sequence)
            counts.append(frame.counts)
    return np.array(numbers, np.uint32), np.array(counts)


def assert_right(numbers: NDArray[np.uint32], counts: Counts) -> None:
    np.testing.assert_array_equal(counts, expected_counts(numbers, ROWS, COLUMNS, DEPTH))


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH_AT_LENGTH
def test_ten_thousand_frames_none_lost_none_misread(machine: Machine, tmp_path: Path) -> None:
    frames = 10_000
    with qemu_board(machine, tmp_path, icount=ICOUNT, is_piped=True) as board, driven(board) as array:
        described = array.connect()
        patiently(lambda: array.start(RATE_HZ))
        numbers, counts = collect(array, frames)
        patiently(array.stop)
        account = board.account()
    assert (described.rows, described.cols, described.bit_depth) == (ROWS, COLUMNS, DEPTH)
    assert described.firmware == f"{machine.name} 1"
    assert_right(numbers, counts)
    assert np.all(np.diff(numbers.astype(np.int64)) == 1)
    found = array.counters
    assert (found.lost, found.faults, found.dropped) == (0, 0, 0)
    assert (account.given_up, account.faults, account.overruns) == (0, 0, 0)
    assert account.stack_bytes < 1024
    assert account.longest_us < 1e6 / RATE_HZ


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH_AT_LENGTH
def test_a_board_that_is_reset_in_mid_stream_is_noticed_and_comes_back(
    machine: Machine, tmp_path: Path
) -> None:
    with qemu_board(machine, tmp_path, icount=ICOUNT) as board, driven(board) as array:
        patiently(array.connect)
        for _ in range(3):
            patiently(lambda: array.start(RATE_HZ))
            assert_right(*collect(array, 100))
            board.reset()
            with pytest.raises(DeviceError, match="no frame"):
                collect(array, 10_000)
            patiently(array.connect)
        patiently(lambda: array.start(RATE_HZ))
        numbers, counts = collect(array, 100)
    assert numbers[0] < 10, "numbers begin anew after a reset"
    assert_right(numbers, counts)


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH
def test_noise_on_the_line_costs_frames_and_none_is_misread(machine: Machine, tmp_path: Path) -> None:
    """One bit in 1 of 2000 bytes to the host flipped, and noise sent to the board all the time."""
    rng = np.random.default_rng(5)
    with qemu_board(machine, tmp_path, icount=ICOUNT, is_piped=True) as board:
        pipes = PipePort(board.path)
        port = NoisyPort(pipes, share=5e-4, seed=3)
        try:
            array = TactileArray(port, MonotonicClock(), "board")
            patiently(array.connect)
            patiently(lambda: array.start(RATE_HZ))
            parts = []
            for _ in range(30):
                port.write(rng.integers(0, 256, 60).astype(np.uint8).tobytes() + b"\0")
                parts.append(collect(array, 50))
            patiently(array.stop)
            account = board.account()
        finally:
            pipes.close()
    numbers, counts = (np.concatenate(found) for found in zip(*parts, strict=True))
    assert_right(numbers, counts)
    steps = np.diff(numbers.astype(np.int64))
    assert np.all(steps > 0)
    missing = int(np.sum(steps - 1))
    assert 50 < missing <= array.counters.lost
    assert missing <= 2 * port.flipped, "a flipped byte costs its message; a flipped delimiter the next, too"
    assert account.faults >= 30, "the board heard noise"
    assert account.given_up == 0


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH_AT_LENGTH
def test_a_host_that_stalls_misses_frames_that_are_counted(machine: Machine, tmp_path: Path) -> None:
    with qemu_board(machine, tmp_path, icount=ICOUNT) as board:
        descriptor = os.open(board.path, os.O_RDWR | os.O_NOCTTY)
        try:
            os.write(descriptor, request(HELLO, 1) + request(START, 2, round(1000 * RATE_HZ)))
            first = read_until(descriptor, 50)
            time.sleep(3.0)
            rest = read_until(descriptor, 200)
            os.write(descriptor, request(STOP, 3))
            came = said(first + rest + read_quiet(descriptor, 0.5))
            account = board.account()
        finally:
            os.close(descriptor)
    frames = [found for found in came if found.type == FRAME]
    numbers = [found.sequence for found in came]
    assert numbers == sorted(set(numbers))
    assert len(frames) == account.frames
    assert account.given_up > 100
    assert came[-1].type == ACK
    assert numbers[-1] + 1 == len(came) + account.given_up, "each gap is of frames that were given up"
    counts = np.array([frame_counts(found) for found in frames]).reshape(-1, ROWS, COLUMNS)
    assert_right(np.array([found.sequence for found in frames], np.uint32), counts)


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH
def test_each_of_many_requests_is_answered(machine: Machine, tmp_path: Path) -> None:
    """Bytes come while the board runs, at any instant. An interrupt that misses one is deaf from then on."""
    with qemu_board(machine, tmp_path) as board:
        descriptor = os.open(board.path, os.O_RDWR | os.O_NOCTTY)
        try:
            for number in range(1, 600):
                os.write(descriptor, request(HELLO, number))
                (answer,) = said(read_until(descriptor, 1))
                assert (answer.type, answer.request) == (DESCRIBE, number)
            account = board.account()
        finally:
            os.close(descriptor)
    assert (account.requests, account.faults, account.overruns) == (599, 0, 0)


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH
def test_untouched_skin_is_quiet_and_can_be_tared(machine: Machine, tmp_path: Path) -> None:
    with (
        qemu_board(machine, tmp_path, source=Source.QUIET, icount=ICOUNT) as board,
        driven(board) as array,
    ):
        patiently(array.connect)
        patiently(lambda: array.start(RATE_HZ))
        _, raw = collect(array, 50)
        patiently(lambda: array.tare(32, pedestal=100))
        collect(array, 80)
        _, tared = collect(array, 50)
        patiently(array.stop)
    assert 202 < raw.mean() < 204
    assert raw.min() >= 200
    assert raw.max() <= 206
    assert abs(tared.mean() - 100) < 1


@pytest.mark.slow
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
@BOTH
def test_what_it_costs_is_what_the_readme_says(machine: Machine) -> None:
    """Flash and RAM of the whole program, start-up and the board's own code included."""
    text = (FIRMWARE / "README.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {machine.core}.*\| ([\d.]+) kB \| ([\d.]+) kB \|", text, re.MULTILINE)
    assert row is not None
    elf = build_firmware("qemu") / machine.name / "firmware.elf"
    listed = subprocess.run(["arm-none-eabi-size", str(elf)], capture_output=True, text=True, check=True)
    code, data, zeroed = map(int, listed.stdout.splitlines()[1].split()[:3])
    assert (code + data) / 1000 == pytest.approx(float(row[1]), abs=0.3)
    assert (data + zeroed) / 1000 == pytest.approx(float(row[2]), abs=0.1)


# ----------------------------------------------------------------------------------------------------
# palpate's commands against arrays whose firmware runs on an emulated Cortex-M3, three of them on one rig.
#
# The boards sample what the emulated skin feels. The commands know nothing of that: to them the rig is real.


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}")
def test_check_watch_and_identify(tmp_path: Path) -> None:
    rig, parts = slow_bench(tmp_path)
    (truth,) = choose_placements(load_rig(rig), load_objects(parts), None, 5)
    with board_bench(load_rig(rig), [truth], 5, tmp_path) as bench:
        real = write_real_rig(rig, bench.paths, tmp_path / "real.toml")
        checked = run("check", "--rig", real, "--json", cwd=tmp_path)
        watched = run("watch", "--rig", real, "--for", 3, "--json", cwd=tmp_path)
        done = run("identify", "--rig", real, "--objects", parts, "--json", cwd=tmp_path)
        accounts = {name: board.account() for name, board in bench.boards.items()}
    assert checked.code == 0, checked.err
    assert [found["firmware"] for found in checked.json["arrays"]] == ["mps2 1"] * 3
    assert watched.code == 0, watched.err
    assert {shown["finger"] for shown in json.loads(watched.out.splitlines()[-1])["fingers"]} == set(accounts)
    assert done.code == 0, done.err
    answer = done.json
    assert (answer["verdict"], answer["object"]) == ("identified", truth.model.name)
    assert answer["emulated"] is True, "the boards say so"
    turns = round((answer["configuration"]["theta"] - truth.theta_rad) / (2 * math.pi))
    pose = {"x": truth.x_mm, "y": truth.y_mm, "theta": truth.theta_rad + 2 * math.pi * turns}
    for key, value in pose.items():
        lo, hi = answer["bounds"][key]
        assert lo <= value <= hi
    for account in accounts.values():
        assert account.frames > 1000
        assert (account.faults, account.overruns) == (0, 0)
