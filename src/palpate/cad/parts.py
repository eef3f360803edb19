"""Parts of CAD files as values, and their permitted sizes and units.

file → `Solid` (readers, checked) → `StableState`s (how it rests) → `CrossSection`s (what fingers meet); or
file → `DrawingFile` with `Drawing`s (outlines that are the same at every height). A wrong unit makes a part
25.4 or 1000 times too large or too small: `size_problem` says so, and which unit would fit.
"""

import re
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Floats, Ints, Polygon, Section


@dataclass(frozen=True, eq=False)
class RotationalSymmetry:
    """Turns by multiples of 2π/`order` about an axis through the centre of mass bring a solid onto itself.

    `axis` (3,): its direction. The turned surface is nowhere further than `apart_mm` from the surface.
    """

    axis: Floats
    order: int
    apart_mm: float


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed surface of triangles in its file's frame.

    `vertices_mm` (n, 3), each used by some face; `faces` (m, 3), counter-clockwise seen from outside; every
    edge belongs to two faces. The real surface is nowhere further than `off_mm` from it. `axis` (3,): about
    which it is a solid of revolution, and `symmetry`, as far as is known. `mended`: what was wrong with the
    file's surface, in words.
    """

    name: str
    vertices_mm: Floats
    faces: Ints
    off_mm: float = 0.0
    axis: Floats | None = None
    symmetry: RotationalSymmetry | None = None
    mended: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class SolidFile:
    """Solids of a file; in words, what else is in it that is no part, and which parts are refused and why."""

    solids: tuple[Solid, ...]
    left_out: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Drawing:
    """Outline of a flat part in its file's frame; curves are within `off_mm` of their chords."""

    name: str
    outline: Polygon
    off_mm: float = 0.0


@dataclass(frozen=True, eq=False)
class DrawingFile:
    """The flat parts that a file shows, and in words what else is in it that is no outline of theirs."""

    drawings: tuple[Drawing, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class StableState:
    """A way in which a solid rests on the support plane.

    A vertex v of the solid is at `rotation` (3, 3) @ v + `offset_mm` (3,): the lowest is at z = 0, the centre
    of mass above the origin. `probability`: how often the solid comes to rest so when dropped anyhow;
    `tipping_angle_rad`: the smallest tilt that tips it over. `support_mm` (n, 2): the convex polygon that it
    rests on, counter-clockwise. `leans`: it lies on a surface that is curved both ways, whose facets tell
    only nearly which way is down. `unknown_mm`: open ranges of height, ascending and apart, at which
    nothing is known of it.
    """

    name: str
    rotation: Floats
    offset_mm: Floats
    probability: float
    tipping_angle_rad: float
    support_mm: Floats
    leans: bool = False
    unknown_mm: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, slots=True, repr=False)
class CrossSection(Section):
    """Section that stands for the true one at every height of its range, the material left of its rings.

    The true section is within `off_mm` of the polygons, in the sense that the recogniser gives to an
    object's tolerance: every point of a true edge is within it of some edge of the polygons, or of a convex
    vertex, whose normal differs by at most asin(4 · off_mm / length of that edge).
    """

    off_mm: float


_PLACEHOLDER = re.compile(
    r"Open CASCADE STEP translator [\d. ]*|Unnamed\d*|geometry_\d+|=>\[[\d:]*\]"
    r"|(COMPOUND|COMPSOLID|SOLID|SHELL)(_\d+)?",
    re.IGNORECASE,
)
"""What Open CASCADE (FreeCAD, CadQuery) and mesh programs call parts that have no name."""


_MOST_NAME_CHARS = 90


def real_name(name: str) -> str:
    """A part's name, or how it begins; empty for one that a program gives to what nobody has named."""
    name = name.strip()[:_MOST_NAME_CHARS]
    return "" if _PLACEHOLDER.fullmatch(name) else name


MIN_SIZE_MM = 1.0
MAX_SIZE_MM = 1000.0

UNIT_MM = {"mm": 1.0, "inch": 25.4, "m": 1000.0, "pt": 25.4 / 72}
"""Units that can be asked for, in mm; points (pt) are those of programs that draw for print."""


GIVE_NO_UNITS = "give no units"
"""Ends the message where units were asked for and the file states others itself."""


def size_problem(size_mm: Floats, units: str | None) -> str | None:
    """Say what is wrong with a part whose bounding box has sides `size_mm` (2,) or (3,), if anything.

    `units`: the unit that its file's numbers were taken to be in; others that would make it fit are named.
    None, or a unit that is not in `UNIT_MM`: none is named.
    """
    largest = float(np.max(size_mm))
    if MIN_SIZE_MM <= largest <= MAX_SIZE_MM:
        return None
    problem = (
        f"its largest side is {largest:.6g} mm; it must be from {MIN_SIZE_MM:g} mm to {MAX_SIZE_MM:g} mm"
    )
    if units in UNIT_MM:
        other = {unit: largest / UNIT_MM[units] * factor for unit, factor in UNIT_MM.items()}
        fitting = [
            f"{side:.6g} mm if its unit were {unit}"
            for unit, side in other.items()
            if unit != "pt"
            if MIN_SIZE_MM <= side <= MAX_SIZE_MM
        ]
        if fitting:
            problem += f" (it would be {', or '.join(fitting)})"
    return problem
