"""Summaries of studies and pairs of runs."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.study_result import ComparedOut, PairStudiedOut, RivalOut, StudyOut, StudyRunOut
from palpate.jobs.study import study
from palpate.rig.study.campaign import RunsFile
from palpate.rig.study.simulation import Simulation, draw_placement, state_shares, with_motion
from palpate.rig.study.summary import StudyGoals, StudySetting, study_out
from palpate.rig.study.variations import MIN_PAIRS, compare_runs
from palpate.views.report.study_text import hard_pairs

# ----------------------------------------------------------------------------------------------------
# Summary of a study: bounds, goals, counts and pairs from runs whose numbers are given.

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())
LIMITS = StudyGoals(1.0, math.radians(1.0), 8)
IDENTIFIED = IdentificationVerdict.IDENTIFIED


def ended(
    number: int,
    verdict: IdentificationVerdict = IDENTIFIED,
    *,
    state: str = "flat",
    mm: float = 0.5,
    deg: float = 0.5,
    grips: int = 3,
    touches: int = 8,
    left: tuple[str, ...] = ("flat",),
    rivals: tuple[RivalOut, ...] = (),
) -> StudyRunOut:
    return StudyRunOut(
        number=number,
        object="plate",
        state=state,
        verdict=verdict,
        named_object="plate",
        named_state=state,
        inside_bounds=True,
        position_error=mm / 5,
        position_bound=mm,
        orientation_bound=math.radians(deg),
        moved=0.0,
        grips=grips,
        touches=touches,
        left=tuple(("plate", name) for name in left),
        rivals=rivals,
    )


def of(runs: list[StudyRunOut]) -> StudyOut:
    return study_out(runs, StudySetting("o", "r", Strategy.PLANNED, seed=0), limits=LIMITS)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=60))
def test_ninety_percent_is_the_smallest_count_that_covers_them(touches: list[int]) -> None:
    found = of([ended(k, touches=count) for k, count in enumerate(touches)]).touches
    covered = np.mean(np.array(touches) <= found.p90)
    fewer = np.mean(np.array(touches) < found.p90)
    assert found.p90 in touches
    assert covered >= 0.9 > fewer
    assert found.max == max(touches)


def test_what_answers_guarantee_is_of_identified_runs_only() -> None:
    bounds = [(0.2, 0.1), (0.4, 0.3), (0.9, 0.8), (0.8, 1.5), (3.0, 0.2)]
    runs = [ended(k, mm=mm, deg=deg) for k, (mm, deg) in enumerate(bounds)]
    runs += [ended(k, IdentificationVerdict.UNRESOLVED, mm=70.0, deg=90.0) for k in (5, 6)]
    found = of(runs)
    assert found.accuracy is not None
    assert (found.accuracy.runs, found.accuracy.within_goal) == (5, 3)
    assert found.accuracy.position == (0.8, 3.0, 3.0)
    degrees = [math.degrees(value) for value in found.accuracy.orientation]
    assert degrees == pytest.approx([0.3, 1.5, 1.5], abs=1e-4)
    assert found.true_error == (0.16, 0.6, 0.6)
    (state,) = found.states
    assert state.accuracy == found.accuracy
    assert (state.identified, state.unresolved, state.indistinguishable) == (5, 2, 0)


def test_runs_that_stop_at_max_grips_and_sets_that_stay_are_counted() -> None:
    twins, own = IdentificationVerdict.INDISTINGUISHABLE, IdentificationVerdict.UNRESOLVED
    runs = [ended(k, twins, left=("flat", "upright")) for k in range(3)]
    runs += [ended(3, twins, left=("flat",)), ended(4, own, grips=8), ended(5, own, grips=7)]
    found = of(runs)
    assert (found.stopped, found.max_grips, found.grips_max) == (1, 8, 8)
    assert [(item.states, item.runs) for item in found.twins] == [
        (("plate, flat", "plate, upright"), 3),
        (("plate, flat",), 1),
    ]


def test_a_pair_has_no_direction_and_is_left_out_if_the_second_grip_told_it_apart() -> None:
    def rival(state: str, touches: int, grips: int) -> tuple[RivalOut, ...]:
        return (RivalOut(object="plate", state=state, touches=touches, grips=grips),)

    runs = [
        ended(0, state="a", left=("a", "b"), rivals=rival("b", 9, 4)),
        ended(1, state="a", left=("a",), rivals=rival("b", 6, 2)),
        ended(2, state="b", left=("a", "b"), rivals=rival("a", 12, 5)),
        ended(3, state="c", left=("c",), rivals=rival("a", 3, 1)),
    ]
    found = of(runs).hardest
    assert {(item.state, item.other_state, item.runs) for item in found} == {
        ("a", "b", 2),
        ("b", "a", 1),
        ("c", "a", 1),
    }
    (pair,) = hard_pairs(found)
    assert {pair.state, pair.other_state} == {"a", "b"}
    assert (pair.runs, pair.left, pair.touches) == (3, 2, 9.0)


def test_a_pair_that_is_left_stays_whatever_its_grips() -> None:
    one = PairStudiedOut(
        object="p", state="a", other_object="p", other_state="b", runs=1, touches=3, left=1, grips=1
    )
    assert hard_pairs([one]) == [one]


def test_states_are_drawn_by_their_probabilities_where_all_are_known() -> None:
    model = next(item for item in SIX.objects)
    states = [replace(model.states[0], name=name) for name in "abc"]
    known = [replace(item, probability=p) for item, p in zip(states, (0.5, 0.1, 0.2), strict=True)]
    some = [known[0], replace(known[1], probability=None), known[2]]
    for own, shares in ((known, (0.625, 0.125, 0.25)), (some, (1 / 3,) * 3)):
        objects = replace(SIX, objects=(replace(model, states=tuple(own)),))
        assert list(state_shares(objects).values()) == pytest.approx(shares)
        rng = np.random.default_rng(0)
        drawn = [draw_placement(objects, 5.0, rng, 125.0).state.name for _ in range(600)]
        counts = [drawn.count(name) / 600 for name in "abc"]
        assert counts == pytest.approx(shares, abs=4 * math.sqrt(0.25 / 600))


def test_where_parts_are_put_is_asked_for_and_belongs_to_the_file_of_runs(tmp_path: Path) -> None:
    held = with_motion(RIG, SIX, PartMotion.STILL)
    near, far = (Simulation(*held, Strategy.PLANNED, 0, placed_within_mm=mm) for mm in (0.0, 60.0))
    by_rig = Simulation(*held, Strategy.PLANNED, 0)
    assert RIG.emulation is not None
    assert by_rig.within_mm == RIG.emulation.placement_radius_mm
    asked = Simulation(*held, Strategy.PLANNED, 0, placed_within_mm=by_rig.within_mm)
    digests = [
        RunsFile(tmp_path / f"{k}.jsonl", item).study for k, item in enumerate((near, far, by_rig, asked))
    ]
    assert len(set(digests)) == 3
    assert digests[2] == digests[3]
    out = study(RIG, SIX, runs=2, budget=0, parts="still", placed_within_mm=3.0)
    assert out.placed_within == 3.0
    with pytest.raises(InputError, match="below the workspace's radius, 125 mm"):
        study(RIG, SIX, runs=2, placed_within_mm=125.0)


# ----------------------------------------------------------------------------------------------------
# Paired runs: what differs by more than chance, judged by scipy.stats; counts by hand.

PAIR_IDENTIFIED, UNRESOLVED = IdentificationVerdict.IDENTIFIED, IdentificationVerdict.UNRESOLVED


def paired_end(number: int, *, identified: bool = True, touches: int = 8, bound: float = 0.5) -> StudyRunOut:
    return StudyRunOut(
        number=number,
        object="plate",
        state="flat",
        verdict=PAIR_IDENTIFIED if identified else UNRESOLVED,
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
    as_is = [paired_end(k, identified=one) for k, (one, _) in enumerate(kinds)]
    varied = [paired_end(k, identified=other) for k, (_, other) in enumerate(kinds)]
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
    as_is = [paired_end(k, touches=one) for k, (one, _) in enumerate(pairs)]
    varied = [paired_end(k, touches=other) for k, (_, other) in enumerate(pairs)]
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
    as_is = [paired_end(k, touches=9) for k in range(11)] + [paired_end(11, touches=108, identified=False)]
    varied = [paired_end(k, touches=8) for k in range(12)]
    out = compare_runs(as_is, varied)
    assert (out.pairs, out.fewer_touches, out.fewer_interval) == (11, 1.0, (1.0, 1.0))
    assert out.saved_touches == pytest.approx(111 / 12, abs=1e-6)


def test_of_few_pairs_neither_touches_nor_bounds_are_compared() -> None:
    for count, is_shown in ((MIN_PAIRS - 1, False), (MIN_PAIRS, True)):
        as_is = [paired_end(k, touches=10, bound=0.5) for k in range(count)]
        varied = [paired_end(k, touches=6, bound=0.2) for k in range(count)]
        out = compare_runs(as_is, varied, comparisons=5)
        assert ("bounds" in out.shown) is ("touches" in out.shown) is is_shown
        assert (out.fewer_interval is not None) is is_shown
        assert (out.runs_wanted is None) is is_shown


def test_how_many_runs_would_show_half_a_touch() -> None:
    """Differences of ± 2 in 40 pairs: the interval is ± 2.02 · 2.03 / √40 = 0.65; (0.65 / 0.5)² · 40 = 67."""
    as_is = [paired_end(k, touches=10) for k in range(40)]
    varied = [paired_end(k, touches=8 if k % 2 else 12) for k in range(40)]
    assert compare_runs(as_is, varied).runs_wanted == 70
    assert compare_runs(as_is, as_is).runs_wanted is None, "nothing differs"
    none_identified = [paired_end(k, identified=False, touches=8 + k % 2) for k in range(20)]
    wanted = compare_runs(as_is, none_identified)
    assert (wanted.pairs, wanted.shown, wanted.runs_wanted) == (0, ("identified",), None)
