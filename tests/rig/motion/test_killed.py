"""SIGKILL and SIGQUIT end palpate in the middle of a motion: only the Bus Watchdog of each servo is left."""

import json
import signal
import subprocess
import time
from pathlib import Path

import pytest
from command import PALPATE, log_bytes, run
from quick_rig import quick_bench
from sampling import sample

from palpate.drivers.dynamixel import control_table as ct
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import open_port
from palpate.testing import served

IDS = (11, 12, 21, 22)


@pytest.mark.realtime
@pytest.mark.timeout(120)
@pytest.mark.parametrize("number", sample([signal.SIGKILL, signal.SIGQUIT], [signal.SIGKILL]))
def test_killed_in_a_closing_the_watchdog_stops_every_servo(tmp_path: Path, number: signal.Signals) -> None:
    small, parts = quick_bench(tmp_path, fingers=2)
    words = ("--rig", small, "--objects", parts, "--seed", 7, "--rig-out", "real.toml")
    with served(tmp_path, "--pty", *words) as (_, told):
        rig = tmp_path / "real.toml"
        slow = rig.read_text().replace("approach_speed_mm_s = 30.0", "approach_speed_mm_s = 5.0")
        rig.write_text(slow)  # fingers still close when the signal comes, on a busy computer, too
        killed = subprocess.Popen(
            [str(PALPATE), "identify", "--rig", "real.toml", "--objects", str(parts)],
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            log = _log_when_closing(tmp_path, killed)
            time.sleep(0.3)
        finally:
            killed.send_signal(number)
            assert killed.wait() == -number, "nothing unwinds"
        time.sleep(1.0)  # nothing may be heard on the bus: the watchdogs count 0.5 s
        clock = MonotonicClock()
        bus = Bus(open_port(told["ports"]["mock://bus"], 1_000_000), clock, 1_000_000, latency_s=0.1)
        try:
            watchdogs = {dxl_id: bus.read(dxl_id, ct.ITEMS["Bus Watchdog"]) for dxl_id in IDS}
            torque = {dxl_id: bus.read(dxl_id, ct.TORQUE_ENABLE) for dxl_id in IDS}
            before = bus.sync_read(IDS, ct.ITEMS["Present Position"]).all()
            time.sleep(0.5)
            speeds = bus.sync_read(IDS, ct.ITEMS["Present Velocity"]).all()
            after = bus.sync_read(IDS, ct.ITEMS["Present Position"]).all()
        finally:
            bus.close()
        assert watchdogs == dict.fromkeys(IDS, -1), "tripped"
        assert torque == dict.fromkeys(IDS, 1), "Bus Watchdog stops motion; it does not switch torque off"
        assert all(abs(after[dxl_id] - before[dxl_id]) <= 1 for dxl_id in IDS)
        assert set(speeds.values()) == {0}
        lines = log_bytes(log).decode().splitlines()
        assert "session" in lines[0]
        assert not any(json.loads(line)["event"] == "end" for line in lines[:-1])
        done = run("stop", "--rig", "real.toml", "--json", cwd=tmp_path)
        assert done.code == 0, done.err
        assert done.json["confirmed"] is True
        checked = run("check", "--rig", "real.toml", "--json", cwd=tmp_path)
        assert checked.code == 0, checked.err


def _log_when_closing(folder: Path, process: subprocess.Popen[bytes]) -> Path:
    while True:
        for log in folder.glob("palpate-sessions/*/session.jsonl.zst"):
            if b'"stage":"closing"' in log_bytes(log):
                return log
        assert process.poll() is None, "it ended by itself"
        time.sleep(0.05)
