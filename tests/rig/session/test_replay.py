"""Replay of sessions, of real ports, of failures."""

import base64
import json
import math
import re
import signal
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from palpate.config import load_objects, load_rig
from palpate.config.schema import schema_text
from palpate.drivers.emulators.servo_firmware import OVERLOAD_BIT
from palpate.drivers.transport.replay import Replayer
from palpate.rig.bench import choose_placements
from palpate.rig.contact_peak import bus_latency_s
from palpate.rig.motion.guarded_approach import GripPhase, carry_out_grip
from palpate.rig.motion.hand import Environment
from palpate.rig.session.log import SessionEvents, line_checksum
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.run import first_difference, replay_with
from palpate.testing import served
from support.benches.rigs import firm_rig, quick_bench, slow_rig
from support.benches.session import small_session
from support.campaign.sampling import sample
from support.commands.command import (
    Here,
    bytes_sent,
    copied,
    log_bytes,
    log_events,
    missing,
    run,
    started,
    violations,
    write_log,
)
from support.commands.repository import EXAMPLES

# ----------------------------------------------------------------------------------------------------
# `palpate replay`: sessions in virtual time come about again byte for byte, and what differs is named.

SEEN = "tee"
"""What the small bench has on its table for seed 7."""


@pytest.fixture(scope="module")
def seed_7(recorded: Callable[[str], Path]) -> Path:
    """The folder of a session on a small bench."""
    return recorded("whole")


@pytest.fixture(scope="module")
def one_grip(recorded: Callable[[str], Path]) -> Path:
    """The folder of a session that gave up after its first grip: quick to replay."""
    return recorded("one grip")


def brief(rig: Any, folder: Path) -> Path:
    """The rig file with a search of one grip."""
    text, number = re.subn(r"max_grips = \d+", "max_grips = 1", rig.read_text(encoding="utf-8"))
    assert number == 1
    (folder / "brief.toml").write_text(text)
    return folder / "brief.toml"


def sent_bytes(session: Path) -> int:
    return len(bytes_sent(log_events(session / "session.jsonl.zst")))


def test_the_shipped_rig_comes_about_again(seed_7: Path, here: Here) -> None:
    done = here("replay", seed_7)
    assert (done.code, done.err) == (0, "")
    lines = len(log_events(seed_7 / "session.jsonl.zst")) - 1
    words = (f"{lines} events", f"{sent_bytes(seed_7)} bytes", "as recorded", f"identified: {SEEN}, flat")
    assert missing(done.out, *words) == []
    assert done.out.count("\n") == 1


def test_a_program_gets_one_object_and_the_log_itself_may_be_named(seed_7: Path, here: Here) -> None:
    done = here("replay", seed_7 / "session.jsonl.zst", "--json")
    assert (done.code, done.err) == (0, "")
    assert violations(done.json, json.loads(schema_text("replay"))) == []
    told = done.json
    assert (told["same"], told["verdict"], told["object"], told["state"]) == (
        True,
        "identified",
        SEEN,
        "flat",
    )
    assert told["end"] == {"how": "done", "message": None}
    assert told["sent_bytes"] == sent_bytes(seed_7)


def test_a_session_with_keys_by_their_old_names_replays(
    one_grip: Path, tmp_path: Path, here: Here, caplog: pytest.LogCaptureFixture
) -> None:
    def change(lines: list[str]) -> list[str]:
        found, checked = [], 0
        for line in lines:
            bare = re.sub(r',"sum":"\w+"}$', "}", line.strip())
            if '"event":"result"' in bare:
                for old, new in (("foretold", "predicted"), ("unnoticed_shift", "detectable_shift")):
                    assert f'"{new}"' in bare
                    bare = bare.replace(f'"{new}"', f'"{old}"')
                bare = bare.replace('"units":"mm, rad",', "")
            bare = re.sub(r',"(loads|touch_records)":\[[^]]*]', "", bare)
            checked = line_checksum(bare, checked)
            found.append(f'{bare[:-1]},"sum":"{checked:08x}"}}\n')
        return found

    folder = copied(one_grip, tmp_path, change)
    text = (folder / "rig.toml").read_text(encoding="utf-8")
    keys = "stranger_chance = 0.01\nunnoticed_shift_mm = 10.0"
    (folder / "rig.toml").write_text(text.replace("[search]", f"[search]\n{keys}"), encoding="utf-8")
    done = here("replay", folder)
    assert (done.code, "all as recorded" in done.out) == (0, True)
    first, second = caplog.messages
    assert "search.stranger_chance is now called false_match_probability" in first
    assert "search.unnoticed_shift_mm is now called detectable_shift_mm" in second


def test_a_session_from_before_there_was_a_truth_event_replays(
    one_grip: Path, tmp_path: Path, here: Here
) -> None:
    def change(lines: list[str]) -> list[str]:
        events = [json.loads(line) for line in lines]
        (truth,) = [event for event in events if event["event"] == "truth"]
        events.remove(truth)
        (result,) = [event for event in events if event["event"] == "result"]
        result["calls"] = truth["calls"] + result.get("calls", "")
        del result["result"]["truth"]["at_measurement"]
        return [json.dumps(event) + "\n" for event in events]

    done = here("replay", copied(one_grip, tmp_path, change))
    assert "check sum is wrong; replaying it made no difference" in done.err


def test_the_truth_of_a_part_that_was_pushed_is_read_from_the_log(tmp_path: Path, here: Here) -> None:
    """At 0.3 N the shipped fingers push a part of 0.5 kg; a replay runs no engine."""
    rig, parts = quick_bench(tmp_path)
    light = '[emulation.part]\nengine = "mujoco"\nmass_kg = 0.5\n\n[[fingers]]'
    rig.write_text(brief(rig, tmp_path).read_text().replace("[[fingers]]", light, 1))
    done = here("identify", "--rig", rig, "--objects", parts, "--seed", 7, "--json")
    truth = done.json["truth"]
    session = tmp_path / done.json["session"]
    (event,) = [item for item in log_events(session / "session.jsonl.zst") if item["event"] == "truth"]
    assert event["part"]["slip_n"] == pytest.approx(0.3 * 0.5 * 9.80665)
    (measured,) = truth["at_measurement"]
    assert measured["x"] == pytest.approx(event["at_measurement"][0]["x_mm"], abs=1e-6)
    (put,) = choose_placements(load_rig(rig), load_objects(parts), None, 7)
    assert 0.01 < math.dist((put.x_mm, put.y_mm), (measured["x"], measured["y"])) < 2
    assert truth["configuration"] != measured
    again = here("replay", session)
    assert (again.code, again.err) == (0, "")

    def change(lines: list[str]) -> list[str]:
        return [line.replace('"configuration":{"x_mm":', '"configuration":{"y":') for line in lines]

    (tmp_path / "changed").mkdir()
    refused = here("replay", copied(session, tmp_path / "changed", change))
    assert refused.code == 2
    assert missing(refused.err, 'the event "truth"', "configuration", "at_measurement") == []


def test_a_replay_writes_nothing(one_grip: Path, here: Here) -> None:
    before = {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in one_grip.iterdir()}
    assert here("replay", one_grip).code == 0
    assert {path.name: (path.stat().st_mtime_ns, path.read_bytes()) for path in one_grip.iterdir()} == before


@pytest.mark.parametrize(("port", "number"), [("mock://bus", 300), ("mock://f2", 2)])
def test_one_changed_byte_that_was_sent_is_noticed_at_that_byte(
    one_grip: Path, tmp_path: Path, here: Here, port: str, number: int
) -> None:
    changed_line = -1
    byte = -1

    def change(lines: list[str]) -> list[str]:
        nonlocal changed_line, byte
        sent = [k for k, line in enumerate(lines) if f'"port":"{port}","direction":"sent"' in line]
        changed_line = sent[number]
        event = json.loads(lines[changed_line])
        data = bytearray(base64.b64decode(event["base64"]))
        byte = len(data) // 2
        data[byte] ^= 1
        old, new = event["base64"], base64.b64encode(data).decode()
        lines[changed_line] = lines[changed_line].replace(old, new)
        return lines

    folder = copied(one_grip, tmp_path, change)
    done = here("replay", folder)
    assert done.code == 1
    assert f"line {changed_line + 1}, " in done.out
    assert f"port {port}: byte {byte} of what is sent differs: sent " in done.out
    assert (" to id " in done.out) == (port == "mock://bus")
    assert f"line {changed_line + 1}: is not as it was written" in done.err
    told = here("replay", folder, "--json")
    assert (told.code, told.json["same"]) == (1, False)
    assert told.json["difference"]["line"] == changed_line + 1
    assert violations(told.json, json.loads(schema_text("replay"))) == []


def test_a_changed_byte_that_was_received_does_not_pass_for_the_session(
    one_grip: Path, tmp_path: Path, here: Here
) -> None:
    """One bit of a frame that nobody looks at changes no byte sent; the check sum still tells."""
    changed_line = -1

    def change(lines: list[str]) -> list[str]:
        nonlocal changed_line
        long = [k for k, line in enumerate(lines) if '"direction":"received"' in line and len(line) > 300]
        changed_line = long[len(long) // 2]
        line = lines[changed_line]
        place = line.index('"base64":"') + 100
        lines[changed_line] = line[:place] + ("A" if line[place] != "A" else "B") + line[place + 1 :]
        return lines

    done = here("replay", copied(one_grip, tmp_path, change))
    assert done.code in (1, 2)
    assert f"line {changed_line + 1}: is not as it was written: its check sum is wrong" in done.err


def test_a_value_that_is_not_what_it_was_is_named(one_grip: Path, tmp_path: Path, here: Here) -> None:
    def change(lines: list[str]) -> list[str]:
        return [
            line.replace(f'"object":"{SEEN}"', '"object":"ell"', 1) if '"result"' in line else line
            for line in lines
        ]

    done = here("replay", copied(one_grip, tmp_path, change))
    assert done.code == 1
    assert f"\"result\" differs: result.object is '{SEEN}', recorded 'ell'" in done.out


@pytest.mark.parametrize("share", [0.2, 0.9999])
def test_a_log_cut_off_anywhere_replays_up_to_there(
    one_grip: Path, tmp_path: Path, here: Here, share: float
) -> None:
    for path in one_grip.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    raw = (one_grip / "session.jsonl.zst").read_bytes()
    kept = raw[: int(share * len(raw))]
    (tmp_path / "session.jsonl.zst").write_bytes(kept)
    done = here("replay", tmp_path)
    assert (done.code, done.err) == (0, "")
    last = log_bytes(tmp_path / "session.jsonl.zst").count(b"\n")
    assert done.out.startswith(f"replayed {last - 1} events, ")
    assert "all as recorded; no answer so far" in done.out
    assert f"the log was cut off after line {last}: it has no end\n" in done.out


def test_what_is_not_a_session_is_one_line(tmp_path: Path, here: Here) -> None:
    done = here("replay", tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "is not a session" in done.err
    assert done.err.count("\n") == 1
    write_log(tmp_path / "session.jsonl.zst", ['{"t_s":0,"event":"session","format":"palpate/session@2"}\n'])
    done = here("replay", tmp_path)
    assert (done.code, done.err.count("\n")) == (2, 1)
    assert 'line 1: must be the event "session" with format "palpate/session@1"' in done.err


def test_a_log_from_before_there_were_replays_is_refused(one_grip: Path, tmp_path: Path, here: Here) -> None:
    copied(one_grip, tmp_path, lambda lines: lines)
    (tmp_path / "rig.toml").unlink()
    done = here("replay", tmp_path)
    assert (done.code, done.out) == (2, "")
    assert "keeps no rig.toml" in done.err


@pytest.mark.campaign
@pytest.mark.slow
def test_arms_whose_goals_are_a_function_of_time(tmp_path: Path, here: Here) -> None:
    rig = brief(EXAMPLES / "two-link-rig.toml", tmp_path)
    text = rig.read_text().replace("sample_rate_hz = 250.0", "sample_rate_hz = 125.0")
    rig.write_text(text.replace("radius_mm = 110.0", "radius_mm = 70.0"))
    args = ("--rig", rig, "--seed", 3, "--strategy", "random", "--json")
    done = here("identify", *args)
    assert done.code in (0, 1), done.err
    again = here("replay", done.json["session"], "--json")
    assert again.code == 0, again.out + again.err
    assert again.json["same"]
    assert (again.json["verdict"], again.json["object"]) == (done.json["verdict"], done.json["object"])


def test_a_scene_with_an_object_of_its_own_is_kept_in_the_folder(tmp_path: Path, here: Here) -> None:
    odd = {
        "name": "odd-one",
        "height": 20.0,
        "outline": [[0, 0], [58, 4], [50, 22], [31, 15], [27, 47], [6, 36]],
    }
    (tmp_path / "odd.json").write_text(
        json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": [odd]})
    )
    scene = {
        "format": "palpate/scene@1",
        "object": "odd-one",
        "objects": "odd.json",
        "configuration": {"x": -21.0, "y": -17.0, "theta": 0.4},
    }
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    rig, parts = quick_bench(tmp_path)
    words = ("--rig", brief(rig, tmp_path), "--objects", parts, "--scene", "scene.json", "--json")
    done = here("identify", *words)
    assert done.code == 1, done.err
    (tmp_path / "odd.json").unlink()
    (tmp_path / "scene.json").unlink()
    again = here("replay", done.json["session"])
    assert again.code == 0, again.out + again.err
    assert again.out.rstrip().endswith(f"all as recorded; {done.json['verdict']}")


@pytest.mark.parametrize(
    ("found", "recorded", "told"),
    [
        ({"a": 1.0}, {"a": 1.000001}, None),
        ({"a": 1.0}, {"a": 1.00001}, "a is 1.0, recorded 1.00001"),
        ({"a": [1, {"b": 2}]}, {"a": [1, {"b": 3}]}, "a[1].b is 2, recorded 3"),
        ({"a": [1]}, {"a": [1, 2]}, "a has 1 values, recorded 2"),
        ({"a": 1}, {"a": True}, "a is 1, recorded True"),
        ({"a": 1}, {"a": 1, "b": 2}, "b is None, recorded 2"),
        ({"wall_seconds": 1.0}, {"wall_seconds": 2.0}, None),
    ],
)
def test_values_are_compared_to_six_decimals(found: Any, recorded: Any, told: str | None) -> None:
    assert first_difference(found, recorded, "") == told


# ----------------------------------------------------------------------------------------------------
# A session in real time, over pseudo-terminals with another process behind them, comes about again: a whole
# one in tests/rig/emulated/test_served.py.


def the_session(folder: Path) -> Path:
    (log,) = folder.glob("palpate-sessions/*/session.jsonl.zst")
    return log.parent


@pytest.mark.realtime
@pytest.mark.slow
def test_a_run_that_ends_early(tmp_path: Path) -> None:
    rig, parts = quick_bench(tmp_path, fingers=2)
    with served(tmp_path, "--rig", rig, "--objects", parts, "--seed", "7", "--rig-out", "real.toml"):
        words = ("identify", "--rig", "real.toml", "--objects", "small-parts.json")
        with started(*words, cwd=tmp_path) as identify:
            identify.until_logged(b'"stage":"closing"')
            time.sleep(0.4)
            assert identify.ended(signal.SIGINT).code == 130
    again = run("replay", the_session(tmp_path), "--json", cwd=tmp_path)
    assert again.code == 0, again.out + again.err
    assert again.json["end"]["how"] == log_events(the_session(tmp_path) / "session.jsonl.zst")[-1]["how"]


# ----------------------------------------------------------------------------------------------------
# `palpate replay` of sessions that ended badly: by a signal, a fault, a hard press, a missing port.


def signalled(folder: Path, number: signal.Signals, when: bytes, after_s: float) -> Path:
    """The session of an `identify` that got a signal some time after `when` was in its log."""
    with started("identify", "--rig", slow_rig(folder), "--json", cwd=folder) as command:
        log = command.until_logged(when)
        time.sleep(after_s)
        command.ended(number)
    return log.parent


@pytest.mark.parametrize("number", sample([signal.SIGINT, signal.SIGTERM], [signal.SIGTERM]))
def test_a_run_that_was_interrupted(tmp_path: Path, here: Here, number: signal.Signals) -> None:
    session = signalled(tmp_path, number, b'"stage":"closing"', 0.17)
    end = log_events(session / "session.jsonl.zst")[-1]
    assert end["how"] == "Interrupted"
    done = here("replay", session)
    assert (done.code, done.err) == (0, ""), done.out
    assert done.out.rstrip().endswith(f"all as recorded; ended by Interrupted: {end['message']}")


def test_a_run_that_was_killed(tmp_path: Path, here: Here) -> None:
    session = signalled(tmp_path, signal.SIGKILL, b'"stage":"closing"', 0.1)
    done = here("replay", session)
    assert (done.code, done.err) == (0, ""), done.out
    assert "the log was cut off after line " in done.out


def test_a_run_that_pressed_too_hard_or_was_held(tmp_path: Path, here: Here) -> None:
    text = firm_rig().read_text(encoding="utf-8")
    for old, new in (
        ("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 70.0"),
        ("max_force_n = 8.0", "max_force_n = 4.0"),
        ("sample_rate_hz = 250.0", "sample_rate_hz = 40.0"),
    ):
        text = text.replace(old, new)
    (tmp_path / "hasty.toml").write_text(text)
    assert here("identify", "--rig", "hasty.toml", "--seed", 5, "--json").code in (3, 4)
    (log,) = tmp_path.glob("palpate-sessions/*/session.jsonl.zst")
    done = here("replay", log.parent)
    assert (done.code, done.err) == (0, ""), done.out
    end = log_events(log)[-1]
    assert end["how"] != "done"
    assert f"all as recorded; ended by {end['how']}: {end['message']}" in done.out


FAULTS: Mapping[str, Callable[[Any], Callable[[], None]]] = {
    "nothing": lambda _: lambda: None,
    "overload": lambda session: lambda: session.servos[22].report_hardware_error(OVERLOAD_BIT),
    "the bus is cut off": lambda session: lambda: setattr(session.cables["mock://bus"], "cut", True),
    "late answers": lambda session: lambda: setattr(session.cables["mock://bus"], "late_s", 0.04),
    "the bus is unplugged": lambda session: lambda: unplug(session.cables["mock://bus"]),
    "Ctrl-C": lambda _: interrupt,
}


def unplug(cable: Any) -> None:
    def gone(*_: object) -> None:
        raise OSError(5, "Input/output error")

    cable.feed = cable.poll = gone


def interrupt() -> None:
    raise KeyboardInterrupt("Ctrl-C")


WHEN = [(GripPhase.AIMING, 0.013), (GripPhase.CLOSING, 1.0), (GripPhase.TOUCHING, 0.3)]


FAULTY = [(fault, *WHEN[k % 3]) for k, fault in enumerate(FAULTS)]


@pytest.mark.parametrize(
    ("fault", "stage", "after_s"),
    sample(FAULTY, FAULTY[2:3]),
)
def test_a_grip_with_a_fault_in_it(tmp_path: Path, fault: str, stage: GripPhase, after_s: float) -> None:
    session = small_session()
    grip = session.middle()
    bring_about = FAULTS[fault](session)

    def on_stage(now: GripPhase) -> None:
        if now is stage:
            session.clock.after(after_s, bring_about)

    ended: list[object] = []
    try:
        ended.append(session.run_grip(tmp_path, grip, on_stage))
    except BaseException as error:
        ended.append((type(error), str(error), getattr(error, "__notes__", [])))
    file = read_session(tmp_path)
    assert file.changed_line is None

    def again(replayer: Replayer, events: SessionEvents) -> None:
        try:
            with Environment(replayer.clock, replayer.open, bus_latency_s(session.rig)).hand(
                session.rig
            ) as hand:
                hand.prepare()
                ended.append(carry_out_grip(hand, grip, lambda _: None))
        except BaseException as error:
            ended.append((type(error), str(error), getattr(error, "__notes__", [])))
            raise

    replayed = replay_with(file, session.rig.bus.port, again)
    assert (replayed.difference, replayed.complete) == (None, True)
    assert replayed.lines == len(file.entries)
    assert str(ended[1]) == str(ended[0])
