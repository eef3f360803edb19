"""The true centroid of a load is within the bound, whatever is unknown of cells, gains and unseen places."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.drivers.tactile.load_bounds import CellLoads, UnseenLoads, centroids

CELLS = 9
PLACE = 2.0 * np.arange(CELLS) - 5.0
seeds = st.integers(0, 2**32 - 1)
NOTHING = UnseenLoads(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)))


def load_of(
    force: np.ndarray, *, spread: float = 0.0, drift: float = 0.0, around: np.ndarray | None = None
) -> CellLoads:
    """One frame."""
    every = np.ones((1, CELLS), dtype=bool) if around is None else around[None]
    patch = every & (force[None] > 0)
    zero = np.zeros((1, CELLS))
    return CellLoads(force[None], zero, zero + drift, patch, every, np.zeros(1), zero + spread)


def points(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Point loads anywhere in a stretch of cells: forces on cells, their places, their centroid."""
    begin, end = np.sort(rng.choice(CELLS + 1, 2, replace=False))
    where = rng.uniform(PLACE[0] + 2 * begin - 1, PLACE[0] + 2 * end - 1, rng.integers(1, 20))
    weight = rng.exponential(size=len(where))
    cell = np.clip(((where - PLACE[0] + 1) // 2).astype(int), 0, CELLS - 1)
    return np.bincount(cell, weight, CELLS), where, float(where @ weight / weight.sum())


def missed(load: CellLoads, truth: float, unseen: UnseenLoads = NOTHING) -> float:
    centre, half = centroids(load, PLACE, 1.0, np.zeros(1), unseen)
    return float(abs(truth - centre[0]) - half[0])


@given(seeds)
def test_load_may_be_anywhere_within_its_cell(seed: int) -> None:
    force, _, truth = points(np.random.default_rng(seed))
    assert missed(load_of(force), truth) <= 1e-9


@given(seeds, st.floats(0.0, 0.4))
def test_gains_may_be_anything_within_their_spread(seed: int, spread: float) -> None:
    """Four standard deviations of independent gains, at most their limit."""
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    gain = 1 + spread * rng.uniform(-1, 1, CELLS)
    # The spread is of what is read: a share of the force said, not of the true one.
    assert missed(load_of(force * gain, spread=spread / (1 - spread)), truth) <= 1e-9


@given(seeds, st.floats(0.0, 0.05))
def test_zeros_may_be_off_by_their_drift(seed: int, drift: float) -> None:
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    force = force / force.sum()
    off = drift * rng.choice((-1, 1), CELLS)
    read = force + off
    if read.sum() < 0.2:
        return
    load = load_of(np.where(force > 0, read, off), drift=drift)
    assert missed(load, truth) <= 1e-9


@given(seeds)
def test_a_cell_that_cannot_be_seen_may_bear_up_to_its_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force, _, truth = points(rng)
    blind = int(rng.integers(0, CELLS))
    seen = np.where(np.arange(CELLS) == blind, 0.0, force)
    if seen.sum() == 0:
        return
    limit = force[blind] * rng.uniform(1.0, 3.0)
    unseen = UnseenLoads(
        np.array([[limit]]), np.array([[PLACE[blind] - 1.0]]), np.array([[PLACE[blind] + 1.0]])
    )
    assert missed(load_of(seen), truth, unseen) <= 1e-9


@given(seeds)
def test_several_unseen_places_add_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    force, _, _ = points(rng)
    extra, at = rng.exponential(0.3, 3), rng.uniform(-20, 20, 3)
    truth = float((force @ PLACE + extra @ at) / (force.sum() + extra.sum()))
    unseen = UnseenLoads(extra[None] * 1.01, at[None] - 0.5, at[None] + 0.5)
    assert missed(load_of(force), truth, unseen) <= 1e-9


def test_where_nothing_limits_unseen_load_the_centroid_may_be_there() -> None:
    force = np.zeros(CELLS)
    force[3:5] = 1.0
    unseen = UnseenLoads(np.array([[np.inf]]), np.array([[3.0]]), np.array([[5.0]]))
    centre, half = centroids(load_of(force), PLACE, 1.0, np.zeros(1), unseen)
    assert centre[0] == pytest.approx(2.0)
    assert centre[0] + half[0] == pytest.approx(5.0)
    anywhere = UnseenLoads(np.array([[np.inf]]), np.array([[-np.inf]]), np.array([[0.0]]))
    assert np.isinf(centroids(load_of(force), PLACE, 1.0, np.zeros(1), anywhere)[1][0])


def test_frames_do_not_mind_one_another() -> None:
    rng = np.random.default_rng(3)
    forces = np.stack([points(rng)[0] for _ in range(20)])
    every = np.ones_like(forces, dtype=bool)
    zero = np.zeros_like(forces)
    none = np.zeros((20, 1))
    many = CellLoads(forces, zero + 0.01, zero, forces > 0, every, np.full(20, 0.01), zero + 0.1)
    centre, half = centroids(many, PLACE, 1.0, np.zeros(20), UnseenLoads(none, none, none))
    for i, force in enumerate(forces):
        one = CellLoads(
            force[None],
            zero[:1] + 0.01,
            zero[:1],
            force[None] > 0,
            every[:1],
            np.full(1, 0.01),
            zero[:1] + 0.1,
        )
        single = centroids(one, PLACE, 1.0, np.zeros(1), NOTHING)
        assert (single[0][0], single[1][0]) == pytest.approx((centre[i], half[i]))


def test_noise_and_a_smaller_cell_change_the_bound_as_they_should() -> None:
    force = np.zeros(CELLS)
    force[2:6] = [1.0, 2.0, 2.0, 1.0]
    quiet = load_of(force)
    _, coarse = centroids(quiet, PLACE, 1.0, np.zeros(1), NOTHING)
    _, fine = centroids(quiet, PLACE, 0.25, np.zeros(1), NOTHING)
    assert coarse[0] == pytest.approx(1.0)
    assert fine[0] == pytest.approx(0.25)
