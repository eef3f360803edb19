"""States are listed before hypotheses are worked out; none is left out that turns out to have one."""

import math

import numpy as np
import pytest
from sampling import sample
from shapely_bench import SHIPPED_OBJECTS, grip, outlines, place

from palpate.recognizer import Catalogue, recognise


@pytest.mark.parametrize("seed", sample(range(60), range(8)))
def test_every_hypothesis_is_of_a_possible_state(seed: int) -> None:
    rng = np.random.default_rng([71, seed])
    models = outlines(SHIPPED_OBJECTS)
    placed = place(models[seed % len(models)], rng)
    fingers = 2 + seed % 3
    contacts = grip(placed, rng, fingers=fingers, bound=0.3, half_range=math.radians(15))
    assert any(contact.touched for contact in contacts)
    found = recognise(Catalogue(models), contacts)
    possible = {item.state.object_name: item.interpretations for item in found.possible_states}
    assert "hypotheses" not in vars(found)
    assert placed.model.name in possible
    assert {item.state.object_name for item in found.hypotheses} <= set(possible)
    assert list(possible.values()) == sorted(possible.values(), reverse=True)
    assert sum(possible.values()) == len(found.constraints.nodes)
