"""The calibration report: one well-formed page, its pictures in their frames, its bounds never inwards."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from calibration_example import calibration_example
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.config.calibration_file import CalibrationFile
from palpate.errors import InputError
from palpate.views.calibration.histogram import draw_histograms
from palpate.views.calibration.numbers import at_most, plus_minus
from palpate.views.calibration.report import report_html, write_report
from palpate.views.calibration.residual_map import draw_map
from palpate.views.calibration.taxel_map import draw_taxels
from palpate.views.calibration.values import MEASURED, NEVER_PRESSED, Mark, MarkMap, Spread, TaxelMap
from palpate.views.label_placement import Box
from palpate.views.scene.values import FingerBase
from palpate.views.svg import text_width

NS = "{http://www.w3.org/2000/svg}"


def pictures(page: str) -> list[str]:
    return re.findall(r"<svg.*?</svg>", page, re.DOTALL)


def text_boxes(svg: str) -> list[tuple[str, Box]]:
    """Where every line of text is, at most."""
    found = []
    for item in ET.fromstring(svg).iter(f"{NS}text"):
        content, size = item.text or "", float(item.attrib["font-size"])
        width = text_width(content, size, bold="font-weight" in item.attrib)
        shift = {"middle": 0.0, "end": -width / 2}.get(item.attrib.get("text-anchor", ""), width / 2)
        at = (float(item.attrib["x"]) + shift, float(item.attrib["y"]) - 0.35 * size)
        found.append((content, Box(*at, width, 0.8 * size)))
    return found


def assert_legible(svg: str) -> None:
    """All texts are in the picture, large enough, and none covers another one."""
    root = ET.fromstring(svg)
    _, _, width, height = map(float, root.attrib["viewBox"].split())
    assert root.attrib["role"] == "img"
    assert [child.tag for child in root][:2] == [f"{NS}title", f"{NS}desc"]
    assert "nan" not in svg
    assert "inf" not in svg
    boxes = text_boxes(svg)
    for content, box in boxes:
        assert box.left >= -1, content
        assert box.left + box.width <= width + 1, content
        assert box.top >= -1, content
        assert box.top + box.height <= height + 1, content
    for index, (content, box) in enumerate(boxes):
        for other, beside in boxes[index + 1 :]:
            assert not box.overlaps(beside), (content, other)
    assert all(float(item.attrib["font-size"]) >= 11 for item in root.iter(f"{NS}text"))


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
    assert not re.search(r'(src|href)="', page)
    assert len(pictures(page)) == 2 + len(example.fingers)
    body = page[page.index("<body>") : page.index("</html>")]
    ET.fromstring(body)  # tags are closed in order


def test_a_place_that_cannot_be_written_is_refused(example: CalibrationFile, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be written"):
        write_report(tmp_path / "nowhere" / "report.html", example)


@pytest.mark.parametrize(
    "file",
    [
        calibration_example(),
        calibration_example(3, rows=6, cols=14, off_mm=0.0),
        calibration_example(4, rows=3, cols=64, off_mm=0.4, names=("left & upper", "<b>", "W" * 60)),
    ],
    ids=["usual", "no residuals", "odd"],
)
def test_pictures_are_legible(file: CalibrationFile) -> None:
    page = report_html(file)
    for svg in pictures(page):
        assert_legible(svg)
    assert "<b>" not in page


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
    for svg in pictures(report_html(some)):
        assert_legible(svg)


def test_the_map_tells_kinds_apart_and_cuts_long_arrows() -> None:
    marks = tuple(
        Mark(0, 0, (20.0 * k, 5.0), 0.5, off, held_out=k == 1, outlier=k == 2)
        for k, off in enumerate((0.01, -0.02, 0.9, 0.015))
    )
    svg = draw_map(MarkMap(("f1",), (FingerBase("f1", (0.0, 190.0)),), marks))
    words = [item.text or "" for item in ET.fromstring(svg).iter(f"{NS}title")]
    assert "placing 0, held out, residual −0.020 mm" in words
    assert "placing 0, left out as an outlier, residual +0.900 mm" in words
    assert "residual longer than drawn" in svg
    lines = [item for item in ET.fromstring(svg).iter(f"{NS}line") if "stroke-dasharray" in item.attrib]
    assert len(lines) == 2  # the outlier's arrow, and the legend's
    assert "residual longer than drawn" not in draw_map(MarkMap(("f1",), (), marks[:2]))


def test_an_arrow_points_along_the_normal_and_is_as_long_as_stated() -> None:
    marks = tuple(Mark(0, 0, (x, 0.0), np.pi / 2, 0.02, held_out=False, outlier=False) for x in (0.0, 100.0))
    svg = draw_map(MarkMap(("f1",), (), marks))
    root = ET.fromstring(svg)
    arrow = next(item for item in root.iter(f"{NS}g") if "placing" in "".join(item.itertext())).find(
        f"{NS}line"
    )
    assert arrow is not None
    x1, y1, x2, y2 = (float(arrow.attrib[key]) for key in ("x1", "y1", "x2", "y2"))
    assert x1 == x2
    dots = [item for item in root.iter(f"{NS}circle") if item.attrib["r"] == "3.2"]
    first, second = dots[:2]  # the legend's come last
    per_mm = (float(second.attrib["cx"]) - float(first.attrib["cx"])) / 100
    stated = re.search(r"drawn (\d+) times", svg)
    assert stated is not None
    assert y1 - y2 == pytest.approx(0.02 * float(stated[1]) * per_mm, abs=0.03)  # y downwards


def test_histograms_count_every_residual_and_say_what_is_beyond() -> None:
    rng = np.random.default_rng(2)
    fitted, held = rng.normal(0, 0.02, 40), np.array([0.11, -0.01])
    svg = draw_histograms((Spread("f1", fitted, held, 3, 0.1),))
    assert "40 fitted, 2 held out" in svg
    assert "bound ± 0.100 mm, 1 beyond" in svg
    assert "outliers, not shown: 3" in svg
    bars = [
        item
        for item in ET.fromstring(svg).iter(f"{NS}rect")
        if item.attrib.get("stroke") and float(item.attrib["y"]) > 30
    ]
    unit = min(float(item.attrib["height"]) for item in bars)
    assert sum(float(item.attrib["height"]) for item in bars) / unit == pytest.approx(42, abs=0.2)
    assert_legible(draw_histograms((Spread("f1", np.empty(0), np.empty(0), 0, None),)))


def test_taxels_by_kind() -> None:
    kinds = ((MEASURED, "dead", NEVER_PRESSED), (MEASURED, "hot", "unresponsive"))
    gain = np.array([[0.9, 1.0, 1.0], [1.12, 1.0, 1.0]])
    svg = draw_taxels(TaxelMap("f1", gain, np.full((2, 3), 0.0301), kinds))
    words = [item.text for item in ET.fromstring(svg).iter(f"{NS}title")]
    assert "row 1, column 0: gain 1.120 ± 3.1 %" in words
    assert "row 0, column 1: dead" in words
    for line in ("measured: 2, median ± 3.1 %", "dead: 1", "hot: 1", "unresponsive: 1", "never pressed: 1"):
        assert line in svg


def test_what_was_never_pressed_is_told_by_its_bound(example: CalibrationFile) -> None:
    page = report_html(example)
    assert page.count(">never pressed: 24<") == 3  # three columns of eight, for three fingers
    assert page.count(">measured: 134, median") == 3


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
