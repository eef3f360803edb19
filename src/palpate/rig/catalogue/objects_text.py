"""Cross sections as values of an objects file: coordinates with six decimals, bounds rounded outward."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from palpate.base.geometry import Floats
from palpate.cad.values import CrossSection, Region
from palpate.config.import_result import FrameOut
from palpate.config.objects_rings import outline_edges
from palpate.config.objects_tables import PolygonText, SectionText
from palpate.config.outlines import MIN_EDGE_MM
from palpate.config.results import DECIMALS

__all__ = [
    "NEGLIGIBLE_MM",
    "Height",
    "bound_mm",
    "edges_of",
    "ends_mm",
    "frame_out",
    "polygons_text",
    "ranges_known",
    "ranges_near",
    "rounded",
    "rounded_up",
    "sections_text",
    "side_text",
]

NEGLIGIBLE_MM = 1e-5
"""What rounding does to coordinates, here and in files with single precision; it is no tolerance."""

Height = float | tuple[float, float]
"""A height that is wanted, mm; two: all from one to the other."""

_NEAR_MM = 0.5
_MOST_RINGS = 64
_SUMMING = 1e-9  # a sixth, six times added, is less than 1
_BOUND_STEPS = 10_000  # to a millimetre


def ends_mm(height_mm: Height) -> tuple[float, float]:
    """Of a height that is wanted: from which to which."""
    return height_mm if isinstance(height_mm, tuple) else (height_mm, height_mm)


def ranges_near(heights_mm: Iterable[Height], top_mm: float) -> list[tuple[float, float]]:
    """Ranges of height, ascending and apart, within 0.5 mm of the given ones and on the part.

    A part that is lower than all of them gets its uppermost millimetre: a state has some section.
    """
    ranges: list[tuple[float, float]] = []
    for begin, end in sorted(map(ends_mm, heights_mm)):
        low, high = max(begin - _NEAR_MM, 0.0), min(end + _NEAR_MM, top_mm)
        if low >= high:
            continue
        if ranges and low <= ranges[-1][1]:
            ranges[-1] = ranges[-1][0], max(high, ranges[-1][1])
        else:
            ranges.append((low, high))
    return ranges or [(max(top_mm - 2 * _NEAR_MM, 0.0), top_mm)]


def ranges_known(sections: Sequence[CrossSection]) -> list[tuple[float, float]]:
    """Ranges of height (mm) that sections cover, ascending and apart, as the file has them."""
    ranges: list[tuple[float, float]] = []
    for section in sections:
        low, high = (rounded(end) for end in section.z_mm)
        if ranges and low <= ranges[-1][1]:
            ranges[-1] = ranges[-1][0], high
        else:
            ranges.append((low, high))
    return ranges


def sections_text(sections: Sequence[CrossSection]) -> list[SectionText]:
    """Cross sections as they stand in a file, from the table up."""
    return [
        SectionText(
            z=(rounded(section.z_mm[0]), rounded(section.z_mm[1])), polygons=polygons_text(section.regions)
        )
        for section in sorted(sections, key=lambda item: item.z_mm)
    ]


def polygons_text(
    regions: Sequence[Region], origin_mm: tuple[float, float] = (0.0, 0.0)
) -> list[PolygonText]:
    """Regions as they stand in a file, seen from another origin."""
    origin = np.array(origin_mm)
    return [_polygon_text(region, origin) for region in regions]


def side_text(rings: Sequence[Floats]) -> list[list[tuple[float, float]]] | None:
    """Rings of a picture, to a hundredth of a millimetre; the longest of very many."""
    longest = sorted(rings, key=len, reverse=True)[:_MOST_RINGS]
    return [[(round(x, 2) + 0.0, round(z, 2) + 0.0) for x, z in ring.tolist()] for ring in longest] or None


def edges_of(section: SectionText) -> int:
    """How many edges a section has, those of holes included."""
    return sum(
        outline_edges(ring) for polygon in section.polygons for ring in (polygon.outer, *polygon.holes)
    )


def frame_out(rotation: Floats, offset_mm: Floats) -> FrameOut:
    """How a state lies to its file: `rotation` (3, 3), `offset_mm` (3,)."""
    rows = [(float(a), float(b), float(c)) for a, b, c in rotation]
    x, y, z = (float(value) for value in offset_mm)
    return FrameOut(rotation=tuple(rows), offset=(x, y, z))


def rounded(value: float) -> float:
    """A number of the file."""
    return round(float(value), DECIMALS) + 0.0


def rounded_up(value: float) -> float:
    """A bound of the file, upward."""
    scale: int = 10**DECIMALS
    return math.ceil(value * scale) / scale


def share(value: float) -> float:
    """A probability, downward: all states' together must not come to more than 1."""
    scale: int = 10**DECIMALS
    return math.floor((value + _SUMMING) * scale) / scale


def bound_mm(parts_mm: Iterable[float]) -> float:
    """The sum of bounds, upward to a tenth of a micrometre, but for what is nothing but rounding."""
    beyond = max(math.fsum(parts_mm) - NEGLIGIBLE_MM, 0.0)
    return math.ceil(beyond * _BOUND_STEPS) / _BOUND_STEPS


def _polygon_text(region: Region, origin: Floats) -> PolygonText:
    outer = _ring_text(region.outer - origin)
    if not region.holes:
        return PolygonText(outer=outer)
    return PolygonText(outer=outer, holes=[_ring_text(hole - origin) for hole in region.holes])


def _ring_text(ring: Floats) -> list[tuple[float, float]]:
    points = np.round(ring, DECIMALS) + 0.0
    # Where rounding makes two points one, one is left.
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1.5 * MIN_EDGE_MM
    return [(x, y) for x, y in points[apart].tolist()]
