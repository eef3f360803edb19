"""`palpate scan`: what is found on an emulated bus, and what is said about it."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ended, run_here
from json_schema import violations
from motor_wire import MotorWire
from served_servos import served_servos
from wording import missing

from palpate.cli.ports import parse_ids
from palpate.config import load_rig, shipped_rig
from palpate.config.schema import schema_text
from palpate.drivers.dynamixel.bus import Ping
from palpate.drivers.dynamixel.bus_scan import FoundServo, Scan, scan
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.rig.diagnostics.servo_bus import BusEndpoint, endpoint_of_rig, scan_result

Here = Callable[..., Ended]

BENCH_IDS = [11, 12, 21, 22, 31, 32]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(args, monkeypatch, capsys)


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
        "baudrates_bps": [9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000],
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
    assert missing(lines[-1], "6 servos", "mock://bus", "emulated", "7 baud rates", "0 to 252") == []


def test_nothing_at_the_only_rate_that_is_tried(here: Here) -> None:
    done = here("scan", "--baud", 57600, "--ids", "1-40", "--json")
    assert done.code == 3
    assert done.json["servos"] == []
    assert len(done.json["warnings"]) == 6, "each servo of the rig file is missing"


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        (["--port", "/dev/no-such-port"], 3, "device error: port /dev/no-such-port does not exist"),
        (["--port", "mock://rig/bus"], 3, "device error: port mock://rig/bus does not exist"),
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
def test_what_people_get_wrong_is_one_line(here: Here, args: list[str], code: int, said: str) -> None:
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
