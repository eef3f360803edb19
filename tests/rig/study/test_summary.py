"""Summary of a study: bounds, goals, counts and pairs from runs whose numbers are given."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.study_result import PairStudiedOut, RivalOut, StudyOut, StudyRunOut
from palpate.jobs.study import study
from palpate.rig.study.campaign import RunsFile
from palpate.rig.study.simulation import Simulation, draw_placement, state_shares, with_motion
from palpate.rig.study.summary import StudyGoals, study_out
from palpate.views.report.study_text import hard_pairs

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
    return study_out(runs, objects="o", rig="r", strategy=Strategy.PLANNED, seed=0, limits=LIMITS)


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
