"""SVG drawings and their curves."""

import io
import math
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
import svgelements
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from palpate.base.errors import InputError
from palpate.base.geometry import Floats
from palpate.cad.curves import (
    MAX_CHORD_TURN_RAD,
    Arc,
    Bezier,
    DrawnCurve,
    bezier,
    bulge_curve,
    chords,
    control_hull,
    spline,
    transform_curve,
)
from palpate.cad.parts import Drawing
from palpate.cad.svg_files import read_svg

# ----------------------------------------------------------------------------------------------------
# SVG files: shapes against closed forms and svgelements' own points, units, and what is refused.

ROOT = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
PAGE = 'width="200mm" height="100mm" viewBox="0 0 200 100"'
SQUARE = '<rect x="10" y="20" width="30" height="20"/>'


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "part.svg"


def read(file: Path, body: str, page: str = PAGE, units: str | None = None) -> tuple[Drawing, ...]:
    file.write_text(f"<svg {ROOT} {page}>{body}</svg>", encoding="utf-8")
    return read_svg(file, units, 0.005).drawings


def shape(drawing: Drawing) -> shapely.MultiPolygon:
    return shapely.MultiPolygon([(drawing.outline.outer, list(drawing.outline.holes))])


def box(drawing: Drawing) -> list[float]:
    return [float(value) for value in shape(drawing).bounds]


@pytest.mark.parametrize(
    ("body", "area"),
    [
        (SQUARE, 600.0),
        ('<rect x="10" y="10" width="40" height="30" rx="5"/>', 1200 - (4 - math.pi) * 25),
        ('<rect x="10" y="10" width="40" height="30" rx="8" ry="99"/>', 1200 - (4 - math.pi) * 8 * 15),
        ('<circle cx="50" cy="50" r="20"/>', math.pi * 400),
        ('<ellipse cx="50" cy="50" rx="20" ry="4"/>', math.pi * 80),
        ('<polygon points="0,0 30,0 30,40"/>', 600.0),
        ('<polyline points="0 0 30 0 30 40 0 0" fill="none" stroke="red"/>', 600.0),
        ('<path d="M50 50h30v-40h-30z"/>', 1200.0),
        ('<path d="m50 50 30 0 0 -40"/><line x1="80" y1="10" x2="50" y2="50"/>', 600.0),
        ('<path d="M20 50a30 15 0 1 0 60 0A30 15 0 1 0 20 50"/>', math.pi * 450),
        ('<path d="M20 50A0 9 0 0 0 40 50V70z"/>', 200.0),
        ('<path d="M0 0q30 0 30 30h-30z"/>', 900 * 2 / 3 + 900 / 6),
        ('<path d="M0 0q15 0 15 15t15 15h-30z"/>', 450.0),
        ('<path d="M0 0c20 0 30 10 30 30h-30z"/>', 750.0),
        (
            '<path d="M0 0h10v10h-10zm20 0h10v10h-10z" transform="translate(9 9) scale(2 3)"/>',
            [600.0, 600.0],
        ),
        (
            '<g transform="rotate(30)"><circle cx="60" cy="10" r="5" transform="skewX(40)scale(3 1)"/></g>',
            75 * math.pi,
        ),
        (SQUARE + '<circle cx="20" cy="30" r="5"/>', 600 - math.pi * 25),
        # fill rules: a subpath that runs the same way as what it is in, and one that runs the other way
        ('<path d="M10 10H70V60H10z M20 20H40V40H20z"/>', 3000.0),
        ('<path d="M10 10H70V60H10z M20 20V40H40V20z"/>', 2600.0),
        ('<path fill-rule="evenodd" d="M10 10H70V60H10z M20 20H40V40H20z"/>', 2600.0),
        ('<path style="fill-rule:evenodd" d="M10 10H70V60H10z M20 20H40V40H20z"/>', 2600.0),
        ('<path fill="none" stroke="red" d="M10 10H70V60H10z M20 20H40V40H20z"/>', 2600.0),
        (
            f'<switch><foreignObject requiredExtensions="x"><p/></foreignObject><g>{SQUARE}</g>'
            '<circle r="9"/></switch>',
            600.0,
        ),
    ],
)
def test_area_of_every_shape(file: Path, body: str, area: float | list[float]) -> None:
    found = read(file, body)
    wanted = area if isinstance(area, list) else [area]
    for drawing, exact in zip(found, wanted, strict=True):
        whole = shape(drawing)
        assert whole.is_valid
        assert whole.area == pytest.approx(exact, abs=drawing.off_mm * whole.length + 1e-6)
        assert drawing.off_mm <= 0.005 + 1e-6


@pytest.mark.parametrize(
    "body",
    [
        '<path d="M20 50c5 -30 40 -30 30 10s-10 20 -30 -10z" transform="rotate(20 50 50)"/>',
        '<path d="M60 50a20 8 33 1 0 9 5z" transform="translate(40 9)skewY(20)"/>',
        '<path d="M20 50q20 -40 40 0T70 80z" transform="matrix(1 .3 -.2 1.2 30 -20)"/>',
        '<g transform="translate(80 60)scale(-1 1)"><ellipse rx="30" ry="9" transform="rotate(50)"/></g>',
    ],
)
def test_points_of_transformed_paths(file: Path, body: str) -> None:
    """svgelements' own points of each path are within the stated deviation; y is turned round."""
    (found,) = read(file, body)
    drawing = svgelements.SVG.parse(
        io.StringIO(f"<svg {ROOT} width='200' height='100'>{body}</svg>"), reify=False
    )
    (drawn,) = (element for element in drawing.elements() if isinstance(element, svgelements.Shape))
    own = svgelements.Path(*drawn.segments(transformed=False))
    points = np.array([(p.x, p.y) for p in (own.point(t) * drawn.transform for t in np.linspace(0, 1, 400))])
    ring = shapely.LinearRing(found.outline.outer)
    assert shapely.distance(shapely.points(points * (1, -1)), ring).max() <= found.off_mm + 1e-6


@pytest.mark.parametrize(
    ("page", "factor"),
    [
        ('width="200mm" height="100mm" viewBox="0 0 200 100"', 1.0),
        ('width="20cm" height="10cm" viewBox="0 0 400 200"', 0.5),
        ('width="4in" height="2in" viewBox="0 0 101.6 50.8"', 1.0),
        ('width="720pt" height="720pt"', 25.4 / 96),
        ('width="96px" viewBox="0 0 48 30"', 25.4 / 48),
        ('width="100mm" height="100mm" viewBox="0 0 100 50"', 1.0),
        ('width="100mm" height="100mm" viewBox="0 0 100 50" preserveAspectRatio="xMinYMin slice"', 2.0),
        ('width="10pc" height="400Q" viewBox="0 0 400 1e2"', 25.4 / 6 / 40),
    ],
)
def test_units_of_the_page(file: Path, page: str, factor: float) -> None:
    (found,) = read(file, SQUARE, page)
    assert np.ptp(found.outline.outer, axis=0) == pytest.approx([30 * factor, 20 * factor], rel=1e-9)
    assert box(found)[0] == pytest.approx(10 * factor)
    assert box(found)[3] == pytest.approx(-20 * factor)


@pytest.mark.parametrize(
    "page",
    ["", 'viewBox="0 0 9 9"', 'width="80" height="40" viewBox="0 0 9 9"', 'width="100%" height="auto"'],
)
def test_units_asked_for(file: Path, page: str) -> None:
    with pytest.raises(InputError, match=r"has no units: .*give units: mm, inch, m, or pt"):
        read(file, SQUARE, page)
    (found,) = read(file, SQUARE, page, units="inch")
    assert np.ptp(found.outline.outer, axis=0) == pytest.approx([30 * 25.4, 20 * 25.4])
    with pytest.raises(InputError, match=r"30000 mm.*it would be 30 mm if its unit were mm"):
        read(file, SQUARE, page, units="m")


def test_units_of_the_page_and_others_asked_for(file: Path) -> None:
    assert read(file, SQUARE, units="mm")
    assert read(file, SQUARE, 'width="3in" viewBox="0 0 80 80"', units="inch")
    with pytest.raises(InputError, match=r"is in mm \(its width and height\), not in inch: give no units"):
        read(file, SQUARE, units="inch")


def test_origin_of_the_view_is_the_top_left(file: Path) -> None:
    (found,) = read(file, SQUARE, 'width="200mm" height="100mm" viewBox="-5 8 200 100"')
    assert box(found) == pytest.approx([15, -32, 45, -12])


def test_what_is_not_seen_is_no_outline(file: Path) -> None:
    hidden = (
        '<style>.gone{display:none}</style><defs><rect id="r" width="9" height="9"/></defs>'
        '<rect class="gone" width="9" height="9"/><g display="none"><circle r="9"/></g>'
        '<g style="visibility:hidden"><circle r="8"/></g><circle r="7" fill="none"/>'
        '<clipPath id="c"><circle r="6"/></clipPath><mask><circle r="5"/></mask>'
        '<symbol><circle r="4"/></symbol>'
        '<marker><circle r="3"/></marker><pattern><circle r="2"/></pattern><text x="3" y="9">Part</text>'
    )
    (found,) = read(file, hidden + SQUARE)
    assert box(found) == pytest.approx([10, -40, 40, -20])
    with pytest.raises(InputError, match="holds no outlines"):
        read(file, hidden)


def test_what_is_left_out_is_counted(file: Path) -> None:
    body = (
        '<clipPath id="c"><circle r="6"/></clipPath><mask id="m"><circle r="5"/></mask>'
        '<text>Part</text><text>No. 2</text><image href="x.png"/>'
        '<g clip-path="url(#c)"><rect x="60" y="20" width="9" height="9"/></g>'
        '<rect x="80" y="20" width="9" height="9" style="fill:red;mask:url(#m)"/>'
        '<rect x="90" y="20" width="9" height="9" clip-path="none"/>'
        '<circle r="7" fill="none"/><circle r="8" visibility="hidden"/>'
    )
    file.write_text(f"<svg {ROOT} {PAGE}>{body}{SQUARE}</svg>", encoding="utf-8")
    assert sorted(read_svg(file, None, 0.005).left_out) == [
        "1 clip paths, which do not cut outlines here",
        "1 images",
        "1 masks",
        "2 hidden shapes, or without fill and stroke",
        "2 texts",
    ]


def test_a_user_unit_may_be_a_point(file: Path) -> None:
    """As in files of Illustrator, which have a viewBox in points and no width."""
    (found,) = read(file, SQUARE, 'viewBox="0 0 200 100"', units="pt")
    assert box(found) == pytest.approx([value * 25.4 / 72 for value in (10, -40, 40, -20)])


def test_used_shapes_are_where_they_are_used(file: Path) -> None:
    body = '<defs><rect id="r" width="9" height="5"/></defs>'
    found = read(
        file, body + '<use xlink:href="#r" x="20" y="30"/><use href="#r" transform="scale(2)" x="30"/>'
    )
    assert [drawing.name for drawing in found] == ["part-1", "part-2"]
    assert box(found[0]) == pytest.approx([60, -10, 78, 0])
    assert box(found[1]) == pytest.approx([20, -35, 29, -30])


def test_copies_of_copies_and_views_within_are_placed(file: Path) -> None:
    """By hand: matrices of SVG 2, 8.3 and 5.6; a view keeps its proportions and is centred."""
    pair = (
        '<g id="pair"><use href="#r" x="1"/><use href="#r" transform="translate(0 20) rotate(90)"/></g>'
        '<use id="twice" href="#pair" x="100" transform="scale(2)"/>'
    )
    views = "".join(
        f'<svg x="20" width="40" {view}><rect x="10" y="10" width="50" height="25"/></svg>'
        for view in ('y="10" height="20" viewBox="0 0 100 50"', 'y="50" height="40" viewBox="-10 0 100 50"')
    )
    found = read(file, f'<defs><rect id="r" width="10" height="6"/>{pair}</defs><use href="#twice"/>{views}')
    assert sorted(map(box, found)) == [
        pytest.approx(sides)
        for sides in ([24, -24, 44, -14], [28, -74, 48, -64], [188, -60, 200, -40], [202, -12, 222, 0])
    ]


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (
            '<path id="rim" d="M50 50h30v10l-29.7 -10"/>',
            r"path 'rim': open loop: gap of 0.3 mm between \(50, 50\) and \(50.3, 50\) mm from the top left",
        ),
        ('<path d="M50 50l30 30h-30l30 -30z"/>', r"path 1: an outline meets itself at \(65, 65\) mm"),
        (SQUARE + '<rect x="35" y="30" width="30" height="20"/>', r"rect 1 and rect 2: two outlines meet at"),
        ('<path id="x" d="M0 0L1 bad"/>', "path 'x' has d='M0 0L1 bad', which cannot be read"),
        ('<path d="M0 0C1 1 2 2 3"/>', "a <path> has d='M0 0C1 1 2 2 3', which"),
        ('<polygon points="1 2 3"/>', "a <polygon> has points='1 2 3'"),
        ('<circle r="1foo"/>', "a <circle> has r='1foo'"),
        ('<rect width="-1" height="3"/>', "a <rect> has width='-1'"),
        ('<g transform="spin(3)"><circle r="3"/></g>', r"a <g> has transform='spin\(3\)'"),
        ('<circle r="3" style="transform: scale(2)"/>', "a <circle> has style='transform"),
        ('<use href="#x"/>', "uses '#x', which is no shape of the file"),
        ('<symbol id="s"><circle r="3"/></symbol><use xlink:href="#s"/>', "uses '#s', which is no shape"),
        ('<use href="other.svg#x"/>', "uses 'other.svg#x', which is no shape of the file"),
        ('<circle r="1e300"/>', "finite numbers|longer than"),
        ('<circle r="0.2"/>', r"circle 1: the part at .* its largest side is 0.4 mm"),
        ("", "holds no outlines"),
    ],
)
def test_refused(file: Path, body: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as raised:
        read(file, body)
    assert str(file) in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("page", "said"),
    [
        ('width="wide" height="3mm"', "its width is 'wide'; needed is a length"),
        ('width="0mm" height="3mm"', "its width is '0mm'; needed is a length"),
        ('width="9mm" height="3mm" viewBox="0 0 9"', "its viewBox is '0 0 9'; needed are four numbers"),
        ('width="9mm" height="3mm" viewBox="0 0 -9 3"', "its viewBox is"),
        ('width="9mm" height="9mm" viewBox="0 0 9 3" preserveAspectRatio="none"', "stretches its viewBox"),
    ],
)
def test_page_that_cannot_be(file: Path, page: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read(file, SQUARE, page)


@pytest.mark.parametrize("content", [b"", b"\0\0", b"<svg", b"<html></html>", b"solid x", b"\xff\xfe<svg/>"])
def test_no_svg_file(file: Path, content: bytes) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        read_svg(file, None, 0.01)
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"no readable SVG file|is XML but no SVG|has no units") as raised:
        read_svg(file, None, 0.01)
    assert "\n" not in str(raised.value)


def test_long_faulty_path_is_refused_at_once(file: Path) -> None:
    """No grammar goes back and tries again."""
    for fault in ("M" + "1" * 20000 + "!", "M" + "1 " * 20000 + "!", "M0 0" + "z " * 20000 + "!"):
        with pytest.raises(InputError, match="cannot be read"):
            read(file, f'<path d="{fault}"/>')


def test_missing_extra_is_named(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "svgelements", None)
    with pytest.raises(
        InputError, match=r"reading SVG files needs svgelements: .* -m pip install .*\[cad\]'"
    ):
        read(file, SQUARE)


# ----------------------------------------------------------------------------------------------------
# Chords of curves keep what they state: seen by sampling the curves densely, with others' evaluators.

numbers = st.floats(-20, 20).map(lambda value: round(value, 3))
points = st.tuples(numbers, numbers)
tolerances = st.sampled_from([0.3, 0.05, 0.004])


def at(curve: DrawnCurve, share: Floats) -> Floats:
    """Points of a curve by its definition; `share` from 0 to 1."""
    if isinstance(curve, Arc):
        t = curve.start_rad + share * curve.sweep_rad
        return curve.centre + np.outer(np.cos(t), curve.axes[0]) + np.outer(np.sin(t), curve.axes[1])
    n = len(curve.points) - 1
    basis = np.array([math.comb(n, k) * share**k * (1 - share) ** (n - k) for k in range(n + 1)]).T
    weighted = basis * curve.weights
    return (weighted / weighted.sum(axis=1, keepdims=True)) @ curve.points


def check(curve: DrawnCurve, curve_mm: float) -> Floats:
    """The chords' ends are on the curve, in order, and it is within the stated deviation of them."""
    found, off = chords(curve, curve_mm)
    assert 0 <= off <= curve_mm * (1 + 1e-12)
    dense = at(curve, np.linspace(0, 1, 20 * len(found) + 1))
    drawn = shapely.LineString(found) if len(found) > 1 else shapely.Point(found[0])
    assert shapely.distance(shapely.points(dense), drawn).max() <= off + 1e-9
    spacing = np.hypot(*np.diff(dense, axis=0).T).max()
    assert shapely.distance(shapely.points(found), shapely.LineString(dense)).max() <= spacing**2 + 1e-9
    assert np.allclose(found[[0, -1]], at(curve, np.array([0.0, 1.0])), atol=1e-9)
    return found


@given(
    centre=points,
    axes=st.tuples(points, points),
    start=st.floats(-7, 7),
    sweep=st.floats(-2 * math.pi, 2 * math.pi).filter(lambda value: abs(value) > 0.01),
    curve_mm=tolerances,
)
@settings(max_examples=30)
def test_arcs_of_any_affine_circle(
    centre: tuple[float, float],
    axes: tuple[tuple[float, float], tuple[float, float]],
    start: float,
    sweep: float,
    curve_mm: float,
) -> None:
    check(Arc(np.array(centre), np.array(axes), start, sweep), curve_mm)


@given(control=st.lists(points, min_size=3, max_size=6), curve_mm=tolerances, data=st.data())
@settings(max_examples=30)
def test_bezier_curves_with_and_without_weights(
    control: list[tuple[float, float]], curve_mm: float, data: st.DataObject
) -> None:
    given_points = np.array(control)
    check(bezier(given_points), curve_mm)
    weights = data.draw(
        st.lists(st.sampled_from([0.2, 1.0, 3.0]), min_size=len(control), max_size=len(control))
    )
    check(Bezier(given_points, np.array(weights)), curve_mm)


@given(control=st.lists(points, min_size=3, max_size=5), curve_mm=tolerances)
@settings(max_examples=40)
def test_normals_differ_by_no_more_than_the_deviation_allows(
    control: list[tuple[float, float]], curve_mm: float
) -> None:
    """asin(4 · deviation / length of the chord), as a `CrossSection` promises."""
    curve = bezier(np.array(control))
    found, off = chords(curve, curve_mm)
    dense = at(curve, np.linspace(0, 1, 4001))
    steps = np.diff(dense, axis=0)
    middle = (dense[1:] + dense[:-1]) / 2
    edges = np.diff(found, axis=0)
    lengths = np.hypot(*edges.T)
    # The chord that each step of the curve belongs to, by where the chords' ends are on it.
    ends = np.array([np.hypot(*(dense - point).T).argmin() for point in found])
    assume(np.all(np.diff(ends) >= 2))
    for k in range(len(edges)):
        own = slice(ends[k] + 1, ends[k + 1] - 1)
        if 4 * off >= lengths[k] or len(middle[own]) == 0:
            continue
        cross = np.abs(steps[own] @ np.array([-edges[k, 1], edges[k, 0]])) / lengths[k]
        length = np.hypot(*steps[own].T)
        moving = length > 1e-6
        assert np.all(cross[moving] <= length[moving] * (4 * off / lengths[k]) + 1e-5)


@pytest.mark.parametrize(("radius", "curve_mm"), [(0.5, 0.01), (20.0, 0.01), (300.0, 0.05), (5.0, 4.0)])
def test_circle_has_as_few_chords_as_allowed(radius: float, curve_mm: float) -> None:
    circle = Arc(np.zeros(2), radius * np.eye(2), 0.3, 2 * math.pi)
    found = check(circle, curve_mm)
    assert np.array_equal(found[0], found[-1])
    count = len(found) - 1
    needed = max(math.pi / math.acos(1 - min(curve_mm / radius, 1)), 2 * math.pi / MAX_CHORD_TURN_RAD)
    assert needed - 1e-6 <= count < needed + 1
    _, off = chords(circle, curve_mm)
    assert off == pytest.approx(radius * (1 - math.cos(math.pi / count)), rel=1e-9)


def test_flat_ellipse_turns_gently() -> None:
    found = check(Arc(np.zeros(2), np.array([[40.0, 0.0], [0.0, 2.0]]), 0.0, 2 * math.pi), 0.05)
    steps = np.diff(found, axis=0)
    directions = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    assert np.abs(np.diff(directions)).max() <= 2 * MAX_CHORD_TURN_RAD
    assert directions[-1] - directions[0] > 2 * math.pi - 2 * MAX_CHORD_TURN_RAD


def test_bulge_is_the_arc_of_the_reference() -> None:
    """tan(sweep / 4): 1 is a half circle, counter-clockwise from start to end."""
    half = bulge_curve(np.array([0.0, 0.0]), np.array([10.0, 0.0]), 1.0)
    assert np.allclose(at(half, np.array([0.0, 0.5, 1.0])), [[0, 0], [5, -5], [10, 0]])
    quarter = bulge_curve(np.array([10.0, 0.0]), np.array([0.0, 10.0]), math.tan(math.pi / 8))
    assert np.allclose(np.hypot(*at(quarter, np.linspace(0, 1, 9)).T), 10.0)
    back = bulge_curve(np.array([0.0, 10.0]), np.array([10.0, 0.0]), -math.tan(math.pi / 8))
    assert np.allclose(np.hypot(*at(back, np.linspace(0, 1, 9)).T), 10.0)


@pytest.mark.parametrize("value", [9e-8, -9e-8, 1.1e-7])
def test_hardly_bulged_edge_has_the_height_that_it_says(value: float) -> None:
    curve = bulge_curve(np.array([100.0, 200.0]), np.array([100.0, 300.0]), value)
    assert at(curve, np.array([0.5]))[0] == pytest.approx([100.0 + value * 50.0, 250.0], abs=1e-7)


@given(seed=st.integers(0, 2**32 - 1), degree=st.integers(1, 5), clamped=st.booleans())
@settings(max_examples=40)
def test_spline_falls_into_its_bezier_curves(seed: int, degree: int, clamped: bool) -> None:
    """Against scipy's evaluation of weighted B-splines, with repeated inner knots and open ends."""
    rng = np.random.default_rng(seed)
    count = degree + 1 + int(rng.integers(0, 6))
    control, weights = rng.normal(size=(count, 2)), rng.uniform(0.3, 3.0, count)
    knots = np.sort(rng.integers(1, 6, count + degree + 1).astype(float))
    if clamped:
        knots[: degree + 1], knots[count:] = 0.0, 7.0
    # A knot that is there more often tears the curve.
    assume(np.all(knots[degree + 1 :] > knots[: -degree - 1]))
    spans = np.unique(knots[degree : count + 1])
    assume(len(spans) > 1)
    other = BSpline(knots, np.column_stack([control * weights[:, None], weights]), degree)
    found = spline(degree, control, weights, knots)
    assert len(found) == len(spans) - 1
    for curve, lo, hi in zip(found, spans[:-1], spans[1:], strict=True):
        share = np.linspace(0, 1, 7)[1:-1]
        value = other(lo + share * (hi - lo))
        assert np.allclose(at(curve, share), value[:, :2] / value[:, 2:], atol=1e-9)


def test_mapped_curve_is_the_curve_of_the_mapped_points() -> None:
    matrix, shift = np.array([[2.0, 0.5], [-1.0, 3.0]]), np.array([4.0, -7.0])
    share = np.linspace(0, 1, 11)
    for curve in (
        Arc(np.array([1.0, 2.0]), np.array([[3.0, 1.0], [0.0, 2.0]]), 0.4, -3.0),
        Bezier(np.array([[0.0, 0.0], [4.0, 1.0], [2.0, 5.0]]), np.array([1.0, 2.0, 1.0])),
    ):
        assert np.allclose(
            at(transform_curve(curve, matrix, shift), share), at(curve, share) @ matrix.T + shift
        )
        assert (
            shapely.MultiPoint(control_hull(curve))
            .convex_hull.buffer(1e-9)
            .covers(shapely.MultiPoint(at(curve, share)))
        )


@pytest.mark.parametrize("curve_mm", [0.0, -1.0, math.nan])
def test_no_tolerance(curve_mm: float) -> None:
    with pytest.raises(InputError, match="more than 0 mm"):
        chords(bezier(np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]])), curve_mm)
