"""Bounds hold over emulated contacts on tips of every kind; `benchmarks/bench_contacts.py` has many more."""

from collections.abc import Callable

import numpy as np
import pytest
from contact_outcomes import Outcome, extracted, processed
from contact_sweep import Session, cylinder_session, pad_session

PER_SESSION = 40
SEEDS = range(400, 405)
MAKERS: dict[str, Callable[[int, int], Session]] = {"cylinder": cylinder_session, "pad": pad_session}


@pytest.mark.parametrize("tip", list(MAKERS))
def test_truths_are_within_their_bounds(tip: str) -> None:
    """Of 200 contacts one may be outside: bounds on noise are four standard deviations."""
    outcomes: list[Outcome] = []
    false = 0
    for seed in SEEDS:
        found = processed(MAKERS[tip](seed, PER_SESSION), seed)
        outcomes += found.outcomes
        false += found.false
    assert false == 0
    missed = [(o.seed, o.index, o.truth.force_n) for o in outcomes if o.patch is None]
    assert len(missed) <= 4, missed  # soft ones, spread out beneath the noise
    outside = [(o.seed, o.index, o.truth, o.outside) for o in outcomes if o.outside]
    assert len(outside) <= 1, outside
    halves = [o.normal_half if tip == "cylinder" else o.centroid_half for o in outcomes]
    assert np.median(halves) < (2.5 if tip == "cylinder" else 12.0)


@pytest.mark.parametrize("tip", list(MAKERS))
def test_single_frames_are_within_their_bounds(tip: str) -> None:
    outcomes = [
        one
        for seed in SEEDS[:4]
        for one in extracted(MAKERS[tip](seed, PER_SESSION), seed, range(0, PER_SESSION, 2))
    ]
    assert [(o.seed, o.index, o.truth, o.outside) for o in outcomes if o.outside] == []


def test_force_on_a_patchs_thin_ends_is_not_lost() -> None:
    """What crosstalk moves beside a patch is its load, too: in the mean nothing is missing but noise."""
    outcomes = [
        one
        for seed in SEEDS[:3]
        for one in extracted(
            cylinder_session(seed, PER_SESSION, gain_spread=0.01), seed, range(0, PER_SESSION, 2)
        )
    ]
    off = [o.patch.force_n / o.truth.force_n - 1 for o in outcomes if o.patch is not None]
    assert len(off) > 40
    assert abs(float(np.median(off))) < 0.004
