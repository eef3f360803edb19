"""Pictures of scenes and of pads."""

import csv
import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from shapely.affinity import rotate, translate
from shapely.geometry import Point, Polygon

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import points_in_polygon
from palpate.config import load_objects, shipped_objects
from palpate.rig.session.archive import summary_of
from palpate.rig.session.log_reader import read_session
from palpate.rig.session.recorded_session import EventSample, open_samples
from palpate.views.exports.csv_files import write_csv
from palpate.views.live.frames import FrameStore, setting_of
from palpate.views.report.run import run_report
from palpate.views.svg import number, shorten, text_width, wrap
from palpate.views.table_picture.approaches import lanes
from palpate.views.table_picture.frame import Box, LabelPlacer, View, nice_step, view_of
from palpate.views.table_picture.picture import draw
from palpate.views.table_picture.values import (
    ApproachArrow,
    BoundedPose,
    FingerBase,
    OtherHypothesis,
    Picture,
    PredictedStop,
    TouchMark,
)
from support.commands.command import log_events
from support.commands.pages import Page

# ----------------------------------------------------------------------------------------------------
# The picture: well-formed, deterministic, in its frame, honest in its numbers, labels in free places.

NS = "{http://www.w3.org/2000/svg}"
SQUARE = np.array([[-20.0, -10.0], [20.0, -10.0], [20.0, 10.0], [-20.0, 10.0]])
HOLE = np.array([[-5.0, -5.0], [-5.0, 5.0], [5.0, 5.0], [5.0, -5.0]])


def turned(ring: Floats, x: float, y: float, theta: float) -> Floats:
    cos, sin = math.cos(theta), math.sin(theta)
    result: Floats = ring @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
    return result


def picture(scale: float = 1.0, others: int = 2) -> Picture:
    rng = np.random.default_rng(5)
    touches = (
        TouchMark("f1", 1, (0.0, 80 * scale), (0.0, 15 * scale), 5 * scale, True, (1.4, 1.8)),
        TouchMark("f2", 1, (-80 * scale, 0.0), (-25 * scale, 0.0), 5 * scale, True),
        TouchMark("f2", 2, (-80 * scale, -40 * scale), (150 * scale, -40 * scale), 5 * scale, False),
    )
    return Picture(
        title="plate, flat: identified",
        subtitle=("emulated bench, seed 7",),
        found=(SQUARE * scale, HOLE * scale),
        pose=BoundedPose((0.0, -0.1, 0.1), (0.0, -0.1, 0.1), (0.0, -0.01, 0.01)),
        truth=(SQUARE * scale + 0.1 * scale,),
        others=tuple(
            OtherHypothesis(
                f"part-{k}",
                "ruled out by grip 2",
                (turned(SQUARE * scale, *rng.normal(0, 5 * scale, 2), rng.uniform(-3, 3)),),
            )
            for k in range(others)
        ),
        touches=touches,
        bases=(FingerBase("f1", (0.0, 190 * scale)), FingerBase("f2", (-190 * scale, 0.0))),
        workspace_radius_mm=125 * scale,
        facts=(("grips", "2"),),
    )


def texts(svg: str) -> list[str]:
    return [item.text or "" for item in ET.fromstring(svg).iter(f"{NS}text")]


def drawn_within_its_frame(shown: Picture) -> str:
    """The picture as text: accessible, the same each time, its texts within the frame."""
    svg = draw(shown)
    root = ET.fromstring(svg)
    assert root.tag == f"{NS}svg"
    assert root.attrib["role"] == "img"
    assert [child.tag for child in root][:2] == [f"{NS}title", f"{NS}desc"]
    assert [word for word in ("nan", "inf", "-0 ") if word in svg] == []
    width, height = (float(v) for v in root.attrib["viewBox"].split()[2:])
    for item in root.iter(f"{NS}text"):
        assert 0 < float(item.attrib["x"]) < width
        assert 0 < float(item.attrib["y"]) < height
    assert draw(shown) == svg
    return svg


@pytest.mark.parametrize(("scale", "others"), [(0.2, 0), (1.0, 1), (5.0, 5), (1.0, 30)])
def test_is_one_accessible_svg_with_finite_coordinates(scale: float, others: int) -> None:
    drawn_within_its_frame(picture(scale, others))


def test_y_points_upwards_and_scale_is_one() -> None:
    view = view_of(picture(), 50.0, 60.0)
    origin, right, up = (view.at(p) for p in ((0.0, 0.0), (10.0, 0.0), (0.0, 10.0)))
    np.testing.assert_allclose(right - origin, [10 * view.scale, 0], atol=1e-9)
    np.testing.assert_allclose(up - origin, [0, -10 * view.scale], atol=1e-9)


def test_window_holds_outlines_and_contacts_and_a_far_miss_does_not_shrink_them() -> None:
    shown = picture()
    view = view_of(shown, 0.0, 0.0)
    for ring in (*shown.found, *shown.truth, *(ring for other in shown.others for ring in other.rings)):
        assert all(view.holds((x, y)) for x, y in ring.tolist())
    assert all(view.holds(touch.end_mm) for touch in shown.touches if touch.touched)
    assert view.x_mm[1] - view.x_mm[0] < 120


def test_found_outline_is_drawn_where_it_is_with_its_hole() -> None:
    shown = picture()
    root = ET.fromstring(draw(shown))
    (found,) = [item for item in root.iter(f"{NS}path") if item.get("fill-rule") and item.get("fill-opacity")]
    assert found.attrib["fill-rule"] == "evenodd"
    assert found.attrib["d"].count("M") == 2
    first = found.attrib["d"][1:].split("Z", maxsplit=1)[0].split()
    corners = np.array([[float(v) for v in pair.split(",")] for pair in first])
    (clip,) = root.iter(f"{NS}clipPath")
    frame = clip[0].attrib
    scale = float(frame["width"]) / np.ptp(view_of(shown, 0, 0).x_mm)
    np.testing.assert_allclose(np.ptp(corners, axis=0), [40 * scale, 20 * scale], atol=0.03)


def test_bounds_are_rounded_outward_about_the_value_shown() -> None:
    pose = BoundedPose((1.004, 0.9, 1.0641), (-2.0, -2.0, -2.0), (0.0, 0.0, math.radians(0.101)))
    shown = texts(draw(replace(picture(), pose=pose)))
    at = shown.index("x", shown.index("Configuration and certified bounds"))
    assert shown[at + 1 : at + 3] == ["1.00 mm", "± 0.10 mm"]
    assert shown[at + 4 : at + 6] == ["−2.00 mm", "± 0.00 mm"]
    assert shown[at + 7 : at + 9] == ["0.00°", "± 0.11°"]


@pytest.mark.parametrize(("count", "drawn"), [(0, 0), (5, 5), (12, 12), (30, 12)])
def test_every_hypothesis_drawn_has_its_letter_twice_and_the_rest_are_counted(count: int, drawn: int) -> None:
    shown = texts(draw(picture(others=count)))
    letters = [chr(ord("a") + k) for k in range(drawn)]
    assert all(shown.count(letter) == 2 for letter in letters if letter not in "xy")
    assert ("and 18 more, not drawn" in shown) == (count == 30)
    assert shown.count("ruled out by grip 2") == drawn


def test_whatever_a_name_holds_is_escaped_and_long_names_are_shortened() -> None:
    nasty = '<script>&"\x00\x1b' + "very long name " * 20
    shown = picture()
    svg = draw(
        replace(
            shown,
            title=nasty,
            subtitle=(nasty,),
            others=(replace(shown.others[0], label=nasty, reason=nasty),),
            touches=tuple(replace(touch, finger=nasty) for touch in shown.touches),
            bases=(FingerBase(nasty, (500.0, 0.0)),),
            facts=((nasty, nasty),),
        )
    )
    root = ET.fromstring(svg)
    assert "<script" not in svg
    assert not list(root.iter(f"{NS}script"))
    width = float(root.attrib["viewBox"].split()[2])
    for item in root.iter(f"{NS}text"):
        room = {"end": float(item.attrib["x"])}.get(
            item.get("text-anchor", ""), width - float(item.attrib["x"])
        )
        bold = item.get("font-weight") == "bold"
        needed = text_width(item.text or "", float(item.attrib["font-size"]), bold=bold)
        assert needed * (0.5 if item.get("text-anchor") == "middle" else 1.0) <= room


def test_legend_names_only_what_is_drawn() -> None:
    bare = texts(draw(Picture("nothing known", touches=picture().touches[:1])))
    assert "object found" not in bare
    assert "approach that touched nothing" not in bare
    assert "approach, and the tip in contact" in bare
    full = texts(draw(picture()))
    for entry in (
        "object found",
        "where it really is (emulated)",
        "approach that touched nothing",
        "workspace",
    ):
        assert entry in full


def test_empty_picture_is_a_picture() -> None:
    assert texts(draw(Picture("no contacts yet")))[0] == "no contacts yet"


def test_all_shipped_models_can_be_drawn() -> None:
    for model in load_objects(shipped_objects()).objects:
        polygon = model.states[0].sections[0].polygons[0]
        rings = tuple(turned(ring, 3.0, -4.0, 0.7) for ring in (polygon.outer, *polygon.holes))
        ET.fromstring(draw(Picture(model.name, found=rings)))


def test_labels_keep_clear_of_lines_and_of_each_other() -> None:
    placer = LabelPlacer(Box(200, 200, 400, 400))
    line = np.array([[0.0, 200.0], [400.0, 200.0]])
    placer.add_line(line)
    anchor = np.array([200.0, 200.0])
    boxes = [placer.place(anchor, 40, 14, clear=6, towards=0.0) for _ in range(8)]
    for box in boxes:
        assert abs(box.y - 200) > box.height / 2
        assert 0 < box.left < 360
    assert not any(one.overlaps(two) for one, two in combinations(boxes, 2))


def test_points_in_polygon_follow_the_even_odd_rule() -> None:
    points = np.array([[0.0, 0.0], [10.0, 0.0], [30.0, 0.0]])
    assert points_in_polygon(points, [SQUARE, HOLE]).tolist() == [False, True, False]


@pytest.mark.parametrize(("span", "step"), [(10.0, 2.0), (1.0, 0.2), (260.0, 50.0), (99.0, 10.0)])
def test_steps_are_round(span: float, step: float) -> None:
    assert nice_step(span, 5.0) == pytest.approx(step)


def test_numbers_and_text_fit() -> None:
    assert [number(v) for v in (-0.001, 1.0, 2.345678, 100.0)] == ["0", "1", "2.35", "100"]
    assert shorten("short", 12, 100) == "short"
    assert text_width(shorten("m" * 50, 12, 60), 12) <= 60
    assert wrap("one two three", 12, 50, most_lines=2)[-1].endswith("…")


def plan(count: int, fingers: int = 2, name: str = "f") -> Picture:
    """A plan's picture: every third hypothesis foretells a miss, every fourth that it may miss."""
    rng = np.random.default_rng([count, fingers])
    approaches = []
    for k in range(fingers):
        start, foretold = (60 * math.cos(2 * k), 60 * math.sin(2 * k)), []
        for index in range(count):
            lo = float(rng.uniform(20, 45))
            stop = None if index % 3 == 2 else (lo, lo + float(rng.uniform(1, 12)))
            words = ("misses",) if stop is None else (f"{stop[0]:.1f} … {stop[1]:.1f}", "1 … 2°")
            foretold.append(PredictedStop(stop, stop is None or index % 4 == 0, words))
        words = ("1.0, 2.0", "3.0°", "70.0")
        approaches.append(
            ApproachArrow(f"{name}{k + 1}", start, 2 * k + math.pi, 70.0, 5.0, words, tuple(foretold))
        )
    return replace(
        picture(others=count),
        found=(),
        pose=None,
        truth=(),
        facts=(("strategy", "planned"),),
        approaches=tuple(approaches),
    )


@pytest.mark.parametrize(("count", "fingers"), [(1, 1), (2, 3), (8, 5), (40, 3)])
def test_a_plan_of_any_size_is_drawn_within_its_frame(count: int, fingers: int) -> None:
    shown = texts(drawn_within_its_frame(plan(count, fingers)))
    assert [shown.count(f"next: f{k + 1}") for k in range(fingers)] == [1] * fingers
    assert (f"and {count - 12} more, not drawn" in shown) == (count > 12)


@pytest.mark.parametrize("count", [1, 3, 8])
def test_bars_lie_where_hypotheses_foretell_the_stop(count: int) -> None:
    """Read back from the page: along each way, both ends of a bar are at the travels foretold."""
    shown = plan(count)
    root = ET.fromstring(draw(shown))
    view = drawn_view(root, shown)
    for approach in shown.approaches:
        start, end = view.at(approach.start_mm), view.at(approach.at(approach.travel_mm))
        along = (end - start) / np.hypot(*(end - start))
        for index, told in enumerate(approach.predictions):
            bars = [
                [(float(item.attrib[f"x{k}"]), float(item.attrib[f"y{k}"])) for k in (1, 2)]
                for item in root.iter(f"{NS}line")
                if item.get("stroke") == shown.colour(index) and item.get("stroke-width") in {"4.5", "3"}
            ]
            read = [((np.array(bar) - start) @ along / view.scale).tolist() for bar in bars]
            fits = [np.allclose(pair, told.stop_mm, atol=0.02) for pair in read if told.stop_mm is not None]
            assert fits.count(True) == (told.stop_mm is not None)


def drawn_view(root: ET.Element, shown: Picture) -> View:
    """The window as it was drawn: made taller, so that its middle is that of `view_of`."""
    (clip,) = root.iter(f"{NS}clipPath")
    left, top, height = (float(clip[0].attrib[key]) for key in ("x", "y", "height"))
    return view_of(shown, left, top).taller(height)


def test_window_holds_the_stops_of_a_plan() -> None:
    shown = plan(6, 3)
    view = view_of(shown, 0.0, 0.0)
    for approach in shown.approaches:
        ends = [end for told in approach.predictions if told.stop_mm is not None for end in told.stop_mm]
        assert all(view.holds(approach.at(end)) for end in ends)


@pytest.mark.parametrize("seed", range(10))
def test_no_two_stops_of_one_lane_overlap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stops = [(k, lo, lo + w) for k, (lo, w) in enumerate(rng.uniform(0, 20, (9, 2)).tolist())]
    taken = lanes(stops, 1.0)
    for (one, in_one), (two, in_two) in combinations(zip(stops, taken, strict=True), 2):
        if in_one == in_two:
            assert one[2] + 1.0 < two[1] or two[2] + 1.0 < one[1]
    assert lanes(stops[:1], 1.0) == [0]
    assert sorted(set(taken)) == [*range(min(taken), max(taken) + 1)]


def test_names_in_a_plan_are_escaped_and_shortened() -> None:
    svg = draw(plan(3, 2, '<b>&"' + "very long finger " * 9))
    assert "<b>" not in svg
    assert ET.fromstring(svg) is not None


def test_legend_of_a_plan_names_what_is_drawn() -> None:
    shown = texts(draw(plan(2, 1)))
    assert "approach of the next grip" in shown
    assert "predicted stop of a hypothesis" in shown
    assert "object found" not in shown
    assert "other hypothesis, by letter" not in shown
    assert "approach of the next grip" not in texts(draw(picture()))


def test_of_a_round_part_theta_is_any() -> None:
    pose = BoundedPose((1.0, 0.9, 1.1), (-2.0, -2.1, -1.9), (0.3, -math.pi, math.pi))
    shown = texts(draw(replace(picture(), pose=pose)))
    assert shown[shown.index("θ") + 1] == "any"
    assert "its origin" in shown
    assert "its frame: origin and x axis" not in shown


def test_a_pad_is_a_line_across_its_way() -> None:
    shown = picture()
    pads = replace(shown, touches=tuple(replace(touch, has_face=True) for touch in shown.touches))
    before, after = (
        [item.attrib for item in ET.fromstring(draw(item)).iter(f"{NS}line")] for item in (shown, pads)
    )
    new = [line for line in after if line not in before]
    faces = [line for line in new if line["stroke-width"] == "3"][:-1]  # the legend's is the last
    assert len(faces) == len(shown.touches)
    first = {name: float(faces[0][name]) for name in ("x1", "y1", "x2", "y2")}
    assert first["y1"] == pytest.approx(first["y2"]), "f1 comes from above"
    other = {name: float(faces[1][name]) for name in ("x1", "y1", "x2", "y2")}
    assert other["x1"] == pytest.approx(other["x2"]), "f2 comes from the left"
    lengths = [math.dist((x["x1"], x["y1"]), (x["x2"], x["y2"])) for x in (first, other)]
    assert lengths[0] == pytest.approx(lengths[1], abs=0.05)


# ----------------------------------------------------------------------------------------------------
# What people and files are shown of a pad's touches: the touched points, each where the part really is.


@pytest.fixture(scope="module")
def session(recorded: Callable[[str], Path]) -> Path:
    return recorded("two grips with pads")


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


MARK = TouchMark("f1", 1, (0.0, 80.0), (0.0, 15.0), 5.0, True, has_face=True, points_mm=((-4.75, 15.0),))


def test_pictures_mark_where_pads_were_touched() -> None:
    pads = Picture("pads", touches=(MARK, replace(MARK, grip=2, end_mm=(0.0, -70.0), touched=False)))
    svg = draw(pads)
    assert "approach, pad, and where it was touched" in svg
    assert "approach, and the tip in contact" not in svg
    assert 'stroke-linecap="butt"' in svg, "a miss has swept what its face passed, and no round end"
    both = draw(replace(pads, touches=(MARK, replace(MARK, finger="f2", has_face=False, points_mm=()))))
    assert "approach, pad, and where it was touched" in both
    assert "approach, and the tip in contact" in both
    moved = draw(replace(pads, touches=(replace(MARK, points_mm=((4.75, 15.0),)), *pads.touches[1:])))
    assert moved != svg
