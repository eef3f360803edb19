"""Connected regions against every pair of boxes tried, one after the other."""

import math

import numpy as np
import pytest

from palpate.recognizer.connected_components import Boxes, component_labels

FEW = 160  # up to here boxes are compared each with each


def boxes_of(
    rng: np.random.Generator, count: int, *, states: int, width: float, size: float, spread: float
) -> Boxes:
    """Boxes anywhere: θ over several turns, states of different symmetry."""
    state = rng.integers(0, states, count)
    turn = 2 * np.pi / np.array([1, 2, 4, 12, 3])[state % 5]
    lo = rng.uniform(0, spread, (count, 2))
    return Boxes(
        state=state,
        middle=rng.uniform(-3 * math.pi, 3 * math.pi, count),
        half_width=width * rng.uniform(0.1, 1.0, count),
        turn=turn,
        lo=lo,
        hi=lo + size * rng.uniform(0.1, 1.0, (count, 2)),
    )


def meet(boxes: Boxes, i: int, j: int) -> bool:
    """Whether two boxes have a configuration in common, some whole number of turns apart."""
    if boxes.state[i] != boxes.state[j]:
        return False
    if np.any(boxes.lo[i] > boxes.hi[j]) or np.any(boxes.lo[j] > boxes.hi[i]):
        return False
    nearest = abs(math.remainder(boxes.middle[i] - boxes.middle[j], boxes.turn[i]))
    return bool(nearest <= boxes.half_width[i] + boxes.half_width[j])


def by_pairs(boxes: Boxes) -> list[frozenset[int]]:
    """Components by joining every two boxes that meet."""
    parent = list(range(len(boxes.state)))

    def root(i: int) -> int:
        while parent[i] != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    count = len(parent)
    for i in range(count):
        for j in range(i):
            if root(i) != root(j) and meet(boxes, i, j):
                parent[root(i)] = root(j)
    return as_sets(np.array([root(i) for i in range(count)], dtype=np.int64))


def as_sets(label: np.ndarray) -> list[frozenset[int]]:
    groups = [frozenset(np.flatnonzero(label == value).tolist()) for value in np.unique(label)]
    return sorted(groups, key=min)


def check(boxes: Boxes) -> int:
    label = component_labels(boxes)
    assert as_sets(label) == by_pairs(boxes)
    assert sorted(set(label.tolist())) == list(range(int(label.max(initial=-1)) + 1))
    return int(label.max(initial=-1)) + 1


@pytest.mark.parametrize("count", [0, 1, 2, 40, FEW - 1, FEW, FEW + 1, 260])
@pytest.mark.parametrize("states", [1, 3])
def test_boxes_anywhere(count: int, states: int) -> None:
    rng = np.random.default_rng(count + 1000 * states)
    for width, size in ((0.02, 5.0), (0.1, 20.0), (0.5, 15.0), (4.0, 4.0)):
        check(boxes_of(rng, count, states=states, width=width, size=size, spread=100.0))


@pytest.mark.parametrize("seed", range(6))
def test_many_boxes_over_each_other(seed: int) -> None:
    """Dense in θ, so that what belongs together is often further apart in the order than first looked at."""
    rng = np.random.default_rng(seed)
    groups = []
    for size, spread in ((2.0, 100.0), (5.0, 100.0), (20.0, 400.0)):
        groups.append(check(boxes_of(rng, 300, states=2, width=1.5, size=size, spread=spread)))
    assert max(groups) > 3


@pytest.mark.parametrize("count", [30, 300])
def test_a_chain_across_the_cut(count: int) -> None:
    """Boxes that only meet end to end, all the way round a turn: one component; without one of them still."""
    for order in (1, 2, 4):
        turn = 2 * math.pi / order
        at = turn * np.arange(count) / count - math.pi + 0.1
        half = np.full(count, turn / count / 2 * (1 + 1e-6))
        place = np.zeros((count, 2))
        ring = Boxes(np.zeros(count, np.int64), at, half, np.full(count, turn), place, place + 1)
        assert check(ring) == 1
        rows = np.delete(np.arange(count), [3, count // 2])
        parts = Boxes(*(getattr(ring, name)[rows] for name in ring.__dataclass_fields__))
        assert check(parts) == 2


@pytest.mark.parametrize("count", [60, 240])
def test_boxes_that_only_touch_are_connected(count: int) -> None:
    """Side by side in x, sharing their sides exactly."""
    x = np.arange(count, dtype=float)
    lo = np.column_stack([x, np.zeros(count)])
    middle, half = np.linspace(0.0, 0.1, count), np.full(count, 0.2)
    state, turn = np.zeros(count, np.int64), np.full(count, 2 * math.pi)
    assert check(Boxes(state, middle, half, turn, lo, lo + 1)) == 1
    assert check(Boxes(state, middle, half, turn, lo, lo + np.array([0.999, 1.0]))) == count


def two_groups(first: int, second: int, bridge: int) -> Boxes:
    """Two groups of boxes, one after the other in θ; box `bridge` of the first reaches over to the second."""
    count = first + second
    lo = np.where(np.arange(count)[:, None] < first, 0.0, 50.0) * np.ones(2)
    hi = lo + 1
    hi[bridge] = 51.0
    return Boxes(
        state=np.zeros(count, np.int64),
        middle=np.linspace(0.0, 0.1, count),
        half_width=np.full(count, 0.3),
        turn=np.full(count, 2 * math.pi),
        lo=lo,
        hi=hi,
    )


@pytest.mark.parametrize(("first", "second"), [(120, 100), (100, 120), (101, 100), (200, 1)])
def test_groups_that_one_distant_box_joins(first: int, second: int) -> None:
    assert check(two_groups(first, second, 10)) == 1


def test_groups_of_one_size_that_one_distant_box_joins() -> None:
    assert check(two_groups(100, 100, 10)) == 1


def test_bins_join_all_that_meet() -> None:
    """The way for very many boxes may join more than meets, never less."""
    rng = np.random.default_rng(9)
    for width in (0.2, 1.5):
        boxes = boxes_of(rng, 400, states=3, width=width, size=6.0, spread=200.0)
        label = component_labels(boxes, most_pairs=0)
        for group in by_pairs(boxes):
            assert len({int(label[k]) for k in group}) == 1
        for value in np.unique(label):
            assert len(np.unique(boxes.state[label == value])) == 1
