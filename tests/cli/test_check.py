"""`palpate check`: what it sees on the emulated bench, whole and broken, and that it moves nothing."""

import json
from pathlib import Path

import pytest
from rich.console import Console
from serial.serialutil import SerialBase

from palpate.base.errors import DeviceError
from palpate.config import RigFile, load_rig, shipped_rig
from palpate.config.diagnosis_results import Cause, CheckOut, FingerHoldOut, HoldCheckOut, Severity
from palpate.config.fields import to_json
from palpate.config.schema import schema_text
from palpate.drivers.emulators.array import EmulatedArray
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.messages import SelfTestResult
from palpate.drivers.transport import SerialPort
from palpate.rig.bench import BenchRig, connect
from palpate.rig.diagnostics.motion_checks import judge_hold
from palpate.rig.diagnostics.servo_bus import BusEndpoint, endpoint_of_rig
from palpate.views.check_table import show_check
from palpate.views.tables import show_unplugged
from support.benches.doctor import checked
from support.benches.rigs import firm_rig
from support.commands.command import Here, missing, violations
from support.commands.repository import EXAMPLES
from support.devices.ports import Listener

RIG = load_rig(shipped_rig())
IDS = [11, 12, 21, 22, 31, 32]


def emulated(place: BusEndpoint) -> dict[int, EmulatedServo]:
    """The bench's emulated servos by id."""
    assert isinstance(place.devices, BenchRig)
    assert place.devices.mock is not None
    fingers = place.devices.mock.rig.bench.fingers
    return {servo.dxl_id: servo for finger in fingers for servo in finger.servos}


def test_the_shipped_rig_as_json(here: Here) -> None:
    done = here("check", "--json")
    assert done.code == 0
    out = done.json
    assert violations(out, json.loads(schema_text("check"))) == []
    assert list(out) == [
        *("format", "rig", "emulated", "well", "adapter", "servos", "arrays", "loop", "bus"),
        *("calibration", "touch_force", "hold", "wiring", "problems", "warnings", "steps", "next"),
    ]
    assert out["format"] == "palpate/check@1"
    assert [servo["id"] for servo in out["servos"]] == IDS
    assert out["adapter"] == {"port": "mock://bus", "baudrate_bps": 1000000, "latency_timer_ms": None}
    assert out["servos"][0] == {
        "id": 11,
        "owner": "f1 aim",
        "model": "XM430-W350",
        "answers": True,
        "firmware": 45,
        "voltage_v": 12.0,
        "voltage_limits_v": [9.5, 16.0],
        "temperature_c": out["servos"][0]["temperature_c"],
        "temperature_limit_c": 80,
        "hardware_error": [],
        "torque_on": False,
        "return_delay_us": 500,
        "settings": [
            {"item": "Return Delay Time", "found": 250, "wanted": 0},
            {"item": "Current Limit", "found": 1193, "wanted": 223},
            {"item": "Min Position Limit", "found": 0, "wanted": 57},
            {"item": "Max Position Limit", "found": 4095, "wanted": 4039},
        ],
        "problems": [],
        "warnings": out["servos"][0]["warnings"],
    }
    assert out["arrays"][0] == {
        "finger": "f1",
        "port": "mock://f1",
        "protocol": "palpate",
        "answers": True,
        "firmware": "palpate emulator 1",
        "unique_id": out["arrays"][0]["unique_id"],
        "emulated": True,
        "rows": 8,
        "columns": 20,
        "shape": "cylinder",
        "bad_taxels": 0,
        "wanted_hz": 500.0,
        "rate_hz": pytest.approx(500.0),
        "lost": 0,
        "latency_timer_ms": None,
        "problems": [],
        "warnings": [],
    }
    assert out["arrays"][0]["unique_id"].startswith("6631"), "f1 in ASCII"
    assert out["calibration"] is None
    assert list(out["loop"]) == ["servos", "cycles", "fast", "rate_hz", "median_ms", "p99_ms", "wire_ms"]
    assert out["bus"]["damaged"] == out["bus"]["silent"] == 0


def test_the_loop_takes_what_the_wire_takes() -> None:
    out = checked(RIG, endpoint_of_rig(RIG))
    assert out.loop is not None
    assert out.loop.wire_ms <= out.loop.median_ms <= 1.3 * out.loop.wire_ms
    assert out.loop.cycles == pytest.approx(out.loop.rate_hz, abs=2)
    assert not any("sample_rate_hz" in text for text in out.warnings), "a run sets the return delay to 0"
    data = RIG.model_dump(mode="json", exclude_none=True)
    data["closing"]["sample_rate_hz"] = 800.0
    for finger in data["fingers"]:
        finger["array"]["baudrate_bps"] = 4_000_000  # fast enough for its frames
    hurried = RigFile.model_validate(data)
    found = checked(hurried, endpoint_of_rig(hurried)).findings
    slow = [item for item in found if item.cause is Cause.BUS_SLOW]
    assert ["sample_rate_hz is 800" in item.saw for item in slow] == [True], "the wire alone is slower"


def test_a_rig_that_has_run_once_has_no_warnings() -> None:
    """Runs write what check wants: one place has the numbers."""
    place = endpoint_of_rig(RIG)
    assert isinstance(place.devices, BenchRig)
    with connect(place.devices) as hand:
        hand.prepare()
    out = checked(RIG, place)
    assert out.well
    assert out.warnings == ()
    assert all(servo.settings == () for servo in out.servos)


def test_nothing_moves_and_torque_is_not_touched() -> None:
    place = endpoint_of_rig(RIG)
    servos = emulated(place)
    before = {dxl_id: servo.shaft_rad for dxl_id, servo in servos.items()}
    listener = Listener(place.clock)

    class Place(BusEndpoint):
        def open(self, baudrate: int, *, shared: bool = False) -> SerialBase:
            return listener.on(super().open(baudrate, shared=shared))

    listened = Place(place.port, place.clock, place.latency_s, place.baudrate, RIG, place.urls, place.devices)
    checked(RIG, listened)
    assert {dxl_id: servo.shaft_rad for dxl_id, servo in servos.items()} == before
    # every write goes to Status Return Level or to the indirect addresses, which start at 168
    writes = listener.sent.split(b"\xff\xff\xfd\x00")[1:]
    addresses = {packet[4] | packet[5] << 8 for packet in writes if packet[3] in (0x03, 0x83)}
    assert addresses <= {68, 168}
    assert not any(packet[3] == 0x93 for packet in writes), "no bulk write"


def test_a_silent_servo_hides_no_other() -> None:
    place = endpoint_of_rig(RIG)
    emulated(place)[21].power_off()
    out = checked(RIG, place)
    assert not out.well
    assert [servo.id for servo in out.servos if servo.answers] == [11, 12, 22, 31, 32]
    assert [(item.cause, item.servos) for item in out.findings[:1]] == [(Cause.SERVO_SILENT, (21,))]
    (problem,) = out.problems
    assert problem.startswith("servo 21 (f2 aim): it does not answer")
    assert out.loop is not None
    assert out.loop.servos == 5


def test_a_port_that_is_not_there_is_one_line(here: Here) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    head, _, rest = text.partition("[emulation]")
    text = head + rest[rest.index("[[fingers]]") :]
    Path("rig.toml").write_text(text.replace("mock://", "/dev/no-such-"))
    done = here("check", "--rig", "rig.toml")
    assert (done.code, done.out) == (3, "")
    (line,) = done.err.splitlines()
    assert line.startswith("device error: port /dev/no-such-bus does not exist")


def test_a_slow_latency_timer_is_said_with_what_to_type(capsys: pytest.CaptureFixture[str]) -> None:
    for timer_s, said in ((0.016, True), (0.001, False), (None, False)):
        port = SerialPort("/dev/ttyUSB7", None, None, None, None, timer_s, None, permitted=True)
        show_unplugged([port], Console(width=200))
        text = capsys.readouterr().out
        assert ("for up to 16 ms" in text) == said
        assert ("echo 1 | sudo tee /sys/class/tty/ttyUSB7/device/latency_timer" in text) == said


def array_of_finger(place: BusEndpoint, number: int) -> EmulatedArray:
    assert isinstance(place.devices, BenchRig)
    assert place.devices.mock is not None
    array = place.devices.mock.rig.bench.fingers[number].array
    assert isinstance(array, EmulatedArray)
    return array


def test_what_an_array_finds_in_itself_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    place = endpoint_of_rig(RIG)
    sick, broken = array_of_finger(place, 0), array_of_finger(place, 1)
    sick.taxels = Taxels(sick.description, seed=1, dead=[(0, 1)], hot=[(7, 19)])
    broken.broken = SelfTestResult.SUPPLY
    out = checked(RIG, place)
    assert not out.well
    assert [array.bad_taxels for array in out.arrays] == [2, 0, 0]
    rates = [array.rate_hz for array in out.arrays]
    assert rates == pytest.approx([500.0] * 3), "they are listened to all the same"
    found = [(item.cause, item.arrays) for item in out.findings if item.severity is Severity.WRONG]
    assert sorted(found) == [
        (Cause.ARRAY_HARDWARE, ("f2",)),
        (Cause.DEAD_TAXEL, ("f1",)),
        (Cause.HOT_TAXEL, ("f1",)),
    ]
    show_check(out, Console(width=160, soft_wrap=True))
    rows = [line for line in capsys.readouterr().out.splitlines() if "8 × 20 cylinder" in line]
    assert [("2 bad" in row, "done" in row, "palpate  " in row) for row in rows] == [
        (True, False, True),
        (False, True, True),
        (False, True, True),
    ]


def test_the_tables_say_what_is_in_the_result(capsys: pytest.CaptureFixture[str]) -> None:
    place = endpoint_of_rig(RIG)
    emulated(place)[12].power_off()
    out = checked(RIG, place)
    show_check(out, Console(width=160, soft_wrap=True))
    text = capsys.readouterr().out
    assert "✗     12  f1 slide" in text
    assert "6 servos" not in text
    assert "1 thing is wrong, 1 warning" in text.splitlines()[-1]
    assert isinstance(out, CheckOut)


def test_the_servos_fit_into_a_narrow_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    show_check(checked(RIG, endpoint_of_rig(RIG)), Console(width=80, soft_wrap=True))
    rows = [line for line in capsys.readouterr().out.splitlines() if "XM430-W350" in line]
    assert [row.split()[1:] for row in rows[:1]] == [
        ["11", "f1", "aim", "XM430-W350", "45", "12.0", "V", "30", "°C", "off", "4", "differ"]
    ]
    assert len(rows) == 6


def test_a_port_that_fails_meanwhile_is_an_error() -> None:
    """Not six servos that do not answer."""
    place = endpoint_of_rig(RIG)

    def unplugged() -> None:
        raise OSError("unplugged")

    class Broken(BusEndpoint):
        def open(self, baudrate: int, *, shared: bool = False) -> SerialBase:
            return Listener(self.clock, unplugged).on(super().open(baudrate, shared=shared))

    broken = Broken(place.port, place.clock, place.latency_s, place.baudrate, RIG, place.urls, place.devices)
    with pytest.raises(DeviceError, match=r"failed: .*unplugged"):
        checked(RIG, broken)


@pytest.mark.parametrize(
    ("most_n", "kind"),
    [(8.0, None), (4.0, "warnings"), (2.0, "problems")],  # two corners at once, each: may, and will exceed it
)
def test_touches_of_pads_that_would_end_a_run_are_said(
    most_n: float, kind: str | None, here: Here, tmp_path: Path
) -> None:
    rig, text = tmp_path / "pads.toml", (EXAMPLES / "pad-rig.toml").read_text(encoding="utf-8")
    rig.write_text(text.replace("max_force_n = 8.0", f"max_force_n = {most_n}"), encoding="utf-8")
    found = here("check", "--rig", str(rig), "--json").json
    hard = [name for name in ("warnings", "problems") for line in found[name] if "would end the run" in line]
    assert hard == ([] if kind is None else [kind])


def test_arrays_on_boards_that_reset_as_their_port_opens(here: Here, tmp_path: Path) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    slow = tmp_path / "boots.toml"
    slow.write_text(text.replace("[emulation]\n", "[emulation]\narray_boot_s = 2.5\n"), encoding="utf-8")
    done = here("check", "--rig", str(slow), "--json")
    assert done.code == 0
    assert [array["lost"] for array in done.json["arrays"]] == [0, 0, 0]
    slow.write_text(text.replace("[emulation]\n", "[emulation]\narray_boot_s = 9.0\n"), encoding="utf-8")
    done = here("check", "--rig", str(slow), "--json")
    assert done.code == 3
    assert all("nothing answers there" in array["problems"][0] for array in done.json["arrays"])


def test_what_a_part_holds_is_said_with_the_line_to_write(capsys: pytest.CaptureFixture[str]) -> None:
    declared = RIG.model_copy(update={"search": RIG.search.model_copy(update={"part_holds_n": 0.5})})
    finger = FingerHoldOut(finger="f1", slid=True, pressed_n=0.5, holds_n=0.41, moved_mm=0.4)
    found = HoldCheckOut(
        part_holds_n=0.41, least_n=0.41, slid=True, largest_n=3.0, moved_mm=0.7, fingers=(finger,)
    )
    _, (finding,) = judge_hold(declared, found)
    assert finding.cause is Cause.PART_SLIDES
    assert missing(finding.saw, "part_holds_n = 0.5 N", "only certain to hold 0.41 N") == []
    out = checked(declared, endpoint_of_rig(declared)).model_copy(update={"hold": found})
    assert violations(json.loads(to_json(out)), json.loads(schema_text("check"))) == []
    show_check(out, Console(width=200))
    said = capsys.readouterr().out
    assert (
        "holds 0.41 N at least (f1 pushed with 0.5 N, of which 0.41 N are certain); moved by 0.7 mm in all "
        "touches together" in said
    )
    assert "below [search]: part_holds_n = 0.41" in said


def test_a_part_is_pushed_only_after_a_yes_and_not_with_a_disc(here: Here) -> None:
    done = here("check", "--hold")
    assert done.code == 2
    assert done.err.splitlines()[-1].endswith("no terminal to ask on: say --yes if they may")
    done = here("check", "--hold", "--touch", "--yes")
    assert done.code == 2
    assert done.err.splitlines()[-1].startswith("error: touch and hold exclude each other")
