"""A test in another project: `pytest` finds the fixture palpate_rig wherever palpate is installed."""

import pytest

import palpate


@pytest.mark.palpate_rig(seed=8)
def test_the_bench_finds_the_part(palpate_rig: palpate.Rig) -> None:
    assert palpate_rig.identify().verdict == "identified"
