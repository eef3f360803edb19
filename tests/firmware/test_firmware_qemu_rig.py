"""palpate's commands against arrays whose firmware runs on an emulated Cortex-M3, three of them on one rig."""

import math
from pathlib import Path

import pytest
from command import run
from qemu_bench import board_bench
from qemu_board import missing_tools
from quick_rig import quick_bench

from palpate.cli.emulate import _with_ports
from palpate.config import load_objects, load_rig
from palpate.rig.bench import place

MISSING = missing_tools()
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}"),
]


def test_check_watch_and_identify(tmp_path: Path) -> None:
    rig, parts = quick_bench(tmp_path)
    text = rig.read_text(encoding="utf-8").replace("approach_speed_mm_s = 30.0", "approach_speed_mm_s = 10.0")
    rig.write_text(text)
    truth = place(load_rig(rig), load_objects(parts), None, 5)
    assert truth is not None
    with board_bench(load_rig(rig), truth, 5, tmp_path) as bench:
        real = tmp_path / "real.toml"
        real.write_text(_with_ports(text, dict(bench.paths)))
        checked = run("check", "--rig", real, "--json", cwd=tmp_path)
        watched = run("watch", "--rig", real, "--for", 3, "--json", cwd=tmp_path)
        done = run("identify", "--rig", real, "--objects", parts, "--json", cwd=tmp_path, timeout_s=200)
        accounts = {name: board.account() for name, board in bench.boards.items()}
    print(checked.out[-3000:], checked.err, watched.out[-600:], watched.err, done.out, done.err, accounts)
    assert checked.code == 0, checked.err
    assert watched.code == 0, watched.err
    assert done.code == 0, done.err
    answer = done.json
    assert (answer["verdict"], answer["object"]) == ("identified", truth.model.name)
    turns = round((answer["configuration"]["theta"] - truth.theta_rad) / (2 * math.pi))
    pose = {"x": truth.x_mm, "y": truth.y_mm, "theta": truth.theta_rad + 2 * math.pi * turns}
    for key, value in pose.items():
        lo, hi = answer["bounds"][key]
        assert lo <= value <= hi
