"""The XML of an SVG file: its page and units, and a check that all of its shapes can be read.

svgelements goes on quietly past what it does not understand, which would change outlines; so attributes are
checked here before. Source: SVG 2, https://www.w3.org/TR/SVG2/
"""

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from palpate.base.errors import InputError
from palpate.base.files import read_bytes
from palpate.base.files.limits import CAD_BYTES
from palpate.cad.part_size import UNIT_MM
from palpate.cad.svg_unfolded import check_unfolded

__all__ = ["Page", "bare_svg", "page", "parse_svg"]

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
class Page:
    """The page in user units, and what one of them is in mm."""

    width: float
    height: float
    user_mm: float


def parse_svg(path: Path) -> ElementTree.Element:
    """The outermost element. Raises InputError for what is no SVG file."""
    try:
        root = ElementTree.fromstring(read_bytes(path, CAD_BYTES, "keep the outlines only"))
    except (ElementTree.ParseError, ValueError, LookupError) as problem:
        raise InputError(f"{path}: is no readable SVG file ({problem}); save it as SVG anew") from None
    if _local(root) != "svg":
        raise InputError(f"{path}: is XML but no SVG: its outermost element is <{_local(root)}>, not <svg>")
    check_unfolded(root, path)
    return root


def page(root: ElementTree.Element, units: str | None, path: Path) -> Page:
    """How large a user unit is: by width, height and viewBox, or what `units` says where they have no unit.

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
        return Page(width, height, UNIT_MM[units])
    if units not in {None, {"in": "inch"}.get(named[0], named[0])}:
        raise InputError(f"{path}: is in {named[0]} (its width and height), not in {units}: give no units")
    if view is None:
        # A user unit is a pixel then.
        pixel = _UNITS_MM["px"]
        width, height = (number * _UNITS_MM[unit or "px"] / pixel for number, unit in sides)
        return Page(width, height, pixel)
    scales = [
        number * _UNITS_MM[unit] / size for (number, unit), size in zip(sides, view, strict=True) if unit
    ]
    fit = (root.get("preserveAspectRatio") or "").split()
    if "none" in fit and max(scales) > min(scales) * (1 + 1e-6):
        raise InputError(f"{path}: stretches its viewBox more in one direction; save it unstretched")
    return Page(view[0], view[1], max(scales) if "slice" in fit else min(scales))


def bare_svg(root: ElementTree.Element, size: Page, path: Path) -> bytes:
    """The file with its page in user units, and without what is never painted, for svgelements to read.

    Raises InputError for attributes of shapes that cannot be read, and for what is used but not there.
    """
    for parent in list(root.iter()):
        for child in list(parent):
            if _local(child) in _NEVER_PAINTED:
                parent.remove(child)
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
