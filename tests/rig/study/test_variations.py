"""Variations of a study: what errors cost, and heights at which fingers tell more apart."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from command import run
from report_page import Page
from stacked_parts import L_SHAPE, objects, part, section

from palpate.base.vocabulary import ErrorSource, IdentificationVerdict, PartMotion, Strategy
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.study_result import StudyRunOut
from palpate.jobs.study import study
from palpate.rig.study.simulation import Simulation, with_motion
from palpate.rig.study.variations import UNVARIED, compare_runs, error_variations, noise_budget

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())
STILL = with_motion(RIG, SIX, PartMotion.STILL)


@pytest.fixture(scope="module")
def rows() -> dict[str, list[StudyRunOut]]:
    """The same runs as they are and with each error halved; parts are 0.2 mm off their models."""
    rig, objects = STILL
    off = replace(objects, objects=tuple(replace(item, tolerance_mm=0.2) for item in objects.objects))
    as_is = Simulation(rig, off, Strategy.PLANNED, 1)
    simulations = {UNVARIED: as_is} | error_variations(as_is)
    return {name: [item.run(k, name) for k in range(12)] for name, item in simulations.items()}


def test_halved_errors_are_tried_on_the_same_parts(rows: dict[str, list[StudyRunOut]]) -> None:
    errors = set(ErrorSource) - {ErrorSource.MOTION}
    assert set(rows) == {UNVARIED, *(f"half {source.value}" for source in errors)}
    parts = {tuple((run.object, run.state) for run in some) for some in rows.values()}
    assert len(parts) == 1
    assert all(run.inside_bounds for some in rows.values() for run in some)


def test_what_is_measured_better_gives_finer_bounds(rows: dict[str, list[StudyRunOut]]) -> None:
    costs = {item.source: item for item in noise_budget(rows)}
    assert set(costs) == set(ErrorSource) - {ErrorSource.MOTION}
    for source in (ErrorSource.POSITION, ErrorSource.TOLERANCE):
        bounds = costs[source].position_bound
        assert bounds is not None
        assert bounds[1] < bounds[0]
    assert costs[ErrorSource.REACH].saved_touches <= 0.0, "fewer aims tell no more apart"
    gained = [item.identified[1] - item.identified[0] for item in noise_budget(rows)]
    assert gained == sorted(gained, reverse=True)


def test_parts_that_may_move_are_held_firmly_at_the_same_places() -> None:
    moving = Simulation(*with_motion(RIG, SIX, PartMotion.MOVING), Strategy.PLANNED, 1)
    held = error_variations(moving)["held"]
    as_is, still = ([item.run(k) for k in range(2)] for item in (moving, held))
    assert [(run.object, run.state) for run in as_is] == [(run.object, run.state) for run in still]
    assert [run.moved for run in still] == [0.0, 0.0]
    direct = Simulation(*STILL, Strategy.PLANNED, 1)
    assert still == [direct.run(k) for k in range(2)], "as with parts that lie still"
    (cost,) = noise_budget({UNVARIED: as_is, "held": still})
    assert (cost.source, cost.runs) == (ErrorSource.MOTION, 2)


def test_parts_that_are_exact_have_no_tolerance_to_halve() -> None:
    exact = replace(SIX, objects=tuple(replace(item, tolerance_mm=0.0) for item in SIX.objects))
    assert "half tolerance" not in error_variations(Simulation(RIG, exact, Strategy.PLANNED, 1))


def test_a_comparison_is_of_pairs_of_runs() -> None:
    (one,) = [Simulation(*STILL, Strategy.PLANNED, 1).run(0)]
    as_is = [one.model_copy(update={"touches": touches}) for touches in (9, 7, 8)]
    varied = [one.model_copy(update={"touches": touches}) for touches in (6, 6, 6)]
    varied[2] = varied[2].model_copy(update={"verdict": IdentificationVerdict.UNRESOLVED})
    found = compare_runs(as_is, varied)
    assert (found.runs, found.touches, found.saved_touches) == (3, (8.0, 6.0), 2.0)
    assert found.standard_error == pytest.approx((1.0 / 3) ** 0.5)  # of 3, 1, 2
    assert found.identified == (3, 2)


def test_a_height_that_tells_apart_what_the_fingers_do_not_is_found_and_tried(tmp_path: Path) -> None:
    """Two parts that differ above 20 mm only; fingers are at 10 mm."""
    low = section(0, 20, L_SHAPE)
    parts = [
        part("one", low, section(20, 40, L_SHAPE)),
        part("two", low, section(20, 40, [[0.6 * x, 0.6 * y] for x, y in L_SHAPE])),
    ]
    file = tmp_path / "parts.json"
    file.write_text(json.dumps(objects(*parts)), encoding="utf-8")
    out = study(RIG, load_objects(file), runs=6, budget=4, parts="still", seed=1)
    best = out.best_heights
    assert best is not None
    assert (best.alike_now, best.alike) == (1, 0)
    assert any(20 < height < 40 for height in best.heights)
    assert best.compared is not None
    assert best.compared.identified == (0, 4)
    assert {(item.a, item.b, item.share) for item in out.confusion} == {
        ("one, s", "two, s", 1.0),
        ("two, s", "one, s", 1.0),
    }
    assert [item.heights for item in out.separating] == [((20.0, 40.0),)]
    assert [item.range for item in out.heights] == [(0.0, 20.0), (20.0, 40.0)]
    told = run("study", "--objects", file, "--runs", 6, "--budget", 4, "--parts", "still", "--seed", 1,
               "--report", "page.html", cwd=tmp_path)  # fmt: skip
    assert told.code == 0
    assert "fingers at 10 mm: 1 pair of states is never, or perhaps not, distinguished; none " in told.out
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert {"Heights of fingers", "What errors cost", "Confusion"} <= set(page.headings)
