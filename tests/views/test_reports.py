"""Reports of sessions and of calibrations."""

import json
import re
import shutil
import sys
import xml.etree.ElementTree as ET
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.config.calibration_file import CalibrationFile
from palpate.config.recognition_results import IdentificationOut
from palpate.views.answer import headline
from palpate.views.numerals import at_most, decimal
from palpate.views.report.calibration import (
    finger_tables,
    never_pressed,
    plus_minus,
    report_html,
    residuals_mm,
    write_report,
)
from palpate.views.report.calibration_plots import residual_histograms, residual_map, svg, taxel_gains
from support.benches.calibration_files import calibration_example
from support.commands.command import Here, log_events, log_lines, write_log
from support.commands.pages import Page

# ----------------------------------------------------------------------------------------------------
# The report of a run: one well-formed page that needs nothing else and says what the log says.


@pytest.fixture(scope="module")
def session(recorded: Callable[[str], Path]) -> Path:
    return recorded("two grips")


def report_of(here: Here, session: Path) -> tuple[str, Page]:
    ended = here("report", session, "--out", "report.html")
    assert (ended.code, ended.err, ended.out) == (0, "", "report.html\n")
    text = Path("report.html").read_text(encoding="utf-8")
    return text, Page(text)


def says_what_the_log_says(session: Path, text: str, page: Page) -> None:
    events = log_events(session / "session.jsonl.zst")
    (result,) = [event["result"] for event in events if event["event"] == "result"]
    assert page.headings[0].startswith(headline(IdentificationOut.model_validate(result)))
    grips = [event["grip"] for event in events if event["event"] == "touches"]
    assert [name for name in page.headings if name.startswith("Grip")] == [f"Grip {n}" for n in grips]
    words = "\n".join(page.words)
    for name, value in result["configuration"].items():
        assert name == "theta" or decimal(value, 3) in words
    for event in events:
        for touch in event.get("touches", ()):
            assert f"{touch['contact']['end_mm'][0]:.2f}" in words
    models = {event["object"] for event in events if event["event"] == "truth"}
    assert models <= set(re.split(r"[, ;:\n]", words))
    assert len(re.findall("<svg ", text)) == 1 + len(grips)


def has_a_row_for_every_state_that_is_not_left(session: Path, page: Page) -> None:
    events = log_events(session / "session.jsonl.zst")
    last = [event for event in events if event["event"] == "recognised"][-1]
    left = {f"{item['object']}, {item['state']}" for item in last["hypotheses"]}
    import palpate

    states = {
        f"{model.name}, {state.name}"
        for model in palpate.load_objects(session / "objects.json").objects
        for state in model.states
    }
    begin = page.words.index("Why each rival fell")
    rows = set(page.words[begin : page.words.index("Timing")])
    assert states - left <= rows
    assert not left & rows


def asks_nothing_of_elsewhere(text: str, page: Page) -> None:
    assert "default-src 'none'" in text
    assert page.addresses == []
    assert "url(" not in text.replace("url(#", "")
    assert "@import" not in text
    for drawing in re.findall(r"<svg .*?</svg>", text, re.DOTALL):
        ET.fromstring(drawing)


def has_ids_that_differ(text: str) -> None:
    ids = re.findall(r' id="([^"]+)"', text)
    assert len(ids) == len(set(ids))


def test_the_report_of_a_whole_run(session: Path, here: Here) -> None:
    text, page = report_of(here, session)
    says_what_the_log_says(session, text, page)
    has_a_row_for_every_state_that_is_not_left(session, page)
    asks_nothing_of_elsewhere(text, page)
    has_ids_that_differ(text)


def test_a_run_that_was_killed_is_reported_as_far_as_it_went(
    session: Path, tmp_path: Path, here: Here
) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(session, folder)
    (folder / "picture.svg").unlink()
    lines = log_lines(session / "session.jsonl.zst")
    (end,) = [k for k, line in enumerate(lines) if '"event":"touches","grip":2' in line]
    write_log(folder / "session.jsonl.zst", lines[:end])
    _, page = report_of(here, folder)
    assert page.headings[0].startswith("No answer")
    assert "ended    killed" in "\n".join(page.words)
    assert "Grip 2" in page.headings


def test_names_are_text(session: Path, tmp_path: Path, here: Here) -> None:
    """An object may be called anything printable."""
    folder = tmp_path / "odd"
    shutil.copytree(session, folder)
    (folder / "picture.svg").unlink()
    odd = "<script>alert(1)</script>&amp;"
    objects = (folder / "objects.json").read_text()
    name = next(event for event in log_events(folder / "session.jsonl.zst") if event["event"] == "truth")
    old = f'"{name["object"]}"'
    assert old in objects
    (folder / "objects.json").write_text(objects.replace(old, f'"{odd}"'))
    lines = log_lines(session / "session.jsonl.zst")
    write_log(folder / "session.jsonl.zst", [line.replace(old, f'"{odd}"') for line in lines])
    text, page = report_of(here, folder)
    assert "<script" not in text
    assert any(odd in word for word in page.words)


def test_a_catalogue_is_reported_with_every_pair_and_every_state(here: Here, tmp_path: Path) -> None:
    outline = [[0, 0], [60, 0], [60, 20], [22, 20], [22, 45], [0, 45]]
    parts = [
        {"name": name, "height": 20.0, "outline": outline, "tolerance": tolerance}
        for name, tolerance in (("ell", 0.1), ("<b>ell & again</b>", 0.2))
    ]
    parts.append({"name": "wedge", "height": 20.0, "outline": [[0, 0], [58, 8], [20, 47]]})
    Path("parts.json").write_text(
        json.dumps({"format": "palpate/objects@1", "units": "mm", "objects": parts})
    )
    done = here("objects", "check", "parts.json", "--report", "page.html", "--json")
    assert done.code == 1
    page = Page(Path("page.html").read_text(encoding="utf-8"))
    assert page.addresses == []
    assert page.headings == [
        "1 pair of states can never be distinguished",
        "Result",
        "Never distinguished",
        "States",
        "Sections",
        "Rig",
        "Versions",
    ]
    (pair,) = json.loads(done.out)["pairs"]
    assert {f"{pair[key]['object']}, flat" for key in ("first", "second")} <= set(page.words)
    assert page.words.count("wedge") >= 2, "in the table and on its card"
    done = here("objects", "check", "parts.json", "--report", "nowhere/page.html")
    assert (done.code, done.err.count("\n")) == (2, 1)


# ----------------------------------------------------------------------------------------------------
# The calibration report: one well-formed page with pictures, or numbers alone; bounds rounded outward.

NS = "{http://www.w3.org/2000/svg}"


def pictures(page: str) -> list[str]:
    encoded = re.findall(r'<img alt="[^"]+" src="data:image/svg\+xml;base64,([^"]*)"/>', page)
    return [b64decode(text).decode() for text in encoded]


def words(picture: str) -> list[str]:
    return ["".join(item.itertext()) for item in ET.fromstring(picture).iter(f"{NS}text")]


@pytest.fixture(scope="module")
def example() -> CalibrationFile:
    return calibration_example()


def test_the_page_needs_nothing_else(example: CalibrationFile, tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(path, example)
    page = path.read_text(encoding="utf-8")
    assert page == report_html(example)
    assert page.startswith("<!doctype html>")
    assert "<script" not in page
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert len(pictures(page)) == 2 + len(example.fingers)
    body = page[page.index("<body>") : page.index("</html>")]
    ET.fromstring(body)  # tags are closed in order


def test_a_place_that_cannot_be_written_is_refused(example: CalibrationFile, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_report(tmp_path / "nowhere" / "report.html", example)


@pytest.mark.parametrize(
    "file",
    [
        pytest.param(calibration_example(), marks=pytest.mark.campaign),
        calibration_example(3, rows=6, cols=14, off_mm=0.0),
        calibration_example(4, rows=3, cols=64, off_mm=0.4, names=("left & upper", "<b>", "W" * 60)),
    ],
    ids=["usual", "no residuals", "odd"],
)
def test_odd_calibrations_have_all_pictures(file: CalibrationFile) -> None:
    page = report_html(file)
    drawn = pictures(page)
    assert len(drawn) == 2 + len(file.fingers)
    for picture in drawn:
        assert "nan" not in picture
        assert words(picture)
    assert "<b>" not in page


def test_without_matplotlib_there_are_the_numbers_and_a_line(
    example: CalibrationFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(sys.modules, "palpate.views.report.calibration_plots", raising=False)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    page = report_html(example)
    assert pictures(page) == []
    assert page.count("[plots]") == 1
    for number in ("22 fitted, 1 held out", "1 dead, 1 hot", "outliers, left out", "Devices"):
        assert number in page


def test_what_was_not_calibrated_is_left_out(example: CalibrationFile) -> None:
    nothing = {"tactile": None, "actuators": None, "place": None, "bounds": None}
    bare = example.model_copy(
        update={"residuals": None, "fingers": [f.model_copy(update=nothing) for f in example.fingers]}
    )
    page = report_html(bare)
    assert pictures(page) == []
    assert "<h2>Fingers" not in page
    first = example.fingers[0].model_copy(update=nothing)
    some = example.model_copy(update={"fingers": [first, *example.fingers[1:]]})
    assert "<td>–</td>" in report_html(some)
    assert len(pictures(report_html(some))) == 1 + len(example.fingers)


def test_the_map_names_fingers_placings_and_residuals_too_long_to_draw(example: CalibrationFile) -> None:
    shown = words(svg(residual_map, example))
    assert {"1", "2", "3", "4"} <= set(shown)  # as `palpate calibrate` counts placings
    for finger in example.fingers:
        assert f"{finger.name}: 24 touches" in shown
    assert any("+0.310 mm" in line for line in shown)  # the outlier
    assert any("outlier" in line for line in shown)
    assert any("held out" in line for line in shown)


def test_histograms_show_every_finger_and_its_bound(example: CalibrationFile) -> None:
    shown = words(svg(residual_histograms, example))
    for finger in example.fingers:
        assert finger.bounds is not None
        assert any(finger.name in text and at_most(finger.bounds.position_mm, 3) in text for text in shown)
    for name in ["fitted", "held out", "residual, mm"]:
        assert name in shown


def test_residuals_are_counted_by_finger(example: CalibrationFile) -> None:
    fitted, held_out = residuals_mm(example, "f1")
    assert (len(fitted), len(held_out)) == (22, 1)  # and an outlier
    rows = dict(finger_tables(example)[0].rows)
    assert rows["touches"][0] == "22 fitted, 1 held out"
    assert rows["outliers, left out"][0] == "1"
    assert rows["beyond the bound on positions"][0] == "none"
    used = np.abs(fitted + held_out)
    assert f"largest {used.max():.3f} mm" in rows["residual"][0]


def test_taxels_by_kind(example: CalibrationFile) -> None:
    tactile = example.fingers[0].tactile
    assert tactile is not None
    assert never_pressed(tactile).sum() == 24  # three columns of eight
    rows = {name: row for table in finger_tables(example) for name, row in table.rows}
    assert rows["unusable taxels"][0] == "1 dead, 1 hot"
    assert rows["taxels never pressed"][0] == "24"
    assert rows["relative gain of taxels"][0].endswith("median bound ± 3.0 %")
    shown = words(svg(taxel_gains, tactile))
    for meaning in ("never pressed", "dead", "hot", "relative gain"):
        assert any(meaning in line for line in shown)


@settings(max_examples=60)
@given(bound=st.floats(1e-6, 50.0), decimals=st.integers(0, 5))
def test_bounds_are_never_rounded_inwards(bound: float, decimals: int) -> None:
    shown = float(at_most(bound, decimals))
    assert shown >= bound - 1e-8
    assert shown <= bound + 10.0**-decimals


@pytest.mark.parametrize(
    ("value", "sigma", "words"),
    [
        (270.0131, 0.00612, "270.0131 ± 0.0062"),
        (-0.0004, 0.012, "0.000 ± 0.012"),
        (-164.5, 1.2, "−164.5 ± 1.2"),
        (5.0, 0.0, "5.000 ± 0.000"),
        (100.0, 37.0, "100 ± 37"),
    ],
)
def test_a_value_has_the_decimals_of_its_deviation(value: float, sigma: float, words: str) -> None:
    assert plus_minus(value, sigma) == words
