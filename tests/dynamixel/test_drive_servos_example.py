"""examples/drive_servos.py as a user runs it, on emulated servos in another process."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from repository import EXAMPLES, ROOT

from palpate.drivers import Bus, MonotonicClock, open_port
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE
from palpate.testing import served

EXAMPLE = EXAMPLES / "drive_servos.py"
PAGE = ROOT / "docs" / "servo-bus.md"
IDS = (11, 12, 21, 22, 31, 32)

pytestmark = pytest.mark.realtime


def drive(port: str, *args: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, str(EXAMPLE), port, *args],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def torque(port: str) -> list[int]:
    with open_port(port, 1_000_000) as opened:
        bus = Bus(opened, MonotonicClock(), 1_000_000, latency_s=0.1)
        return [bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in IDS]


def test_it_moves_one_servo_within_its_range_and_switches_torque_off(tmp_path: Path) -> None:
    with served(tmp_path, "--pty", "--seed", 7) as (_, printed):
        port = printed["ports"]["mock://bus"]
        process = drive(port, "--id", "11", "--by", "0.2")
        out, err = process.communicate(timeout=60)
        assert (process.returncode, err) == (0, "")
        assert [int(dxl_id) for dxl_id in re.findall(r"servo (\d+), XM430-W350", out)] == list(IDS)
        moved = re.search(r"servo 11: reached at (\S+) rad, from (\S+) rad", out)
        assert moved is not None, out
        assert float(moved[1]) - float(moved[2]) == pytest.approx(0.2, abs=0.04)
        assert torque(port) == [0] * 6

        process = drive(port, "--id", "11", "--by", "0.6")
        out, err = process.communicate(timeout=60)
        assert process.returncode == 1
        assert "outside its range" in err
        assert torque(port) == [0] * 6


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_on_the_way_it_switches_torque_off(tmp_path: Path, number: signal.Signals) -> None:
    with served(tmp_path, "--pty", "--seed", 7) as (_, printed):
        port = printed["ports"]["mock://bus"]
        process = drive(port, "--id", "11", "--by", "0.5")
        assert process.stdout is not None
        for _ in IDS:
            assert process.stdout.readline()
        time.sleep(0.4)  # half a second of a move that takes one
        process.send_signal(number)
        out, _ = process.communicate(timeout=60)
        assert process.returncode != 0
        assert "reached" not in out
        assert torque(port) == [0] * 6


def test_the_page_shows_the_example() -> None:
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert program.strip() in EXAMPLE.read_text(encoding="utf-8")
