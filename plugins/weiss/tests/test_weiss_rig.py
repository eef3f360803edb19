"""The emulated bench with fingers that speak Weiss Robotics' protocols, from rig file to verdict."""

from pathlib import Path

import pytest

from support.benches.rigs import firm_rig, small, small_parts
from support.commands.command import run_here


def rig_file(folder: Path, protocol: str, rate_hz: float, *lines: str) -> Path:
    """The small bench with arrays of another protocol, which needs a lower rate."""
    text = small(firm_rig())
    keys = [f'protocol = "{protocol}"', "counts_per_n = 2000.0", *lines]
    text = text.replace('protocol = "palpate"', "\n".join(keys))
    text = text.replace("sample_rate_hz = 250.0", f"sample_rate_hz = {rate_hz}")
    file = folder / f"{protocol}.toml"
    file.write_text(text, encoding="utf-8")
    return file


@pytest.mark.slow
def test_a_part_is_identified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    file = rig_file(tmp_path, "weiss-wts", 100.0, 'first_texel = "upper-right"', 'first_row = "upright"')
    words = ["identify", "--rig", file, "--objects", small_parts(tmp_path), "--seed", 7, "--json"]
    done = run_here(words, monkeypatch, capsys)
    assert done.code == 0, done.err
    answer = done.json
    assert (answer["verdict"], answer["object"], answer["emulated"]) == ("identified", "tee", True)
    assert answer["truth"]["inside_bounds"] is True
    assert answer["touches"] <= 12


@pytest.mark.parametrize(
    ("protocol", "rate_hz", "firmware"),
    [
        ("weiss-wts", 100.0, "WTS 2.1.4.0"),
        ("weiss-dsa", 30.0, "DSACON32 R290"),
    ],
)
def test_check_looks_at_them(
    protocol: str,
    rate_hz: float,
    firmware: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    file = rig_file(tmp_path, protocol, rate_hz)
    done = run_here(["check", "--rig", file, "--json"], monkeypatch, capsys)
    assert done.code == 0, done.err
    for array in done.json["arrays"]:
        assert (array["firmware"], array["rows"], array["columns"]) == (firmware, 8, 20)
        assert array["rate_hz"] == pytest.approx(rate_hz, rel=0.02)
        assert (array["lost"], array["problems"], array["warnings"]) == (0, [], [])
