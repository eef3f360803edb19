"""Stable states of an imported solid, with their cross sections as an objects file has them.

Stable states that are the same but for a turn about the vertical become one. Coordinates have six decimals,
bounds are rounded outward.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from multiprocessing import parent_process

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Polygon
from palpate.cad.parts import CrossSection, Solid, StableState
from palpate.cad.resting_surface import (
    RestingSurface,
    regions_of,
    resting_surface_of,
    silhouette,
    slice_surface,
)
from palpate.cad.section_bounds import valid_region
from palpate.cad.sections import SectionsError, sections_of
from palpate.cad.stable_states import LeftOut, stable_states, state_as_drawn
from palpate.cad.state_merging import MergedState, merge_states
from palpate.config.catalogue_results import FrameOut, ImportedStateOut, OmittedStatesOut
from palpate.config.fields import DECIMALS
from palpate.config.objects_tables import PolygonText, SectionText, StateText, outline_edges
from palpate.config.outline_checks import MIN_AREA_MM2, MIN_EDGE_MM
from palpate.rig.catalogue.round_outlines import RoundSections, round_sections
from palpate.rig.workers import in_processes

_NEGLIGIBLE_MM = 1e-5
"""What rounding does to coordinates, here and in files with single precision; it is no tolerance."""

Height = float | tuple[float, float]
"""A height that is wanted, mm; two: all from one to the other."""

_NEIGHBOURHOOD_MM = 0.5
_MAX_RINGS = 64
_SUMMING_SLACK = 1e-9  # a sixth, six times added, is less than 1
_BOUND_STEPS = 10_000  # to a millimetre


def ends_mm(height_mm: Height) -> tuple[float, float]:
    """Ends of a range about a height that is wanted."""
    return height_mm if isinstance(height_mm, tuple) else (height_mm, height_mm)


def _ranges_near(heights_mm: Iterable[Height], top_mm: float) -> list[tuple[float, float]]:
    """Ranges of height, ascending and apart, within 0.5 mm of the given ones and on the part.

    A part that is lower than all of them gets its uppermost millimetre: a state has some section.
    """
    ranges: list[tuple[float, float]] = []
    for begin, end in sorted(map(ends_mm, heights_mm)):
        low, high = max(begin - _NEIGHBOURHOOD_MM, 0.0), min(end + _NEIGHBOURHOOD_MM, top_mm)
        if low >= high:
            continue
        if ranges and low <= ranges[-1][1]:
            ranges[-1] = ranges[-1][0], max(high, ranges[-1][1])
        else:
            ranges.append((low, high))
    return ranges or [(max(top_mm - 2 * _NEIGHBOURHOOD_MM, 0.0), top_mm)]


def _ranges_known(sections: Sequence[CrossSection]) -> list[tuple[float, float]]:
    """Ranges of height (mm) that sections cover, ascending and apart, as the file has them."""
    ranges: list[tuple[float, float]] = []
    for section in sections:
        low, high = (round_coordinate(end) for end in section.z_mm)
        if ranges and low <= ranges[-1][1]:
            ranges[-1] = ranges[-1][0], high
        else:
            ranges.append((low, high))
    return ranges


def _sections_text(sections: Sequence[CrossSection]) -> list[SectionText]:
    """Cross sections as they stand in a file, from the table up."""
    return [
        SectionText(
            z=(round_coordinate(section.z_mm[0]), round_coordinate(section.z_mm[1])),
            polygons=polygons_text(section.polygons),
        )
        for section in sorted(sections, key=lambda item: item.z_mm)
    ]


def polygons_text(
    regions: Sequence[Polygon], origin_mm: tuple[float, float] = (0.0, 0.0)
) -> list[PolygonText]:
    """Regions as they stand in a file, seen from another origin."""
    origin = np.array(origin_mm)
    return [_polygon_text(region, origin) for region in regions]


def _side_text(rings: Sequence[Floats]) -> list[list[tuple[float, float]]] | None:
    """Rings of a picture, to a hundredth of a millimetre; the longest of very many."""
    longest = sorted(rings, key=len, reverse=True)[:_MAX_RINGS]
    return [[(round(x, 2) + 0.0, round(z, 2) + 0.0) for x, z in ring.tolist()] for ring in longest] or None


def edge_count(section: SectionText) -> int:
    """Number of edges of a section, those of holes included."""
    return sum(
        outline_edges(ring) for polygon in section.polygons for ring in (polygon.outer, *polygon.holes)
    )


def frame_out(rotation: Floats, offset_mm: Floats) -> FrameOut:
    """Frame of a state in its file: `rotation` (3, 3), `offset_mm` (3,)."""
    rows = [(float(a), float(b), float(c)) for a, b, c in rotation]
    x, y, z = (float(value) for value in offset_mm)
    return FrameOut(rotation=tuple(rows), offset=(x, y, z))


def round_coordinate(value: float) -> float:
    """A number of the file."""
    return round(float(value), DECIMALS) + 0.0


def _round_up(value: float) -> float:
    """A bound of the file, upward."""
    scale: int = 10**DECIMALS
    return math.ceil(value * scale) / scale


def _round_probability(value: float) -> float:
    """A probability, downward: all states' together must not come to more than 1."""
    scale: int = 10**DECIMALS
    return math.floor((value + _SUMMING_SLACK) * scale) / scale


def bound_mm(parts_mm: Iterable[float]) -> float:
    """The sum of bounds, upward to a tenth of a micrometre, but for what is nothing but rounding."""
    beyond = max(math.fsum(parts_mm) - _NEGLIGIBLE_MM, 0.0)
    return math.ceil(beyond * _BOUND_STEPS) / _BOUND_STEPS


def _polygon_text(region: Polygon, origin: Floats) -> PolygonText:
    outer, holes = _ring_text(region.outer - origin), [_ring_text(hole - origin) for hole in region.holes]
    # A hole that encloses no area has no room for any tip, and could not be read again.
    kept = [hole for hole in holes if len(hole) > 2 and shapely.Polygon(hole).area >= MIN_AREA_MM2]
    return PolygonText(outer=outer, holes=kept) if kept else PolygonText(outer=outer)


def _ring_text(ring: Floats) -> list[tuple[float, float]]:
    points = np.round(ring, DECIMALS) + 0.0
    # Where rounding makes two points one, one is left.
    apart = np.hypot(*(points - np.roll(points, 1, axis=0)).T) > 1.5 * MIN_EDGE_MM
    return [(x, y) for x, y in points[apart].tolist()]


Report = Callable[[str], None]

_HEIGHT_TOLERANCE_MM = 0.002  # about a height: fingers' are taken to be exact
_TOP_DIVISIONS = 20
_MAX_SECTIONS = 2000  # of a state; a wall that leans by 45° over 100 mm takes half as many at 0.1 mm


@dataclass(frozen=True)
class Shares:
    """Shares that an import may lose: to curves and few sections together, and to states made one.

    The rest as `cad_import.ImportOptions` has it.
    """

    sections_mm: float
    merged_mm: float
    heights_mm: tuple[Height, ...] | None
    least_probability: float
    as_is: bool
    deviation_mm: float = 0.0


@dataclass(frozen=True)
class ImportedState:
    """An imported state: its text in an objects file, and its entry in the result.

    `off_mm`: how far true sections may be from those written, what the surface itself is off included.
    """

    text: StateText
    result: ImportedStateOut
    off_mm: float


@dataclass(frozen=True)
class ImportedStates:
    """Every state of a solid that is written, and what is left out."""

    states: tuple[ImportedState, ...]
    left_out: tuple[OmittedStatesOut, ...] = ()
    warnings: tuple[str, ...] = ()


def import_states(solid: Solid, shares: Shares, report: Report) -> ImportedStates:
    """The states of a solid with their sections; `report` hears what is being done.

    States that can be given no section within the tolerance are left out. Raises InputError if all are.
    """
    if shares.as_is:
        return _as_it_lies(solid, shares, report)
    report("stable states")
    stable, unstable = stable_states(solid)
    kept, out = merge_states(solid, stable, _Slices(solid).of, shares.merged_mm, shares.least_probability)
    if not kept:
        raise InputError(
            f"{solid.name}: no stable state is as probable as {shares.least_probability:g}: "
            "give a smaller least probability, or import it as it is, without stable states"
        )
    report(f"sections of {len(kept)} states")
    found = _section_all(solid, kept, shares, report)
    states = tuple(item for item in found if isinstance(item, ImportedState))
    out += [item for item in found if isinstance(item, LeftOut)]
    if not states:
        raise InputError(f"{solid.name}: in each of its states {out[-1].reason}; give a greater tolerance")
    return ImportedStates(states, _left_out([*unstable, *out]))


def _section_all(
    solid: Solid, kept: Sequence[MergedState], shares: Shares, report: Report
) -> list[ImportedState | LeftOut]:
    """All states, in parallel processes; an interruption does not wait for those that have been begun.

    One after the other where there is one only, and where files are imported in parallel.
    """
    if len(kept) == 1 or parent_process() is not None:
        return [_section_state(solid, item, shares) for item in kept]
    found: dict[int, ImportedState | LeftOut] = {}
    for index, state in in_processes(_section_state, [(solid, item, shares) for item in kept]):
        found[index] = state
        report(f"sections of {len(kept)} states, {len(found)} done")
    return [found[index] for index in range(len(kept))]


def _section_state(solid: Solid, item: MergedState, shares: Shares) -> ImportedState | LeftOut:
    """One state, in a process of its own: large parts take seconds for each."""
    solid = solid if item.model is None else item.model
    try:
        sections = _sections(solid, item.state, shares)
    except SectionsError as error:
        return LeftOut(error.reason, item.state.probability, -item.state.rotation[2])
    return _imported_state(item.state, sections, solid, shares, item)


def _as_it_lies(solid: Solid, shares: Shares, report: Report) -> ImportedStates:
    """The only state of a solid that is not dropped."""
    state = state_as_drawn(solid)
    warnings = (
        () if state.tipping_angle_rad > 0 else ("would topple as it lies in the file, if nothing held it",)
    )
    report("sections")
    return ImportedStates(
        (_imported_state(state, _sections(solid, state, shares), solid, shares),), (), warnings
    )


class _Slices:
    """Exact sections of a solid's states, for those who compare them."""

    def __init__(self, solid: Solid) -> None:
        self._solid = solid
        self._last: tuple[StableState, RestingSurface] | None = (
            None  # one: hundreds of large surfaces are too many
        )

    def of(self, state: StableState, heights_mm: Floats) -> list[shapely.Geometry]:
        """Solid regions at each of the heights; empty above the part."""
        if self._last is None or self._last[0] is not state:
            self._last = state, resting_surface_of(self._solid, state)
        surface = self._last[1]
        return [_region(surface, float(height)) for height in heights_mm]


def _region(surface: RestingSurface, height_mm: float) -> shapely.Geometry:
    return valid_region(regions_of([ring.points for ring in slice_surface(surface, height_mm)]))


def _sections(solid: Solid, state: StableState, shares: Shares) -> tuple[CrossSection, ...]:
    """Sections that are written: of all heights, or near those that were asked for.

    A height that is asked for is known by itself where a wall is too nearly level for more. A state that is
    known at none of them is there all the same: then its top is. Raises SectionsError if none can be given.
    """
    near, top = shares.heights_mm, _top_mm(solid, state)
    if near is None:
        return sections_of(solid, state, shares.sections_mm, None, _MAX_SECTIONS)
    found = _between(solid, state, shares, _ranges_near(near, top))
    for height in dict.fromkeys(end for each in near for end in ends_mm(each)):
        if height < top:
            found = _with_height(found, height, solid, state, shares)
    if any(section.polygons for section in found):
        return found
    return tuple(sorted((*found, *_uppermost(solid, state, shares)), key=lambda section: section.z_mm))


def _uppermost(solid: Solid, state: StableState, shares: Shares) -> tuple[CrossSection, ...]:
    """Sections of the uppermost twentieth of a state that has any. Raises SectionsError if none has."""
    parts = _top_mm(solid, state) * np.linspace(1.0, 0.0, _TOP_DIVISIONS + 1)
    problems: list[SectionsError] = []
    for end, begin in pairwise(parts.tolist()):
        try:
            return sections_of(solid, state, shares.sections_mm, [(begin, end)], _MAX_SECTIONS)
        except SectionsError as error:
            problems.append(error)
    raise problems[0]


def _with_height(
    found: tuple[CrossSection, ...], height_mm: float, solid: Solid, state: StableState, shares: Shares
) -> tuple[CrossSection, ...]:
    """The sections with one at just this height, if there is none and it can be given."""
    low = max((s.z_mm[1] for s in found if s.z_mm[0] <= height_mm), default=0.0)
    high = min((s.z_mm[0] for s in found if s.z_mm[1] >= height_mm), default=math.inf)
    if low >= height_mm or high <= height_mm:
        return found
    just = [(max(low, height_mm - _HEIGHT_TOLERANCE_MM), min(high, height_mm + _HEIGHT_TOLERANCE_MM))]
    some = _between(solid, state, shares, just)
    return tuple(sorted((*found, *some), key=lambda section: section.z_mm))


def _between(
    solid: Solid, state: StableState, shares: Shares, ranges_mm: Sequence[tuple[float, float]]
) -> tuple[CrossSection, ...]:
    """Sections in ranges of height; none if none can be given."""
    try:
        return sections_of(solid, state, shares.sections_mm, ranges_mm, _MAX_SECTIONS)
    except SectionsError:
        return ()


def _top_mm(solid: Solid, state: StableState) -> float:
    return float((solid.vertices_mm @ state.rotation[2]).max() + state.offset_mm[2])


def _imported_state(
    state: StableState,
    sections: Sequence[CrossSection],
    solid: Solid,
    shares: Shares,
    found: MergedState | None = None,
) -> ImportedState:
    """A state as text of the file and as result; `found`: None for a part that rests as drawn."""
    probability = None if found is None else _round_probability(state.probability)
    apart_mm = 0.0 if found is None else found.apart_mm
    circles = round_sections(solid, state, sections, shares.sections_mm)
    if circles is None:
        some = _sections_text([section for section in sections if section.polygons])
    else:
        some = list(circles.sections)
    top = round_coordinate(_top_mm(solid, state))
    known = _ranges_known(sections)
    everywhere = len(known) == 1 and known[0][0] == 0.0 and known[0][1] >= top - _NEGLIGIBLE_MM
    heights = None if everywhere else known
    # Faces that are level but for rounding end where their sections do.
    height = some[-1].z[1] if everywhere else max(top, *(section.z[1] for section in some))
    tipping = round_coordinate(state.tipping_angle_rad) or None
    counts = [edge_count(section) for section in some]
    text = StateText(
        name=state.name,
        probability=probability,
        tipping_angle=tipping,
        height=height,
        heights=heights,
        normal_bound=circles and _normal_bound_rad(circles, solid, shares, found),
        sections=some,
        side=_side_text(silhouette(solid, state)),
    )
    off = max(section.off_mm for section in sections) if circles is None else circles.off_mm
    result = ImportedStateOut.of(
        text,
        sections=len(some),
        edges=(min(counts), max(counts)),
        merged=1 if found is None else found.count,
        section_tolerance=bound_mm([off - solid.off_mm]),
        merged_tolerance=bound_mm([apart_mm]),
        frame=frame_out(state.rotation, state.offset_mm),
    )
    return ImportedState(text, result, off + apart_mm)


def _normal_bound_rad(
    circles: RoundSections, solid: Solid, shares: Shares, found: MergedState | None
) -> float | None:
    """Bound on how far normals of the part may be off those of the circles; None where nobody knows.

    Facets say nothing of a curve that they are some way off, nor of what was made otherwise. A state that was
    merged stands with its axis off by what merged states are apart; more than two, both ends of one axis, are
    those of a ball, each with an axis of its own.
    """
    if shares.deviation_mm > 0 or solid.off_mm > _NEGLIGIBLE_MM or (found is not None and found.count > 2):
        return None
    apart = 0.0 if found is None else found.apart_mm
    return _round_up(circles.turn_rad + math.asin(min(apart / circles.least_radius_mm, 1.0)))


def _left_out(items: Sequence[LeftOut]) -> tuple[OmittedStatesOut, ...]:
    """States left out, those of one reason together, the most frequent first."""
    groups: dict[str, list[LeftOut]] = {}
    for item in items:
        groups.setdefault(item.reason.partition(":")[0], []).append(item)
    result = [
        OmittedStatesOut(reason=reason, states=len(some), probability=sum(item.probability for item in some))
        for reason, some in groups.items()
    ]
    return tuple(sorted(result, key=lambda item: -item.probability))
