"""`palpate calibrate`: what is asked, refused and foretold before anything moves."""

import io
import sys
from pathlib import Path

import pytest
from command import run_here
from repository import EXAMPLES
from rich.console import Console

from palpate.base.errors import InputError
from palpate.calibration.reference import ReferenceDisc, ReferencePlate
from palpate.cli.calibration_dialogue import ConsoleTable

FRESH = EXAMPLES / "fresh-rig.toml"


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "my-rig.toml"
    path.write_text(FRESH.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def test_a_dry_run_says_what_would_be_done_and_does_nothing(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = run_here(["calibrate", "--rig", rig, "--dry-run"], monkeypatch, capsys)
    assert ended.code == 0
    assert ended.out == ""
    for words in ("actuators", "tactile", "fingers", "6 placings", "my-rig.calibration.toml"):
        assert words in ended.err
    assert sorted(path.name for path in rig.parent.iterdir()) == ["my-rig.toml"]


def test_nothing_moves_unless_somebody_says_yes(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    ended = run_here(["calibrate", "--rig", rig, "tactile"], monkeypatch, capsys)
    assert ended.code == 2
    assert "say --yes if they may" in ended.err
    assert sorted(path.name for path in rig.parent.iterdir()) == ["my-rig.toml"]


@pytest.mark.parametrize(
    ("rig_file", "change", "message"),
    [
        ("fresh-arms.toml", None, "links of finger a1 pass at 30 mm: use lower references"),
        ("fresh-rig.toml", ("height_mm = 10.0", "height_mm = 45.0"), "references must stand higher"),
    ],
)
def test_what_cannot_be_calibrated_is_refused_before_anything_moves(
    tmp_path: Path,
    rig_file: str,
    change: tuple[str, str] | None,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = (EXAMPLES / rig_file).read_text(encoding="utf-8")
    path = tmp_path / "rig.toml"
    path.write_text(text if change is None else text.replace(*change), encoding="utf-8")
    ended = run_here(["calibrate", "--rig", path, "--yes"], monkeypatch, capsys)
    assert ended.code == 2
    assert message in " ".join(ended.err.split())


def test_a_record_that_cannot_be_read_is_not_overwritten(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = rig.with_name("my-rig.calibration.run.json")
    record.write_text('{"format": "palpate/calibration-run@1"', encoding="utf-8")
    ended = run_here(["calibrate", "--rig", rig, "--yes"], monkeypatch, capsys)
    assert ended.code == 2
    assert "restart to begin anew" in " ".join(ended.err.split())
    assert record.read_text(encoding="utf-8").endswith('run@1"')


def test_a_rig_that_is_not_known_well_is_not_identified_with(
    rig: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = run_here(["identify", "--rig", rig, "--sessions", rig.parent / "s"], monkeypatch, capsys)
    assert ended.code == 2
    said = " ".join(ended.err.split())
    assert "may be off by 13.5 mm, more than its tip's radius (5 mm)" in said
    assert "palpate calibrate --rig" in said


def test_a_person_is_asked_once_to_clear_the_table_and_for_every_placing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("\n\n\n"))
    out = io.StringIO()
    table = ConsoleTable(Console(file=out, width=200))
    table.clear()
    table.clear()
    table.put(ReferenceDisc("disc", 25.0), (0.0, 0.0))
    table.put(ReferencePlate("plate", [[0, 0], [40, 0], [40, 40], [0, 40]]), (30.0, -12.0))
    said = out.getvalue()
    assert said.count("Clear the table") == 1
    assert "Put the disc in the middle; alone" in said
    assert "Put the plate near x 30, y -12 mm, turned as you like" in said
    with pytest.raises(InputError, match="standard input has ended"):
        table.clear()
