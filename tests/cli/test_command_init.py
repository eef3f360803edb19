"""`palpate init`: a rig file for devices that answer, which loads and which `check` accepts."""

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from command import PALPATE, run
from firm_rig import firm_rig

from palpate.config import load_rig

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@contextmanager
def served(folder: Path) -> Iterator[dict[str, str]]:
    """Ports of the shipped bench, served by another process, by their names in its rig file."""
    process = subprocess.Popen(
        [PALPATE, "emulate", "--rig", firm_rig(), "--seed", "7"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        said: dict[str, Any] = json.loads(process.stdout.readline())
        yield said["ports"]
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=10)


def test_what_answers_is_in_the_file(tmp_path: Path) -> None:
    with served(tmp_path) as ports:
        bus, *arrays = ports.values()
        words = [word for place in arrays for word in ("--array", place)]
        asked = ("init", "--port", bus, "--baud", 1000000, "--max-id", 40, *words, "--out", "mine.toml")
        ended = run(*asked, cwd=tmp_path)
        assert (ended.code, ended.err) == (0, "")
        assert ended.out.startswith("mine.toml: 3 fingers, ")
        rig = load_rig(tmp_path / "mine.toml")
        shipped = load_rig(firm_rig())
        for finger, other, place in zip(rig.fingers, shipped.fingers, arrays, strict=True):
            assert finger.array.port == place
            for servo, its in zip(finger.servos.values(), other.servos.values(), strict=True):
                assert (servo.dxl_id, servo.model) == (its.dxl_id, its.model)
        assert "answered: 8 × 20 taxels" in (tmp_path / "mine.toml").read_text(encoding="utf-8")
        schema = json.loads((tmp_path / "rig.schema.json").read_text(encoding="utf-8"))
        assert schema["properties"]["format"]["const"] == "palpate/rig@1"
        checked = run("check", "--rig", "mine.toml", "--json", cwd=tmp_path)
        assert checked.json["format"] == "palpate/check@1"
        assert "no answer" not in checked.out
        again = run(*asked, cwd=tmp_path)
        assert (again.code, again.err.count("\n")) == (2, 1)
        assert "mine.toml is there already" in again.err


def test_an_array_that_is_silent_is_named_and_marked(tmp_path: Path) -> None:
    with served(tmp_path) as ports:
        bus = next(iter(ports.values()))
        words = ("--port", bus, "--baud", 1000000, "--max-id", 40, "--array", tmp_path / "nowhere")
        ended = run("init", *words, cwd=tmp_path)
        assert ended.code == 0
        assert "nowhere" in ended.err
    text = (tmp_path / "rig.toml").read_text(encoding="utf-8")
    assert "CHANGE: did not answer" in text
    assert text.count("CHANGE: palpate find-port says which it is") == 2
    load_rig(tmp_path / "rig.toml")


def test_a_bus_without_servos_is_refused(tmp_path: Path) -> None:
    with served(tmp_path) as ports:
        bus = next(iter(ports.values()))
        ended = run("init", "--port", bus, "--baud", 1000000, "--max-id", 5, cwd=tmp_path)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "0 servos answered; a finger has two: check power, cables and ids" in ended.err
    assert list(tmp_path.glob("*.toml")) == []
