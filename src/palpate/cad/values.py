"""What a CAD file holds and what becomes of it: the values that are passed between the modules of `cad`.

file → `Solid` (readers, checked) → `StableState`s (how it rests) → `CrossSection`s (what fingers meet); or
file → `DrawingFile` with `Drawing`s (outlines that are the same at every height).
"""

from dataclasses import dataclass

from palpate.base.geometry import Floats, Ints

__all__ = ["CrossSection", "Drawing", "DrawingFile", "Region", "RotationalSymmetry", "Solid", "StableState"]


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
    which it is a solid of revolution, and `symmetry`, as far as is known.
    """

    name: str
    vertices_mm: Floats
    faces: Ints
    off_mm: float = 0.0
    axis: Floats | None = None
    symmetry: RotationalSymmetry | None = None


@dataclass(frozen=True, eq=False)
class Region:
    """A polygon with holes: `outer` (n, 2) counter-clockwise, holes (k, 2) clockwise; open rings, mm."""

    outer: Floats
    holes: tuple[Floats, ...] = ()


@dataclass(frozen=True, eq=False)
class Drawing:
    """Outline of a flat part in its file's frame; curves are within `off_mm` of their chords."""

    name: str
    region: Region
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
    only nearly which way is down.
    """

    name: str
    rotation: Floats
    offset_mm: Floats
    probability: float
    tipping_angle_rad: float
    support_mm: Floats
    leans: bool = False


@dataclass(frozen=True, eq=False)
class CrossSection:
    """What a finger at any height within `z_mm` = (from, to) meets.

    There the true section is within `off_mm` of `regions`, in the sense that the recogniser gives to an
    object's tolerance: every point of a true edge is within it of some edge of the regions, or of a convex
    vertex, whose normal differs by at most asin(4 · off_mm / length of that edge).
    """

    z_mm: tuple[float, float]
    regions: tuple[Region, ...]
    off_mm: float
