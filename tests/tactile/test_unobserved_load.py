"""Limits on load that an array does not show, against log-concave loads drawn at random."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.drivers.tactile.load_bounds import crosstalk_limit_n, load_beyond_edge, log_concave_limit_n

seeds = st.integers(0, 2**32 - 1)


def log_concave(rng: np.random.Generator, count: int) -> np.ndarray:
    """A line of loads whose logarithm is concave; some of them end abruptly."""
    slopes = np.sort(rng.normal(0, rng.uniform(0.1, 2.0), count))[::-1]
    line = np.exp(np.cumsum(slopes) - np.cumsum(slopes).max())
    if rng.random() < 0.5:
        begin, end = np.sort(rng.integers(0, count + 1, 2))
        line = np.where((np.arange(count) >= begin) & (np.arange(count) < end), line, 0.0)
    return line


def sheet(rng: np.random.Generator, rows: int, cols: int) -> np.ndarray:
    """A log-concave load on a grid: an ellipse of pressure with a power, turned, summed over fine cells."""
    fine = 6
    x = (np.arange(cols * fine) + 0.5) / fine
    z = (np.arange(rows * fine) + 0.5)[:, None] / fine
    at, turn = (rng.uniform(0, cols), rng.uniform(0, rows)), rng.uniform(0, np.pi)
    a, b = rng.uniform(0.8, 4.0, 2)
    u = (x - at[0]) * np.cos(turn) + (z - at[1]) * np.sin(turn)
    v = (z - at[1]) * np.cos(turn) - (x - at[0]) * np.sin(turn)
    pressure = np.maximum(0.0, 1 - (u / a) ** 2 - (v / b) ** 2) ** rng.choice([0.0001, 0.5, 1.0])
    return np.asarray(pressure.reshape(rows, fine, cols, fine).sum(axis=(1, 3)))


@given(seeds)
def test_a_hidden_cell_never_bears_more_than_the_shape_allows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load = sheet(rng, 6, 7)
    hidden = rng.random(load.shape) < 0.15
    low, high = np.where(hidden, 0.0, load)[None], np.where(hidden, np.inf, load)[None]
    limit = log_concave_limit_n(low, high)[0]
    assert (load <= limit * (1 + 1e-9)).all()


@given(seeds)
def test_wider_limits_allow_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load = sheet(rng, 5, 6)[None]
    doubt = rng.uniform(0, 0.2, load.shape)
    sharp = log_concave_limit_n(load, load)
    loose = log_concave_limit_n(load * (1 - doubt), load * (1 + doubt))
    assert (sharp <= loose * (1 + 1e-9)).all()


def test_the_shape_says_what_two_neighbours_say() -> None:
    line = np.array([[[0.0, 1.0, 4.0, 0.0, 4.0, 1.0]]])
    high = line.copy()
    low = line.copy()
    low[..., 3], high[..., 3] = 0.0, np.inf
    assert log_concave_limit_n(low, high)[0, 0, 3] == pytest.approx(4.0**2 / 1.0)
    # The neighbour or the one after it cannot be seen: nothing says.
    low[..., [1, 5]], high[..., [1, 5]] = 0.0, np.inf
    assert np.isinf(log_concave_limit_n(low, high)[0, 0, 3])


@given(seeds)
def test_crosstalk_never_hides_a_load(seed: int) -> None:
    rng = np.random.default_rng(seed)
    load, share = sheet(rng, 5, 6), rng.uniform(0.04, 0.12)
    hidden = rng.random(load.shape) < 0.2
    padded = np.pad(load, 1)
    neighbours = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
    shown = load * (1 - 4 * share) + share * neighbours
    limit = crosstalk_limit_n(np.where(hidden, np.inf, shown)[None], share * rng.uniform(0.5, 1.0))[0]
    assert (load <= limit * (1 + 1e-9)).all()


def test_without_crosstalk_nothing_shows() -> None:
    assert np.isinf(crosstalk_limit_n(np.zeros((1, 2, 3)), 0.0)).all()


@given(seeds, st.floats(0.0, 0.2))
def test_what_lies_beyond_is_no_more_than_the_limit(seed: int, doubt: float) -> None:
    rng = np.random.default_rng(seed)
    line = log_concave(rng, 30)
    for edge in range(1, 29):
        rest = line[edge + 1 :]
        if line[: edge + 1].sum() == 0:  # not seen at all
            continue
        outer, inner = line[edge] * (1 + doubt), line[edge - 1] * (1 - doubt)
        load, reach = load_beyond_edge(np.array([outer]), np.array([inner]))
        assert rest.sum() <= load[0] * (1 + 1e-9) + 1e-12
        if rest.sum() > 0:
            centred = float(rest @ np.arange(1, len(rest) + 1) / rest.sum())
            assert centred <= reach[0] * (1 + 1e-9)


def test_a_load_that_does_not_fall_may_go_on_for_ever() -> None:
    load, reach = load_beyond_edge(np.array([1.0, 0.95, 0.5, 0.0]), np.array([0.8, 1.0, 1.0, 1.0]))
    assert np.isinf(load[:2]).all()
    assert np.isinf(reach[:2]).all()
    assert load[2:] == pytest.approx([0.5, 0.0])  # 0.25 + 0.125 + …
    assert reach[2:] == pytest.approx([2.0, 0.0])
