"""`palpate init`: a rig file for devices that answer, which loads and which `check` accepts."""

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.resources import as_file
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from command import PALPATE, run
from firm_rig import firm_rig
from sampling import sample

import palpate
from palpate.config import load_rig
from palpate.config.loading import SHIPPED_RIGS, shipped_rig

DOCS = Path(__file__).parents[2] / "docs"


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


@pytest.mark.realtime
@pytest.mark.slow
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


@pytest.mark.realtime
@pytest.mark.slow
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


@pytest.mark.realtime
@pytest.mark.slow
def test_a_bus_without_servos_is_refused(tmp_path: Path) -> None:
    with served(tmp_path) as ports:
        bus = next(iter(ports.values()))
        ended = run("init", "--port", bus, "--baud", 1000000, "--max-id", 5, cwd=tmp_path)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "0 servos answered; a finger has two: check power, cables and ids" in ended.err
    assert list(tmp_path.glob("*.toml")) == []


@pytest.mark.parametrize("bench", sample(SHIPPED_RIGS[1:], SHIPPED_RIGS[2:]))
def test_a_shipped_bench_is_copied_and_can_be_run(bench: str, tmp_path: Path) -> None:
    ended = run("init", "--bench", bench, "--out", "mine.toml", cwd=tmp_path)
    assert (ended.code, ended.err) == (0, "")
    rig = palpate.open_rig(tmp_path / "mine.toml", seed=2)
    assert rig.file == load_rig(shipped_rig(bench))
    answer = rig.identify()
    truth = answer.result.truth
    assert truth is not None
    assert (answer.verdict.value, answer.object) == ("identified", truth.object)
    assert truth.inside_bounds
    again = run("init", "--bench", bench, "--out", "mine.toml", cwd=tmp_path)
    assert (again.code, again.err) == (
        2,
        "error: mine.toml is there already: choose another with --out, or remove it\n",
    )


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "give --port, whose servos are asked, or --bench"),
        (("--bench", "bench", "--port", "/dev/null"), "give --port, whose servos are asked, or --bench"),
        (("--bench", "bank"), "palpate ships bench, xm430-bench, xl330-bench"),
        (("--bench", "bench", "--array", "/dev/null"), "a copied rig has its own"),
    ],
)
def test_port_and_bench_exclude_each_other(words: tuple[str, ...], told: str, tmp_path: Path) -> None:
    ended = run("init", *words, "--out", "mine.toml", cwd=tmp_path)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert told in ended.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bench", SHIPPED_RIGS[1:])
def test_the_drawing_in_the_docs_is_that_of_the_file(bench: str, tmp_path: Path) -> None:
    with as_file(shipped_rig(bench)) as file:
        ended = run("check", "--rig", file, "--picture", "rig.svg", cwd=tmp_path)
    assert ended.code == 0
    drawn = (tmp_path / "rig.svg").read_text(encoding="utf-8")
    assert (DOCS / "images" / f"{bench}.svg").read_text(encoding="utf-8").strip() == drawn.strip()
    ElementTree.fromstring(drawn)
