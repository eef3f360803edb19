"""A session in real time, over pseudo-terminals with another process behind them, comes about again."""

import json
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command import PALPATE, log_bytes, log_events, run
from quick_rig import quick_bench

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@contextmanager
def served(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """The emulator's process, of a small bench of two fingers, with `real.toml`; ended as by Ctrl-C."""
    rig, parts = quick_bench(folder, fingers=2)
    process = subprocess.Popen(
        [PALPATE, "emulate", "--rig", rig, "--objects", parts, "--seed", "7", "--rig-out", "real.toml"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["format"] == "palpate/ports@1"
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=10)
        finally:
            process.kill()


def the_session(folder: Path) -> Path:
    (log,) = folder.glob("palpate-sessions/*/session.jsonl.zst")
    return log.parent


@pytest.mark.timeout(250)
def test_a_run_of_one_grip(tmp_path: Path) -> None:
    """However it ended: a busy machine may make a device error of it, which must come about again, too."""
    with served(tmp_path):
        text = (tmp_path / "real.toml").read_text(encoding="utf-8")
        (tmp_path / "real.toml").write_text(re.sub(r"max_grips = \d+", "max_grips = 1", text))
        words = ("--rig", "real.toml", "--objects", "small-parts.json", "--json")
        done = run("identify", *words, cwd=tmp_path, timeout_s=200)
    again = run("replay", the_session(tmp_path), "--json", cwd=tmp_path)
    assert again.code == 0, again.out + again.err
    told = again.json
    assert told["same"]
    end = log_events(the_session(tmp_path) / "session.jsonl.zst")[-1]
    assert told["end"] == {"how": end["how"], "message": end["message"]}
    if done.code in (0, 1):
        for key in ("verdict", "object", "state"):
            assert told[key] == done.json[key]
    assert told["sent_bytes"] > 2000


@pytest.mark.timeout(120)
def test_a_run_that_ends_early(tmp_path: Path) -> None:
    with served(tmp_path):
        identify = subprocess.Popen(
            [PALPATE, "identify", "--rig", "real.toml", "--objects", "small-parts.json"],
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            end = time.monotonic() + 60
            while not any(
                b'"stage":"closing"' in log_bytes(log)
                for log in tmp_path.glob("palpate-sessions/*/session.jsonl.zst")
            ):
                assert time.monotonic() < end
                time.sleep(0.05)
            time.sleep(0.4)
            identify.send_signal(signal.SIGINT)
            code = identify.wait(timeout=30)
        finally:
            identify.kill()
            identify.wait()
    assert code == 130
    again = run("replay", the_session(tmp_path), "--json", cwd=tmp_path)
    assert again.code == 0, again.out + again.err
    assert again.json["end"]["how"] == log_events(the_session(tmp_path) / "session.jsonl.zst")[-1]["how"]
