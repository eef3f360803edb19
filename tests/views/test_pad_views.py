"""What people and files are shown of a pad's touches: the touched points, each where the part really is."""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import log_events
from recorded_run import two_grips
from report_page import Page
from repository import EXAMPLES
from shapely.affinity import rotate, translate
from shapely.geometry import Point, Polygon

from palpate.config import load_objects
from palpate.rig.session.archive import summary_of
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.recorded_session import EventSample, open_samples
from palpate.views.exports.csv_files import write_csv
from palpate.views.live.frames import FrameStore, setting_of
from palpate.views.report.run import run_report
from palpate.views.table_picture.picture import draw
from palpate.views.table_picture.values import Picture, TouchMark


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return two_grips(tmp_path_factory.mktemp("run"), rig=EXAMPLES / "pad-rig.toml")


@pytest.fixture(scope="module")
def events(session: Path) -> list[dict[str, Any]]:
    return log_events(session / "session.jsonl.zst")


@pytest.fixture(scope="module")
def points(session: Path) -> list[dict[str, Any]]:
    """Touched points in the file of contacts, which is the evidence."""
    grips = json.loads((session / "contacts.json").read_text(encoding="utf-8"))["grips"]
    return [item for grip in grips for item in grip["contacts"] if item["touched"]]


@pytest.fixture(scope="module")
def boundary(session: Path, events: list[dict[str, Any]]) -> Any:
    """Where the part's boundary really was: it lies still, and has upright walls."""
    (truth,) = [event for event in events if event["event"] == "truth"]
    models = {model.name: model for model in load_objects(session / "objects.json").objects}
    (state,) = [item for item in models[truth["object"]].states if item.name == truth["state"]]
    outer, *holes = state.sections[0].rings
    at = truth["configuration"]
    lies = rotate(Polygon(outer, holes), math.degrees(at["theta_rad"]), origin=(0, 0))
    return translate(lies, at["x_mm"], at["y_mm"]).boundary


def csv_rows(session: Path, folder: Path) -> list[dict[str, str]]:
    write_csv(open_samples(read_session(session), session), folder)
    with (folder / "contacts.csv").open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_exported_places_are_touched_within_their_bounds(
    session: Path, points: Sequence[dict[str, Any]], boundary: Any, tmp_path: Path
) -> None:
    rows = [row for row in csv_rows(session, tmp_path / "csv") if row["touched"] == "True"]
    assert len(rows) >= 4
    for row in rows:
        place = Point(float(row["x_mm"]), float(row["y_mm"]))
        assert boundary.distance(place) <= float(row["position_bound_mm"])
        assert row["normal_lo_rad"] == row["normal_hi_rad"] == "", "a pad measures none"
    shown = [(row["finger"], float(row["x_mm"]), float(row["y_mm"])) for row in rows]
    assert shown == [(item["finger"], *item["centre"]) for item in points]
    assert [float(row["position_bound_mm"]) for row in rows] == [item["position_bound"] for item in points]


def test_a_pads_own_contact_is_the_middle_of_its_face(events: Sequence[dict[str, Any]]) -> None:
    touches = [touch for event in events for touch in event.get("touches", ())]
    touched = [touch for touch in touches if touch["contact"]["touched"]]
    assert touched
    for touch in touched:
        points = [item for item in touch["points"] if item["touched"]]
        assert touch["contact"]["normal"] is None
        assert touch["contact"]["position_bound_mm"] < min(item["position_bound_mm"] for item in points)


def test_the_live_page_lists_the_points_and_draws_faces(
    session: Path, points: Sequence[dict[str, Any]]
) -> None:
    samples = open_samples(read_session(session), session)
    store = FrameStore()
    store.take(item for item in samples if isinstance(item, EventSample))
    contacts = json.loads(store.texts[-1])["contacts"]
    assert all(item["pad"] and item["normal"] is None for item in contacts)
    places = [place for item in contacts if item["touched"] for place in item["places"]]
    assert [place["at"] for place in places] == [item["centre"] for item in points]
    assert [place["bound"] for place in places] == [item["position_bound"] for item in points]
    fingers: Any = setting_of(samples.rig, samples.objects)["fingers"]
    assert all(finger["pad"] for finger in fingers)


def test_the_report_lists_the_points(session: Path, points: Sequence[dict[str, Any]]) -> None:
    samples = open_samples(read_session(session), session)
    page = Page(run_report(samples, summary_of(session), session))
    words = "\n".join(page.words)
    for item in points:
        assert item["finger"] in words
        assert f"{item['centre'][0]:.2f}" in words
    assert "It measures no normal" in words
    assert "range of the outward normal" not in words
    assert "approach, and the tip in contact" not in words


MARK = TouchMark("f1", 1, (0.0, 80.0), (0.0, 15.0), 5.0, True, is_pad=True, points_mm=((-4.75, 15.0),))


def test_pictures_mark_where_pads_were_touched() -> None:
    pads = Picture("pads", touches=(MARK, replace(MARK, grip=2, end_mm=(0.0, -70.0), touched=False)))
    svg = draw(pads)
    assert "approach, pad, and where it was touched" in svg
    assert "approach, and the tip in contact" not in svg
    assert 'stroke-linecap="butt"' in svg, "a miss has swept what its face passed, and no round end"
    both = draw(replace(pads, touches=(MARK, replace(MARK, finger="f2", is_pad=False, points_mm=()))))
    assert "approach, pad, and where it was touched" in both
    assert "approach, and the tip in contact" in both
    moved = draw(replace(pads, touches=(replace(MARK, points_mm=((4.75, 15.0),)), *pads.touches[1:])))
    assert moved != svg
