"""Probabilities of states count in the weights of hypotheses, not in what is possible."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.recognizer import Catalogue, recognise
from support.oracles.shapely_touches import SHIPPED_OBJECTS, grip, outlines, place


def test_of_states_that_look_alike_the_more_probable_is_first() -> None:
    model = outlines(SHIPPED_OBJECTS)[0]
    (flat,) = model.states
    rng = np.random.default_rng(3)
    contacts = grip(place(model, rng), rng)
    for shares in ((0.2, 0.8), (0.8, 0.2)):
        states = tuple(replace(flat, name=f"state-{k}", probability=share) for k, share in enumerate(shares))
        found = recognise(Catalogue([replace(model, states=states)]), contacts).hypotheses
        by_state = [sum(item.weight for item in found if item.state_index == k) for k in range(2)]
        assert by_state == pytest.approx(list(shares))
        assert found[0].state_index == int(np.argmax(shares))
        assert len(found) == 2 * len({item.search_bounds for item in found})


def test_states_are_equally_frequent_unless_all_probabilities_are_known() -> None:
    model = outlines(SHIPPED_OBJECTS)[0]
    (flat,) = model.states
    known = tuple(replace(flat, name=str(k), probability=share) for k, share in enumerate((0.9, None)))
    other = tuple(replace(flat, name=str(k), probability=share) for k, share in enumerate((3.0, 1.0, 0.0)))
    catalogue = Catalogue([replace(model, states=known), replace(model, name="other", states=other)])
    assert catalogue.prior[:4] == pytest.approx([0.5, 0.5, 0.75, 0.25])
    assert 0 < catalogue.prior[4] < 0.01
