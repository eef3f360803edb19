"""The emulated bench with these sensors on its fingers, from rig file to verdict."""

import json
from pathlib import Path

import pytest

import palpate

RIG = Path(__file__).parents[1] / "examples" / "flexitac-bench.toml"


@pytest.mark.slow
def test_a_part_is_identified_within_its_bounds(tmp_path: Path) -> None:
    with palpate.open_rig(RIG, seed=11) as rig:
        answer = rig.identify(sessions=tmp_path)
    assert answer.verdict == "identified"
    truth = json.loads(answer.to_json())["truth"]
    assert (truth["named"], truth["inside_bounds"]) == (True, True)
