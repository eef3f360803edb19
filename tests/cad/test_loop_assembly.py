"""Strokes become loops, loops become parts: found again from shuffled pieces, or refused with the place."""

import math
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from palpate.base.errors import InputError
from palpate.cad.curves import Arc, bezier, bulge_curve
from palpate.cad.drawing_outlines import Sheet, Stroke, close_loops, nest_loops
from palpate.cad.parts import Drawing, size_problem
from support.commands.command import missing

SHEET = Sheet("part.dxf", "inch", (1 / 25.4, 1 / 25.4))


def lines(points: list[tuple[float, float]], closed: bool = True) -> list[Stroke]:
    ends = points[1:] + points[:1] if closed else points[1:]
    return [
        Stroke("layer 'cut'", (bezier(np.array([a, b])),)) for a, b in zip(points, ends, strict=False)
    ]  # fmt: skip


def box(x: float, y: float, width: float, height: float) -> list[tuple[float, float]]:
    return [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]


def circle(x: float, y: float, radius: float) -> Stroke:
    return Stroke("layer 'cut'", (Arc(np.array([x, y]), radius * np.eye(2), 0.0, 2 * math.pi),))


def drawn(strokes: list[Stroke], curve_mm: float = 0.01) -> tuple[Drawing, ...]:
    return nest_loops(close_loops(strokes, curve_mm, SHEET), "part", "mm", SHEET)


def area(drawing: Drawing) -> float:
    return float(shapely.Polygon(drawing.outline.outer, drawing.outline.holes).area)


def check(drawing: Drawing) -> None:
    """What a `Drawing` promises of its rings."""
    region = drawing.outline
    assert shapely.is_ccw(shapely.LinearRing(region.outer))
    assert not any(shapely.is_ccw(shapely.LinearRing(hole)) for hole in region.holes)
    assert shapely.Polygon(region.outer, region.holes).is_valid
    for ring in (region.outer, *region.holes):
        assert np.all(np.isfinite(ring))
        steps = np.roll(ring, -1, axis=0) - ring
        following = np.roll(steps, -1, axis=0)
        sine = (steps[:, 0] * following[:, 1] - steps[:, 1] * following[:, 0]) / (
            np.hypot(*steps.T) * np.hypot(*following.T)
        )
        assert np.abs(sine).min() > 1e-9


@given(
    corners=st.lists(
        st.tuples(st.floats(20, 40), st.floats(0, 0.3), st.floats(-0.2, 0.2), st.booleans()),
        min_size=3,
        max_size=12,
    ),
    holes=st.integers(0, 3),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=60)
def test_shuffled_pieces_are_found_again(
    corners: list[tuple[float, float, float, bool]], holes: int, seed: int
) -> None:
    """A star of lines and arcs with square holes, cut up, turned round and shuffled."""
    rng = np.random.default_rng(seed)
    angles = [2 * math.pi * (k + late) / len(corners) for k, (_, late, _, _) in enumerate(corners)]
    radii = np.array([radius for radius, *_ in corners])
    ring = radii[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    exact, strokes = shapely.Polygon(ring).area, []
    for k, (_, _, sweep, bent) in enumerate(corners):
        start, end = ring[k], ring[(k + 1) % len(ring)]
        sweep = sweep if bent and abs(sweep) > 1e-3 else 0.0  # noqa: PLW2901
        if sweep:
            radius = math.dist(start, end) / 2 / math.sin(sweep / 2)
            exact += radius**2 * (sweep - math.sin(sweep)) / 2
        strokes.append(Stroke("layer 'cut'", (bulge_curve(start, end, math.tan(sweep / 4)),)))
    for k in range(holes):
        strokes += lines(box(-1.2 + 0.9 * k, -0.3, 0.6, 0.6))
    shuffled = [
        turned(strokes[k]) if rng.random() < 0.5 else strokes[k] for k in rng.permutation(len(strokes))
    ]
    (found,) = drawn(shuffled, 0.002)
    check(found)
    region = found.outline
    assert len(region.holes) == holes
    length = shapely.LinearRing(region.outer).length
    assert area(found) == pytest.approx(exact - 0.36 * holes, abs=found.off_mm * length + 1e-9)
    assert found.off_mm <= 0.002 + 1e-8


def turned(stroke: Stroke) -> Stroke:
    (curve,) = stroke.curves
    if isinstance(curve, Arc):
        back = Arc(curve.centre, curve.axes, curve.start_rad + curve.sweep_rad, -curve.sweep_rad)
        return Stroke(stroke.label, (back,))
    return Stroke(stroke.label, (bezier(curve.points[::-1]),))


def test_ends_within_the_joining_distance_are_one_point() -> None:
    strokes = lines(box(0, 0, 30, 20))
    strokes[1] = Stroke("layer 'cut'", (bezier(np.array([[30.003, 0.0], [30.0, 20.002]])),))
    (found,) = drawn(strokes)
    assert len(found.outline.outer) == 4
    assert 0.003 <= found.off_mm <= 0.0031
    (exact,) = drawn(lines(box(0, 0, 30, 20)))
    assert 0 < exact.off_mm < 1e-8


def test_gap_is_named_in_the_files_unit() -> None:
    strokes = lines(box(0, 0, 25.4, 50.8))
    strokes[2] = Stroke("layer 'cut'", (bezier(np.array([[25.4, 50.8], [0.3, 50.8]])),))
    with pytest.raises(InputError) as raised:
        drawn(strokes)
    words = ("part.dxf", "layer 'cut'", "gap of 0.3 mm", "(0.011811, 2)", "(0, 2) inch", "0.005 mm")
    assert missing(str(raised.value), *words) == []


def test_loose_line_and_branch() -> None:
    outline = lines(box(0, 0, 30, 20))
    with pytest.raises(InputError, match=r"line between .* is in no outline"):
        drawn(outline + lines([(40, 5), (45, 5)], closed=False))
    with pytest.raises(InputError, match=r"3 lines meet at \(0, 0\) inch"):
        drawn(outline + lines([(0, 0), (-5, -5)], closed=False))
    with pytest.raises(InputError, match=r"open loop: gap of 20 mm .*and 2 more loose ends"):
        drawn(outline[:3] + lines([(100, 0), (100, 50), (150, 50)], closed=False))


def test_what_is_drawn_twice_is_taken_once() -> None:
    arc = Stroke("layer '0'", (bulge_curve(np.array([30.0, 0.0]), np.array([30.0, 20.0]), 0.7),))
    outline = [*(s for k, s in enumerate(lines(box(0, 0, 30, 20))) if k != 1), arc, circle(10, 10, 4)]
    (once,) = drawn(outline)
    (twice,) = drawn(outline + [turned(stroke) for stroke in outline])
    assert np.array_equal(once.outline.outer, twice.outline.outer)
    assert len(twice.outline.holes) == 1
    # The same outline as a polyline that starts elsewhere.
    around = pairwise([(30, 20), (0, 20), (0, 0), (30, 0), (30, 20)])
    closed = Stroke("layer '1'", tuple(bezier(np.array(ends)) for ends in around))
    (square,) = drawn([*lines(box(0, 0, 30, 20)), closed])
    assert len(square.outline.outer) == 4


@pytest.mark.parametrize(
    ("strokes", "said"),
    [
        (
            lines([(0, 0), (20, 20), (20, 0), (0, 20)]),
            r"an outline meets itself at \(0.393701, 0.393701\) inch",
        ),
        (lines(box(0, 0, 20, 20)) + lines(box(10, 10, 20, 20)), "two outlines meet at"),
        (lines(box(0, 0, 20, 20)) + lines(box(20, 5, 20, 5)), "two outlines run along each other at"),
        ([*lines(box(0, 0, 20, 20)), circle(10, 10, 10)], "two outlines meet at"),
        (lines([(0, 0), (30, 0), (10, 0), (10, 10)]), "an outline runs back along itself at"),
        (lines([(0, 0), (30, 0), (20, 0)]), "encloses no area"),
        (lines(box(0, 0, 2000, 20)), r"wrong size: its largest side is 2000 mm; .*from 1 mm to 1000 mm"),
        ([circle(0, 0, 0.3)], "wrong size: its largest side is 0.6 mm"),
        ([circle(0, 0, 1e9)], "longer than 100000 mm"),
        ([circle(math.nan, 0, 3)], "no finite numbers"),
        (lines([(5, 5), (5, 5)], closed=False), "have no length"),
    ],
)
def test_refused_with_the_place(strokes: list[Stroke], said: str) -> None:
    with pytest.raises(InputError, match=said) as raised:
        drawn(strokes)
    assert "\n" not in str(raised.value)


def test_many_strokes_shorter_than_a_point() -> None:
    t = np.linspace(0, 2 * math.pi, 4000)[:-1]
    ring = [(float(2 * math.cos(a)), float(2 * math.sin(a))) for a in t]
    with pytest.raises(InputError, match=r"shorter than 0\.005 mm"):
        drawn(lines(ring))


def test_loops_nest_to_any_depth() -> None:
    """Every second one is a hole; what lies in a hole is a part of its own."""
    strokes = [circle(0, 0, r) for r in (40, 30, 20, 10)]
    strokes += [circle(35, 0, 2), *lines(box(100, 0, 10, 10)), *lines(box(60, 0, 10, 10))]
    big, inner, left, right = drawn(strokes)
    assert [d.name for d in (big, inner, left, right)] == ["part-1", "part-2", "part-3", "part-4"]
    assert [len(d.outline.holes) for d in (big, inner, left)] == [2, 1, 0]
    assert area(big) == pytest.approx(math.pi * (40**2 - 30**2 - 2**2), rel=2e-3)
    assert area(inner) == pytest.approx(math.pi * (20**2 - 10**2), rel=2e-3)
    assert left.outline.outer.min() == 0
    assert left.outline.outer.max() == 70
    for drawing in (big, inner, left, right):
        check(drawing)
    assert np.hypot(*big.outline.outer.T).max() == pytest.approx(40)
    assert np.hypot(*inner.outline.outer.T).max() == pytest.approx(20)


def test_collinear_points_are_merged_across_the_start() -> None:
    ring = [(10.0, 0.0), (20.0, 0.0), (30.0, 0.0), (30.0, 9.0), (30.0, 20.0), (0.0, 20.0), (0.0, 0.0)]
    (found,) = drawn(lines(ring))
    assert sorted(map(tuple, found.outline.outer.tolist())) == [(0, 0), (0, 20), (30, 0), (30, 20)]


@pytest.mark.parametrize(
    ("side", "units", "hint"),
    [
        (20000.0, "m", "(it would be 20 mm if its unit were mm, or 508 mm if its unit were inch)"),
        (0.7, "mm", "(it would be 17.78 mm if its unit were inch, or 700 mm if its unit were m)"),
        (5e6, "mm", ""),
        (20000.0, None, ""),
        (20000.0, "cm", ""),
    ],
)
def test_size_problem_names_the_unit_that_would_fit(side: float, units: str | None, hint: str) -> None:
    problem = size_problem(np.array([side, side / 3]), units)
    assert problem is not None
    assert problem.endswith(hint or "1000 mm")


@pytest.mark.parametrize("side", [1.0, 30.0, 1000.0])
def test_sizes_that_fit(side: float) -> None:
    assert size_problem(np.array([0.5, side, 0.1]), "mm") is None
