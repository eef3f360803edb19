"""Preparation as arrays: however states are put together, every number is the one made of all at once."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.base.geometry import ObjectModel, State
from palpate.recognizer import Catalogue, Finger
from palpate.recognizer.catalogue import FACET_ERROR_MM, prepare_states
from palpate.recognizer.preparation import (
    FingerPreparation,
    NamedArrays,
    PreparedStates,
    prepare_finger,
    state_digest,
)
from support.oracles.kernel import FINGERS, bits_of, drawn_catalogue


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.campaign)])
def test_parts_joined_chosen_and_taken_from_arrays_are_the_whole(seed: int, exact: bool) -> None:
    objects = drawn_catalogue(seed, exact=exact, least_vertices=900)
    rng = np.random.default_rng(seed)
    fresh = Catalogue(objects)
    order = rng.permutation(len(fresh.states))
    back = np.argsort(order)
    single = [(item, state) for item in objects for state in item.states]
    cuts = np.sort(rng.choice(len(order), 4, replace=False))
    chunks = [part for part in np.split(order, cuts) if len(part)]
    parts = []
    for chunk in chunks:
        models = [_only(*single[number]) for number in chunk]
        parts.append(PreparedStates.of(models, prepare_states(models)))
    states = PreparedStates.join(parts).select(back)
    states = PreparedStates.from_arrays(NamedArrays(states.arrays()), len(order))
    taken = Catalogue(objects, states=states.states(objects))
    for finger in FINGERS:
        made = [
            prepare_finger([taken.states[number] for number in chunk], finger, FACET_ERROR_MM, exact)
            for chunk in chunks
        ]
        whole = FingerPreparation.join(made).select(back)
        taken.take(finger, FingerPreparation.from_arrays(NamedArrays(whole.arrays()), len(order)))
    expected, found = bits_of(fresh), bits_of(taken)
    assert [name for name in expected if expected[name] != found[name]] == []


def test_digests_differ_where_outlines_tolerances_heights_or_bounds_do() -> None:
    digests = [
        state_digest(item, state) for item in drawn_catalogue(3, least_vertices=900) for state in item.states
    ]
    # The drawn ones come twice under other names only where they are the same.
    assert len(set(digests)) >= len(digests) - 4
    item = drawn_catalogue(3)[0]
    (state, *_), base = item.states, state_digest(item, item.states[0])
    section = state.sections[0]
    ring = section.polygons[0].outer.copy()
    ring[0, 0] = np.nextafter(ring[0, 0], np.inf)
    other = replace(section, polygons=(replace(section.polygons[0], outer=ring), *section.polygons[1:]))
    changed = [
        state_digest(replace(item, tolerance_mm=item.tolerance_mm + 1e-12), state),
        state_digest(replace(item, normal_bound_rad=0.1), state),
        state_digest(item, replace(state, normal_bound_rad=0.1)),
        state_digest(item, replace(state, curves_off_mm=1e-3)),
        state_digest(item, replace(state, curves_turn_rad=1e-3)),
        state_digest(item, replace(state, sections=(other, *state.sections[1:]))),
        state_digest(item, replace(state, sections=(replace(section, z_mm=(0.0, 7.0)), *state.sections[1:]))),
        state_digest(item, replace(state, sections=(*state.sections, section))),
    ]
    assert base not in changed
    assert len(set(changed)) == len(changed)
    assert state_digest(replace(item, name="another", holds_n=1.0), replace(state, name="s")) == base


@pytest.mark.parametrize("how", ["missing", "type", "shape", "descending", "beyond"])
@pytest.mark.parametrize(
    "name", ["outlines.start", "outlines.first", "pieces.turn_rad", "sides.first", "clearance_mm"]
)
def test_arrays_that_are_none_are_refused(name: str, how: str) -> None:
    finger = Finger(4.0, 5.0)
    objects = drawn_catalogue(4, exact=True)[:3]
    states = Catalogue(objects).states
    arrays = prepare_finger(states, finger, FACET_ERROR_MM, True).arrays()
    value = arrays.pop(name)
    if how == "type":
        arrays[name] = value.astype(np.float32)
    elif how == "shape":
        arrays[name] = value[:-1]
    elif how == "descending":
        arrays[name] = value[::-1].copy() if value.dtype == np.int64 else value.reshape(-1)[:0]
    elif how == "beyond":
        arrays[name] = value + 1 if value.dtype == np.int64 else np.concatenate([value, value])
    with pytest.raises(ValueError, match=name.rpartition(".")[2]):
        FingerPreparation.from_arrays(NamedArrays(arrays), len(states))


def _only(item: ObjectModel, state: State) -> ObjectModel:
    return replace(item, states=(state,))
