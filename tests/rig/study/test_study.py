"""Studies: trials, moving parts, variations, a cluster."""

import json
import random
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from palpate.base.errors import InputError, RigWarning
from palpate.base.vocabulary import ErrorSource, IdentificationVerdict, PartMotion, Strategy
from palpate.config import RigFile, load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.emulation import EmulatedPartConfig
from palpate.config.schema import schema_text
from palpate.config.study_result import StudyRunOut
from palpate.jobs.study import study
from palpate.rig.study.simulation import Simulation, motion_of, with_motion
from palpate.rig.study.summary import StudySetting, is_wrong, study_out
from palpate.rig.study.variations import UNVARIED, compare_runs, error_variations, noise_budget
from palpate.views.report.study_text import study_lines
from support.benches.parts import L_SHAPE, objects, section, stacked_part
from support.benches.processes import Cluster, cluster
from support.benches.rigs import small, small_parts
from support.campaign.sampling import sample
from support.commands.command import PALPATE, PATIENCE_S, Here, run, violations
from support.commands.pages import Page
from support.commands.repository import EXAMPLES, ROOT

# ----------------------------------------------------------------------------------------------------
# Studies: simulated runs never lose the truth, are the same on any number of cores, and are resumed.

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())


def simulation(seed: int = 1, strategy: Strategy = Strategy.PLANNED) -> Simulation:
    return Simulation(*with_motion(RIG, SIX, PartMotion.STILL), strategy, seed)


@pytest.mark.parametrize("runs", sample([10, 400], [10]))
@pytest.mark.parametrize("strategy", sample(Strategy, [Strategy.PLANNED]))
def test_the_truth_is_never_lost_and_no_answer_is_wrong(strategy: Strategy, runs: int) -> None:
    some = simulation(strategy=strategy)
    rows = [some.run(number) for number in range(runs)]
    assert [row for row in rows if not row.inside_bounds] == []
    assert not any(map(is_wrong, rows))
    assert len({row.object for row in rows}) >= 5
    known = [row for row in rows if row.verdict is IdentificationVerdict.IDENTIFIED]
    assert all(row.fewest is not None and 3 <= row.fewest <= row.touches for row in known)
    if strategy is Strategy.PLANNED:
        assert sum(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows) >= 0.9 * runs


def test_what_feels_the_same_is_left_at_the_end(tmp_path: Path) -> None:
    ell = next(item for item in load_objects(small_parts(tmp_path)).objects if item.name == "ell")
    twins = replace(SIX, objects=(ell, replace(ell, name="again")))
    some = Simulation(*with_motion(RIG, twins, PartMotion.STILL), Strategy.PLANNED, 3)
    rows = [some.run(number) for number in range(4)]
    assert all(row.left == (("again", "flat"), ("ell", "flat")) for row in rows)
    assert not any(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows)
    out = study_out(rows, StudySetting("twins", "r", Strategy.PLANNED, seed=3))
    assert (out.wrong, out.lost) == (0, 0)
    assert sum(pair.left for pair in out.hardest) == 4
    assert all(state.identified == 0 for state in out.states)


def test_a_run_depends_on_its_number_only_and_a_study_goes_on_where_it_ended(tmp_path: Path) -> None:
    keep = tmp_path / "runs.jsonl"
    told: list[str] = []
    given: dict[str, Any] = {"seed": 5, "parts": "still", "budget": 0, "keep": keep}
    whole = study(RIG, SIX, runs=14, progress=told.append, **given)
    counts = [line for line in told if line.startswith("runs:")]
    assert (counts[0], counts[-1]) == ("runs: 0 of 14", "runs: 14 of 14")
    lines = keep.read_text().splitlines(keepends=True)
    assert len(lines) == 15
    rows = {row.number: row for row in map(StudyRunOut.model_validate_json, lines[1:])}
    alone = simulation(seed=5)
    assert all(
        rows[number] == StudyRunOut.model_validate_json(alone.run(number).model_dump_json())
        for number in (0, 13)
    )
    keep.write_text("".join(lines[:12]) + lines[12][:30])  # killed while it wrote
    told.clear()
    again = study(RIG, SIX, runs=14, progress=told.append, **given)
    assert again.model_copy(update={"seconds": whole.seconds}) == whole
    assert next(line for line in told if line.startswith("runs:")) == "runs: 11 of 14"
    assert sorted(keep.read_text().splitlines()) == sorted(line.strip() for line in lines)
    assert study(RIG, SIX, runs=12, **given).runs == 12
    assert len(keep.read_text().splitlines()) == 15, "nothing was to be done"


@pytest.mark.parametrize(
    "change", [{"seed": 6}, {"strategy": Strategy.RANDOM}, {"objects": replace(SIX, objects=SIX.objects[:5])}]
)
def test_runs_of_another_study_are_refused(change: dict[str, object], tmp_path: Path) -> None:
    keep = tmp_path / "runs.jsonl"
    study(RIG, SIX, runs=1, seed=5, keep=keep)
    before = keep.read_bytes()
    given = {"objects": SIX, "seed": 5} | change
    with pytest.raises(InputError, match="holds runs of another study"):
        study(RIG, given.pop("objects"), runs=2, keep=keep, **given)  # type: ignore[arg-type]
    keep.write_bytes(before.replace(b'"code":"', b'"code":"0'))
    with pytest.raises(
        InputError, match=r"another study \(by code of palpate that has been upgraded or changed"
    ):
        study(RIG, SIX, runs=2, seed=5, keep=keep)


def test_what_is_wrong_with_a_file_of_runs_is_said_and_costs_no_run(tmp_path: Path) -> None:
    keep = tmp_path / "runs.jsonl"
    given: dict[str, Any] = {"parts": "still", "budget": 0, "keep": keep}
    keep.touch()
    whole = study(RIG, SIX, runs=3, **given)
    head, *lines = keep.read_bytes().splitlines(keepends=True)
    assert len(lines) == 3
    for beginning in (b"", head[:20], head[:-1]):
        keep.write_bytes(beginning)
        again = study(RIG, SIX, runs=3, **given)
        assert again.model_copy(update={"seconds": whole.seconds}) == whole
        assert keep.read_bytes().startswith(head)
    for other in (
        b'{\n  "format": "palpate/objects@1"\n}\n',
        b"\x00\xff",
        b'{"format":"palpate/runs@1"}',
        b"\n",
    ):
        keep.write_bytes(other)
        with pytest.raises(
            InputError, match=r"is not a file of runs: its first line is .*; choose another file"
        ):
            study(RIG, SIX, runs=3, **given)
        assert keep.read_bytes() == other
    damaged = b"".join([head, lines[0], b'{"number": 1}\n', lines[2]])
    keep.write_bytes(damaged)
    with pytest.raises(InputError, match="line 3 is damaged; delete that line, and its run is done again"):
        study(RIG, SIX, runs=3, **given)
    assert keep.read_bytes() == damaged
    keep.write_bytes(b"".join([head, lines[0], lines[2]]))
    again = study(RIG, SIX, runs=3, **given)
    assert again.model_copy(update={"seconds": whole.seconds}) == whole


def test_a_rig_of_which_too_little_is_known_is_refused_as_identify_does(tmp_path: Path, here: Here) -> None:
    fresh = EXAMPLES / "fresh-rig.toml"
    told = here("study", "--rig", fresh, "--runs", 2, "--keep", "runs.jsonl")
    identified = here("identify", "--rig", fresh)
    assert (told.code, told.out, told.err) == (2, "", identified.err)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match=r'^rig "fresh": by its bounds, .* `palpate calibrate --rig FILE`'):
        study(load_rig(fresh), SIX, runs=2)


def test_the_command_says_what_the_json_and_the_report_say(tmp_path: Path, here: Here) -> None:
    words = ("study", "--runs", 3, "--seed", 2, "--keep", "runs.jsonl")
    told = here(*words, "--json", "--report", "study.html")
    assert (told.code, told.err) == (0, "")
    assert violations(told.json, json.loads(schema_text("study"))) == []
    assert (told.json["runs"], told.json["wrong"], told.json["lost"]) == (3, 0, 0)
    assert (
        sum(item["runs"] for item in told.json["verdicts"])
        == sum(state["runs"] for state in told.json["states"])
        == 3
    )
    page = Page((tmp_path / "study.html").read_text(encoding="utf-8"))
    assert page.addresses == []
    assert page.headings[0].startswith("100 % of 3 runs identified")
    assert "No wrong answer in 3 runs (fewer than 63.2 % with 95 % confidence)." in page.words
    assert {f"{state['object']}, {state['state']}" for state in told.json["states"]} <= set(page.words)
    shown = here(*words, "--report", "study.html")
    assert (shown.code, shown.err) == (0, "")
    first, *_, last = shown.out.splitlines()
    assert first == f"3 runs, rig bench, {len(told.json['states'])} of 6 states drawn, parts that move:"
    assert last == "report study.html, runs runs.jsonl"
    refused = here("study", "--runs", 1, "--keep", "nowhere/runs.jsonl")
    assert (refused.code, refused.err.count("\n")) == (2, 1)


def test_states_that_no_finger_touches_are_not_drawn(tmp_path: Path) -> None:
    """They lie below all fingers: a run with one would touch nothing, whatever the rig resolves."""
    low = {"name": "low", "sections": [section(0, 5, L_SHAPE)], "probability": 0.9}
    high = {"name": "high", "sections": [section(0, 20, L_SHAPE)], "probability": 0.1}
    file = tmp_path / "plates.json"
    file.write_text(json.dumps(objects({"name": "plate", "states": [low, high]})))
    keep = tmp_path / "runs.jsonl"
    with pytest.warns(RigWarning, match="plate, low"):
        out = study(RIG, load_objects(file), runs=4, parts="still", budget=0, keep=keep, workers=1)
    runs = [json.loads(line) for line in keep.read_text().splitlines()]
    assert {run["state"] for run in runs if "state" in run} == {"high"}
    assert (out.lost, [item.state for item in out.states]) == (0, ["high"])


def test_parts_that_do_not_fit_into_the_workspace_are_counted() -> None:
    objects = load_objects(shipped_objects())
    rig = load_rig(shipped_rig())
    assert rig.emulation is not None
    narrow = rig.model_copy(update={"workspace": rig.workspace.model_copy(update={"radius_mm": 40.0})})
    counts = []
    for one in (rig, narrow):
        simulation = Simulation(*with_motion(one, objects, PartMotion.STILL), Strategy.RANDOM, 0)
        rows = [simulation.run(number) for number in range(3)]
        out = study_out(rows, StudySetting("shipped", "r", Strategy.RANDOM, seed=0))
        counts.append(out.sticking_out)
        assert ("parts sticking out" in "\n".join(study_lines(out, [10.0]))) is bool(out.sticking_out)
    assert counts[0] == 0
    assert counts[1] > 0


# ----------------------------------------------------------------------------------------------------
# Studies of parts that fingers move: how far, that the truth is never lost, and what rig files say of it.

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())


def of_mass(mass_kg: float) -> RigFile:
    """The shipped rig with a part of a mass."""
    assert RIG.emulation is not None
    part = EmulatedPartConfig(engine="quasi-static", mass_kg=mass_kg, friction=0.3, tip_friction=0.5)
    return RIG.model_copy(update={"emulation": RIG.emulation.model_copy(update={"part": part})})


@pytest.mark.parametrize("runs", sample([4, 300], [4]))
def test_the_truth_is_never_lost_although_parts_are_pushed(runs: int) -> None:
    some = Simulation(*with_motion(RIG, SIX, PartMotion.MOVING), Strategy.PLANNED, 4)
    rows = [some.run(number) for number in range(runs)]
    assert [row for row in rows if not row.inside_bounds] == []
    assert not any(map(is_wrong, rows))
    assert sum(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows) >= 0.9 * runs
    again = Simulation(*with_motion(RIG, SIX, PartMotion.MOVING), Strategy.PLANNED, 4)
    assert again.run(runs - 1) == rows[-1], "a run depends on its number only"


def test_a_light_part_is_moved_a_heavy_one_is_not_and_one_that_is_held_neither() -> None:
    def moved(rig: RigFile, motion: PartMotion) -> list[float]:
        some = Simulation(*with_motion(rig, SIX, motion), Strategy.PLANNED, 2)
        return [some.run(number).moved for number in range(2)]

    light, heavy = (moved(of_mass(mass), PartMotion.MOVING) for mass in (0.03, 20.0))
    assert min(light) > 0.005
    assert max(heavy) < 1e-9
    assert moved(of_mass(0.03), PartMotion.STILL) == [0.0] * 2


@pytest.mark.parametrize("runs", sample([4, 10], [4]))
def test_a_part_that_moves_takes_more_touches_and_is_found_less_finely(runs: int) -> None:
    """The same parts at the same places."""
    still, moving = (
        [Simulation(*with_motion(RIG, SIX, motion), Strategy.PLANNED, 1).run(k) for k in range(runs)]
        for motion in PartMotion
    )
    assert [(run.object, run.state) for run in still] == [(run.object, run.state) for run in moving]
    both = [(one.position_bound, other.position_bound) for one, other in zip(still, moving, strict=True)]
    bounds = np.array([pair for pair in both if None not in pair], dtype=float)
    assert np.median(bounds[:, 0]) < np.median(bounds[:, 1])
    assert sum(run.touches for run in still) < sum(run.touches for run in moving)


def test_whether_parts_move_is_as_the_rig_file_says_or_as_asked() -> None:
    assert motion_of(RIG) is PartMotion.MOVING
    held, objects = with_motion(RIG, SIX, PartMotion.STILL)
    assert motion_of(held) is PartMotion.STILL
    assert held.search.part_holds_n is None
    assert [item.holds_n for item in objects.objects] == [None] * 6
    assert motion_of(with_motion(held, objects, PartMotion.MOVING)[0]) is PartMotion.MOVING


def test_a_real_rig_is_studied_with_parts_that_lie_still_only() -> None:
    rig = load_rig(EXAMPLES / "real-rig.toml")
    with pytest.raises(InputError, match="describes real devices, and nothing of parts that move"):
        study(rig, SIX, runs=2, parts="moving")
    out = study(rig, SIX, runs=1, budget=0)
    assert (out.parts, out.wrong, out.lost) == (PartMotion.STILL, 0, 0)


@pytest.mark.parametrize("given", [{"parts": "fast"}, {"strategy": "clever"}])
def test_an_unknown_word_is_refused_with_those_that_are_known(given: dict[str, str]) -> None:
    with pytest.raises(InputError, match=r'"(fast|clever)"; allowed: \w+, \w+'):
        study(RIG, SIX, runs=2, **given)  # type: ignore[arg-type]


# ----------------------------------------------------------------------------------------------------
# Variations of a study: what errors cost, and heights at which fingers tell more apart.

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())
STILL = with_motion(RIG, SIX, PartMotion.STILL)


@pytest.fixture(scope="module")
def rows() -> dict[str, list[StudyRunOut]]:
    """The same runs as they are and with each error halved; parts are 0.2 mm off their models."""
    rig, objects = STILL
    off = replace(objects, objects=tuple(replace(item, tolerance_mm=0.2) for item in objects.objects))
    as_is = Simulation(rig, off, Strategy.PLANNED, 1)
    simulations = {UNVARIED: as_is} | error_variations(as_is)
    return {name: [item.run(k, name) for k in range(6)] for name, item in simulations.items()}


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


def test_a_height_that_tells_apart_what_the_fingers_do_not_is_found_and_tried(
    tmp_path: Path, here: Here
) -> None:
    """Two parts that differ above 20 mm only; fingers are at 10 mm."""
    low = section(0, 20, L_SHAPE)
    parts = [
        stacked_part("one", low, section(20, 40, L_SHAPE)),
        stacked_part("two", low, section(20, 40, [[0.6 * x, 0.6 * y] for x, y in L_SHAPE])),
    ]
    file = tmp_path / "parts.json"
    file.write_text(json.dumps(objects(*parts)), encoding="utf-8")
    keep = tmp_path / "runs.jsonl"
    out = study(RIG, load_objects(file), runs=6, budget=4, parts="still", seed=1, keep=keep)
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
    told = here("study", "--objects", file, "--runs", 6, "--budget", 4, "--parts", "still", "--seed", 1,
               "--keep", keep, "--report", "page.html")  # fmt: skip
    assert told.code == 0
    assert "fingers at 10 mm: 1 pair of states is never, or perhaps not, distinguished; none " in told.out
    page = Page((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert {"Heights of fingers", "What errors cost", "Confusion"} <= set(page.headings)


# ----------------------------------------------------------------------------------------------------
# Studies on a cluster: killed workers cost nothing but time; what is amiss is one line.

RUNS = 16
BENCH = ("--rig", "rig.toml", "--objects", "small-parts.json")
WORDS = ("study", *BENCH, "--budget", 1, "--runs", RUNS, "--seed", 3)


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    """A folder with a small rig and its parts."""
    (tmp_path / "rig.toml").write_text(small(ROOT / "src/palpate/config/rigs/bench.toml"), encoding="utf-8")
    small_parts(tmp_path)
    return tmp_path


def started(bench: Path, on: Cluster) -> subprocess.Popen[str]:
    """A study on the cluster."""
    words = (*WORDS, "--json", "--scheduler", on.address, "--keep", "runs.jsonl")
    return subprocess.Popen(
        [PALPATE, *map(str, words)], cwd=bench, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def without_progress(err: str) -> str:
    """What a study says beside how far it is; on a slow computer it says that now and then."""
    return "".join(line for line in err.splitlines(keepends=True) if not line.startswith("runs: "))


def wait_for_runs(process: subprocess.Popen[str], keep: Path, count: int) -> None:
    """Until so many are kept, or it has ended."""
    while process.poll() is None and not (keep.exists() and keep.read_bytes().count(b"\n") > count):
        time.sleep(0.1)


def killed_while_it_runs(process: subprocess.Popen[str], on: Cluster, rng: random.Random) -> int:
    """Kill a worker now and then until the study ends; how many."""
    killed = 0
    while process.poll() is None:
        time.sleep(rng.uniform(0.3, 1.5))
        # Not for ever: a worker takes seconds to start, and all of them at once would get nothing done.
        killed += killed < 2 and on.kill_one(rng)
    return killed


@pytest.mark.slow
def test_workers_that_are_killed_lose_nothing_and_nothing_counts_twice(bench: Path) -> None:
    with cluster(bench, workers=2) as on:
        process = started(bench, on)
        wait_for_runs(process, bench / "runs.jsonl", 3)
        killed = killed_while_it_runs(process, on, random.Random(1))
        out, err = process.communicate()
    assert (process.returncode, without_progress(err)) == (0, "")
    assert killed >= 2
    here = run(*WORDS, "--json", "--keep", "here.jsonl", cwd=bench)
    assert json.loads(out) | {"seconds": 0.0} == here.json | {"seconds": 0.0}
    kept, kept_here = (
        sorted((bench / name).read_text().splitlines()) for name in ("runs.jsonl", "here.jsonl")
    )
    assert kept == kept_here
    assert len(kept) > RUNS + 1, "runs with halved errors are among them"


@pytest.mark.campaign
@pytest.mark.slow
def test_a_study_that_was_begun_here_goes_on_on_a_cluster(bench: Path) -> None:
    words = ("study", *BENCH, "--budget", 0, "--seed", 3, "--keep", "runs.jsonl", "--json")
    run(*words, "--runs", 3, cwd=bench)
    with cluster(bench, workers=1) as on:
        told = run(*words, "--runs", 6, "--scheduler", on.address, cwd=bench)
    assert (told.code, without_progress(told.err), told.json["runs"]) == (0, "", 6)
    assert told.json | {"seconds": 0.0} == run(*words, "--runs", 6, cwd=bench).json | {"seconds": 0.0}


@pytest.mark.slow
def test_a_scheduler_that_is_lost_is_one_line_and_what_was_done_is_kept(bench: Path) -> None:
    with cluster(bench, workers=1) as on:
        process = started(bench, on)
        keep = bench / "runs.jsonl"
        wait_for_runs(process, keep, 3)
        on.scheduler.kill()
        _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    words = (
        "the scheduler was lost; runs that were done are in runs.jsonl; the same command goes on from there"
    )
    assert without_progress(err) == f"error: {words}\n"
    assert 3 < keep.read_text().count("\n") < RUNS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("address", "words"),
    [
        (
            "tcp://127.0.0.1:9",
            "no dask scheduler answers at tcp://127.0.0.1:9; start one with `dask scheduler`",
        ),
        ("workshop", '"workshop" is no address of a dask scheduler, such as tcp://192.168.1.5:8786'),
    ],
)
def test_no_scheduler_is_one_line(address: str, words: str, here: Here) -> None:
    told = here("study", "--runs", 2, "--scheduler", address)
    assert (told.code, told.out) == (2, "")
    assert told.err.startswith(f"error: {words}")
    assert told.err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.campaign
def test_a_scheduler_without_workers_is_one_line(tmp_path: Path, here: Here) -> None:
    with cluster(tmp_path, workers=0) as on:
        told = here("study", "--runs", 2, "--scheduler", on.address)
    assert (told.code, told.err.count("\n")) == (2, 1)
    assert f"has no workers; start some with `dask worker {on.address}`" in told.err
