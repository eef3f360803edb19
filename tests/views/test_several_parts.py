"""Several parts on one table, as people see them: page, moving picture, report, lists and lines of a run."""

import csv
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import shapely

from palpate.base.geometry.outlines import rings_of
from palpate.config.recognition_results import IdentificationOut
from palpate.jobs.session import open_session
from palpate.rig.session.logged_values import by_part, grip_records
from palpate.rig.session.recorded_session import open_samples
from palpate.views.answer import answer_lines, picture_facts, rest_words
from palpate.views.exports.csv_files import write_csv
from palpate.views.live.frames import FrameStore
from palpate.views.numerals import at_least, at_most
from palpate.views.run_scene import SceneFeed, frame_of, heaviest, widest_place
from support.commands.command import Here, log_events
from support.commands.pages import Page

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def session(recorded: Callable[[str], Path]) -> Path:
    return recorded("two parts")


@pytest.fixture(scope="module")
def answer(session: Path) -> IdentificationOut:
    return IdentificationOut.model_validate_json((session / "result.json").read_text())


@pytest.fixture(scope="module")
def frames(session: Path) -> list[dict[str, Any]]:
    store = FrameStore()
    store.take(open_samples(open_session(session).log, session))
    return list(map(json.loads, store.texts))


def bounds_in_words(answer: IdentificationOut, decimals: int) -> list[str]:
    """Ends of all parts' bounds on x and y, rounded outward."""
    pairs = [pair for part in answer.parts if part.bounds for pair in (part.bounds.x, part.bounds.y)]
    return [end for lo, hi in pairs for end in (at_least(lo, decimals), at_most(hi, decimals))]


def test_the_log_says_how_many_divisions_are_left_and_whose_hypotheses_are(session: Path) -> None:
    events = [item for item in log_events(session / "session.jsonl.zst") if item["event"] == "recognised"]
    assert all(event["divisions"] >= 1 for event in events)
    assert events[-1]["divisions"] == 1
    assert {item.get("part", 1) for item in events[-1]["hypotheses"]} == {1, 2}
    planned = [item for item in log_events(session / "session.jsonl.zst") if item["event"] == "planned"]
    assert all(item["approaches"] for item in planned)
    assert planned


def test_the_page_shows_each_part_with_its_hypotheses(
    frames: list[dict[str, Any]], answer: IdentificationOut
) -> None:
    known = [frame for frame in frames if frame["parts"]]
    assert known[0]["divisions"] >= 1
    for frame in known:
        assert [part["number"] for part in frame["parts"]] == sorted(
            {part["number"] for part in frame["parts"]}
        )
        for part in frame["parts"]:
            assert sum(item["weight"] for item in part["hypotheses"]) == pytest.approx(1.0, abs=1e-3)
    last = frames[-1]
    assert [part["hypotheses"][0]["object"] for part in last["parts"]] == [p.object for p in answer.parts]
    assert [part["verdict"] for part in last["parts"]] == [p.verdict.value for p in answer.parts]
    assert answer.table is not None
    assert last["rest"] == rest_words(answer.table)
    assert all(str(part.object) in last["answer"] for part in answer.parts)


def test_the_moving_picture_names_every_part_with_its_bounds(
    session: Path, answer: IdentificationOut, here: Here
) -> None:
    assert here("export", session, "--animation", "run.svg").code == 0
    root = ET.parse("run.svg").getroot()
    words = ["".join(item.itertext()) for item in root.iter(f"{SVG}text")]
    said = "\n".join(words)
    for part in answer.parts:
        assert any(f"{part.verdict.value}: {part.object}, {part.state}" in line for line in words)
    for end in bounds_in_words(answer, 2):
        assert end in said
    height = float(str(root.get("height")))
    assert all(float(str(item.get("y"))) < height for item in root.iter(f"{SVG}text"))


def test_the_report_has_a_table_for_each_part(session: Path, answer: IdentificationOut, here: Here) -> None:
    assert here("report", session, "--out", "report.html").code == 0
    text = Path("report.html").read_text(encoding="utf-8")
    page = Page(text)
    said = "\n".join(page.words)
    for number, part in enumerate(answer.parts, start=1):
        assert f"Part {number}, {part.verdict.value}: {part.object}, {part.state}" in page.headings
    for end in bounds_in_words(answer, 3):
        assert end in said
    for drawing in re.findall(r"<svg .*?</svg>", text, re.DOTALL):
        ET.fromstring(drawing)
    # Which touches are whose is not in the log, so nothing is said of why each rival fell.
    assert not any("rival" in name for name in page.headings)


def test_lists_of_sessions_name_every_part(session: Path, answer: IdentificationOut, here: Here) -> None:
    found = json.loads(here("info", session, "--json").out)
    assert [(item["verdict"], item["object"], item["state"]) for item in found["parts"]] == [
        (part.verdict.value, part.object, part.state) for part in answer.parts
    ]
    assert all(f"{part.object}, {part.state}" in here("info", session).out for part in answer.parts)


def test_the_answer_says_last_what_else_may_lie_there(answer: IdentificationOut) -> None:
    lines = answer_lines(answer)
    assert answer.table is not None
    assert lines[-1] == rest_words(answer.table)
    assert sum(line.startswith("part ") for line in lines) == len(answer.parts)
    facts = dict(picture_facts(answer))
    for part in answer.parts:
        shown, half = facts[f"{part.object}, θ"].replace("−", "-").removesuffix("°").split(" ± ")
        assert part.bounds is not None
        lo, hi = (57.29577951308232 * value for value in part.bounds.theta)
        assert float(shown) - float(half) <= lo <= hi <= float(shown) + float(half)


def test_of_each_part_some_hypotheses_are_drawn(session: Path) -> None:
    records = [item for item in grip_records(open_session(session).log) if item.hypotheses]
    for grip in records:
        assert {item.part for item in heaviest(grip.hypotheses, 2)} == {item.part for item in grip.hypotheses}
        assert all(own[0].weight == max(item.weight for item in own) for own in by_part(grip.hypotheses))


def test_names_stand_inside_of_outlines() -> None:
    ring = shapely.box(0, 0, 60, 40).difference(shapely.box(10, 10, 60, 30)).union(shapely.box(70, 0, 71, 1))
    assert shapely.Point(widest_place(rings_of(ring))).within(ring)


def test_every_part_has_a_frame_and_rows_of_its_own(session: Path, tmp_path: Path) -> None:
    samples = open_samples(open_session(session).log, session)
    feed = SceneFeed(samples.rig, samples.objects)
    scenes = [scene for sample in samples if (scene := feed.take(sample)) is not None]
    assert [frame_of(item) for item in scenes[-1].parts] == ["part", "part-2"]
    write_csv(samples, tmp_path / "csv")
    with (tmp_path / "csv" / "hypotheses.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if not row["grip"]]
    assert [(row["object"], row["part"]) for row in rows] == [("tr-1", "1"), ("grip", "2")]
