"""`palpate identify` as a process: what is on stdout, what is in the session, exit codes, signals."""

import json
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from palpate.config import load_objects
from palpate.config.schema import schema_text
from palpate.config.writers import file_text
from palpate.drivers.dynamixel.packet import BROADCAST_ID
from support.benches.rigs import firm_rig, quick_bench, slow_rig
from support.campaign.sampling import sample
from support.commands.command import (
    Here,
    bytes_sent,
    log_bytes,
    log_events,
    run,
    started,
    torque_writes,
    violations,
)

IDS = (11, 12, 21, 22, 31, 32)
WALL = re.compile(r'"wall_seconds": [0-9.e-]+')


def schema(name: str) -> dict[str, Any]:
    loaded = json.loads(schema_text(name))
    assert isinstance(loaded, dict)
    return loaded


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Rig file and catalogue of a small bench."""
    return quick_bench(tmp_path_factory.mktemp("bench"))


@pytest.fixture
def on_bench(bench: tuple[Path, Path]) -> tuple[object, ...]:
    """The options that name them."""
    return ("--rig", bench[0], "--objects", bench[1])


def scene(folder: Path, name: str, x: float, y: float, theta: float, objects: str | None = None) -> Path:
    content: dict[str, Any] = {
        "format": "palpate/scene@1",
        "object": name,
        "configuration": {"x": x, "y": y, "theta": theta},
    }
    if objects is not None:
        content["objects"] = objects
    path = folder / "scene.json"
    path.write_text(json.dumps(content))
    return path


def errors(told: dict[str, Any]) -> list[str]:
    return violations(told, schema("identification"))


def check_truth(told: dict[str, Any]) -> None:
    truth = told["truth"]
    assert truth["named"]
    assert truth["inside_bounds"]
    for key in ("x", "y", "theta"):
        lo, hi = told["bounds"][key]
        assert lo <= truth["configuration"][key] <= hi
        assert lo <= told["configuration"][key] <= hi


def test_one_json_object_one_log_and_the_same_again(
    tmp_path: Path, bench: tuple[Path, Path], on_bench: tuple[object, ...], here: Here
) -> None:
    """Same seed in another process and a folder of another name: only the wall time differs."""
    fresh = tmp_path / "elsewhere"
    fresh.mkdir()
    apart = run("identify", *on_bench, "--seed", 7, "--json", cwd=fresh)
    first = here("identify", *on_bench, "--seed", 7, "--json")
    assert first.code == 0, first.err
    told = first.json
    assert errors(told) == []
    assert told["verdict"] == "identified"
    assert told["emulated"] is True
    assert told["grips"] <= told["touches"] <= 3 * told["grips"]
    check_truth(told)
    assert "Traceback" not in first.err

    folder = tmp_path / told["session"]
    assert not Path(told["session"]).is_absolute()
    assert {item.name for item in folder.iterdir()} == {
        "contacts.json",
        "objects.json",
        "picture.svg",
        "result.json",
        "rig.toml",
        "session.jsonl.zst",
    }
    kept = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert json.loads(kept["result.json"]) == told
    check_log(folder, told)

    assert WALL.sub("", apart.out) == WALL.sub("", first.out)
    assert kept["rig.toml"] == bench[0].read_bytes()
    assert kept["objects.json"].decode() == file_text(load_objects(bench[1]))
    for name in ("contacts.json", "picture.svg"):
        assert (fresh / told["session"] / name).read_bytes() == kept[name]

    # The contacts that were felt say the same without a rig.
    assert violations(json.loads(kept["contacts.json"]), schema("contacts")) == []
    args = ("--objects", bench[1], "--contacts", folder / "contacts.json", "--json")
    known = here("recognize", *args)
    assert known.code == 0, known.err
    assert violations(known.json, schema("recognition")) == []
    assert known.json["verdict"] == "unique"
    best = known.json["hypotheses"][0]
    assert (best["object"], best["state"]) == (told["object"], told["state"])
    for key in ("x", "y", "theta"):
        lo, hi = best["bounds"][key]
        assert lo <= told["truth"]["configuration"][key] <= hi


def check_log(folder: Path, told: dict[str, Any]) -> None:
    events = log_events(folder / "session.jsonl.zst")
    assert events[0]["event"] == "session"
    assert (events[-1]["event"], events[-1]["how"], events[-1]["message"]) == ("end", "done", None)
    assert [event["result"] for event in events if event["event"] == "result"] == [told]
    assert sum(len(event["touches"]) for event in events if event["event"] == "touches") == told["touches"]
    ports = {event["port"] for event in events if event["event"] == "bytes"}
    assert ports == {"mock://bus", "mock://f1", "mock://f2", "mock://f3"}
    assert {event["direction"] for event in events if event["event"] == "bytes"} == {"sent", "received"}
    assert off_at_the_end(events) == set(IDS)


def off_at_the_end(events: list[dict[str, Any]]) -> set[int]:
    """Ids whose last write of Torque Enable, by the bytes in the log, is 0."""
    last = dict(torque_writes(bytes_sent(events, "mock://bus")))
    return {dxl_id for dxl_id, value in last.items() if value == 0} - {BROADCAST_ID}


def test_a_scene_places_the_object_and_people_are_told_where(
    tmp_path: Path, on_bench: tuple[object, ...], here: Here
) -> None:
    where = scene(tmp_path, "tee", 5.5, -3.25, -2.0)
    done = here("identify", *on_bench, "--scene", where, "--picture", "made.svg")
    assert done.code == 0, done.err
    assert done.out.startswith("identified: tee, flat\n")
    assert "inside the bounds" in done.out
    assert "OUTSIDE" not in done.out
    assert (tmp_path / "made.svg").read_text().startswith("<svg")
    (result,) = tmp_path.glob("palpate-sessions/*/result.json")
    told = json.loads(result.read_text())
    truth = told["truth"]["configuration"]
    assert (truth["x"], truth["y"], truth["theta"]) == (5.5, -3.25, -2.0)
    check_truth(told)
    assert told["truth"]["position_error_mm"] < 1.0
    assert told["truth"]["orientation_error_rad"] < 0.01745


def test_what_is_not_in_the_catalogue_is_not_called_something_in_it(
    tmp_path: Path, on_bench: tuple[object, ...], here: Here
) -> None:
    (tmp_path / "odd.json").write_text(
        json.dumps(
            {
                "format": "palpate/objects@1",
                "units": "mm",
                "objects": [
                    {
                        "name": "odd-one",
                        "height": 20.0,
                        "outline": [[0, 0], [58, 4], [50, 22], [31, 15], [27, 47], [6, 36]],
                    }
                ],
            }
        )
    )
    where = scene(tmp_path, "odd-one", -21.0, -17.0, 0.8, objects="odd.json")
    done = here("identify", *on_bench, "--scene", where, "--seed", 2, "--json")
    assert done.code == 1, done.err
    assert errors(done.json) == []
    assert done.json["verdict"] == "unknown"
    assert done.json["object"] is None
    assert done.json["bounds"] is None
    assert done.json["truth"]["object"] == "odd-one"
    assert not done.json["truth"]["named"]


def test_a_port_that_does_not_exist_is_named(tmp_path: Path, here: Here) -> None:
    rig = real_rig(tmp_path, bus="/dev/serial/by-id/no-such-adapter")
    done = here("identify", "--rig", rig, "--json")
    assert done.code == 3
    assert done.out == ""
    (line,) = done.err.splitlines()
    assert line.startswith("device error: port /dev/serial/by-id/no-such-adapter does not exist")
    assert list(tmp_path.glob("palpate-sessions/*")) == [], "a start that failed leaves no session"


def test_pressing_too_hard_is_a_safety_stop(tmp_path: Path, here: Here) -> None:
    """A finger that calls it a contact only just below the limit has pressed too hard before it stands."""
    text = firm_rig().read_text(encoding="utf-8")
    for old, new in (
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 40.0"),
        ("contact_force_n = 0.3", "contact_force_n = 5.9"),
        ("max_force_n = 8.0", "max_force_n = 6.0"),
    ):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "hasty.toml").write_text(text)
    done = here("identify", "--rig", "hasty.toml", "--seed", 7, "--json")
    assert done.code == 4
    assert done.out == ""
    (line,) = done.err.splitlines()
    assert re.match(
        r"safety stop: finger f\d felt \d\.\d N, above max_force_n = 6 N; fingers were stopped", line
    )
    (log,) = tmp_path.glob("palpate-sessions/*/session.jsonl.zst")
    events = log_events(log)
    assert events[-1]["how"] == "SafetyStop"
    assert off_at_the_end(events) == set(IDS)


def real_rig(folder: Path, bus: str) -> Path:
    """The shipped bench as a rig file without emulation, on ports of real kinds."""
    text = firm_rig().read_text(encoding="utf-8")
    text = re.sub(r"\[emulation\]\n(.+\n)+", "", text)
    text = text.replace("mock://bus", bus).replace("mock://f", "/dev/serial/by-id/no-such-array-")
    path = folder / "real.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("number", sample([signal.SIGINT, signal.SIGTERM, signal.SIGHUP], [signal.SIGINT]))
def test_a_signal_in_the_middle_of_a_closing(tmp_path: Path, number: signal.Signals) -> None:
    with started("identify", "--rig", slow_rig(tmp_path), "--json", cwd=tmp_path) as command:
        log = command.until_logged(b'"stage":"closing"')
        time.sleep(0.1)
        done = command.ended(number, number)  # an impatient second one must not keep torque on
    assert (done.code, done.out) == (128 + number, ""), done.err
    assert done.err.splitlines()[-2:] == ["interrupted", "torque is off"]
    assert "Traceback" not in done.err
    events = log_events(log)
    assert [event["stage"] for event in events if event["event"] == "stage"] == ["aiming", "closing"]
    assert (events[-1]["event"], events[-1]["how"]) == ("end", "Interrupted")
    assert off_at_the_end(events) == set(IDS)
    moved = [event for event in events if event["event"] == "bytes" and event["t_s"] > events[-1]["t_s"]]
    assert moved == []


def test_a_killed_session_leaves_a_log_that_can_be_read(tmp_path: Path) -> None:
    with started("identify", "--json", cwd=tmp_path) as command:
        log = command.until_logged(b'"stage":"closing"')
    lines = log_bytes(log).decode().split("\n")
    for line in lines[:-1]:
        json.loads(line)
    assert len(lines) > 100
