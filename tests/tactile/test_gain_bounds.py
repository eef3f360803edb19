"""A gain bound for every taxel: taxels that were calibrated narrow what is said of contacts on them."""

import math
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest
from contact_outcomes import Outcome, extracted, processed
from contact_sweep import Session, calibrated, cylinder_session, describe, pad_session, pressed_session

from palpate.base.errors import InputError
from palpate.drivers.tactile.columns import Columns, columns_of
from palpate.drivers.tactile.contact import ContactExtractor
from palpate.drivers.tactile.description import Shape
from palpate.drivers.tactile.frames import TactileFrame
from palpate.drivers.tactile.patches import TipCalibration

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
