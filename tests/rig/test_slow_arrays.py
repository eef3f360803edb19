"""A run with arrays that send seldom: servos hear from the host often enough all the same."""

from pathlib import Path

import pytest
from command import run_here

from palpate.config import shipped_rig


@pytest.mark.slow
def test_a_part_is_identified_with_ten_frames_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bus Watchdog is armed with 0.5 s: less than a tare takes here, or five frames."""
    monkeypatch.chdir(tmp_path)
    text = shipped_rig().read_text(encoding="utf-8")
    text = text.replace("sample_rate_hz = 250.0", "sample_rate_hz = 10.0")
    text = text.replace("approach_speed_mm_s = 20.0", "approach_speed_mm_s = 10.0")
    Path("rig.toml").write_text(text, encoding="utf-8")
    done = run_here(["identify", "--rig", "rig.toml", "--seed", 7, "--json"], monkeypatch, capsys)
    assert done.code == 0, done.err
    assert (done.json["verdict"], done.json["object"]) == ("identified", "hand")
    assert done.json["truth"]["inside_bounds"] is True
    assert "heard nothing" not in done.err
