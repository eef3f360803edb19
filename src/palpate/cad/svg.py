"""SVG reader: drawings as outlines of flat parts, in mm.

What counts is geometry: paths, rectangles, circles, ellipses, polygons, polylines and lines, however they are
painted; neither fill rule nor clipping changes it. What is not displayed, or has neither fill nor stroke, and
text and images are left out, and counted. y points down in SVG and up here.
"""

import io
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from palpate.base.errors import InputError
from palpate.base.optional_imports import needed, readable
from palpate.cad.curves import Arc, Curve, line, mapped
from palpate.cad.loop_assembly import Sheet, Stroke, closed_loops
from palpate.cad.ring_nesting import parts
from palpate.cad.svg_page import Page, bare_svg, page, parse_svg
from palpate.cad.svg_rest import no_outlines
from palpate.cad.values import DrawingFile

__all__ = ["read_svg"]


def read_svg(path: Path, units: str | None, curve_mm: float) -> DrawingFile:
    """The parts that a drawing shows, each with its holes, from the largest on; curves within `curve_mm`.

    `units`: "mm", "inch", "m" or "pt" for a file whose width and height have no unit; a user unit (of the
    viewBox) is so much. Raises InputError for a file that is no SVG, has no or other units, or whose lines
    are no closed outlines, with coordinates in mm from the top left, y downwards.
    """
    root = parse_svg(path)
    size = page(root, units, path)
    left_out = no_outlines(root)
    with readable(path, "SVG"):
        strokes = list(_strokes(bare_svg(root, size, path), size, left_out))
    rest = tuple(f"{count} {what}" for what, count in left_out.most_common())
    if not strokes:
        also = f"; left out: {', '.join(rest)}" if rest else ""
        raise InputError(
            f"{path}: holds no outlines; draw them as paths or shapes with a stroke or a fill{also}"
        )
    sheet = Sheet(str(path), "mm from the top left", (1.0, -1.0))
    return DrawingFile(parts(closed_loops(strokes, curve_mm, sheet), path.stem, units, sheet), rest)


def _strokes(source: bytes, size: Page, left_out: Counter[str]) -> Iterator[Stroke]:
    """All that is drawn, from the page's top left, y upwards, mm; adds to what is `left_out`."""
    svgelements = needed("svgelements", "cad", "reading SVG files")
    drawing = svgelements.SVG.parse(io.BytesIO(source), reify=False)
    number: Counter[str] = Counter()
    for shape in drawing.elements():
        if not isinstance(shape, svgelements.Shape):
            continue
        tag = str(shape.values.get("tag", "shape"))
        number[tag] += 1
        if not _painted(shape):
            left_out["hidden shapes, or without fill and stroke"] += 1
            continue
        own = shape.transform
        matrix = size.user_mm * np.array([[own.a, own.c], [-own.b, -own.d]])
        shift = size.user_mm * np.array([own.e, -own.f])
        label = f"{tag} '{shape.id}'" if shape.id else f"{tag} {number[tag]}"
        for curves in _subpaths(shape):
            yield Stroke(label, tuple(mapped(curve, matrix, shift) for curve in curves))


def _painted(shape: Any) -> bool:
    """Is it visible, with a fill or a stroke?"""
    hidden = shape.values.get("visibility") in {"hidden", "collapse"} or shape.values.get("display") == "none"
    return not hidden and (shape.fill.value is not None or shape.stroke.value is not None)


def _subpaths(shape: Any) -> Iterator[list[Curve]]:
    """The curves of each subpath, in the shape's own coordinates."""
    curves: list[Curve] = []
    ended = True
    for segment in shape.segments(transformed=False):
        kind = type(segment).__name__
        if curves and (ended or kind == "Move"):
            yield curves
            curves = []
        ended = kind == "Close"
        curve = None if kind == "Move" else _curve(segment, kind)
        if curve is not None:
            curves.append(curve)
    if curves:
        yield curves


def _curve(segment: Any, kind: str) -> Curve | None:
    if kind == "Close" and (segment.end is None or segment.start == segment.end):
        return None
    if kind == "Arc" and segment.rx > 0 and segment.ry > 0:
        centre, x_end, y_end = (_point(p) for p in (segment.center, segment.prx, segment.pry))
        axes = np.array([x_end, y_end]) - centre
        return Arc(centre, axes, float(segment.get_start_t()), float(segment.sweep))
    if kind in {"QuadraticBezier", "CubicBezier"}:
        controls = [segment.start, *_controls(segment, kind), segment.end]
        return line(np.array([_point(p) for p in controls]))
    # Also arcs without a radius (SVG 2, 9.5.1: they are straight).
    return line(np.array([_point(segment.start), _point(segment.end)]))


def _controls(segment: Any, kind: str) -> list[Any]:
    return [segment.control] if kind == "QuadraticBezier" else [segment.control1, segment.control2]


def _point(point: Any) -> Any:
    return np.array([point.x, point.y], dtype=np.float64)
