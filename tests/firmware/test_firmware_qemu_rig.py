"""palpate's commands against arrays whose firmware runs on an emulated Cortex-M3, three of them on one rig.

The boards sample what the emulated skin feels. The commands know nothing of that: to them the rig is real.
"""

import json
import math
from pathlib import Path

import pytest
from command import run
from qemu_bench import board_bench, slow_bench, write_real_rig
from qemu_board import missing_tools

from palpate.config import load_objects, load_rig
from palpate.rig.bench import choose_placement

MISSING = missing_tools()
pytestmark = [
    pytest.mark.realtime,
    pytest.mark.slow,
    pytest.mark.campaign,
    pytest.mark.skipif(bool(MISSING), reason=f"needs the Debian packages {MISSING}"),
]


def test_check_watch_and_identify(tmp_path: Path) -> None:
    rig, parts = slow_bench(tmp_path)
    truth = choose_placement(load_rig(rig), load_objects(parts), None, 5)
    assert truth is not None
    with board_bench(load_rig(rig), truth, 5, tmp_path) as bench:
        real = write_real_rig(rig, bench.paths, tmp_path / "real.toml")
        checked = run("check", "--rig", real, "--json", cwd=tmp_path)
        watched = run("watch", "--rig", real, "--for", 3, "--json", cwd=tmp_path)
        done = run("identify", "--rig", real, "--objects", parts, "--json", cwd=tmp_path, timeout_s=200)
        accounts = {name: board.account() for name, board in bench.boards.items()}
    assert checked.code == 0, checked.err
    assert [found["firmware"] for found in checked.json["arrays"]] == ["mps2 1"] * 3
    assert watched.code == 0, watched.err
    assert {shown["finger"] for shown in json.loads(watched.out.splitlines()[-1])["fingers"]} == set(accounts)
    assert done.code == 0, done.err
    answer = done.json
    assert (answer["verdict"], answer["object"]) == ("identified", truth.model.name)
    assert answer["emulated"] is True, "the boards say so"
    turns = round((answer["configuration"]["theta"] - truth.theta_rad) / (2 * math.pi))
    pose = {"x": truth.x_mm, "y": truth.y_mm, "theta": truth.theta_rad + 2 * math.pi * turns}
    for key, value in pose.items():
        lo, hi = answer["bounds"][key]
        assert lo <= value <= hi
    for account in accounts.values():
        assert account.frames > 1000
        assert (account.faults, account.overruns) == (0, 0)
