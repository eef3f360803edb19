"""Standard output that is full, closed, or read by somebody who has heard enough."""

import json
import subprocess
from itertools import cycle, product
from pathlib import Path

import pytest
from command import PALPATE, log_events
from firm_rig import firm_rig
from quick_rig import small, small_parts
from repository import EXAMPLES
from sampling import sample
from wording import missing

ASKING = ("setup-motors --rig rig.toml", "calibrate --rig rig.toml", "doctor --move", "check --hold")
STDIN = ("<&-", "</dev/null")
QUESTIONS = tuple(product(ASKING, STDIN))


def shell(line: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a line with PALPATE for the command."""
    text = line.replace("PALPATE", str(PALPATE))
    return subprocess.run(["sh", "-c", text], cwd=cwd, capture_output=True, text=True, check=False)


def test_a_full_device_is_one_line(tmp_path: Path) -> None:
    done = shell("PALPATE --version > /dev/full", tmp_path)
    assert done.returncode == 5
    assert missing(done.stderr, "error: ", "output", "No space left on device") == []
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&-", ">&- 2>&- <&-"])
def test_closed_streams_are_no_error(tmp_path: Path, closed: str) -> None:
    done = shell(f"PALPATE --version {closed}", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(("command", "stdin"), sample(QUESTIONS, zip(ASKING, cycle(STDIN))))
def test_a_question_that_nobody_hears_is_a_line(tmp_path: Path, command: str, stdin: str) -> None:
    """Of commands that somebody has to answer; the rig's devices are not even looked at."""
    (tmp_path / "rig.toml").write_text((EXAMPLES / "fresh-rig.toml").read_text(encoding="utf-8"))
    done = shell(f"PALPATE {command} {stdin}", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "and there is no terminal to ask on" in done.stderr


def test_a_display_that_fails_at_the_end_leaves_the_answer(tmp_path: Path) -> None:
    text = small(firm_rig()).replace("max_grips = 8", "max_grips = 1")
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    small_parts(tmp_path)
    done = shell("PALPATE identify --rig rig.toml --objects small-parts.json --json 2> /dev/full", tmp_path)
    assert done.returncode == 5
    assert json.loads(done.stdout)["grips"] == 1
    (session,) = (tmp_path / "palpate-sessions").iterdir()
    assert (session / "result.json").exists()
    assert log_events(session / "session.jsonl.zst")[-1]["how"] == "done"


def test_a_reader_that_has_gone_is_no_traceback(tmp_path: Path) -> None:
    done = shell("PALPATE --help | true", tmp_path)
    assert done.stderr == ""


def test_no_command_shows_the_help_and_no_error(tmp_path: Path) -> None:
    for command in ("PALPATE", "PALPATE objects"):
        done = shell(command, tmp_path)
        assert (done.returncode, done.stderr) == (2, "")
        assert "Usage: palpate" in done.stdout


def test_a_picture_that_finds_no_room_is_one_line(tmp_path: Path) -> None:
    """`ulimit -f` lets no file grow beyond so many blocks, as a full disk: EFBIG in place of ENOSPC."""
    done = shell(
        "trap '' XFSZ; ulimit -f 0; PALPATE plan --contacts CONTACTS --picture p.svg".replace(
            "CONTACTS", str(EXAMPLES / "first-grip.json")
        ),
        tmp_path,
    )
    assert done.returncode == 5
    assert done.stderr.startswith("output error: p.svg cannot be written: File too large")
