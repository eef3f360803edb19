"""palpate's time beside that of peers: fails when a ratio falls below half of what is recorded.

Processor times of the same run, the median of interleaved rounds (`benchmarks/bench_peers.py --record`).
"""

import json
import sys

import pytest

from support.commands.repository import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
from bench_peers import RECORD, quick_ratios

from palpate.recognizer import numpy_steps
from palpate.recognizer.steps import STEPS


@pytest.mark.slow
@pytest.mark.skipif(STEPS is numpy_steps, reason="ratios are recorded with the compiled kernel")
def test_no_ratio_to_a_peer_has_halved() -> None:
    recorded = json.loads(RECORD.read_text())
    ratios = quick_ratios()
    assert ratios.keys() == recorded.keys()
    halved = {name: (ratios[name], was) for name, was in recorded.items() if ratios[name] < was / 2}
    assert not halved, "peer's time by palpate's: now, recorded"
