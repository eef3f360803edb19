"""`palpate find-port`: plugging and unplugging, and what it says."""

import json
import os
import pty
import signal
import subprocess
from collections.abc import Iterable, Sequence

import pytest
from command import PALPATE, run_here
from json_schema import violations
from rich.console import Console
from wording import missing

from palpate.config.schema import schema_text
from palpate.drivers.transport.clock import VirtualClock
from palpate.drivers.transport.ports import SerialPort, serial_ports
from palpate.rig.diagnostics.host_ports import find_unplugged, ports_out
from palpate.views.ports_table import show_unplugged


def port(device: str, by_id: str | None = None, timer_s: float | None = None) -> SerialPort:
    return SerialPort(device, by_id, None, (0x0403, 0x6014), "FT3", timer_s, None, True)


ARRAY = port("/dev/ttyACM0", "/dev/serial/by-id/array")
ADAPTER = port("/dev/ttyUSB0", "/dev/serial/by-id/adapter", 0.016)
MOVED = port("/dev/ttyUSB1", "/dev/serial/by-id/adapter", 0.016)
UNNAMED = port("/dev/ttyUSB1")


class Computer:
    """Its ports change with each thing that a person is asked to do, and with time."""

    def __init__(
        self, steps: Iterable[Sequence[SerialPort]], later: Sequence[SerialPort] | None = None
    ) -> None:
        """`later`: the ports from one second on."""
        self.clock = VirtualClock()
        self._steps = iter(steps)
        self._ports = next(self._steps)
        self._later = later
        self.asked: list[str] = []

    def look(self) -> Sequence[SerialPort]:
        return self._ports if self._later is None or self.clock.now() < 1.0 else self._later

    def ask(self, what: str) -> bool:
        self.asked.append(what)
        ports = next(self._steps, None)
        if ports is None:
            return False
        self._ports = ports
        return True

    def find(self) -> Sequence[SerialPort]:
        return find_unplugged(self.look, self.ask, self.clock)


def test_the_one_that_went_and_came_back() -> None:
    computer = Computer([[ARRAY, ADAPTER], [ARRAY], [ARRAY, MOVED]])
    assert computer.find() == [MOVED]
    unplug, plug_in = computer.asked
    assert "unplug" in unplug
    assert missing(plug_in, "/dev/ttyUSB0", "plug it in") == []


def test_somebody_who_presses_enter_too_early_is_asked_again() -> None:
    computer = Computer([[ARRAY, ADAPTER], [ARRAY, ADAPTER], [ARRAY], [ARRAY, ADAPTER]])
    assert computer.find() == [ADAPTER]
    assert computer.asked[1].startswith("no port has gone")


def test_the_name_under_by_id_comes_a_moment_later() -> None:
    computer = Computer([[ADAPTER], [], [UNNAMED]])
    assert computer.find() == [UNNAMED], "it never comes"
    assert 5.0 < computer.clock.now() < 6.0
    computer = Computer([[ADAPTER], [], [UNNAMED]], later=[MOVED])
    assert computer.find() == [MOVED]
    assert computer.clock.now() < 2.0


def test_somebody_who_gives_up() -> None:
    assert Computer([[ADAPTER]]).find() == ()
    assert Computer([[ADAPTER], []]).find() == [ADAPTER], "it was unplugged, and stays so"


def test_what_is_found_is_said_as_a_line_of_the_rig_file(capsys: pytest.CaptureFixture[str]) -> None:
    show_unplugged([MOVED], Console(soft_wrap=True))
    told = capsys.readouterr().out
    assert '    port = "/dev/serial/by-id/adapter"\n' in told
    assert "FTDI FT232H" in told
    assert "up to 16 ms" in told
    assert "sudo tee /sys/class/tty/ttyUSB1/device/latency_timer" in told


def test_as_json() -> None:
    out = json.loads(ports_out([ARRAY, ADAPTER], ADAPTER).model_dump_json())
    assert violations(out, json.loads(schema_text("serial-ports"))) == []
    assert out["found"] == "/dev/serial/by-id/adapter"
    assert out["ports"][1] == {
        "name": "/dev/serial/by-id/adapter",
        "device": "/dev/ttyUSB0",
        "by_id": "/dev/serial/by-id/adapter",
        "description": None,
        "usb_id": "0403:6014",
        "serial_number": "FT3",
        "latency_timer_ms": 16.0,
        "used_by": None,
        "permitted": True,
    }


@pytest.mark.parametrize("args", [["find-port", "--json"], ["find-port", "--list", "--json"]])
def test_without_a_terminal_it_only_lists(
    args: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done = run_here(args, monkeypatch, capsys)
    ports = serial_ports()
    assert done.code == (0 if ports else 3)
    assert [item["device"] for item in done.json["ports"]] == [item.device for item in ports]
    assert done.json["found"] is None
    assert "unplug" not in done.err


@pytest.mark.realtime
@pytest.mark.parametrize(("typed", "code", "said"), [("q\n", 0, "nothing was unplugged"), ("\x03", 130, "")])
def test_on_a_terminal_it_asks(typed: str, code: int, said: str) -> None:
    if not serial_ports():
        pytest.skip("this computer has no serial port")
    controller, terminal = pty.openpty()
    with subprocess.Popen(
        [str(PALPATE), "find-port"],
        stdin=terminal,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            assert process.stderr is not None
            asked = process.stderr.read(len("unplug the adapter you look for"))
            assert asked == "unplug the adapter you look for"
            if typed == "\x03":
                process.send_signal(signal.SIGINT)
            else:
                os.write(controller, typed.encode())
            out, err = process.communicate(timeout=30)
        finally:
            process.kill()
            os.close(terminal)
            os.close(controller)
    assert process.returncode == code
    assert said in out
    assert "torque" not in err
