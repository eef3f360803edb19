"""A grip with arrays that send seldom: servos hear from the host often enough all the same."""

from pathlib import Path

import pytest
from command import run_here
from firm_rig import firm_rig
from quick_rig import small, small_parts


@pytest.mark.slow
def test_a_grip_with_ten_frames_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bus Watchdog is armed with 0.5 s: less than a tare takes here, or five frames."""
    monkeypatch.chdir(tmp_path)
    text = small(firm_rig())
    text = text.replace("sample_rate_hz = 250.0", "sample_rate_hz = 10.0")
    text = text.replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 10.0")
    text = text.replace("max_grips = 8", "max_grips = 1")
    Path("rig.toml").write_text(text, encoding="utf-8")
    words = ["--rig", "rig.toml", "--objects", small_parts(tmp_path), "--seed", 7, "--json"]
    done = run_here(["identify", *words], monkeypatch, capsys)
    assert done.code in (0, 1), done.err
    assert done.json["grips"] == 1
    assert done.json["touches"] == 3
    assert "heard nothing" not in done.err
