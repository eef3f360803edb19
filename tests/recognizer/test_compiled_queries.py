"""A whole query has the same hypotheses, witnesses and bounds with and without the compiled kernel."""

import math

import numpy as np
import pytest
from campaign_objects import objects_of
from kernel_switch import needs_kernel, without_kernel
from sampling import sample
from shapely_bench import grip, place, until_touched

from palpate.base.geometry import Floats
from palpate.recognizer import Catalogue, Contact, Recognition, recognise
from palpate.recognizer.budget import Budget
from palpate.recognizer.hypotheses import Hypotheses

pytestmark = needs_kernel


def answered(source: str, grips: list[list[Contact]], spurious: int, budget: Budget) -> Recognition:
    """With a catalogue of its own: the kernel's has arrays that numpy's has not."""
    found = recognise(Catalogue(objects_of(source)), grips[0], spurious, budget)
    for contacts in grips[1:]:
        assert found.hypotheses is not None
        found = found.extend(contacts)
    assert found.hypotheses.lo is not None
    return found


def measured(found: Hypotheses) -> tuple[Floats, ...]:
    """Configurations and bounds (h, 3), mm and rad, and weights (h,)."""
    configuration = np.column_stack([found.position_mm, found.regions.theta])
    return configuration, found.lo, found.hi, found.weight


@pytest.mark.parametrize("source", ["memo", "own", "loose"])
@pytest.mark.parametrize("seed", sample(range(60), range(6)))
def test_answers_are_the_same(source: str, seed: int) -> None:
    rng = np.random.default_rng([87, seed, len(source)])
    models = objects_of(source)
    placed = place(models[int(rng.integers(len(models)))], rng)
    how = {
        "bound": float(rng.choice([0.05, 0.3, 1.0])),
        "radius": float(rng.choice([0.0, 5.0])),
        "half_range": math.radians(float(rng.choice([2.0, 15.0]))),
    }
    grips = [until_touched(grip, placed, rng, fingers=3, **how)]
    if rng.random() < 0.5:
        grips.append(grip(placed, rng, fingers=2, **how))
    spurious = int(rng.random() < 0.3 and sum(contact.touched for contact in grips[0]) > 2)
    budget = Budget(int(rng.choice([1_000_000, 100_000, 10_000])))
    one = answered(source, grips, spurious, budget)
    with without_kernel():
        two = answered(source, grips, spurious, budget)
    assert len(one.cells) == len(two.cells)
    assert np.array_equal(one.hypotheses.state, two.hypotheses.state)
    assert np.array_equal(one.hypotheses.verified, two.hypotheses.verified)
    for found, expected in zip(measured(one.hypotheses), measured(two.hypotheses), strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
