"""The tests of a real rig, on served emulated devices: they pass, fail, err and skip where they should."""

import json
import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import pytest

from palpate.config import load_rig
from palpate.drivers.dynamixel.control_table import TORQUE_ENABLE
from palpate.rig.diagnostics.servo_bus import list_servos
from palpate.rig.fingers import servo_settings
from palpate.testing import hardware, served
from palpate.testing.hardware.bench import open_bus
from support.benches.rigs import quick_bench
from support.campaign.sampling import sample
from support.commands.command import PATIENCE_S
from support.commands.repository import EXAMPLES, ROOT

REAL = EXAMPLES / "real-rig.toml"
SUITE = (sys.executable, "-m", "palpate.testing.hardware")
BLOCK = [[-20, -15], [20, -15], [20, 15], [-20, 15]]
WEDGE = [[-20, -15], [25, -15], [-20, 15]]
MOVES = re.compile(r"^\S+ moves: \S.*$", re.MULTILINE)


def suite(folder: Path, *words: object, stdin: int = subprocess.DEVNULL) -> subprocess.CompletedProcess[str]:
    """Run it in a folder of its own, as from an installed package."""
    return subprocess.run(
        [*SUITE, *map(str, words)],
        cwd=folder,
        stdin=stdin,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def parts_on_table(folder: Path) -> tuple[Path, Path]:
    """A catalogue of two parts, and a scene with one of them in the middle: the table's edge is clear."""
    parts, scene = folder / "parts.json", folder / "scene.json"
    models = [
        {"name": name, "height": 20.0, "outline": ring} for name, ring in (("block", BLOCK), ("wedge", WEDGE))
    ]
    parts.write_text(json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": models}))
    where = {"x": 0.0, "y": 0.0, "theta": 0.3}
    scene.write_text(json.dumps({"format": "palpate/scene@1", "object": "block", "configuration": where}))
    return parts, scene


def rig_file(folder: Path, fingers: int) -> Path:
    """A small bench that needs few frames a second, on a computer that other tests use, too.

    It searches slowly: with the latency that `patient` declares a quicker touch would exceed max_force_n.
    """
    rig, _ = quick_bench(folder, fingers)
    text = rig.read_text(encoding="utf-8")
    for old, new in (
        ("sample_rate_hz = 125.0", "sample_rate_hz = 100.0"),
        ("approach_speed_mm_s = 30.0", "approach_speed_mm_s = 60.0\nsearch_speed_mm_s = 5.0"),
        ("range_deg = [-35.0, 35.0]", "range_deg = [-8.0, 8.0]"),
    ):
        assert old in text
        text = text.replace(old, new)
    rig.write_text(text, encoding="utf-8")
    return rig


def patient(rig: Path) -> None:
    """Served devices may have to wait for their turn on the computer."""
    text = rig.read_text(encoding="utf-8")
    rig.write_text(text.replace("latency_ms = 100", "latency_ms = 400", 1), encoding="utf-8")


def set_up_servos(rig_path: Path) -> None:
    """What `palpate setup-motors` writes, which wants servos one by one."""
    rig = load_rig(rig_path)
    with open_bus(rig) as bus:
        for item in servo_settings(rig, bus):
            item.limits.write(item.servo)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Rig file of a served rig with one finger, set up, a block on its table."""
    folder = tmp_path_factory.mktemp("bench")
    parts, scene = parts_on_table(folder)
    words = ("--rig", rig_file(folder, 1), "--objects", parts, "--scene", scene, "--seed", 7)
    with served(folder, *words, "--rig-out", "real.toml"):
        patient(folder / "real.toml")
        set_up_servos(folder / "real.toml")
        yield folder / "real.toml"


def outcomes(junit: Path) -> dict[str, str]:
    """By test: passed, failed, error or skipped."""
    found = {}
    for case in ElementTree.parse(junit).iter("testcase"):
        tags = {child.tag for child in case} - {"properties", "system-out"}
        found[case.attrib["name"]] = {"failure": "failed"}.get(tag := next(iter(tags), "passed"), tag)
    return found


def properties(junit: Path, name: str) -> dict[str, str]:
    """What was noted of a test; "" for the whole run."""
    root = ElementTree.parse(junit)
    found = [case for case in root.iter("testcase") if case.attrib["name"] == name]
    items = found[0].iter("property") if found else root.find("testsuite/properties") or ()
    return {item.attrib["name"]: item.attrib["value"] for item in items}


@pytest.mark.realtime
def test_a_rig_that_is_well_passes(bench: Path, tmp_path: Path) -> None:
    """All but the identification, which is for a part that is named.

    What failed is tried again: on a busy computer served devices fall silent, and fingers stop for it.
    """
    words = ("--rig", bench, "--yes-move", "--junitxml")
    done = suite(tmp_path, *words, "found.xml")
    said = [done.stdout]
    found = outcomes(tmp_path / "found.xml")
    for again in ("second.xml", "third.xml"):
        if "failed" in found.values() or "error" in found.values():
            said.append(suite(tmp_path, *words, again, "--last-failed").stdout)
            found |= outcomes(tmp_path / again)
    skipped = [name for name, outcome in found.items() if outcome == "skipped"]
    assert skipped == ["test_a_known_part_is_identified"]
    assert [name for name, outcome in found.items() if outcome not in ("passed", "skipped")] == [], said
    assert len(MOVES.findall(done.stdout)) == 7, "what moves is said beforehand"
    servo = properties(tmp_path / "found.xml", "test_step[firmware-12-f1-slide]")
    assert servo.items() >= {("servo", "12 (f1 slide)"), ("model", "XM430-W350"), ("firmware", "45")}
    array = properties(tmp_path / "found.xml", "test_step[arrays-answer-f1]")
    assert array.items() >= {("protocol", "palpate"), ("geometry", "8 x 20 cylinder"), ("emulated", "True")}
    assert len(array["unique_id"]) == 32
    frames = properties(tmp_path / "found.xml", "test_step[frames-f1]")
    assert 0 < int(frames["frames"]) <= 520, "5 s at 100 Hz; a busy computer's devices live more slowly"
    assert properties(tmp_path / "found.xml", "")["rig"] == "firm-bench"
    assert "loop_rate_hz" in done.stdout, "figures are shown"


@pytest.mark.realtime
def test_what_is_wrong_fails_and_hides_no_other_device(tmp_path: Path) -> None:
    """A servo and an array that are not there, one that answers as another model, limits not written."""
    parts, scene = parts_on_table(tmp_path)
    words = ("--rig", rig_file(tmp_path, 2), "--objects", parts, "--scene", scene)
    with served(tmp_path, *words, "--rig-out", "real.toml") as (_, printed):
        rig = tmp_path / "real.toml"
        patient(rig)
        text = rig.read_text(encoding="utf-8")
        for old, new in (
            ("dxl_id = 12", "dxl_id = 13"),
            (printed["ports"]["mock://f1"], str(tmp_path / "no-such-port")),
            (printed["ports"]["mock://f2"], str(tmp_path / "nor-this")),
            ('dxl_id = 21\nmodel = "XM430-W350"', 'dxl_id = 21\nmodel = "XL330-M288"'),
        ):
            assert text.count(old) == 1
            text = text.replace(old, new)
        rig.write_text(text, encoding="utf-8")
        which = "there or ids or models or settings or traffic or frames or jump"
        done = suite(tmp_path, "--rig", rig, "--yes-move", "--junitxml", "found.xml", "-k", which)
    assert done.returncode == 1
    by_device = {
        name.removeprefix("test_step[").removesuffix("]"): outcome
        for name, outcome in outcomes(tmp_path / "found.xml").items()
    }
    assert by_device == {
        "port-is-there": "failed",
        **{"ids": "passed", "ids-11-f1-aim": "passed", "ids-13-f1-slide": "failed"},
        **{"ids-21-f2-aim": "passed", "ids-22-f2-slide": "passed"},
        **{"models": "passed", "models-11-f1-aim": "passed", "models-13-f1-slide": "skipped"},
        **{"models-21-f2-aim": "failed", "models-22-f2-slide": "passed"},
        **{"settings-in-EEPROM": "passed", "settings-in-EEPROM-11-f1-aim": "failed"},
        **{"settings-in-EEPROM-13-f1-slide": "skipped", "settings-in-EEPROM-21-f2-aim": "skipped"},
        "settings-in-EEPROM-22-f2-slide": "failed",
        **{"bus-traffic": "passed", "bus-traffic-11-f1-aim": "passed", "bus-traffic-13-f1-slide": "skipped"},
        **{"bus-traffic-21-f2-aim": "skipped", "bus-traffic-22-f2-slide": "passed"},
        **{"frames": "skipped", "frames-f1": "skipped", "frames-f2": "skipped"},
        "test_torque_goes_on_without_a_jump": "error",
    }
    assert re.search(r"servo 13 \(f1 slide\): it does not answer", done.stdout)
    assert re.search(r"no-such-port", done.stdout)


def test_without_a_terminal_nothing_moves_unasked(tmp_path: Path) -> None:
    """The ports of this rig do not exist: they are not even opened."""
    done = suite(tmp_path, "--rig", REAL, "-k", "not devices and not identified")
    assert done.returncode == 0, done.stdout
    assert "7 skipped" in done.stdout
    assert "--yes-move if it may" in done.stdout


@pytest.mark.parametrize(("answer", "outcome"), [("y", "1 error"), ("", "1 skipped")])
def test_on_a_terminal_it_asks(tmp_path: Path, answer: str, outcome: str) -> None:
    """With a yes it goes on, here to ports that do not exist."""
    ours, theirs = pty.openpty()
    try:
        os.write(ours, f"{answer}\n".encode())
        done = suite(tmp_path, "--rig", REAL, "-k", "jump", stdin=theirs)
    finally:
        os.close(ours)
        os.close(theirs)
    assert "torque goes on where everything stands" in done.stdout
    assert "may it? [y/N]" in done.stdout
    assert outcome in done.stdout, done.stdout


@pytest.mark.realtime
@pytest.mark.campaign
def test_a_signal_ends_it_with_torque_off(bench: Path, tmp_path: Path) -> None:
    """SIGTERM while a finger may move ends the whole session, not one test."""
    words = ("--rig", bench, "--yes-move", "-k", "air or touch")
    process = subprocess.Popen([*SUITE, *map(str, words)], cwd=tmp_path, stdout=subprocess.PIPE, text=True)
    rig = load_rig(bench)
    ids = [servo.dxl_id for servo in list_servos(rig)]
    try:
        assert process.stdout is not None
        while "moves:" not in process.stdout.readline():
            assert process.poll() is None
        time.sleep(1.0)
        process.send_signal(signal.SIGTERM)
        out, _ = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == pytest.ExitCode.INTERRUPTED, out
    assert " moves:" not in out, "no other test begins"
    with open_bus(rig) as bus:
        assert {bus.read(dxl_id, TORQUE_ENABLE) for dxl_id in ids} == {0}


@pytest.mark.realtime
@pytest.mark.campaign
def test_the_part_that_lies_there_is_the_answer(tmp_path: Path) -> None:
    rig, parts = quick_bench(tmp_path)
    quick = rig.read_text(encoding="utf-8")
    rig.write_text(quick.replace("touch_speed_mm_s", "search_speed_mm_s = 6.0\ntouch_speed_mm_s", 1))
    scene = tmp_path / "scene.json"
    where = {"x": -20.0, "y": -20.0, "theta": 0.3}
    scene.write_text(json.dumps({"format": "palpate/scene@1", "object": "ell", "configuration": where}))
    words = ("--rig", rig, "--objects", parts, "--scene", scene, "--rig-out", "real.toml")
    with served(tmp_path, *words):
        patient(tmp_path / "real.toml")
        about = ("--part", "ell", "--objects", parts, "-k", "identified")
        for _ in range(3):  # a busy computer's devices fall silent now and then
            done = suite(tmp_path, "--rig", "real.toml", "--yes-move", *about)
            if "answer " in done.stdout:
                break
    assert "1 passed" in done.stdout, done.stdout
    assert "answer ell" in done.stdout, done.stdout
    assert list((tmp_path / "palpate-sessions").iterdir()), "a log to send back"


def test_without_a_rig_everything_is_skipped_with_the_reason(tmp_path: Path) -> None:
    done = suite(tmp_path, "--junitxml", "found.xml")
    assert done.returncode == 0
    assert set(outcomes(tmp_path / "found.xml").values()) == {"skipped"}
    assert "needs a rig: --rig FILE" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    sample(
        [
            (("--rig", "none.toml"), "none.toml"),
            (("--rig", EXAMPLES / "firm-rig.toml"), "palpate emulate --rig"),
            (("--rig", REAL, "--part", "sphinx"), 'no object is called "sphinx"'),
            (("--rig", REAL, "--objects", "parts.json"), "--part"),
            (("--rig", REAL, "-n", "2"), "several processes"),
        ],
        [(("--rig", REAL, "--part", "sphinx"), 'no object is called "sphinx"')],
    ),
)
def test_what_cannot_be_run_is_said_in_a_line(tmp_path: Path, words: tuple[object, ...], said: str) -> None:
    done = suite(tmp_path, *words)
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_in_a_checkout_a_rig_is_enough() -> None:
    """`pytest --rig FILE` runs these tests and no others."""
    words = ("--rig", REAL, "--collect-only", "-q", "-p", "no:cacheprovider")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    # Names of tests only: what pytest prints besides, such as warnings, may hold "::" too.
    collected = [line for line in done.stdout.splitlines() if re.match(r"\S+\.py::", line)]
    assert len(collected) > 10
    # The folder that pytest writes before them depends on what it takes for its root.
    own = {path.name for path in Path(hardware.__file__).parent.glob("test_*.py")}
    assert {Path(line.partition("::")[0]).name for line in collected} == own
