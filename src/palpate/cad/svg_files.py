"""SVG files: drawings as outlines of flat parts, in mm.

What counts is geometry: paths, rectangles, circles, ellipses, polygons, polylines and lines, however they are
painted; clipping does not change it. Subpaths of a shape that is only filled bound material where its fill
rule says so. What is not displayed, or has neither fill nor stroke, and text and images are left out, and
counted. y points down in SVG and up here.

svgelements goes on quietly past what it does not understand, which would change outlines; so attributes are
checked here before. A `use` is a copy of another element with all that it holds, and a few lines of copies of
copies are more than any computer draws ("billion laughs"): the size with every copy drawn is computed before
any is. Source: SVG 2, https://www.w3.org/TR/SVG2/
"""

import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from palpate.base.errors import InputError
from palpate.base.file_io import CAD_BYTES, MOST_DRAWN_NUMBERS, MOST_DRAWN_PIECES, MOST_NESTING, read_bytes
from palpate.base.geometry.plane import points_in_polygon, signed_area
from palpate.base.optional_imports import import_extra, input_errors
from palpate.cad.curves import Arc, DrawnCurve, bezier, chords_of_chain, control_hull, transform_curve
from palpate.cad.drawing_outlines import Sheet, Stroke, close_loops, nest_loops
from palpate.cad.parts import UNIT_MM, DrawingFile

_NO_OUTLINES = {"text": "texts", "image": "images", "foreignObject": "foreign objects"}
_CUTTING = {"clip-path": "clip paths, which do not cut outlines here", "mask": "masks"}


def _count_no_outlines(root: ElementTree.Element) -> Counter[str]:
    """Texts, images, and references to clip paths and masks, in words with their number."""
    found: Counter[str] = Counter()
    for element in root.iter():
        kind = str(element.tag).rpartition("}")[2]
        if kind in _NO_OUTLINES:
            found[_NO_OUTLINES[kind]] += 1
        for name, what in _CUTTING.items():
            style = re.search(rf"(?:^|;)\s*{name}\s*:\s*([^;]*)", element.get("style", ""))
            value = style[1] if style else element.get(name, "none")
            if value.strip() not in {"none", ""}:
                found[what] += 1
        if kind == "style":  # a class may cut, too, whoever it is for
            for name, what in _CUTTING.items():
                found[what] += len(re.findall(rf"(?<![\w-]){name}\s*:\s*url", element.text or ""))
    return +found


_DIGITS = re.compile(r"[0-9.]+")


def _check_unfolded(root: Element, path: Path) -> None:
    """Raise InputError for too deep a nesting, too many elements or numbers, and copies within themselves."""
    named = {name: element for element in root.iter() if (name := element.get("id"))}
    came_to: dict[Element, tuple[int, int]] = {}
    open_elements: dict[Element, int] = {}
    stack = [(root, False)]
    while stack:
        element, done = stack.pop()
        if done:
            del open_elements[element]
            parts = [came_to[inner] for inner in _within(element, named)]
            numbers = sum(len(_DIGITS.findall(element.get(key, ""))) for key in ("d", "points"))
            pieces = 1 + sum(part[0] for part in parts)
            came_to[element] = pieces, numbers + sum(part[1] for part in parts)
        elif element in open_elements:
            raise InputError(f"{path}: uses '#{element.get('id')}' within itself; remove this copy")
        elif element not in came_to:
            open_elements[element] = len(stack)
            if len(open_elements) > MOST_NESTING:
                raise InputError(
                    f"{path}: elements are nested more than {MOST_NESTING} deep; take groups apart"
                )
            stack.append((element, True))
            stack += [(inner, False) for inner in _within(element, named)]
    pieces, numbers = came_to[root]
    for count, most, what in (
        (pieces, MOST_DRAWN_PIECES, "elements"),
        (numbers, MOST_DRAWN_NUMBERS, "numbers"),
    ):
        if count > most:
            raise InputError(
                f"{path}: draws {min(count, 10**15):.6g} {what}, those of copies counted each time; "
                f"at most {most} are read: keep the outlines only"
            )


def _within(element: Element, named: dict[str, Element]) -> list[Element]:
    """State of drawing within an element."""
    inner = list(element)
    if element.tag.rpartition("}")[2] == "use":
        hrefs = (value for key, value in element.attrib.items() if key.rpartition("}")[2] == "href")
        target = named.get(next(hrefs, "")[1:])
        if target is not None:
            inner.append(target)
    return inner


# Atomic groups: a number is never split, so that a fault far behind takes no second try from before.
_SIZE = r"(?>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
_NUMBER = rf"(?>[-+]?{_SIZE})"
_COMMA = r"(?>\s*+,?\s*+)"
_UNIT = r"\s*+(?:mm|cm|in|pt|pc|px|Q|%|)\s*+"
_LENGTH = re.compile(rf"\s*+({_NUMBER})\s*+(mm|cm|in|pt|pc|px|Q|)\s*+")
_UNITS_MM = {
    "mm": 1.0,
    "cm": 10.0,
    "in": 25.4,
    "pt": 25.4 / 72,
    "pc": 25.4 / 6,
    "px": 25.4 / 96,
    "Q": 0.25,
}
"""Absolute units, in mm. Source: CSS Values and Units 4, section 6.2."""


def _arguments(*each: str) -> str:
    """Once or more, numbers (or what else is given) with at most a comma between them."""
    return rf"(?:{_COMMA.join(each)}{_COMMA})++"


_COMMANDS = {
    "mlt": _arguments(_NUMBER, _NUMBER),
    "hv": _arguments(_NUMBER),
    "c": _arguments(*[_NUMBER] * 6),
    "sq": _arguments(*[_NUMBER] * 4),
    "a": _arguments(_NUMBER, _NUMBER, _NUMBER, "[01]", "[01]", _NUMBER, _NUMBER),
    "z": "",
}
_PATH = "|".join(rf"[{keys}{keys.upper()}]\s*+{arguments}" for keys, arguments in _COMMANDS.items())
_TRANSFORM = rf"(?:matrix|translate|scale|rotate|skewX|skewY)\s*+\(\s*+{_arguments(_NUMBER)}\)"
_SIZES = re.compile(rf"\s*+\+?{_SIZE}{_UNIT}|\s*+auto\s*+")
_PLACES = re.compile(rf"\s*+{_NUMBER}{_UNIT}")
_GRAMMARS = {
    "d": re.compile(rf"\s*+(?:[mM]\s*+{_COMMANDS['mlt']}\s*+(?:(?:{_PATH})\s*+)*+)?"),
    "points": re.compile(rf"\s*+(?:{_COMMANDS['mlt']})?"),
    "transform": re.compile(rf"\s*+(?:none|(?:{_TRANSFORM}{_COMMA})*+)"),
    "style": re.compile(r"(?:(?!\btransform\b).)*+", re.DOTALL),
    **dict.fromkeys(("width", "height", "r", "rx", "ry"), _SIZES),
    **dict.fromkeys(("x", "y", "cx", "cy", "x1", "y1", "x2", "y2"), _PLACES),
}
"""By attribute: what is understood. A transform that is a style is not."""

_SHAPES = {"path", "rect", "circle", "ellipse", "polygon", "polyline", "line", "g", "use", "svg"}
_NEVER_PAINTED = {"clipPath", "mask", "marker", "pattern", "symbol"}
"""Their content is painted, if at all, only where others refer to it."""


@dataclass(frozen=True)
class SvgPage:
    """The page in user units, and what one of them is in mm."""

    width: float
    height: float
    user_mm: float


def _parse_svg(path: Path) -> ElementTree.Element:
    """The outermost element. Raises InputError for what is no SVG file."""
    try:
        root = ElementTree.fromstring(read_bytes(path, CAD_BYTES, "keep the outlines only"))
    except (ElementTree.ParseError, ValueError, LookupError) as problem:
        raise InputError(f"{path}: is no readable SVG file ({problem}); save it as SVG anew") from None
    if _local(root) != "svg":
        raise InputError(f"{path}: is XML but no SVG: its outermost element is <{_local(root)}>, not <svg>")
    _check_unfolded(root, path)
    return root


def page_of(root: ElementTree.Element, units: str | None, path: Path) -> SvgPage:
    """Size of a user unit by width, height and viewBox, or by `units` where they have no unit.

    Raises InputError where neither says it, or both do differently.
    """
    view = _view_box(root, path)
    sides = [_side(root, name, path) for name in ("width", "height")]
    named = [unit for _, unit in sides if unit]
    if not named:
        if units is None:
            raise InputError(
                f"{path}: has no units: say what a user unit is; give units: mm, inch, m, or pt (Illustrator)"
            )
        width, height = view or [number or 1.0 for number, _ in sides]
        return SvgPage(width, height, UNIT_MM[units])
    if units not in {None, {"in": "inch"}.get(named[0], named[0])}:
        raise InputError(f"{path}: is in {named[0]} (its width and height), not in {units}: give no units")
    if view is None:
        # A user unit is a pixel then.
        pixel = _UNITS_MM["px"]
        width, height = (number * _UNITS_MM[unit or "px"] / pixel for number, unit in sides)
        return SvgPage(width, height, pixel)
    scales = [
        number * _UNITS_MM[unit] / size for (number, unit), size in zip(sides, view, strict=True) if unit
    ]
    fit = (root.get("preserveAspectRatio") or "").split()
    if "none" in fit and max(scales) > min(scales) * (1 + 1e-6):
        raise InputError(f"{path}: stretches its viewBox more in one direction; save it unstretched")
    return SvgPage(view[0], view[1], max(scales) if "slice" in fit else min(scales))


def _bare_svg(root: ElementTree.Element, size: SvgPage, path: Path) -> bytes:
    """The file with its page in user units, and without what is never painted, for svgelements to read.

    Raises InputError for attributes of shapes that cannot be read, and for what is used but not there.
    """
    _leave_out_unpainted(root)
    names = {element.get("id") for element in root.iter()}
    for element in root.iter():
        kind = _local(element)
        if kind not in _SHAPES or element is root:
            continue
        for name, grammar in _GRAMMARS.items():
            value = element.get(name)
            if value is not None and not grammar.fullmatch(value):
                raise InputError(
                    f"{path}: {_named(element)} has {name}='{_short(value)}', which cannot be read"
                )
        target = next((v for k, v in element.attrib.items() if k.rpartition("}")[2] == "href"), "")
        if kind == "use" and target[1:] not in names:
            raise InputError(f"{path}: uses '{target}', which is no shape of the file; convert it to paths")
    root.set("width", repr(size.width))
    root.set("height", repr(size.height))
    root.attrib.pop("preserveAspectRatio", None)
    written: bytes = ElementTree.tostring(root)
    return written


def _leave_out_unpainted(root: ElementTree.Element) -> None:
    """Remove what is never painted, and all alternatives but one."""
    for parent in list(root.iter()):
        for child in list(parent):
            if _local(child) in _NEVER_PAINTED:
                parent.remove(child)
        if _local(parent) == "switch":
            _choose_alternative(parent)


def _choose_alternative(switch: ElementTree.Element) -> None:
    """Make a `switch` a group of the first alternative that needs no extension (SVG 2, 5.10.2)."""
    chosen = next(
        (
            child
            for child in switch
            if child.get("requiredExtensions") is None
            and _local(child) not in _NO_OUTLINES
            and "en" in child.get("systemLanguage", "en")
        ),
        None,
    )
    switch[:] = [] if chosen is None else [chosen]
    switch.tag = switch.tag[: -len("switch")] + "g"


def _local(element: ElementTree.Element) -> str:
    """The name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def _named(element: ElementTree.Element) -> str:
    name = element.get("id")
    return f"{_local(element)} '{name}'" if name else f"a <{_local(element)}>"


def _short(value: str) -> str:
    value = " ".join(value.split())
    return value if len(value) <= 40 else f"{value[:37]}…"


def _view_box(root: ElementTree.Element, path: Path) -> list[float] | None:
    """Width and height of the viewBox."""
    box = root.get("viewBox")
    if box is None:
        return None
    numbers = [float(number) for number in re.findall(_NUMBER, box)]
    if (
        not re.fullmatch(rf"\s*+{_arguments(*[_NUMBER] * 4)}", box)
        or len(numbers) != 4
        or min(numbers[2:]) <= 0
    ):
        raise InputError(f"{path}: its viewBox is '{_short(box)}'; needed are four numbers: x y width height")
    return numbers[2:]


def _side(root: ElementTree.Element, name: str, path: Path) -> tuple[float, str]:
    """Number and unit of the page's width or height; (0, "") where it depends on the window."""
    value = root.get(name, "auto").strip()
    if value == "auto" or value.endswith("%"):
        return 0.0, ""
    match = _LENGTH.fullmatch(value)
    if match is None or float(match[1]) <= 0:
        raise InputError(f"{path}: its {name} is '{_short(value)}'; needed is a length, as in 120mm or 4.5in")
    return float(match[1]), match[2]


def read_svg(path: Path, units: str | None, curve_mm: float) -> DrawingFile:
    """The parts that a drawing shows, each with its holes, from the largest on; curves within `curve_mm`.

    `units`: "mm", "inch", "m" or "pt" for a file whose width and height have no unit; a user unit (of the
    viewBox) is so much. Raises InputError for a file that is no SVG, has no or other units, or whose lines
    are no closed outlines, with coordinates in mm from the top left, y downwards.
    """
    root = _parse_svg(path)
    size = page_of(root, units, path)
    left_out = _count_no_outlines(root)
    with input_errors(path, "SVG"):
        strokes = list(_strokes(_bare_svg(root, size, path), size, left_out))
    rest = tuple(f"{count} {what}" for what, count in left_out.most_common())
    if not strokes:
        also = f"; left out: {', '.join(rest)}" if rest else ""
        raise InputError(
            f"{path}: holds no outlines; draw them as paths or shapes with a stroke or a fill{also}"
        )
    sheet = Sheet(str(path), "mm from the top left", (1.0, -1.0))
    return DrawingFile(nest_loops(close_loops(strokes, curve_mm, sheet), path.stem, units, sheet), rest)


def _strokes(source: bytes, size: SvgPage, left_out: Counter[str]) -> Iterator[Stroke]:
    """All that is drawn, from the page's top left, y upwards, mm; adds to what is `left_out`."""
    svgelements = import_extra("svgelements", "cad", "reading SVG files")
    drawing = svgelements.SVG.parse(io.BytesIO(source), reify=False)
    number: Counter[str] = Counter()
    for shape in drawing.elements():
        if not isinstance(shape, svgelements.Shape):
            continue
        tag = str(shape.values.get("tag", "shape"))
        number[tag] += 1
        if not _is_painted(shape):
            left_out["hidden shapes, or without fill and stroke"] += 1
            continue
        own = shape.transform
        matrix = size.user_mm * np.array([[own.a, own.c], [-own.b, -own.d]])
        shift = size.user_mm * np.array([own.e, -own.f])
        label = f"{tag} '{shape.id}'" if shape.id else f"{tag} {number[tag]}"
        for curves in _boundary_subpaths(shape, list(_subpaths(shape))):
            yield Stroke(label, tuple(transform_curve(curve, matrix, shift) for curve in curves))


_FILL_CHORD_SHARE = 1e-3  # of a shape's size: chords by which subpaths are told to be in each other


def _boundary_subpaths(shape: Any, subpaths: list[list[DrawnCurve]]) -> list[list[DrawnCurve]]:
    """Subpaths on one side of which a shape is filled, all of one that is not only filled.

    By the fill rule nonzero (SVG 2, 13.4.2) one that runs the same way as what it is in bounds nothing.
    """
    only_filled = shape.fill.value is not None and shape.stroke.value is None
    if len(subpaths) < 2 or not only_filled or shape.values.get("fill-rule", "nonzero") != "nonzero":
        return subpaths
    size = max(float(np.ptp(control_hull(curve), axis=0).max()) for curves in subpaths for curve in curves)
    rings = [chords_of_chain(curves, max(size, 1e-6) * _FILL_CHORD_SHARE)[0] for curves in subpaths]
    turns = [int(np.sign(signed_area(ring))) for ring in rings]
    kept = []
    for own, curves in enumerate(subpaths):
        outside = sum(
            turns[other]
            for other, ring in enumerate(rings)
            if other != own and points_in_polygon(rings[own][:1], [ring])[0]
        )
        if (outside == 0) != (outside + turns[own] == 0):
            kept.append(curves)
    return kept


def _is_painted(shape: Any) -> bool:
    """Is it visible, with a fill or a stroke?"""
    hidden = shape.values.get("visibility") in {"hidden", "collapse"} or shape.values.get("display") == "none"
    return not hidden and (shape.fill.value is not None or shape.stroke.value is not None)


def _subpaths(shape: Any) -> Iterator[list[DrawnCurve]]:
    """The curves of each subpath, in the shape's own coordinates."""
    curves: list[DrawnCurve] = []
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


def _curve(segment: Any, kind: str) -> DrawnCurve | None:
    if kind == "Close" and (segment.end is None or segment.start == segment.end):
        return None
    if kind == "Arc" and segment.rx > 0 and segment.ry > 0:
        centre, x_end, y_end = (_point(p) for p in (segment.center, segment.prx, segment.pry))
        axes = np.array([x_end, y_end]) - centre
        return Arc(centre, axes, float(segment.get_start_t()), float(segment.sweep))
    if kind in {"QuadraticBezier", "CubicBezier"}:
        controls = [segment.start, *_controls(segment, kind), segment.end]
        return bezier(np.array([_point(p) for p in controls]))
    # Also arcs without a radius (SVG 2, 9.5.1: they are straight).
    return bezier(np.array([_point(segment.start), _point(segment.end)]))


def _controls(segment: Any, kind: str) -> list[Any]:
    return [segment.control] if kind == "QuadraticBezier" else [segment.control1, segment.control2]


def _point(point: Any) -> Any:
    return np.array([point.x, point.y], dtype=np.float64)
