"""`palpate scan`, `find-port` and `stop`: servos without a rig file."""

import json
import os
import pty
import signal
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path

import pytest
from rich.console import Console

from palpate.cli.setup import parse_ids
from palpate.config import load_rig, shipped_rig
from palpate.config.commissioning_results import RebootOut
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.bus import Bus, Ping
from palpate.drivers.dynamixel.bus_scan import FoundServo, Scan, scan
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.transport.clock import MonotonicClock, VirtualClock
from palpate.drivers.transport.ports import PortTaken, SerialPort, open_port, serial_ports
from palpate.rig.diagnostics.host_ports import find_unplugged, ports_out
from palpate.rig.diagnostics.servo_bus import BusEndpoint, endpoint_of_rig, reboot_all, scan_result, stop_all
from palpate.testing import served
from palpate.views.tables import show_unplugged
from support.benches.rigs import firm_rig
from support.commands.command import PALPATE, PATIENCE_S, Here, missing, started, violations
from support.devices.servo_wire import MotorWire, served_servos

# ----------------------------------------------------------------------------------------------------
# `palpate scan`: what is found on an emulated bus, and what is said about it.


RIG = load_rig(shipped_rig())


def torque(servo: EmulatedServo) -> bool:
    return bool(servo._unit.table.get("Torque Enable"))


def all_on(servos: list[EmulatedServo]) -> None:
    for servo in servos:
        servo._unit.set_torque(on=True)


BENCH_IDS = [11, 12, 21, 22, 31, 32]


def found_by(place: BusEndpoint, *rates: int, ids: range = range(20)) -> list[FoundServo]:
    return list(scan(place.open, place.clock, rates, ids, latency_s=place.latency_s).found)


def test_the_shipped_rig_as_json(here: Here) -> None:
    done = here("scan", "--ids", "11,12", "--json")
    assert done.code == 0
    assert violations(done.json, json.loads(schema_text("scan"))) == []
    assert done.json == {
        "format": "palpate/scan@1",
        "port": "mock://bus",
        "emulated": True,
        "baudrates_bps": [9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000, 4500000],
        "ids": [11, 12],
        "servos": [
            {
                "baudrate_bps": 1000000,
                "id": dxl_id,
                "model": "XM430-W350",
                "model_number": 1020,
                "firmware": 45,
                "crowded": False,
                "owner": owner,
            }
            for dxl_id, owner in ((11, "f1 aim"), (12, "f1 slide"))
        ],
        "warnings": [],
    }


def test_the_shipped_rig_as_a_table(here: Here) -> None:
    done = here("scan")
    assert done.code == 0
    assert done.err == ""
    lines = done.out.splitlines()
    assert [int(line.split()[1]) for line in lines[1:-1]] == BENCH_IDS
    assert missing(lines[-1], "6 servos", "mock://bus", "emulated", "8 baud rates", "0 to 252") == []


def test_nothing_at_the_only_rate_that_is_tried(here: Here) -> None:
    done = here("scan", "--baud", 57600, "--ids", "1-40", "--json")
    assert done.code == 3
    assert done.json["servos"] == []
    assert len(done.json["warnings"]) == 6, "each servo of the rig file is missing"


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (["--port", "/dev/no-such-port"], 3, "device error: port /dev/no-such-port does not exist"),
        (["--port", "mock://nobody/bus"], 3, "device error: port mock://nobody/bus does not exist"),
        (["--ids", "1-"], 2, '"1-" is neither an id nor a range'),
        (["--ids", "20-1"], 2, '"20-1" is not a range within 0-252'),
        (["--ids", "300"], 2, '"300" is not a range within 0-252'),
        (["--ids", ""], 2, '"" is neither an id nor a range'),
        (["--baud", "-1"], 2, "--baud -1: a baud rate is positive"),
        (["--baud", "fast"], 2, "'--baud'"),
        (["--port", "/dev/ttyUSB0", "--rig", "rig.toml"], 2, "a port and a rig exclude each other"),
        (["--rig", "no-such.toml"], 2, "no-such.toml"),
    ],
)
def test_what_people_get_wrong_with_scan_is_one_line(
    here: Here, args: list[str], code: int, said: str
) -> None:
    done = here("scan", *args)
    assert (done.code, done.out) == (code, "")
    (line,) = done.err.splitlines()
    assert said in line


def test_ids_are_read_as_people_write_them() -> None:
    assert parse_ids("1-3,2,7, 11-12") == [1, 2, 3, 7, 11, 12]


def test_two_servos_with_one_id_are_told_from_one() -> None:
    """They answer alike to a ping; what they measure differs."""
    twins = [EmulatedServo(5, start_rad=0.1), EmulatedServo(5, start_rad=0.9)]
    wire = MotorWire([*twins, EmulatedServo(6)])
    place = wire.place()
    found = found_by(place, 1_000_000)
    assert [(item.dxl_id, item.crowded) for item in found] == [(5, True), (6, False)]
    wire.plug(twins[0], wire.servos[2])
    assert [item.crowded for item in found_by(place, 1_000_000)] == [False, False]


def test_warnings_name_what_the_rig_file_has_otherwise() -> None:
    place = endpoint_of_rig(load_rig(shipped_rig()))
    aim = Ping(1020, 46)
    scanned = Scan(
        (
            FoundServo(57_600, 11, aim),
            FoundServo(1_000_000, 12, Ping(1200, 52)),
            FoundServo(1_000_000, 21, Ping(9999, 1)),
            FoundServo(1_000_000, 22, None, crowded=True),
            FoundServo(1_000_000, 31, aim),
            FoundServo(1_000_000, 40, aim),
        ),
        {4_000_000: "the port says no"},
    )
    out = scan_result(place, scanned, [57_600, 1_000_000, 4_000_000], range(253))
    assert out.baudrates_bps == (57_600, 1_000_000)
    assert [servo.model for servo in out.servos] == [
        *("XM430-W350", "XL330-M288", None, None, "XM430-W350", "XM430-W350"),
    ]
    wanted = [
        "4000000 baud could not be tried: the port says no",
        "two servos or more seem to have id 22",
        "servo 21 has model number 9999",
        "servos on one bus need different supplies (5 V for XL330-M288, 12 V for XM430-W350)",
        "servo 11 (f1 aim) answers at 57600 baud, not at the rig file's 1000000",
        "servo 12 (f1 slide) is a XL330-M288, not the rig file's XM430-W350",
        "servo 21 (f2 aim) is a model number 9999, not the rig file's XM430-W350",
        "servo 32 (f3 slide) of the rig file does not answer",
        "servo 40 at 1000000 baud is not in the rig file",
    ]
    assert len(out.warnings) == len(wanted)
    for warning, words in zip(out.warnings, wanted, strict=True):
        assert words in warning


@pytest.mark.realtime
def test_servos_on_a_pseudo_terminal(here: Here) -> None:
    with served_servos([3, 14]) as served:
        done = here("scan", "--port", served.path, "--baud", 1_000_000, "--ids", "1-20", "--json")
    assert done.code == 0, done.err
    assert [servo["id"] for servo in done.json["servos"]] == [3, 14]
    assert done.json["emulated"] is False


# ----------------------------------------------------------------------------------------------------
# `palpate find-port`: plugging and unplugging, and what it says.


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
def test_without_a_terminal_it_only_lists(args: list[str], here: Here) -> None:
    done = here(*args)
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
            out, err = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
            os.close(terminal)
            os.close(controller)
    assert process.returncode == code
    assert said in out
    assert "torque" not in err


# ----------------------------------------------------------------------------------------------------
# `palpate reboot`: what was latched, and whether servos are back.


def rebooting(*poked: tuple[str, int], bits: int = 0) -> tuple[EmulatedServo, RebootOut]:
    """A servo of the rig with torque on and items poked, and what its reboot says."""
    servo = EmulatedServo(12)
    wire = MotorWire([servo])
    all_on([servo])
    servo._unit.motion.shaft_rad += 20.0
    for item, value in poked:
        servo._unit.table.set(item, value)
    servo.report_hardware_error(bits)
    return servo, reboot_all(wire.place(RIG), RIG, [12])


def test_a_latched_error_is_gone_after_a_reboot_and_so_are_the_turns() -> None:
    servo, out = rebooting(bits=0x21)
    assert out.well
    assert out.servos[0].latched == ("input voltage", "overload")
    assert out.servos[0].again == ()
    assert not torque(servo)
    assert servo._unit.drive.present_tick() < 4096


def test_an_error_whose_cause_stays_is_said_to_be_back() -> None:
    _, out = rebooting(("Temperature Limit", 25), bits=0x04)
    assert not out.well
    assert out.servos[0].again == ("overheating",)


@pytest.mark.parametrize("poked", [("Startup Configuration", 1), ("Status Return Level", 0)])
def test_torque_is_off_after_a_reboot_whatever_the_servo_is_set_to(poked: tuple[str, int]) -> None:
    servo, out = rebooting(poked)
    assert out.well
    assert not torque(servo)


def test_a_servo_that_is_not_there_is_not_back() -> None:
    out = reboot_all(MotorWire([EmulatedServo(12)]).place(RIG), RIG, [12, 21])
    assert [servo.problem is None for servo in out.servos] == [True, False]
    assert not out.well


def test_reboot_asks_and_tells(here: Here) -> None:
    Path("bench.toml").write_text(firm_rig().read_text(encoding="utf-8"))
    assert here("reboot", "--rig", "bench.toml").code == 2
    assert here("reboot", "--rig", "bench.toml", "--id", "7", "--yes").code == 2
    done = here("reboot", "--rig", "bench.toml", "--id", "11", "--id", "32", "--yes", "--json")
    assert done.code == 0
    assert violations(done.json, json.loads(schema_text("reboot"))) == []
    assert [servo["id"] for servo in done.json["servos"]] == [11, 32]
    assert "turns are forgotten" in done.err


# ----------------------------------------------------------------------------------------------------
# `palpate stop`: what is confirmed, what is not, and beside a run that is using the port.


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
def test_what_people_get_wrong_with_stop_is_one_line(
    here: Here, args: list[str], code: int, said: str
) -> None:
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
def test_beside_a_run_that_moves(tmp_path: Path, here: Here) -> None:
    """The run ends with an error, and every servo has its torque off."""
    with served(tmp_path, "--pty", "--seed", 7, "--rig-out", "real.toml") as (_, told):
        text = (tmp_path / "real.toml").read_text(encoding="utf-8")
        patient = text.replace("latency_ms = 100", "latency_ms = 500", 1)
        (tmp_path / "real.toml").write_text(patient)
        with started("identify", "--rig", "real.toml", cwd=tmp_path) as run:
            run.until_logged(b'"stage":"closing"')
            done = here("stop", "--rig", "real.toml", "--json")
            ended = run.ended()
        assert ended.code == 4, ended.err
        assert "has its torque off, and this run did not switch it off" in ended.err
        assert done.json["told"] >= 10
        bus = Bus(
            open_port(told["ports"]["mock://bus"], 1_000_000), MonotonicClock(), 1_000_000, latency_s=0.5
        )
        try:
            state = {dxl_id: bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in (11, 12, 21, 22, 31, 32)}
        finally:
            bus.close()
    assert state == dict.fromkeys(state, 0)
