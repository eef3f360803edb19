"""`palpate stop`: what is confirmed, what is not, and beside a run that is using the port."""

import json
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from command import PALPATE, Ended, log_bytes, run_here
from firm_rig import firm_rig
from json_schema import violations
from motor_wire import MotorWire
from served_servos import served_servos

from palpate.config import load_rig, shipped_rig
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.clock import MonotonicClock
from palpate.drivers.transport.ports import PortTaken, open_port
from palpate.rig.diagnostics.servo_bus import stop_all
from palpate.testing import served

Here = Callable[..., Ended]
RIG = load_rig(shipped_rig())


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(args, monkeypatch, capsys)


def torque(servo: EmulatedServo) -> bool:
    return bool(servo._unit.table.get("Torque Enable"))


def all_on(servos: list[EmulatedServo]) -> None:
    for servo in servos:
        servo._unit.set_torque(on=True)


def test_a_rig_as_json(here: Here) -> None:
    Path("bench.toml").write_text(firm_rig().read_text(encoding="utf-8"))
    done = here("stop", "--rig", "bench.toml", "--json")
    assert done.code == 0
    assert violations(done.json, json.loads(schema_text("stop"))) == []
    assert done.json == {
        "format": "palpate/stop@1",
        "port": "mock://bus",
        "emulated": True,
        "baudrate_bps": 1000000,
        "told": 10,
        "taken": False,
        "confirmed": True,
        "servos": [
            {"id": dxl_id, "owner": owner, "off": True, "problem": None}
            for dxl_id, owner in (
                (11, "f1 aim"),
                (12, "f1 slide"),
                (21, "f2 aim"),
                (22, "f2 slide"),
                (31, "f3 aim"),
                (32, "f3 slide"),
            )
        ],
    }


def test_every_servo_on_the_wire_known_or_not() -> None:
    """Also one of another baud rate than the rest is not forgotten in silence: it is not confirmed."""
    servos = [EmulatedServo(11), EmulatedServo(99), EmulatedServo(12, baud_rate_code=1)]
    wire = MotorWire(servos)
    all_on(servos)
    out = stop_all(wire.place(RIG), 1_000_000)
    assert [torque(servo) for servo in servos] == [False, False, True]
    assert {servo.id: servo.off for servo in out.servos} == {
        **dict.fromkeys((11, 99), True),
        **dict.fromkeys((12, 21, 22, 31, 32), False),
    }
    assert not out.confirmed
    assert "does not answer" in str({servo.id: servo.problem for servo in out.servos}[12])


def test_a_servo_with_a_hardware_error_is_confirmed_too() -> None:
    servo = EmulatedServo(5)
    wire = MotorWire([servo])
    servo.report_hardware_error(0x01)  # Shutdown does not select it: torque stays
    all_on([servo])
    out = stop_all(wire.place(), 1_000_000)
    assert out.confirmed
    assert not torque(servo)


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        ([], 2, "say which servos to stop: give a rig file, or a port"),
        (["--rig", "a.toml", "--port", "/dev/ttyUSB0"], 2, "a port and a rig exclude each other"),
        (["--port", "/dev/ttyUSB0", "--baud", "0"], 2, "baud rate 0: it must be positive"),
        (["--port", "/dev/no-such-port"], 3, "port /dev/no-such-port does not exist"),
    ],
)
def test_what_people_get_wrong_is_one_line(here: Here, args: list[str], code: int, said: str) -> None:
    done = here("stop", *args)
    assert (done.code, done.out) == (code, "")
    (line,) = done.err.splitlines()
    assert said in line


@pytest.mark.realtime
def test_nobody_answers_at_that_baud_rate(here: Here) -> None:
    with served_servos([3]) as wire:
        done = here("stop", "--port", wire.path, "--baud", 57_600)
    assert done.code == 3
    assert "NOT confirmed: no servo answers" in done.out
    assert "cut the servos' power" in done.out


@pytest.mark.realtime
def test_a_port_that_another_program_keeps(here: Here) -> None:
    """Torque goes off all the same; nobody can confirm it, and that is said."""
    with served_servos([3, 14]) as wire:
        with wire.service.lock:
            all_on(list(wire.servos.values()))
        with open_port(wire.path, 1_000_000), pytest.raises(PortTaken):
            open_port(wire.path, 1_000_000)
        with open_port(wire.path, 1_000_000):
            done = here("stop", "--port", wire.path, "--json")
        with wire.service.lock:
            assert not any(torque(servo) for servo in wire.servos.values())
    assert done.code == 3
    assert done.json["taken"] is True
    assert done.json["confirmed"] is False
    assert done.json["servos"] == []
    assert done.json["told"] >= 20
    assert "another program is using" in done.err


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(120)
def test_beside_a_run_that_moves(tmp_path: Path, here: Here) -> None:
    """The run ends with an error, and every servo has its torque off."""
    with served(tmp_path, "--pty", "--seed", 7, "--rig-out", "real.toml") as (_, told):
        text = (tmp_path / "real.toml").read_text(encoding="utf-8")
        patient = text.replace("latency_ms = 100", "latency_ms = 500", 1)
        (tmp_path / "real.toml").write_text(patient)
        run = subprocess.Popen(
            [str(PALPATE), "identify", "--rig", "real.toml"],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            log = _session_log(tmp_path, run)
            while b'"stage":"closing"' not in log_bytes(log):
                assert run.poll() is None, run.communicate()
                time.sleep(0.05)
            begin = time.monotonic()
            done = here("stop", "--rig", "real.toml", "--json")
            _, err = run.communicate(timeout=20)
            took_s = time.monotonic() - begin
        finally:
            run.kill()
            run.wait()
        assert run.returncode == 4, err
        assert "has its torque off, and this run did not switch it off" in err
        assert took_s < 12
        assert done.json["told"] >= 10
        bus = Bus(
            open_port(told["ports"]["mock://bus"], 1_000_000), MonotonicClock(), 1_000_000, latency_s=0.5
        )
        try:
            state = {dxl_id: bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in (11, 12, 21, 22, 31, 32)}
        finally:
            bus.close()
    assert state == dict.fromkeys(state, 0)


def _session_log(folder: Path, run: subprocess.Popen[str]) -> Path:
    while True:
        found = list(folder.glob("palpate-sessions/*/session.jsonl.zst"))
        if found:
            return found[0]
        assert run.poll() is None, run.communicate()
        time.sleep(0.05)
