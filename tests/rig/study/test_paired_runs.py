"""Paired runs: what differs by more than chance, judged by scipy.stats; counts by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from palpate.base.vocabulary import IdentificationVerdict
from palpate.config.study_result import ComparedOut, StudyRunOut
from palpate.rig.study.variations import MIN_PAIRS, compare_runs

IDENTIFIED, UNRESOLVED = IdentificationVerdict.IDENTIFIED, IdentificationVerdict.UNRESOLVED


def ended(number: int, *, identified: bool = True, touches: int = 8, bound: float = 0.5) -> StudyRunOut:
    return StudyRunOut(
        number=number,
        object="plate",
        state="flat",
        verdict=IDENTIFIED if identified else UNRESOLVED,
        named_object="plate",
        named_state="flat",
        inside_bounds=True,
        position_error=0.1,
        position_bound=bound,
        orientation_bound=bound / 50,
        moved=0.0,
        grips=3,
        touches=touches,
        left=(("plate", "flat"),),
        rivals=(),
    )


def of_identified(both: int, gained: int, lost: int, neither: int, comparisons: int = 1) -> ComparedOut:
    """So many runs that were identified both ways, only varied, only as they are, and not at all."""
    kinds = [(True, True)] * both + [(False, True)] * gained + [(True, False)] * lost
    kinds += [(False, False)] * neither
    as_is = [ended(k, identified=one) for k, (one, _) in enumerate(kinds)]
    varied = [ended(k, identified=other) for k, (_, other) in enumerate(kinds)]
    return compare_runs(as_is, varied, comparisons=comparisons)


@given(*(st.integers(0, 30) for _ in range(4)), st.integers(1, 6))
def test_identified_runs_differ_as_mcnemar_says(
    both: int, gained: int, lost: int, neither: int, comparisons: int
) -> None:
    if not both + gained + lost + neither:
        return
    out = of_identified(both, gained, lost, neither, comparisons)
    assert out.identified == (both + lost, both + gained)
    assert (out.runs, out.pairs) == (both + gained + lost + neither, both)
    p = stats.binomtest(gained, gained + lost).pvalue if gained + lost else 1.0
    assert ("identified" in out.shown) == (p < 0.05 / comparisons)


def test_a_few_more_identified_runs_may_be_chance() -> None:
    """5 of 5 that differ: p is 1/16; 6 of 6: 1/32, which is enough for one comparison and not for two."""
    assert of_identified(5, 5, 0, 2).shown == ()
    assert of_identified(5, 6, 0, 2).shown == ("identified",)
    assert of_identified(5, 6, 0, 2, comparisons=2).shown == ()


@given(
    st.lists(st.tuples(st.integers(4, 20), st.integers(4, 20)), min_size=MIN_PAIRS, max_size=40),
    st.integers(1, 6),
)
def test_touches_differ_as_students_interval_says(pairs: list[tuple[int, int]], comparisons: int) -> None:
    as_is = [ended(k, touches=one) for k, (one, _) in enumerate(pairs)]
    varied = [ended(k, touches=other) for k, (_, other) in enumerate(pairs)]
    out = compare_runs(as_is, varied, comparisons=comparisons)
    differences = np.array([one - other for one, other in pairs])
    assert out.fewer_touches == pytest.approx(differences.mean(), abs=1e-6)
    assert out.fewer_interval is not None
    if differences.std() == 0:
        assert out.fewer_interval == pytest.approx((differences[0],) * 2)
        return
    expected = stats.ttest_1samp(differences, 0).confidence_interval(1 - 0.05 / comparisons)
    assert out.fewer_interval == pytest.approx((expected.low, expected.high), abs=2e-6)
    if min(abs(end) for end in expected) > 1e-6:
        assert ("touches" in out.shown) == (expected.low > 0 or expected.high < 0)


def test_touches_are_compared_of_runs_that_were_identified_both_ways() -> None:
    """Of 12 pairs of which one was not: 11 save one touch each, and the other, 100, does not count."""
    as_is = [ended(k, touches=9) for k in range(11)] + [ended(11, touches=108, identified=False)]
    varied = [ended(k, touches=8) for k in range(12)]
    out = compare_runs(as_is, varied)
    assert (out.pairs, out.fewer_touches, out.fewer_interval) == (11, 1.0, (1.0, 1.0))
    assert out.saved_touches == pytest.approx(111 / 12, abs=1e-6)


def test_of_few_pairs_neither_touches_nor_bounds_are_compared() -> None:
    for count, is_shown in ((MIN_PAIRS - 1, False), (MIN_PAIRS, True)):
        as_is = [ended(k, touches=10, bound=0.5) for k in range(count)]
        varied = [ended(k, touches=6, bound=0.2) for k in range(count)]
        out = compare_runs(as_is, varied, comparisons=5)
        assert ("bounds" in out.shown) is ("touches" in out.shown) is is_shown
        assert (out.fewer_interval is not None) is is_shown
        assert (out.runs_wanted is None) is is_shown


def test_how_many_runs_would_show_half_a_touch() -> None:
    """Differences of ± 2 in 40 pairs: the interval is ± 2.02 · 2.03 / √40 = 0.65; (0.65 / 0.5)² · 40 = 67."""
    as_is = [ended(k, touches=10) for k in range(40)]
    varied = [ended(k, touches=8 if k % 2 else 12) for k in range(40)]
    assert compare_runs(as_is, varied).runs_wanted == 70
    assert compare_runs(as_is, as_is).runs_wanted is None, "nothing differs"
    none_identified = [ended(k, identified=False, touches=8 + k % 2) for k in range(20)]
    wanted = compare_runs(as_is, none_identified)
    assert (wanted.pairs, wanted.shown, wanted.runs_wanted) == (0, ("identified",), None)
