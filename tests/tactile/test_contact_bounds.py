"""Bounds of contacts: gains, unobserved load, pressed columns."""

import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.drivers.emulators.taxels import Taxels
from palpate.drivers.tactile.columns import (
    Columns,
    columns_of,
    crosstalk_limit_n,
    load_beyond_edge,
    log_concave_limit_n,
)
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import ContactPatch, TipCalibration
from support.oracles.array_contacts import (
    Outcome,
    Session,
    calibrated,
    cylinder_session,
    describe,
    extracted,
    pad_session,
    pressed_session,
    processed,
)

# ----------------------------------------------------------------------------------------------------
# A gain bound for every taxel: taxels that were calibrated narrow what is said of contacts on them.

MAKERS: dict[str, Callable[..., Session]] = {"cylinder": cylinder_session, "pad": pad_session}
COUNT = 30
SEED = 502
WIDE = 0.4


def every(session: Session, seed: int) -> list[Outcome]:
    return processed(session, seed).outcomes + extracted(session, seed, range(0, COUNT, 6))


def halved(session: Session, seed: int) -> Session:
    """Its columns on one side are known."""
    left = np.asarray(session.description.columns) < 0
    return calibrated(session, seed, np.broadcast_to(left, session.gain.shape), 0.03)


@pytest.mark.parametrize("tip", list(MAKERS))
def test_the_same_bound_everywhere_says_what_one_bound_says(tip: str) -> None:
    one = MAKERS[tip](SEED, COUNT, gain_spread=WIDE)
    same = np.full(one.gain.shape, WIDE)
    other = replace(one, calibration=replace(one.calibration, gain_spread=same))
    which = range(0, COUNT, 2)
    for a, b in zip(extracted(one, SEED, which), extracted(other, SEED, which), strict=True):
        assert (a.patch is None) == (b.patch is None)
        if a.patch is None or b.patch is None:
            continue
        for field in fields(a.patch):
            one_says, other_says = getattr(a.patch, field.name), getattr(b.patch, field.name)
            if field.name == "flags" or one_says is None:
                assert other_says == one_says, field.name
            else:
                expected = pytest.approx(np.asarray(one_says), rel=1e-9, nan_ok=True)
                assert np.asarray(other_says) == expected, field.name


def test_half_calibrated_cylinders_stay_inside_and_get_narrower() -> None:
    known = every(pressed_session(SEED, COUNT), SEED)
    wide = every(cylinder_session(SEED, COUNT, gain_spread=WIDE), SEED)
    assert [(o.seed, o.index, o.truth, o.outside) for o in known + wide if o.outside] == []
    # The same contacts on the same tips; half of them or more lie where gains are known.
    assert np.median([o.normal_half for o in known]) < 0.9 * np.median([o.normal_half for o in wide])
    assert np.median(force_shares(known)) < 0.6 * np.median(force_shares(wide))


def test_half_calibrated_pads_stay_inside_and_get_narrower() -> None:
    known, wide = [], []
    for seed in (502, 503, 505):
        session = pad_session(seed, COUNT, gain_spread=WIDE)
        known += every(halved(session, seed), seed)
        wide += every(session, seed)
    assert [(o.seed, o.index, o.truth, o.outside) for o in known + wide if o.outside] == []
    assert np.median(force_shares(known)) < 0.9 * np.median(force_shares(wide))


def force_shares(outcomes: list[Outcome]) -> list[float]:
    return [o.patch.force_bound_n / o.patch.force_n for o in outcomes if o.patch is not None]


def test_a_columns_variance_is_its_taxels_spreads_by_the_load_they_carry() -> None:
    """Two rows that carry 3/4 and 1/4: variance is the sum of (spread/√3 · load)²."""
    load = np.outer([0.75, 0.25], [0.1, 0.4, 1.0, 0.4, 0.1])
    spreads = np.array([[0.4, 0.03, 0.2, 0.03, 0.4], [0.03, 0.4, 0.2, 0.03, 0.4]])
    without = columns(load, np.zeros(spreads.shape)).variance
    with_them = columns(load, spreads).variance
    expected = ((spreads / math.sqrt(3) * load) ** 2).sum(axis=0)
    assert (with_them - without)[0] == pytest.approx(expected, rel=1e-6)


def test_a_taxel_that_is_not_looked_at_does_not_count() -> None:
    load = np.outer([0.4, 0.3, 0.3], [0.1, 0.4, 1.0, 0.4, 0.1])
    usable = np.ones(load.shape, dtype=bool)
    usable[0, 2] = False
    spreads = np.full(load.shape, 0.1)
    odd = spreads.copy()
    odd[0, 2] = 0.9
    assert columns(load, odd, usable).variance == pytest.approx(columns(load, spreads, usable).variance)


def columns(load: np.ndarray, spreads: np.ndarray, usable: np.ndarray | None = None) -> Columns:
    """Columns of one frame with a count for each mN, with nearly no noise."""
    seen = np.ones(load.shape, dtype=bool) if usable is None else usable
    calibration = TipCalibration(gain=np.ones(load.shape), gain_spread=spreads)
    per_count = np.full(load.shape, 1e-3)
    return columns_of(1000 * load[None], seen[None], per_count, 0.01, None, calibration, 0.2)


SMALL = describe(Shape.CYLINDER, 4, 8, math.radians(20), 2.0, counts_per_n=1000.0, radius_mm=6.0)


@pytest.mark.parametrize("spread", [np.full((4, 7), 0.1), np.full((4, 8), 1.0), -0.1, 1.0, math.nan])
def test_spreads_that_do_not_fit_are_refused(spread: float | np.ndarray) -> None:
    with pytest.raises(InputError, match="gain_spread"):
        ContactExtractor(SMALL, TipCalibration(gain=np.ones((4, 8)), gain_spread=spread))


def test_only_the_force_on_badly_known_taxels_is_badly_known() -> None:
    spreads = np.full((4, 8), 0.02)
    spreads[:, 4:] = WIDE
    pad = replace(SMALL, shape=Shape.FLAT)
    extractor = ContactExtractor(pad, TipCalibration(gain=np.ones((4, 8)), gain_spread=spreads))
    bounds = []
    for column in (1, 6):
        counts = np.zeros((4, 8), np.uint16)
        counts[:, column - 1 : column + 2] = [60, 300, 60]
        patch = extractor.extract(TactileFrame(0, 0.0, 0.0, counts))
        assert patch is not None
        bounds.append(patch.force_bound_n / patch.force_n)
    good, bad = bounds
    assert good < 0.1
    assert bad > 0.25


# ----------------------------------------------------------------------------------------------------
# Limits on load that an array does not show, against log-concave loads drawn at random.

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


# ----------------------------------------------------------------------------------------------------
# Columns that are certainly pressed are pressed, whatever gains, crosstalk and noise make of it.

ROWS, COLS, PITCH = 4, 12, 1.0
DESCRIPTION = describe(Shape.FLAT, ROWS, COLS, PITCH, 4.0, counts_per_n=2000.0)


def touched(
    force_n: np.ndarray, *, usable: np.ndarray | None = None, seed: int = 0, **hidden: float
) -> ContactPatch | None:
    """What an array shows of a force on each column, shared by its rows."""
    shape = (ROWS, COLS)
    dead = [] if usable is None else [(int(row), int(col)) for row, col in np.argwhere(~usable)]
    taxels = Taxels(DESCRIPTION, seed=seed, offset_counts=20.0, dead=dead, **hidden)
    extractor = ContactExtractor(
        DESCRIPTION,
        TipCalibration(gain=np.ones(shape), gain_spread=0.2, noise_counts=2.0, usable=usable),
    )
    extractor.tare([TactileFrame(k, 0.0, 0.0, taxels.counts(np.zeros(shape))) for k in range(64)])
    force = np.repeat(force_n[None] / ROWS, ROWS, axis=0)
    return extractor.extract([TactileFrame(k, 0.0, 0.0, taxels.counts(force)) for k in range(8)])


def at(column: int) -> tuple[float, float]:
    middle = (column - (COLS - 1) / 2) * PITCH
    return middle - PITCH / 2, middle + PITCH / 2


@settings(max_examples=60)
@given(
    st.lists(st.tuples(st.integers(0, COLS - 1), st.floats(0.02, 3.0)), min_size=1, max_size=4),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.2),
    st.integers(0, 2**31),
)
def test_what_is_certainly_pressed_is_pressed(
    loads: list[tuple[int, float]], crosstalk: float, spread: float, seed: int
) -> None:
    force = np.zeros(COLS)
    for column, load in loads:
        force[column] += load
    found = touched(force, seed=seed, crosstalk=crosstalk, gain_spread=spread, noise_counts=2.0)
    if found is None:
        return
    pressed = [at(column) for column in np.flatnonzero(force)]
    for item in found.pressed_mm or ():
        assert any(item == pytest.approx(place) for place in pressed)
    if max(load for _, load in loads) > 0.3:
        assert found.pressed_mm is not None, "of a touch that is felt it is known where"
        assert found.loaded_mm is not None
        assert found.loaded_mm[0] <= found.pressed_mm[0][0]
        assert found.pressed_mm[1][1] <= found.loaded_mm[1]


def test_two_corners_are_two_places_and_their_middle_is_none() -> None:
    force = np.zeros(COLS)
    force[[2, 9]] = 0.5
    found = touched(force, crosstalk=0.06, noise_counts=2.0)
    assert found is not None
    assert found.pressed_mm == (pytest.approx(at(2)), pytest.approx(at(9)))
    assert found.loaded_mm == pytest.approx((at(1)[0], at(10)[1])), "crosstalk is shown beside"


def test_beside_a_taxel_that_cannot_be_read_nothing_is_certain() -> None:
    usable = np.ones((ROWS, COLS), dtype=bool)
    usable[1, 4] = False
    force = np.zeros(COLS)
    force[5] = 0.5
    beside = touched(force, usable=usable, noise_counts=2.0)
    assert beside is not None
    assert beside.pressed_mm is None
    force = np.roll(force, 3)
    elsewhere = touched(force, usable=usable, noise_counts=2.0)
    assert elsewhere is not None
    assert elsewhere.pressed_mm == (pytest.approx(at(8)),) * 2
