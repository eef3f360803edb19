"""`palpate doctor`: every fault is named, none is invented, and what it writes for others is private."""

import getpass
import io
import json
import math
import os
import pty
import re
import socket
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console
from scipy.signal import lfilter

from palpate import open_rig
from palpate.base.errors import InputError
from palpate.config import CalibrationDevice, calibration_path, calibration_toml, load_rig, shipped_rig
from palpate.config.diagnosis_results import Cause, DoctorOut, Outcome
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.control_table import Area
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.transport.ports import PortMissing, PortTaken, open_port
from palpate.rig.diagnostics.array_examination import analyse_untouched
from palpate.rig.diagnostics.diagnosis import diagnose
from palpate.rig.diagnostics.host_ports import Computer
from palpate.rig.diagnostics.steps import DiagnosisCase
from palpate.views.doctor import doctor_report, show_doctor
from support.benches.calibration_files import MADE, empty_calibration
from support.benches.doctor import FAULTS, PORTS, WELL, Fault, examined, set_up_with
from support.campaign.sampling import sample
from support.commands.command import Here, violations


def fault(name: str) -> Fault:
    return next(item for item in FAULTS if item.name == name)


@pytest.mark.parametrize("planted", sample(FAULTS, FAULTS[::8]), ids=lambda item: item.name)
def test_a_fault_is_named_and_nothing_else(planted: Fault, tmp_path: Path) -> None:
    found = examined(planted, tmp_path)
    assert {item.cause for item in found.findings} == {planted.cause}
    assert any(planted.device in item.device for item in found.findings)
    assert found.next is not None or planted.cause is Cause.LIMITS_NOT_SET
    for item in found.findings:
        assert item.saw
        assert item.means
        assert item.next
        assert not {item.saw[-1], item.means[-1], item.next[-1]} & set(".; ")


@pytest.mark.parametrize("planted", WELL, ids=lambda item: item.name)
@pytest.mark.parametrize("seed", sample([3, 11], [3]))
def test_a_set_up_without_a_fault_has_no_findings(planted: Fault, seed: int, tmp_path: Path) -> None:
    found = examined(planted, tmp_path, seed)
    assert found.findings == ()
    assert found.well
    assert found.next is None
    assert found.moved is planted.move
    outcomes = {item.step: item.outcome for item in found.steps}
    assert outcomes.pop("wiring") is (Outcome.WELL if planted.move else Outcome.SKIPPED)
    assert set(outcomes.values()) == {Outcome.WELL}


def test_there_are_thirty_faults_of_different_causes() -> None:
    assert len(FAULTS) >= 30
    assert len({item.cause for item in FAULTS}) >= 30


def test_steps_behind_a_failed_one_are_skipped_with_the_reason(tmp_path: Path) -> None:
    found = examined(fault("the bus's adapter is not plugged in"), tmp_path)
    by_name = {item.step: item for item in found.steps}
    assert by_name["port is there"].outcome is Outcome.WRONG
    assert by_name["baud rate"].skipped_because == "the bus's port /dev/ttyUSB0 cannot be used"
    assert by_name["supply voltage"].skipped_because == "no servo answers as the rig file says"
    assert by_name["taxel map"].outcome is Outcome.WELL, "arrays have ports of their own"
    for item in found.steps:
        assert (item.skipped_because is None) == (item.outcome is not Outcome.SKIPPED)
    assert found.device_missing


def test_one_thing_is_said_to_be_done_first_and_warnings_wait(tmp_path: Path) -> None:
    def both(found: object) -> None:
        fault("latency timer of 16 ms").plant(found)  # type: ignore[arg-type]
        fault("torque left on").plant(found)  # type: ignore[arg-type]

    found = examined(Fault("both", None, "", both), tmp_path)
    assert [item.cause for item in found.findings] == [Cause.LATENCY_TIMER, Cause.TORQUE_ON]
    assert str(found.next).startswith("servo 12 (f1 slide): palpate stop --rig rig.toml")


def test_fingers_do_not_move_while_something_is_wrong(tmp_path: Path) -> None:
    planted = fault("torque left on")
    found = examined(Fault("moved", planted.cause, "", planted.plant, move=True), tmp_path)
    assert not found.moved
    assert found.steps[-1].skipped_because == "fingers move only once nothing else is wrong"


def eeprom(servo: EmulatedServo) -> dict[str, int]:
    table = servo._unit.table
    return {item.name: table.get(item.name) for item in table if item.area is Area.EEPROM}


def test_nothing_moves_and_nothing_is_written_to_eeprom(tmp_path: Path) -> None:
    found = set_up_with(fault("limits not set"), tmp_path)
    before = [(servo.shaft_rad, eeprom(servo)) for servo in found.servos()]
    on_bench = found.on_bench()
    case = DiagnosisCase(on_bench, found.place(on_bench.described), Computer(tmp_path))
    assert not diagnose(case, MADE).moved
    assert [(servo.shaft_rad, eeprom(servo)) for servo in found.servos()] == before
    assert before[5][1]["Current Limit"] == 1193, "as it was planted"


def test_the_shipped_rig_as_json(here: Here) -> None:
    done = here("doctor", "--json")
    assert done.code == 0, "what differs in a new servo's EEPROM is a warning"
    out = done.json
    assert violations(out, json.loads(schema_text("doctor"))) == []
    assert out["format"] == "palpate/doctor@1"
    assert [item["step"] for item in out["steps"]] == [
        *("port is there", "permission", "other programs", "latency timer", "baud rate", "ids", "models"),
        *("firmware", "supply voltage", "hardware errors", "torque", "settings in EEPROM", "bus traffic"),
        *("zeros", "arrays answer", "array geometry", "frames", "taxel map", "noise and drift"),
        *("force scale", "touch force", "calibration", "wiring"),
    ]
    assert [item["cause"] for step in out["steps"] for item in step["findings"]] == ["limits-not-set"]
    assert out["next"] is None
    assert "settings in EEPROM" in done.err, "people read it on stderr"


def test_joints_move_with_leave_alone(here: Here) -> None:
    done = here("doctor", "--move", "--yes", "--json")
    assert done.code == 0
    assert done.json["moved"] is True
    assert done.json["steps"][-1]["saw"] == "0 tips were pressed, 6 joints moved"
    refused = here("doctor", "--move")
    assert refused.code == 2
    assert refused.err.splitlines()[-1].endswith("no terminal to ask on: say --yes if they may")


def test_a_real_rig_needs_somebody_who_looks(tmp_path: Path) -> None:
    with open_rig(real_rig(tmp_path)) as rig, pytest.raises(InputError, match="give an onlooker"):
        rig.doctor(move=True)


def test_of_some_ports_that_are_missing_each_is_a_finding(tmp_path: Path) -> None:
    """What to do next is about all of them."""
    gone = {PORTS[name]: PortMissing(name) for name in ("f1", "f3")}
    found = examined(Fault("two arrays", None, "", lambda setup: setup.refused.update(gone)), tmp_path, 3)
    (ports, *_) = found.steps
    assert [item.device for item in ports.findings] == [
        f"port {port} (array {name})" for name, port in PORTS.items() if port in gone
    ]
    assert found.next is not None
    assert found.next.startswith(" and ".join(item.device for item in ports.findings))


def real_rig(folder: Path) -> Path:
    head, _, rest = shipped_rig().read_text(encoding="utf-8").partition("[emulation]")
    file = folder / "rig.toml"
    file.write_text(
        (head + rest[rest.index("[[fingers]]") :]).replace("mock://", "/dev/no-such-"), encoding="utf-8"
    )
    return file


def test_exit_codes_are_those_of_the_page(here: Here, tmp_path: Path) -> None:
    real_rig(tmp_path)
    missing = here("doctor", "--rig", "rig.toml")
    assert missing.code == 3
    said = " ".join(missing.out.split())
    assert "all ports: none of them is there: /dev/no-such-bus (the servos' bus), /dev/no-such-f1" in said
    assert said.count("/dev/no-such-f1") == 1
    assert said.endswith(
        "next all ports: plug the adapters in, then find their names with: palpate find-port"
    )
    assert here("doctor", "--rig", "no-such.toml").code == 2

    emulated = tmp_path / "emulated.toml"
    emulated.write_text(shipped_rig().read_text(encoding="utf-8"), encoding="utf-8")
    device = CalibrationDevice(port="mock://bus", kind="servo", id="11", model="XL330-M288", firmware="52")
    arrays = [
        CalibrationDevice(port=f"mock://{name}", kind="array", id="00" * 16, model="palpate", firmware="1")
        for name in ("f1", "f2", "f3")
    ]
    file = empty_calibration(load_rig(emulated), [device, *arrays])
    calibration_path(emulated).write_text(calibration_toml(file), encoding="utf-8")
    other = here("doctor", "--rig", "emulated.toml", "--json")
    assert other.code == 1
    assert other.json["next"] == "calibration: palpate calibrate --rig emulated.toml"
    assert here("doctor", "--rig", "emulated.toml", "--no-calibration").code == 0


def shown(out: DoctorOut, width: int) -> list[str]:
    written = io.StringIO()
    show_doctor(out, Console(width=width, file=written))
    return [line.rstrip() for line in written.getvalue().splitlines()]


def test_the_text_fits_a_terminal_and_ends_with_what_to_do(tmp_path: Path) -> None:
    lines = shown(examined(fault("a servo at another baud rate"), tmp_path), 80)
    assert max(map(len, lines)) <= 80
    at = next(k for k, line in enumerate(lines) if line.startswith("✗ baud rate "))
    assert lines[at].endswith("5 of 6 servos at 1000000 baud, 1 at 57600")
    assert "servo 21 (f2 aim): it answers at 57600 baud" in lines[at + 1]
    assert "1 thing is wrong" in lines[-2]
    assert "palpate setup-motors --rig rig.toml --id 21" in lines[-1]


# -- the report ---------------------------------------------------------------------------------------


def test_a_report_has_what_helps_and_nothing_private(here: Here, tmp_path: Path) -> None:
    file = real_rig(tmp_path)
    serial = "/dev/serial/by-id/usb-FTDI_USB__-__Serial_Converter_FT3WHRKK-if00-port0"
    text = file.read_text(encoding="utf-8").replace("/dev/no-such-bus", serial)
    file.write_text(text.replace("/dev/no-such-f1", "socket://lab-pc.example.org:7000"), encoding="utf-8")
    assert here("doctor", "--rig", str(file), "--report", "report.md").code == 3
    report = Path("report.md").read_text(encoding="utf-8")
    private = getpass.getuser(), socket.gethostname(), str(Path.home()), str(tmp_path), "FT3WHRKK", "lab-pc"
    for word in private:
        assert word not in report
    assert "[port-missing]" in report
    assert "- palpate " in report
    assert "- Python 3" in report
    assert "baudrate_bps = 1000000" in report
    assert 'model = "XM430-W350"' in report
    assert report.count("/dev/serial/by-id/#") >= 3, "one hash for one adapter, wherever it is named"
    assert len({part[:8] for part in report.split("/dev/serial/by-id/#")[1:]}) == 1


def test_names_of_users_and_computers_are_left_out_wherever_they_stand() -> None:
    rig = load_rig(shipped_rig())
    out = open_rig().doctor().result
    finding = examined_text(
        out, f"{Path('/home', 'ada', 'rigs', 'left.toml')} on workbench-7 of Ada, 192.168.7.20"
    )
    report = doctor_report(finding, rig, {"ada": "<user>", "workbench-7": "<host>"})
    assert not re.search(r"\bada\b", report, re.IGNORECASE)
    assert "adapter" in report
    for word in ("workbench-7", "left.toml", "192.168"):
        assert word not in report
    assert "<host> of <user>" in report


def examined_text(out: DoctorOut, text: str) -> DoctorOut:
    """A result with some text in a finding."""
    found = out.findings[0].model_copy(update={"saw": text})
    step = out.steps[0].model_copy(update={"findings": (found,)})
    return out.model_copy(update={"steps": (step, *out.steps[1:])})


def test_an_array_that_was_replaced_is_hashed_in_a_report(tmp_path: Path) -> None:
    out = examined(fault("an array replaced since calibration"), tmp_path)
    report = doctor_report(out, load_rig(shipped_rig()))
    assert "00" * 16 in out.findings[0].saw
    assert "00" * 16 not in report
    assert "was made with array #" in report


# -- what it rests on ---------------------------------------------------------------------------------


def test_ports_that_do_not_open_say_why() -> None:
    with pytest.raises(PortMissing):
        open_port("/dev/no-such-port", 57_600)
    with pytest.raises(PortMissing):
        open_port("mock://no-such/bus", 57_600)
    master, slave = pty.openpty()
    try:
        name = os.ttyname(slave)
        with closing(open_port(name, 57_600)), pytest.raises(PortTaken):
            open_port(name, 57_600)
    finally:
        os.close(master)
        os.close(slave)


def test_a_computer_of_which_nothing_is_known_says_nothing(tmp_path: Path) -> None:
    nothing = Computer(tmp_path / "none")
    assert not nothing.runs("ModemManager")
    assert not nothing.may_be_probed("/dev/ttyUSB0")
    assert nothing.user_of("/dev/ttyUSB0") is None
    assert nothing.latency_timer_s("/dev/ttyUSB0") is None
    assert nothing.find_brltty_claim() is None
    assert nothing.group_of("/dev/no-such-port") is None


def test_modem_manager_that_is_told_to_leave_a_port_alone_is_no_finding(tmp_path: Path) -> None:
    def told(found: object) -> None:
        fault("ModemManager may probe an array").plant(found)  # type: ignore[arg-type]
        data = tmp_path / "run/udev/data/c188:1"
        data.write_text("E:ID_MM_CANDIDATE=1\nE:ID_MM_DEVICE_IGNORE=1\n", encoding="ascii")

    assert examined(Fault("told", None, "", told), tmp_path).findings == ()


def frames_of(counts: np.ndarray, rate_hz: float = 250.0) -> list[TactileFrame]:
    return [
        TactileFrame(k, k / rate_hz, k / rate_hz, np.clip(np.rint(frame), 0, 4095).astype("<u2"))
        for k, frame in enumerate(counts)
    ]


@pytest.mark.parametrize("memory", [0.0, 0.9])
@pytest.mark.parametrize("noise", sample([0.2, 2.0, 20.0], [2.0]))
def test_still_arrays_do_not_drift(noise: float, memory: float) -> None:
    """In forty arrays of 160 taxels, with white noise and with noise that remembers for ten frames."""
    rng = np.random.default_rng(1)
    for _ in range(40):
        rough = lfilter([math.sqrt(1 - memory**2)], [1, -memory], rng.normal(0, noise, (850, 8, 20)), axis=0)
        found = analyse_untouched(frames_of(300 + rough[100:]), 4095, 0.0)
        assert found is not None
        assert found.drifting == 0
        bad = found.dead | found.hot | found.unsteady
        assert not bad.any()


def test_drift_is_seen_beyond_what_is_allowed() -> None:
    rng = np.random.default_rng(2)
    time = np.arange(750)[:, None, None] / 250.0
    counts = 300 + rng.normal(0, 2.0, (750, 8, 20)) + 3.0 * time * (np.arange(20) == 4)
    found = analyse_untouched(frames_of(counts), 4095, 0.0)
    assert found is not None
    assert found.drifting == 8
    assert found.drift_counts_per_s == pytest.approx(3.0, abs=0.5)
    allowed = analyse_untouched(frames_of(counts), 4095, 4.0)
    assert allowed is not None
    assert allowed.drifting == 0


def test_few_frames_say_nothing() -> None:
    assert analyse_untouched(frames_of(np.full((5, 2, 2), 300.0)), 4095, 0.0) is None
