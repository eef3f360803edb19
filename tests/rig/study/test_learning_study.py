"""Studies of learning: runs, their judgement by shapely, costs of tolerances, and what is refused."""

import json
import math
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import palpate
from palpate.base.errors import InputError, RigWarning
from palpate.config import RigFile
from palpate.config.fields import to_json
from palpate.config.learning_study_result import LearningRunOut, LearningStepOut
from palpate.config.schema import schema_text
from palpate.rig.emulated.scene import put_down
from palpate.rig.fingers import resolution_of
from palpate.rig.learning.learning_search import LearningSearch
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.study.learning_simulation import (
    LearningSimulation,
    is_inside_bounds,
    learnable_objects,
    tolerance_costs,
)
from palpate.rig.study.simulated_touches import SimulatedTouches
from palpate.views.report.study_text import learning_study_lines
from support.benches.parts import objects, rectangle, section, stacked_part
from support.benches.rigs import firm_rig, small_objects, small_rig
from support.commands.command import Here, violations
from support.commands.repository import EXAMPLES

HEIGHT_MM, GOAL_MM = 20.0, 6.0


@cache
def bench() -> tuple[RigFile, Reach]:
    """A small bench with a stage that turns, and few of its approaches."""
    rig = small_rig(EXAMPLES / "turning-rig.toml")
    return rig, reach_of(rig, most_paths=500)


def test_a_part_is_learned_and_the_truth_lies_between_its_bounds() -> None:
    rig, reach = bench()
    run = LearningSimulation(rig, reach, small_objects(), HEIGHT_MM, GOAL_MM, 300.0, 0).run(3)
    assert run.goal_met
    assert run.inside_bounds
    assert run.tolerance is not None
    assert run.tolerance <= GOAL_MM
    assert run.falling[-1] == LearningStepOut(
        touches=run.touches, rig_seconds=run.rig_seconds, tolerance=run.tolerance
    )
    assert all(before.tolerance > after.tolerance for before, after in pairwise(run.falling))
    assert run.grips <= run.touches <= 3 * run.grips
    # Closing, measuring and going back take seconds; a finger needs no minute for it.
    assert 5 * run.grips < run.rig_seconds < 60 * run.grips


def test_what_lies_elsewhere_than_was_felt_is_outside_the_bounds() -> None:
    rig, reach = bench()
    rng = np.random.default_rng(3)
    model = small_objects().objects[0]
    lies = put_down(model, model.states[0], 10.0, rng, rig.workspace.radius_mm)
    search = LearningSearch(rig, reach, HEIGHT_MM, GOAL_MM)
    touches = SimulatedTouches([lies], resolution_of(rig), rng)
    assert is_inside_bounds(search, lies), "nothing is said yet"
    for _ in range(3):
        search.take([item.contact for item in touches(search.next())])
    assert is_inside_bounds(search, lies)
    assert not is_inside_bounds(search, replace(lies, x_mm=lies.x_mm + 8.0))
    assert not is_inside_bounds(search, replace(lies, theta_rad=lies.theta_rad + 0.8))


def test_a_run_depends_on_its_number_and_the_seed_only() -> None:
    rig, _ = bench()
    given: dict[str, Any] = {"height_mm": HEIGHT_MM, "max_seconds": 20.0, "seed": 4}
    told: list[str] = []
    one = palpate.study_learning(rig, small_objects(), runs=2, workers=1, progress=told.append, **given)
    two = palpate.study_learning(rig, small_objects(), runs=3, workers=2, **given)
    assert one.runs == two.runs[:2]
    assert two.runs[0] != two.runs[1]
    assert told[-1] == "runs: 2 of 2"
    assert violations(json.loads(to_json(two)), json.loads(schema_text("learning-study"))) == []
    assert two.format == "palpate/learning-study@1"
    assert all(run.rig_seconds > 20.0 and run.tolerance is None and not run.goal_met for run in two.runs)
    assert two.outside == 0
    assert [item.tolerance for item in two.costs] == [6.0, 4.0, 3.0, 2.0]
    assert all(item.runs == 0 and item.touches is None for item in two.costs)


def run_of(number: int, *falling: tuple[int, float, float]) -> LearningRunOut:
    """A run whose tolerance fell so, by touches, seconds and tolerance."""
    steps = tuple(LearningStepOut(touches=a, rig_seconds=b, tolerance=c) for a, b, c in falling)
    last = steps[-1] if steps else LearningStepOut(touches=9, rig_seconds=90.0, tolerance=math.inf)
    return LearningRunOut(
        number=number,
        object="part",
        state="flat",
        grips=9,
        touches=last.touches,
        rig_seconds=last.rig_seconds,
        tolerance=last.tolerance if steps else None,
        goal_met=bool(steps) and last.tolerance <= 1.5,
        inside_bounds=True,
        falling=steps,
    )


def test_what_a_tolerance_costs_is_the_median_of_the_runs_that_reached_it() -> None:
    runs = [
        run_of(0, (30, 100.0, 5.0), (40, 150.0, 3.5), (80, 300.0, 1.4)),
        run_of(1, (50, 200.0, 2.9)),
        run_of(2, (70, 240.0, 5.5), (90, 320.0, 3.9)),
    ]
    costs = {
        item.tolerance: (item.runs, item.touches, item.rig_seconds) for item in tolerance_costs(runs, 1.5)
    }
    assert costs == {
        6.0: (3, 50.0, 200.0),
        4.0: (3, 50.0, 200.0),
        3.0: (2, 65.0, 250.0),
        2.0: (1, 80.0, 300.0),
        1.5: (1, 80.0, 300.0),
    }
    assert [item.tolerance for item in tolerance_costs(runs, 2.5)] == [6.0, 4.0, 3.0, 2.5]


def test_states_in_two_pieces_or_beside_no_tip_are_left_out() -> None:
    two = stacked_part("two", section(0, 20, rectangle(20, 20), rectangle(20, 20, 40)))
    low = stacked_part("low", section(0, 3, rectangle(40, 30)))
    block = stacked_part("block", section(0, 20, rectangle(40, 30)))
    rig, reach = bench()
    fingers = LearningSearch(rig, reach, HEIGHT_MM, GOAL_MM).fingers
    kept, others = learnable_objects(palpate.load_objects(objects(two, low, block)), fingers)
    assert [item.name for item in kept.objects] == ["block"]
    assert [name.split(",")[0] for name in others] == ["two", "low"]
    with pytest.warns(RigWarning, match="two"):
        out = palpate.study_learning(
            rig, palpate.load_objects(objects(two, block)), height_mm=HEIGHT_MM, max_seconds=5.0, runs=1
        )
    assert out.runs[0].object == "block"
    with pytest.raises(InputError, match="two"):
        palpate.study_learning(rig, palpate.load_objects(objects(two)), height_mm=HEIGHT_MM)


@pytest.mark.parametrize(
    ("changed", "named"),
    [
        ({"height_mm": 0.0}, "height_mm"),
        ({"height_mm": 3.0}, "lower than all tips"),
        ({"tolerance_mm": math.nan}, "tolerance_mm"),
        ({"max_seconds": math.inf}, "max_seconds"),
        ({"runs": 0}, "runs"),
        ({"workers": 0}, "workers"),
        ({"seed": -1}, "seed"),
    ],
)
def test_values_that_mean_nothing_are_refused(changed: dict[str, Any], named: str) -> None:
    rig, _ = bench()
    with pytest.raises(InputError, match=named):
        palpate.study_learning(rig, small_objects(), **({"height_mm": HEIGHT_MM} | changed))


def test_rigs_that_cannot_learn_are_refused_as_by_learn() -> None:
    for rig, named in (
        (palpate.load_rig(), "part_holds_n"),
        (palpate.load_rig(EXAMPLES / "pad-rig.toml"), "upright round tips"),
    ):
        with pytest.raises(InputError, match=named):
            palpate.study_learning(rig, palpate.load_objects(), height_mm=HEIGHT_MM)


def test_parts_that_fit_nowhere_end_the_study() -> None:
    rig, reach = bench()
    long = palpate.load_objects(objects(stacked_part("long", section(0, 20, rectangle(140, 10)))))
    with pytest.raises(InputError, match="workspace"):
        LearningSimulation(rig, reach, long, HEIGHT_MM, GOAL_MM, 300.0, 0).run(0)


def test_the_command_prints_a_table_or_one_object(here: Here) -> None:
    words = ("objects", "study-learning", "--height", "18", "--rig", firm_rig(), "--runs", 1)
    done = here(*words, "--max-seconds", 10, "--tolerance", 3, "--json")
    assert done.code == 0
    assert violations(done.json, json.loads(schema_text("learning-study"))) == []
    assert (done.json["goal"], done.json["height"], len(done.json["runs"])) == (3.0, 18.0, 1)


def test_a_truth_outside_its_bounds_is_said() -> None:
    rig, _ = bench()
    out = palpate.study_learning(rig, small_objects(), height_mm=HEIGHT_MM, max_seconds=5.0, runs=1)
    name = out.runs[0].object
    lines = learning_study_lines(out)
    assert any(name in line for line in lines), "it was not learned"
    false = out.model_copy(update={"outside": 1})
    assert learning_study_lines(false) != lines
