"""Studies: simulated runs never lose the truth, are the same on any number of cores, and are resumed."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import run
from json_schema import violations
from quick_rig import small_parts
from report_page import Page
from repository import EXAMPLES
from sampling import sample

from palpate.base.errors import InputError
from palpate.base.vocabulary import IdentificationVerdict, PartMotion, Strategy
from palpate.config import load_objects, load_rig, shipped_objects, shipped_rig
from palpate.config.schema import schema_text
from palpate.config.study_result import StudyRunOut
from palpate.jobs.study import study
from palpate.rig.study.simulation import Simulation, with_motion
from palpate.rig.study.summary import is_wrong, study_out
from palpate.views.report.study_text import study_lines

RIG, SIX = load_rig(shipped_rig()), load_objects(shipped_objects())


def simulation(seed: int = 1, strategy: Strategy = Strategy.PLANNED) -> Simulation:
    return Simulation(*with_motion(RIG, SIX, PartMotion.STILL), strategy, seed)


@pytest.mark.parametrize("runs", sample([16, 400], [16]))
@pytest.mark.parametrize("strategy", sample(Strategy, [Strategy.PLANNED]))
def test_the_truth_is_never_lost_and_no_answer_is_wrong(strategy: Strategy, runs: int) -> None:
    some = simulation(strategy=strategy)
    rows = [some.run(number) for number in range(runs)]
    assert [row for row in rows if not row.inside_bounds] == []
    assert not any(map(is_wrong, rows))
    assert len({row.object for row in rows}) >= 5
    if strategy is Strategy.PLANNED:
        assert sum(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows) >= 0.9 * runs


def test_what_feels_the_same_is_left_at_the_end(tmp_path: Path) -> None:
    ell = next(item for item in load_objects(small_parts(tmp_path)).objects if item.name == "ell")
    twins = replace(SIX, objects=(ell, replace(ell, name="again")))
    some = Simulation(*with_motion(RIG, twins, PartMotion.STILL), Strategy.PLANNED, 3)
    rows = [some.run(number) for number in range(4)]
    assert all(row.left == (("again", "flat"), ("ell", "flat")) for row in rows)
    assert not any(row.verdict is IdentificationVerdict.IDENTIFIED for row in rows)
    out = study_out(rows, objects="twins", rig="r", strategy=Strategy.PLANNED, seed=3)
    assert (out.wrong, out.lost) == (0, 0)
    assert sum(pair.left for pair in out.hardest) == 4
    assert all(state.identified == 0 for state in out.states)


def test_a_run_depends_on_its_number_only_and_a_study_goes_on_where_it_ended(tmp_path: Path) -> None:
    keep = tmp_path / "runs.jsonl"
    told: list[str] = []
    given: dict[str, Any] = {"seed": 5, "parts": "still", "budget": 0, "keep": keep}
    whole = study(RIG, SIX, runs=30, progress=told.append, **given)
    counts = [line for line in told if line.startswith("runs:")]
    assert (counts[0], counts[-1]) == ("runs: 0 of 30", "runs: 30 of 30")
    lines = keep.read_text().splitlines(keepends=True)
    assert len(lines) == 31
    rows = {row.number: row for row in map(StudyRunOut.model_validate_json, lines[1:])}
    alone = simulation(seed=5)
    assert all(
        rows[number] == StudyRunOut.model_validate_json(alone.run(number).model_dump_json())
        for number in (0, 17)
    )
    keep.write_text("".join(lines[:12]) + lines[12][:30])  # killed while it wrote
    told.clear()
    again = study(RIG, SIX, runs=30, progress=told.append, **given)
    assert again.model_copy(update={"seconds": whole.seconds}) == whole
    assert next(line for line in told if line.startswith("runs:")) == "runs: 11 of 30"
    assert sorted(keep.read_text().splitlines()) == sorted(line.strip() for line in lines)
    assert study(RIG, SIX, runs=12, **given).runs == 12
    assert len(keep.read_text().splitlines()) == 31, "nothing was to be done"


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


def test_a_rig_of_which_too_little_is_known_is_refused_as_identify_does(tmp_path: Path) -> None:
    fresh = EXAMPLES / "fresh-rig.toml"
    told = run("study", "--rig", fresh, "--runs", 2, "--keep", "runs.jsonl", cwd=tmp_path)
    identified = run("identify", "--rig", fresh, cwd=tmp_path)
    assert (told.code, told.out, told.err) == (2, "", identified.err)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match=r'^rig "fresh": by its bounds, .* `palpate calibrate --rig FILE`'):
        study(load_rig(fresh), SIX, runs=2)


def test_the_command_says_what_the_json_and_the_report_say(tmp_path: Path) -> None:
    words = ("study", "--runs", 6, "--seed", 2, "--keep", "runs.jsonl")
    told = run(*words, "--json", "--report", "study.html", cwd=tmp_path)
    assert (told.code, told.err) == (0, "")
    assert violations(told.json, json.loads(schema_text("study"))) == []
    assert (told.json["runs"], told.json["wrong"], told.json["lost"]) == (6, 0, 0)
    assert (
        sum(item["runs"] for item in told.json["verdicts"])
        == sum(state["runs"] for state in told.json["states"])
        == 6
    )
    page = Page((tmp_path / "study.html").read_text(encoding="utf-8"))
    assert page.addresses == []
    assert page.headings[0].startswith("100 % of 6 runs identified")
    assert "No wrong answer in 6 runs (fewer than 39.4 % with 95 % confidence)." in page.words
    assert {f"{state['object']}, {state['state']}" for state in told.json["states"]} <= set(page.words)
    shown = run(*words, "--report", "study.html", cwd=tmp_path)
    assert (shown.code, shown.err) == (0, "")
    first, *_, last = shown.out.splitlines()
    assert first == f"6 runs, rig bench, {len(told.json['states'])} of 6 states drawn, parts that move:"
    assert last == "report study.html, runs runs.jsonl"
    refused = run("study", "--runs", 1, "--keep", "nowhere/runs.jsonl", cwd=tmp_path)
    assert (refused.code, refused.err.count("\n")) == (2, 1)


def test_parts_that_do_not_fit_into_the_workspace_are_counted() -> None:
    objects = load_objects(shipped_objects())
    rig = load_rig(shipped_rig())
    assert rig.emulation is not None
    narrow = rig.model_copy(update={"workspace": rig.workspace.model_copy(update={"radius_mm": 40.0})})
    counts = []
    for one in (rig, narrow):
        simulation = Simulation(*with_motion(one, objects, PartMotion.STILL), Strategy.RANDOM, 0)
        rows = [simulation.run(number) for number in range(3)]
        out = study_out(rows, objects="shipped", rig="r", strategy=Strategy.RANDOM, seed=0)
        counts.append(out.sticking_out)
        assert ("parts sticking out" in "\n".join(study_lines(out, [10.0]))) is bool(out.sticking_out)
    assert counts[0] == 0
    assert counts[1] > 0
