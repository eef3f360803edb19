"""Cross sections of a resting solid, with adaptive heights and proven error bounds.

Each stands for a slab of heights by one outline, taken near the slab's middle and simplified.
`section_bounds` bounds how far every true edge in the slab is from it; outside of a tube of that radius
round its edges nothing changes over the slab, so every true section's material is within it of the outline's;
the reverse is proven there, too. Where the real surface may be off the facets, facets that are as much
higher or lower count, too: sloping walls are off by more in a section than in space. Slabs end at level faces
and where upright walls begin or end; in between they are made as high as the proof allows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, Ints, Polygon
from palpate.base.geometry.outlines import EdgeRings
from palpate.base.geometry.plane import segment_distance
from palpate.cad.parts import CrossSection, Solid, StableState
from palpate.cad.resting_surface import (
    ROUNDING_SHARE,
    SAME_HEIGHT_MM,
    RestingSurface,
    SectionRing,
    regions_of,
    resting_surface_of,
    slice_surface,
)
from palpate.cad.section_bounds import (
    corner_pieces,
    distance_bound,
    facet_pieces,
    material_bound_mm,
    simplify_ring,
)

_SIMPLIFY_SHARE = 0.18
"""Of the tolerance, for simplifying outlines between sloping walls; drift over the slab takes the rest."""
_SIMPLIFY_SHARE_UPRIGHT = 0.9
_KEPT_EDGES = 60
"""Outlines with no more are left as they are, but for rounding."""
_ENOUGH_SHARE = 0.93
"""A slab that takes so much of the tolerance is high enough."""
_AIM_SHARE = 0.985
_MAX_TRIES = 7
_MAX_GROWTH = 4.0
"""A slab is tried that is at most so many times higher than the one before."""
_LEAST_SLAB_MM = 1e-3
_ROUNDING_SHARE = 1e-6
"""Heights of slabs that differ by less are the same."""
_SOONER_SHARES = (0.5, 0.8, 0.2)
"""Where in a slab the next one may begin if it cannot at its end."""
_LEVEL_PROBLEM = "a wall that leans moves too far"
_THIN_SLAB_MM, _MOST_THIN_SLABS = 0.02, 4
"""Nobody knows a finger's height better: after so many lower slabs in a row, heights are skipped."""
_MOST_SKIPPED_MM = 0.32
"""At once, beside a height where sections cannot be given."""
_LEAST_KNOWN_MM = 0.25
"""Sections between skipped heights are left out too if they cover less."""
_SAME_POINT_MM = 2e-6
"""Points closer together are one."""
_RING_SHARE = 0.05
"""Of the size of a ring: no ring is simplified by more than this."""


class SectionsError(InputError):
    """Failure to give a state the sections that were asked for; `reason` says why."""

    def __init__(self, where: str, reason: str, advice: str = "give a greater tolerance") -> None:
        super().__init__(where, reason, advice)
        self.reason = reason

    def __str__(self) -> str:
        return "{}: {}; {}".format(*self.args)


def sections_of(
    solid: Solid,
    state: StableState,
    tolerance_mm: float,
    heights_mm: Sequence[tuple[float, float]] | None = None,
    most: int = 400,
) -> tuple[CrossSection, ...]:
    """Cross sections of a solid as it rests, from the support plane up, within a tolerance.

    `heights_mm`: only these ranges, clipped to the part; `most`: no more sections than this. A height means
    that height within 1 µm. Heights at which a wall is so nearly level that a slab of 0.02 mm would leave
    the tolerance are in no section: there nothing is known. Raises InputError if the tolerance leaves
    nothing beside what the solid is off by; SectionsError if no range meets the part, if no height can be
    known, and if more sections were needed, naming the height.
    """
    budget = tolerance_mm - solid.off_mm
    if not budget > 0:
        raise InputError(
            f"{solid.name}: its surface is off by {solid.off_mm:.3g} mm already; "
            f"give a tolerance greater than that"
        )
    where = f"{solid.name}, {state.name}"
    surface = resting_surface_of(solid, state)
    found: list[CrossSection] = []
    problem = ""
    for begin, end in _without(_ranges(solid, surface, heights_mm), state.unknown_mm):
        for slab, trial in _slabs(surface, begin, end, budget):
            problem = problem or trial.problem
            if len(found) == most:
                raise SectionsError(
                    where,
                    f"more than {most} cross sections are needed at height {slab[0]:.4g} mm",
                    "give heights that leave it out, or a greater tolerance",
                )
            if not trial.problem:
                found.append(CrossSection(slab, trial.regions, trial.off_mm + solid.off_mm))
    known = tuple(_long_runs(found))
    if not any(section.polygons for section in known):
        problem = problem or "each range of heights is too short, or differs as the part rolls"
        off = f" where its surface is off by {solid.off_mm:.2g} mm" if solid.off_mm > SAME_HEIGHT_MM else ""
        raise SectionsError(where, f"no section can be given, as {problem}{off}")
    return known


def _long_runs(sections: list[CrossSection]) -> Iterator[CrossSection]:
    """Select sections that follow one another over a quarter of a millimetre, or over all there is."""
    run: list[CrossSection] = []
    for section in [*sections, None]:
        if run and (section is None or section.z_mm[0] > run[-1].z_mm[1]):
            long = run[-1].z_mm[1] - run[0].z_mm[0] >= _LEAST_KNOWN_MM
            if long or len(run) == len(sections):
                yield from run
            run = []
        if section is not None:
            run.append(section)


def _ranges(
    solid: Solid, surface: RestingSurface, heights_mm: Sequence[tuple[float, float]] | None
) -> list[tuple[float, float]]:
    """Disjoint ranges of height, ascending, within the part."""
    top = surface.top_mm
    if heights_mm is None:
        return [(0.0, top)]
    merged: list[tuple[float, float]] = []
    for begin, end in sorted((max(0.0, a), min(top, b)) for a, b in heights_mm):
        if end - begin < SAME_HEIGHT_MM:
            continue
        if merged and begin <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((begin, end))
    if not merged:
        raise SectionsError(
            solid.name, f"no given height is on the part, which is {top:.4g} mm high", "give others"
        )
    return merged


def _without(
    ranges: Sequence[tuple[float, float]], unknown: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """What ranges of height, ascending and apart, leave of others."""
    left = list(ranges)
    for low, high in unknown:
        parts = [part for begin, end in left for part in ((begin, min(end, low)), (max(begin, high), end))]
        left = [(begin, end) for begin, end in parts if end - begin >= SAME_HEIGHT_MM]
    return left


@dataclass(frozen=True, eq=False)
class _Trial:
    """Result of trying one outline for a slab: `off_mm` is proven if there is no `problem`.

    `drift_mm`: how far walls are from it, or an estimate; 0 where nothing can be said.
    """

    regions: tuple[Polygon, ...]
    off_mm: float
    drift_mm: float
    problem: str = ""


_Slab = tuple[tuple[float, float], _Trial]


@dataclass(frozen=True, eq=False)
class _SlabSearch:
    """Search for slabs below a height `high` of a surface, within a `budget` (mm) of deviation.

    `peaks` (k,): heights at which some part of the surface begins or ends.
    """

    surface: RestingSurface
    high: float
    peaks: Floats
    budget: float

    def begin_lower(
        self, last: _Slab, here: tuple[float, _Trial]
    ) -> tuple[_Slab, tuple[float, float], _Trial]:
        """The slab before and the one that follows it, if none is found that begins where that one ends.

        What is proven of a slab is proven of a part of it: the next one may begin in it, and get over a
        height at which none can begin. `here`: end and trial of the one that failed, which comes back if no
        other does.
        """
        (begin, end), proven = last
        for share in _SOONER_SHARES:
            at = begin + share * (end - begin)
            to, trial = self.highest_slab(at, 2 * (end - at))
            if not trial.problem and to > end + _LEAST_SLAB_MM:
                return ((begin, at), proven), (at, to), trial
        return last, (end, here[0]), here[1]

    def highest_slab(self, at: float, height: float, least: float = _LEAST_SLAB_MM) -> tuple[float, _Trial]:
        """The end of the highest slab from `at` that is found in a few tries, up to `high`.

        The first guess is `height`; slabs lower than `least` are not looked for. How far an outline is off
        tells by how much to change it; where that says nothing, because something begins or ends in the
        slab, it may have to end at a peak.
        """
        good: tuple[float, _Trial] | None = None
        bad = np.inf
        to = min(self.high, at + height)
        if self.high - to < 0.2 * height:
            to = self.high
        tries = 0
        while True:
            trial = _try_outline(self.surface, at, to, self.budget)
            tries += 1
            if not trial.problem:
                good = (to, trial)
                if to == self.high or trial.drift_mm >= _ENOUGH_SHARE * self.budget or tries >= _MAX_TRIES:
                    return good
            else:
                bad = to
            if good is not None and (tries >= _MAX_TRIES or bad - good[0] < 0.04 * (good[0] - at)):
                return good
            if good is None and bad - at < least * (1 + _ROUNDING_SHARE):
                return bad, trial
            to = self._next_end(at, good, bad, trial, tries)

    def _next_end(
        self, at: float, good: tuple[float, _Trial] | None, bad: float, trial: _Trial, tries: int
    ) -> float:
        """The end to be tried next, between one that is good, if any, and one that is bad, if any.

        What an outline is off need not shrink with the slab: after a second bad try it is lowered by more.
        """
        least = at if good is None else good[0]
        tried = bad if trial.problem else least
        if 0 < trial.drift_mm < np.inf:
            ratio = _AIM_SHARE * self.budget / trial.drift_mm
            power = min(tries, 2) if good is None else 1
            guess = at + (tried - at) * min(max(ratio**power, 0.1), _MAX_GROWTH)
        else:
            between = (
                self.peaks[(self.peaks > least) & (self.peaks < bad)] if bad < np.inf else self.peaks[:0]
            )
            guess = float(between[len(between) // 2]) if len(between) else np.inf
        if bad == np.inf:
            return self.high if self.high - guess < 0.2 * (guess - at) else min(guess, self.high)
        margin = 0.02 * (bad - least)
        if good is None and self.budget < trial.drift_mm < np.inf:
            guess = min(guess, bad - 2 * margin)
        if least + margin < guess < bad - margin:
            return guess
        return (least + bad) / 2 if good is not None else at + (bad - at) / 4


def _slabs(surface: RestingSurface, begin: float, end: float, budget: float) -> Iterator[_Slab]:
    """Slabs that tile a range, each as high as can be; those with a problem have no outline.

    Beside a height that has a problem more and more is skipped, so that a nearly level wall is soon over.
    """
    breaks = _breaks(surface, budget)
    breaks = breaks[(breaks > begin + SAME_HEIGHT_MM) & (breaks < end - SAME_HEIGHT_MM)]
    peaks = surface.peaks()
    for low, high in zip([begin, *breaks], [*breaks, end], strict=True):
        search = _SlabSearch(surface, high, peaks, budget)
        at, height, skip, thin, likely = low, high - low, _THIN_SLAB_MM, 0, 2 * _AIM_SHARE * budget
        last: _Slab | None = None  # it may yet have to end sooner
        while at < high:
            height = max(_foreseen_height(surface, at, at + height, likely), _THIN_SLAB_MM)
            # Beyond a height that is skipped, thin slabs seldom begin a run that is long enough to be kept.
            skipping = last is not None and bool(last[1].problem)
            to, trial = search.highest_slab(at, height, _THIN_SLAB_MM if skipping else _LEAST_SLAB_MM)
            if trial.problem and last is not None and not last[1].problem:
                last, (at, to), trial = search.begin_lower(last, (to, trial))
            likely = _likely_drift(surface, at, to, trial, budget)
            thin = thin + 1 if to - at < _THIN_SLAB_MM and to < high else 0
            if trial.problem or thin > _MOST_THIN_SLABS:
                trial = replace(trial, problem=trial.problem or _LEVEL_PROBLEM)
                to = min(high, at + skip)
                skip = min(2 * skip, _MOST_SKIPPED_MM)
            elif not thin:
                skip = _THIN_SLAB_MM
            if last is not None:
                yield last
            last = (at, to), trial
            at, height = to, _MAX_GROWTH * max(to - at, _THIN_SLAB_MM)
        if last is not None:
            yield last


def _foreseen_height(surface: RestingSurface, at: float, high: float, likely_mm: float) -> float:
    """Height of a slab from `at` in which no facet drifts sideways by more, up to `high`: a guess for one."""
    facets = surface.within(at, high)
    begin, drift = np.maximum(surface.low[facets], at), surface.drift[facets]
    end = begin + likely_mm / np.maximum(drift, 1e-300)
    return float(end[end < surface.high[facets]].min(initial=high)) - at


def _likely_drift(surface: RestingSurface, at: float, to: float, trial: _Trial, budget: float) -> float:
    """Estimate of a facet's drift in the next slab, from how far an outline was off in this one."""
    facets = surface.within(at, to)
    height = np.minimum(surface.high[facets], to) - np.maximum(surface.low[facets], at)
    drifted = float((surface.drift[facets] * height).max(initial=0.0))
    if not 0 < trial.drift_mm < np.inf:
        return 2 * _AIM_SHARE * budget
    return _AIM_SHARE * budget * min(max(drifted / trial.drift_mm, 1.0), _MAX_GROWTH)


def _breaks(surface: RestingSurface, budget: float) -> Floats:
    """Heights (k,) of level faces, and those at which all walls begin or cease to be upright."""
    corners = surface.vertices_mm[surface.faces[surface.level]]
    extent = np.ptp(corners, axis=1).max(axis=1, initial=0.0)
    faces = corners[extent > budget / 2, 0, 2]
    sloping = ~surface.level & ~surface.upright
    order = np.argsort(surface.low[sloping])
    low, high = surface.low[sloping][order], np.maximum.accumulate(surface.high[sloping][order])
    gap = np.flatnonzero(low[1:] > high[:-1] + SAME_HEIGHT_MM)
    bounds = np.concatenate([low[:1], high[gap], low[gap + 1], high[-1:]])
    return np.unique(np.concatenate([faces, bounds]))


def _try_outline(surface: RestingSurface, low: float, high: float, budget: float) -> _Trial:
    """Try one outline for a slab."""
    facets = surface.within(low, high)
    if not len(facets):
        return _Trial((), 0.0, 0.0)
    around = surface.around(low, high)
    facets = surface.within(*around)
    upright = bool((surface.upright | surface.bare)[facets].all())
    for share in (0.5, 0.42, 0.61):
        raw = [
            ring
            for ring in map(_clean, slice_surface(surface, low + share * (high - low)))
            if len(ring.points)
        ]
        most = budget * (_SIMPLIFY_SHARE_UPRIGHT if upright else _SIMPLIFY_SHARE)
        few = sum(len(ring.points) for ring in raw) <= _KEPT_EDGES
        # Facets of one plane are not quite that in single precision: their points go in any case.
        rounding = min(ROUNDING_SHARE * surface.size_mm, most)
        for simplify in (rounding, 0.0) if few else (most, rounding, 0.0):
            trial = _prove(surface, facets, around, raw, simplify, budget)
            if trial is not None:
                return trial
    return _Trial((), 0.0, 0.0, "its outline crosses or touches itself")


def _prove(
    surface: RestingSurface,
    facets: Ints,
    slab: tuple[float, float],
    raw: list[SectionRing],
    simplify: float,
    budget: float,
) -> _Trial | None:
    """Simplify an outline and prove it; None if it is not simple, or a hole of it is in no material."""
    rings, owners = [], []
    count, stray = 0, 0.0
    for ring in raw:
        least = min(simplify, _RING_SHARE * float(np.ptp(ring.points, axis=0).max()))
        own = simplify_ring(ring.points, surface.normal[ring.facet], surface.bare[ring.facet], least)
        if len(own) < 3:
            own = np.arange(len(ring.points))
        place = (np.searchsorted(own, np.arange(len(ring.points)), side="right") - 1) % len(own)
        stray = max(stray, _stray_mm(ring.points, ring.points[own], place))
        rings.append(ring.points[own])
        owners.append(count + place)
        count += len(own)
    outline = EdgeRings.of(rings)
    off, good = _outline_bound(surface, facets, slab, raw, outline, owners, budget)
    if not good:
        return _Trial((), off, off, _LEVEL_PROBLEM)
    if rings and not shapely.MultiLineString([np.vstack([ring, ring[:1]]) for ring in rings]).is_simple:
        return None
    off = max(off, stray, 1e-9 * surface.size_mm)
    try:
        regions = regions_of(rings)
        reached = material_bound_mm(
            regions, lambda: regions_of([ring.points for ring in raw]), surface, facets, slab, off, budget
        )
    except InputError:  # a hole lies outside of the material
        return None
    if reached is None:
        return _Trial((), off, off, "something too thin leans too much")
    return _Trial(regions, reached, off)


def _outline_bound(
    surface: RestingSurface,
    facets: Ints,
    slab: tuple[float, float],
    raw: list[SectionRing],
    outline: EdgeRings,
    owners: list[Ints],
    budget: float,
) -> tuple[float, bool]:
    if not raw:
        return np.inf, False
    middles = np.concatenate([(ring.points + np.roll(ring.points, -1, axis=0)) / 2 for ring in raw])
    near, owner = cKDTree(middles), np.concatenate(owners)
    most = 0.0
    for pieces in (facet_pieces(surface, facets, *slab), corner_pieces(surface, facets, *slab)):
        off, good = distance_bound(pieces, outline, near, owner, budget, budget)
        most = max(most, off)
        if not good:
            return off, False
    return most, True


def _stray_mm(points: Floats, chosen: Floats, place: Ints) -> float:
    """Largest distance of points (n, 2) from chords between `chosen` ones; `place` (n,): whose chord."""
    ends = np.roll(chosen, -1, axis=0)
    return float(segment_distance(points, chosen[place], ends[place]).max())


def _clean(ring: SectionRing) -> SectionRing:
    """Without points that repeat the one before."""
    far = np.hypot(*(np.roll(ring.points, -1, axis=0) - ring.points).T) > _SAME_POINT_MM
    return SectionRing(ring.points[far], ring.facet[far])
