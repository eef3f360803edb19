"""`palpate home`: what it says, and what it refuses before anything moves."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from command import Ended, run_here

from palpate.config import shipped_rig
from palpate.config.commissioning_results import HomeOut

Here = Callable[..., Ended]
BENCH = shipped_rig("xm430-bench")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Here:
    monkeypatch.chdir(tmp_path)
    return lambda *args: run_here(args, monkeypatch, capsys)


def test_slides_that_stand_anywhere_are_homed(here: Here, tmp_path: Path) -> None:
    rig = tmp_path / "anywhere.toml"
    text = BENCH.read_text(encoding="utf-8")
    rig.write_text(text.replace("noise_counts = 2.0", 'noise_counts = 2.0\nstart = "anywhere"'), "utf-8")
    ended = here("home", "--rig", rig, "--yes", "--seed", 1, "--json")
    assert ended.code == 0
    HomeOut.model_validate_json(ended.out)
    slides = json.loads(ended.out)["slides"]
    assert [(slide["finger"], slide["dxl_id"]) for slide in slides] == [("f1", 12), ("f2", 22), ("f3", 32)]
    assert any(slide["turns"] < 0 for slide in slides)
    assert "f3: slide (servo 32) is homed; its count is" in ended.err


def test_a_rig_without_stops_has_nothing_to_home_against(here: Here) -> None:
    ended = here("home", "--rig", shipped_rig(), "--yes")
    assert (ended.code, ended.out) == (2, "")
    assert "has no slide with stops_mm" in ended.err


def test_nothing_moves_where_nobody_can_be_asked(here: Here) -> None:
    ended = here("home", "--rig", BENCH)
    assert ended.code == 2
    assert "say --yes if they may" in ended.err
