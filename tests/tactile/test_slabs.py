"""Many profiles at once give what the templates give one by one."""

import math
from dataclasses import fields

import numpy as np
import pytest

from palpate.drivers.tactile.template_search import ProfileBatch, TemplateSlabs
from palpate.drivers.tactile.templates import ColumnProfile, TemplateSet, template_set

PITCH = math.radians(13.5)
COLS = 14
SLACK, LIMIT = 16.0, 20.0
GRAIN_COLUMNS = 0.2  # what the templates taken as one may differ by


@pytest.fixture(scope="module")
def templates() -> TemplateSet:
    return template_set(
        pitch_rad=PITCH,
        radius_mm=5.0,
        stiffness_n_per_mm=3.0,
        stiffness_bound=0.3,
        crosstalk=0.075,
        least_depth=0.012,
    )


@pytest.fixture(scope="module")
def slabs(templates: TemplateSet) -> TemplateSlabs:
    return TemplateSlabs(templates)


def drawn(templates: TemplateSet, count: int, seed: int, noise: float = 0.01) -> ProfileBatch:
    """Profiles of templates with one edge, anywhere on the array, with noise."""
    rng = np.random.default_rng(seed)
    kinds = np.flatnonzero(templates.one_edge)
    least, most = templates.least_n, templates.most_n
    force = np.zeros((count, COLS))
    reach = templates.cells.shape[1] // 2
    for i in range(count):
        k = int(rng.choice(kinds))
        total = rng.uniform(max(least[k], 0.3), max(min(most[k], 5.0), 0.31))
        middle = int(rng.integers(4, COLS - 4))
        wide = np.zeros(COLS + 2 * reach)
        wide[middle : middle + 2 * reach + 1] = templates.cells[k]
        force[i] = total * wide[reach:-reach]
    force += noise * rng.standard_normal(force.shape)
    variance = np.full_like(force, noise**2) + (0.02 * force) ** 2
    return profiles(force, variance)


def profiles(force: np.ndarray, variance: np.ndarray) -> ProfileBatch:
    place = np.arange(COLS)
    near = (
        np.abs(place - force.argmax(axis=1)[:, None]) <= 4
    )  # as the extractor, which leaves other columns out
    beside = np.where(near, force, 0.0)
    total = beside.sum(axis=1)
    centroid = beside @ place / total
    variance_beside = np.where(near, variance, 0.0)
    error = (
        np.where(np.isfinite(variance_beside), variance_beside, 0.0) * (place - centroid[:, None]) ** 2
    ).sum(axis=1)
    return ProfileBatch(force, variance, total, np.zeros(len(force)), centroid, 6 * np.sqrt(error) / total)


def run(force: np.ndarray) -> tuple[int, int]:
    """First and last column of the patch."""
    first = last = int(force.argmax())
    limit = max(0.04 * force.max(), 0.04)
    while first > 0 and force[first - 1] > limit:
        first -= 1
    while last < COLS - 1 and force[last + 1] > limit:
        last += 1
    return first, last


def some(p: ProfileBatch, which: np.ndarray) -> ProfileBatch:
    return ProfileBatch(**{f.name: getattr(p, f.name)[which] for f in fields(ProfileBatch)})


def narrowings(templates: TemplateSet, slabs: TemplateSlabs, p: ProfileBatch) -> list[float]:
    """By how many columns the hulls of many profiles are narrower than those of one at a time."""
    found, narrower = slabs.match(p, SLACK), []
    for i in range(len(p.total_n)):
        one = templates.match(ColumnProfile(p.force_n[i], p.variance[i], *run(p.force_n[i]), 0.0), SLACK)
        if one is not None and max(one.misfit, found.misfit[i]) <= LIMIT:
            low, high = one.low_rad / PITCH, one.high_rad / PITCH
            narrower.append(float(max(found.low[i] - low, high - found.high[i])))
    return narrower


def test_the_hull_contains_what_single_templates_give(templates: TemplateSet, slabs: TemplateSlabs) -> None:
    narrower = narrowings(templates, slabs, drawn(templates, 120, 1))
    assert len(narrower) > 100
    assert max(narrower) <= GRAIN_COLUMNS
    assert np.median(narrower) <= 0.0


def test_the_hull_of_a_weak_contact_contains_what_single_templates_give(
    templates: TemplateSet, slabs: TemplateSlabs
) -> None:
    assert max(narrowings(templates, slabs, drawn(templates, 120, 7, noise=0.03))) <= GRAIN_COLUMNS


def test_what_fits_a_template_is_found(templates: TemplateSet, slabs: TemplateSlabs) -> None:
    found = slabs.match(drawn(templates, 300, 2), SLACK)
    assert (found.misfit <= LIMIT).mean() > 0.95


def test_order_and_company_do_not_matter(templates: TemplateSet, slabs: TemplateSlabs) -> None:
    p = drawn(templates, 200, 3)
    order = np.random.default_rng(3).permutation(200)
    whole, mixed = slabs.match(p, SLACK), slabs.match(some(p, order), SLACK)
    half = slabs.match(some(p, np.arange(100)), SLACK)
    for name in ("low", "high"):
        together = getattr(whole, name)
        assert getattr(mixed, name) == pytest.approx(together[order], abs=GRAIN_COLUMNS)
        assert np.mean(np.abs(getattr(mixed, name) - together[order]) > 1e-4) < 0.01
        assert np.mean(np.abs(getattr(half, name) - together[:100]) > 1e-4) < 0.02
    assert mixed.misfit == pytest.approx(whole.misfit[order], rel=1e-3, abs=1e-2)
    assert (mixed.one_edge == whole.one_edge[order]).mean() > 0.99


def test_moved_by_a_column_the_answer_moves_by_a_column(templates: TemplateSet, slabs: TemplateSlabs) -> None:
    p = drawn(templates, 60, 4, noise=1e-4)
    moved = profiles(np.roll(p.force_n, 1, axis=1), np.roll(p.variance, 1, axis=1))
    one, two = slabs.match(p, SLACK), slabs.match(moved, SLACK)
    inside = np.isfinite(one.misfit) & (p.force_n[:, -1] < 1e-3)
    assert inside.sum() > 40
    assert two.low[inside] == pytest.approx(one.low[inside] + 1, abs=1e-3)
    assert two.high[inside] == pytest.approx(one.high[inside] + 1, abs=1e-3)


def test_a_force_that_no_template_has_gives_none(templates: TemplateSet, slabs: TemplateSlabs) -> None:
    p = drawn(templates, 4, 5)
    for factor in (1e-4, 1e4):
        found = slabs.match(profiles(p.force_n * factor, p.variance * factor**2), SLACK)
        assert np.isinf(found.misfit).all()
        assert not found.one_edge.any()
        assert np.isinf(found.low).all()


def test_no_profiles_give_no_matches(slabs: TemplateSlabs) -> None:
    none = np.zeros((0, COLS))
    empty = np.zeros(0)
    found = slabs.match(ProfileBatch(none, none, empty, empty, empty, empty), SLACK)
    assert len(found.misfit) == 0


def test_columns_that_are_not_looked_at_do_not_spoil_the_rest(
    templates: TemplateSet, slabs: TemplateSlabs
) -> None:
    p = drawn(templates, 200, 6)
    variance = p.variance.copy()
    strongest = p.force_n.argmax(axis=1)
    variance[np.arange(200), strongest] = np.inf
    found = slabs.match(
        ProfileBatch(p.force_n, variance, p.total_n, p.missing_n, p.centroid, p.window), SLACK
    )
    whole = slabs.match(p, SLACK)
    assert np.isfinite(found.misfit[np.isfinite(whole.misfit)]).all()
    wider = (found.high - found.low) - (whole.high - whole.low)
    assert np.median(wider[np.isfinite(wider)]) >= 0


@pytest.mark.parametrize("pitch_deg", [6.0, 37.0])
def test_columns_of_any_width_keep_their_templates_whole(pitch_deg: float) -> None:
    """Few columns reach as far as templates do, and are moved by two more."""
    made = template_set(
        pitch_rad=math.radians(pitch_deg),
        radius_mm=12.0,
        stiffness_n_per_mm=3.0,
        stiffness_bound=0.3,
        crosstalk=0.075,
        least_depth=0.012,
    )
    some_slabs = TemplateSlabs(made)
    force = np.zeros((1, COLS))
    reach = made.cells.shape[1] // 2
    k = int(np.flatnonzero(made.one_edge)[0])
    wide = np.zeros(COLS + 2 * reach)
    wide[7 : 7 + 2 * reach + 1] = made.cells[k] * made.least_n[k] * 1.1
    force[0] = wide[reach:-reach]
    found = some_slabs.match(profiles(force, np.full_like(force, 1e-4 * force.max() ** 2)), SLACK)
    assert found.misfit[0] <= LIMIT
    assert found.low[0] - 0.2 <= 7 + made.angle_columns[k] <= found.high[0] + 0.2
