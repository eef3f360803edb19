"""Sections of a state by height, the heights at which they are known, and their rotational symmetry.

Regions are Shapely's, mm, in the object's own frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import shapely

from palpate.base.geometry import Floats, Section, State
from palpate.base.geometry.outlines import polygons_of, region_of
from palpate.config import ObjectsFile
from palpate.recognizer import SYMMETRY_TOLERANCE_MM, centroid, rotational_symmetry

Range = tuple[float, float]

_SAME_PLACES_MM = 1e-6  # regions whose points agree to this are drawn and listed as one


@dataclass(frozen=True, eq=False)
class Level:
    """A range of height (mm, both ends included) over which the region is one and the same."""

    z_mm: Range
    region: shapely.Geometry
    edges: int

    def is_at(self, z_mm: float) -> bool:
        """True if a height is in the range."""
        return self.is_within((z_mm, z_mm))

    def is_within(self, span_mm: Range) -> bool:
        """True if some height of a span is in the range."""
        return self.z_mm[0] <= span_mm[1] and span_mm[0] <= self.z_mm[1]


@dataclass(frozen=True, eq=False)
class StateSections:
    """One state of one object; the true outlines are within `tolerance_mm` of the regions."""

    object_name: str
    state: State
    tolerance_mm: float

    @property
    def name(self) -> str:
        """Object and state, as results name them."""
        return f"{self.object_name}, {self.state.name}"

    @cached_property
    def levels(self) -> tuple[Level, ...]:
        """Levels from the bottom up; sections that touch and are the same are one."""
        levels: list[Level] = []
        for section in sorted(self.state.sections, key=lambda part: part.z_mm):
            level = Level(section.z_mm, region_of(section.polygons), sum(map(len, section.rings)))
            below = levels[-1] if levels else None
            if below is not None and below.z_mm[1] == level.z_mm[0] and _same(below.region, level.region):
                levels[-1] = Level((below.z_mm[0], level.z_mm[1]), below.region, below.edges)
            else:
                levels.append(level)
        return tuple(levels)

    def region_at(self, z_mm: float) -> shapely.Geometry:
        """Region that a finger at a height meets, empty for nothing; of two sections, whichever stands out.

        The height must be known: `State.known_at`.
        """
        return self.region_within((z_mm, z_mm))

    def region_within(self, span_mm: Range) -> shapely.Geometry:
        """Region that a tip between two heights meets: whatever stands out anywhere along it."""
        found = [level.region for level in self.levels if level.is_within(span_mm)]
        return found[0] if len(found) == 1 else shapely.union_all(found)

    @property
    def steps_mm(self) -> tuple[float, ...]:
        """Heights at which something begins or ends, ascending: sections, and what is known."""
        ends = [z for level in self.levels for z in level.z_mm]
        ends += [z for known in self.state.heights_mm or () for z in known]
        return tuple(sorted({*ends, 0.0, self.state.top_mm}))


def state_sections(objects: ObjectsFile) -> tuple[StateSections, ...]:
    """Every state of every object, in the file's order."""
    return tuple(
        StateSections(item.name, state, item.tolerance_mm + state.curves_off_mm)
        for item in objects.objects
        for state in item.states
    )


def region_within(state: State, span_mm: Range) -> shapely.Geometry:
    """Region of the sections between two heights, without the levels of the others; empty for nothing."""
    return shapely.union_all([region_of(section.polygons) for section in state.sections_within(span_mm)])


def level_bounds_mm(states: Sequence[StateSections], half_length_mm: float) -> list[float]:
    """Heights, ascending, at which what a tip of some length meets of some state begins or ends."""
    own = sorted({step for item in states for step in item.steps_mm})
    if not half_length_mm:
        return own
    ends = {step + side * half_length_mm for step in own for side in (-1, 1)}
    return sorted({half_length_mm, *(end for end in ends if end >= half_length_mm)})


def join_ranges(ranges: Sequence[Range]) -> tuple[Range, ...]:
    """Ranges in ascending order, with those that touch joined."""
    joined: list[Range] = []
    for low, high in sorted(ranges):
        if joined and low <= joined[-1][1]:
            joined[-1] = (joined[-1][0], max(high, joined[-1][1]))
        else:
            joined.append((low, high))
    return tuple(joined)


def _same(first: shapely.Geometry, second: shapely.Geometry) -> bool:
    return bool(shapely.equals_exact(first, second, _SAME_PLACES_MM, normalize=True))


@dataclass(frozen=True, eq=False)
class SectionSymmetry:
    """Symmetry: alike after each nth of a turn, n = `order`, about its centre of area (2,), mm."""

    order: int
    centre_mm: Floats


def symmetry_of_region(region: shapely.Geometry) -> SectionSymmetry:
    """SectionSymmetry of one section."""
    return _symmetry([(0.0, 1.0, region)])


def symmetry_of_state(state: StateSections) -> SectionSymmetry:
    """SectionSymmetry of all sections of a state together."""
    return _symmetry([(*level.z_mm, level.region) for level in state.levels])


def _symmetry(parts: list[tuple[float, float, shapely.Geometry]]) -> SectionSymmetry:
    state = State("", tuple(Section((low, high), polygons_of(region)) for low, high, region in parts))
    centre = centroid(state)
    return SectionSymmetry(rotational_symmetry(state, centre, SYMMETRY_TOLERANCE_MM).order, centre)
