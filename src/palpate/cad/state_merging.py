"""Merging of congruent stable states: a cube has six faces to rest on and one state.

Two states are one if a rigid motion in the plane, never a reflection, brings exact sections of one onto those
of the other (`planar_congruence`) at heights in the middle between levels of corners, of both, and if that
motion brings the whole resting solid onto itself (`surface_congruence`): sections propose, the surface
decides. States with the same height and the same height of the centre of mass are compared, one of each that
a known rotational symmetry makes of each other (`solid_symmetries`); a state that is not proven to be
congruent stays its own.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import shapely

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import signed_area
from palpate.cad.parts import Solid, StableState
from palpate.cad.planar_congruence import PlanarMotion, find_motions
from palpate.cad.resting_surface import ROUNDING_SHARE
from palpate.cad.rolling import RollingState, rolling_states
from palpate.cad.solid_symmetries import KnownSymmetries, orbits_of
from palpate.cad.stable_states import LeftOut, centre_of_mass, settle_leaning, upright_state
from palpate.cad.surface_congruence import SurfaceDistance, congruence_bound_mm

SlicesOf = Callable[[StableState, Floats], Sequence[Any]]
"""Exact sections of a state at heights (k,) as polygonal shapely geometries, empty ones above it."""

_MAX_HEIGHTS = 8
"""More heights than these are thinned out evenly."""
_MAX_COMPARED = 800
"""So many states are compared, most probable first."""
_MAX_SEARCH_COST = 150.0
"""Searches for motions between sections, those of more than 500 corners counted by the cube of these."""
_MAX_MOTIONS = 16
"""So many motions that sections allow are tried on the solid."""
_FACETS_OF_TWICE_EFFORT = 100_000
"""A surface of so many facets is worth twice the effort."""
_UPRIGHT_RAD = 1e-3
"""How far a symmetry may be from bringing one state to stand as another; it is put right then."""
_NEARLY_EXACT_SHARE = 0.05
"""Of the distance allowed: surfaces so near have sections that near, but where walls are all but level."""
_BALL_STATES = 12
"""So many states of a ball stand for all."""
_MOST_PROBABLE_ROLLING = 0.04
"""States that are more probable stay their own: a prism of few sides does not roll."""
_POLE_SHARE = 0.05
"""Share of a ball's height, at either end, where sections change too fast to be compared."""


@dataclass(frozen=True, eq=False)
class MergedState:
    """A state that stands for `count` of them, with their probabilities' sum and least tipping angle.

    `apart_mm`: the largest distance of any of their surfaces, and of any of the sections that were compared
    (without points in straight lines), from this state's. `model`: the solid that rests so, where it is not
    the one that was given, but one of revolution in its place (`rolling`).
    """

    state: StableState
    apart_mm: float
    count: int
    model: Solid | None = None


@dataclass(frozen=True, eq=False)
class _Family:
    """States that are about as tall are sliced at the same `heights_mm` (k,)."""

    top_mm: float
    heights_mm: Floats


@dataclass(frozen=True, eq=False)
class _Sliced:
    """A state with its slices at its family's heights, and the heights (h,) that its own levels ask for."""

    state: StableState
    centre_mm: float
    family: _Family
    slices: Sequence[Any]
    own_mm: Floats
    support_mm2: float


@dataclass(eq=False)
class _Group:
    first: _Sliced
    members: list[StableState] = field(default_factory=list)
    apart_mm: float = 0.0


def merge_states(
    solid: Solid,
    states: Sequence[StableState],
    slices_of: SlicesOf,
    within_mm: float,
    least_probability: float = 0.0,
    most: int = 24,
    effort: int = 800_000,
) -> tuple[list[MergedState], list[LeftOut]]:
    """States by falling probability, named anew, none within a distance of another; and what is left out.

    `states` as `stable_states` orders them. A ball, whose surface is everywhere as far from its centre
    within `within_mm`, has one state; its `apart_mm` is that of 12 states between 5 % and 95 % of its
    height. States of a part that rolls become one of a `model`. States that lean become one upright state or
    are left out. Of the others the 800 most probable are compared and further ones are left out together, as
    are those less probable than asked and those beyond the `most` most probable ones. Proofs are made
    until the distance from the surface of `effort` points was asked (10 µs each; twice as many for 100,000
    facets), and sections are compared up to a limit, too: what is left out says so, with no probability of
    its own.
    """
    if _is_ball(solid, within_mm):
        return _choose([_ball(solid, states, slices_of)], [], least_probability, most)
    rolling = _rolling(solid, states, within_mm, least_probability, most)
    rolled = {id(state) for item in rolling for state in item.members}
    states, out = settle_leaning(solid, [state for state in states if id(state) not in rolled])
    orbits = orbits_of(solid, states, within_mm)
    compared = orbits[:_MAX_COMPARED]
    groups: list[_Group] = []
    families: list[_Family] = []
    looks = round(effort * (1 + len(solid.faces) / _FACETS_OF_TWICE_EFFORT))
    pairs = _Pairs(solid, slices_of, within_mm, looks, KnownSymmetries(SurfaceDistance(solid)))
    for orbit in compared:
        sliced = _slice(solid, orbit.first, families, slices_of, within_mm)
        group, apart = _group_of(sliced, groups, pairs)
        group.members += orbit.members
        group.apart_mm = max(group.apart_mm, apart + orbit.apart_mm)
    rest = [state for orbit in orbits[len(compared) :] for state in orbit.members]
    if rest:
        out.append(
            _leave_out_together(f"{len(rest)} states beyond the {_MAX_COMPARED} that are compared", rest)
        )
    if pairs.unproven:
        reason = f"not compared, it would take too long: {len(pairs.unproven)} states may be as others are"
        out.append(LeftOut(reason, 0.0, -pairs.unproven[0].rotation[2]))
    found = [_merge_group(item.first.state, item.members, item.apart_mm) for item in groups]
    found += [MergedState(item.state, 0.0, len(item.members), item.model) for item in rolling]
    return _choose(found, out, least_probability, most)


def _rolling(
    solid: Solid, states: Sequence[StableState], within_mm: float, least: float, most: int
) -> list[RollingState]:
    """Families of states that roll into one another, more than half of which would be left out."""
    some = [
        orbit.members
        for orbit in orbits_of(solid, states, within_mm)
        if sum(state.probability for state in orbit.members) < _MOST_PROBABLE_ROLLING
    ]
    found = rolling_states(solid, [state for members in some for state in members], within_mm)
    # Each by itself is known at more heights.
    return [item for item in found if 2 * _share_alone(item, least, most) < item.state.probability]


def _share_alone(family: RollingState, least: float, most: int) -> float:
    """Probability of those members that would have a state of their own."""
    alone = [state.probability for state in family.members if state.probability >= least and not state.leans]
    return sum(alone[:most])


def _ball(solid: Solid, states: Sequence[StableState], slices_of: SlicesOf) -> MergedState:
    """A ball's one state: every section is in a ring about the centre, whichever facet it lies on."""
    first = states[0] if solid.axis is None else upright_state(solid, solid.axis, states)
    top = float((solid.vertices_mm @ first.rotation[2] + first.offset_mm[2]).max())
    heights = np.linspace(_POLE_SHARE, 1 - _POLE_SHARE, _MAX_HEIGHTS) * top
    least, most = np.full(_MAX_HEIGHTS, np.inf), np.zeros(_MAX_HEIGHTS)
    for state in states[:_BALL_STATES]:
        outlines = shapely.boundary(np.array(slices_of(state, heights), dtype=object))
        least = np.minimum(least, shapely.distance(outlines, shapely.Point(0.0, 0.0)))
        corners, owner = shapely.get_coordinates(outlines, return_index=True)
        np.maximum.at(most, owner, np.hypot(*corners.T))
    return _merge_group(first, states, float((most - least).max()))


def _choose(
    found: list[MergedState], out: list[LeftOut], least: float, most: int
) -> tuple[list[MergedState], list[LeftOut]]:
    found = sorted(found, key=lambda item: -round(item.state.probability, 6))
    likely = [item for item in found if item.state.probability >= least]
    for item in found[len(likely) :]:
        share = item.state.probability
        out.append(LeftOut(f"improbable: {100 * share:.2g} %", share, -item.state.rotation[2]))
    beyond = [item.state for item in likely[most:]]
    if beyond:
        out.append(_leave_out_together(f"{len(beyond)} states beyond the {most} most probable", beyond))
    named = [
        replace(item, state=replace(item.state, name=f"state-{number}"))
        for number, item in enumerate(likely[:most], start=1)
    ]
    return named, out


def _leave_out_together(reason: str, states: Sequence[StableState]) -> LeftOut:
    total = sum(state.probability for state in states)
    return LeftOut(f"{reason}: {100 * total:.2g} %", total, -states[0].rotation[2])


def _merge_group(first: StableState, members: Sequence[StableState], apart_mm: float) -> MergedState:
    state = replace(
        first,
        probability=sum(item.probability for item in members),
        tipping_angle_rad=min(item.tipping_angle_rad for item in members),
    )
    return MergedState(state, apart_mm, len(members))


def _slice(
    solid: Solid,
    state: StableState,
    families: list[_Family],
    slices_of: SlicesOf,
    within: float,
) -> _Sliced:
    height = solid.vertices_mm @ state.rotation[2] + state.offset_mm[2]
    centre = float(centre_of_mass(solid) @ state.rotation[2] + state.offset_mm[2])
    own, top = _heights(height, within), float(height.max())
    family = next((item for item in families if abs(item.top_mm - top) <= within), None)
    if family is None:
        family = _Family(top, own)
        families.append(family)
    slices = _straighten(slices_of(state, family.heights_mm), _straight_mm(solid))
    return _Sliced(state, centre, family, slices, own, signed_area(state.support_mm))


def _straight_mm(solid: Solid) -> float:
    """Points nearer to a straight line are on it: facets of one plane leave many in sections."""
    return ROUNDING_SHARE * float(np.ptp(solid.vertices_mm, axis=0).max())


def _straighten(slices: Sequence[Any], straight_mm: float) -> Sequence[Any]:
    result: Sequence[Any] = shapely.simplify(np.array(slices, dtype=object), straight_mm)
    return result


def _group_of(sliced: _Sliced, groups: list[_Group], pairs: "_Pairs") -> tuple[_Group, float]:
    """The group that a state belongs to, a new one if need be, and how far apart it is from its first."""
    alike = [
        group
        for group in groups
        if group.first.family is sliced.family
        and abs(group.first.centre_mm - sliced.centre_mm) <= pairs.within_mm
    ]
    # States that rest on as large a polygon are likely the same.
    for group in sorted(alike, key=lambda item: abs(item.first.support_mm2 - sliced.support_mm2)):
        apart = pairs.apart_mm(sliced, group.first)
        if apart is not None:
            return group, apart
    groups.append(_Group(sliced))
    return groups[-1], 0.0


class _Pairs:
    """Distances between pairs of states of one solid.

    `looks`: points that may be asked for; `unproven`: states that were not compared any more.
    """

    def __init__(
        self, solid: Solid, slices_of: SlicesOf, within_mm: float, looks: int, known: KnownSymmetries
    ) -> None:
        self.slices_of = slices_of
        self.within_mm = within_mm
        self.straight_mm = _straight_mm(solid)
        self.looks = looks
        self.known = known
        self.unproven: list[StableState] = []
        self.searched = 0.0

    def apart_mm(self, one: _Sliced, other: _Sliced) -> float | None:
        """Distance of a state from another; None if no motion is found that brings them close."""
        shared = one.family.heights_mm
        alike = len(one.own_mm) == len(shared) and np.allclose(
            one.own_mm, shared, rtol=0.0, atol=self.within_mm
        )
        first, second = one.slices, other.slices
        if alike:
            exactly = self._by_symmetry(one.state, other.state)
            if exactly is not None:
                return exactly
        if self.searched >= _MAX_SEARCH_COST:
            if one.state not in self.unproven:
                self.unproven.append(one.state)
            return None
        self.searched += max((shapely.get_num_coordinates(first).sum() / 500) ** 3, 1.0)
        found = find_motions(first, second, self.within_mm, most=1)
        if not found:
            return None
        if not alike:
            # Levels of its own: what is between them must be the same as well, in the same motion.
            both = np.concatenate([shared, one.own_mm])
            first, second = (
                _straighten(self.slices_of(item.state, both), self.straight_mm) for item in (one, other)
            )
            found = find_motions(first, second, self.within_mm, most=1)
        least = self._of_solid(one.state, other.state, found)
        if least is not None or not found:
            return least
        # Sections that are symmetric allow several motions, of which the solid may allow another one.
        every = find_motions(first, second, self.within_mm, most=_MAX_MOTIONS)
        return self._of_solid(one.state, other.state, every)

    def _by_symmetry(self, one: StableState, other: StableState) -> float | None:
        """Distance by a known symmetry of the solid, or two in a row, if it is nearly exact.

        Then no sections need to be compared. Putting it upright moves no point by more than some vertex;
        only where that comes to too much, the surface is asked.
        """
        known, surface = self.known, self.known.surface
        found = known.taking(one.rotation[2], other.rotation[2], _UPRIGHT_RAD)
        if found is None:
            return None
        turn_rad, shift_mm = _in_plane(one, other, found.rotation, found.shift_mm)
        rotation, shift = _in_file(one, other, PlanarMotion(turn_rad, shift_mm, 0.0))
        by = surface.vertices_mm @ (rotation - found.rotation).T + (shift - found.shift_mm)
        nearly = _NEARLY_EXACT_SHARE * self.within_mm
        off = found.apart_mm + float(np.linalg.norm(by, axis=1).max())
        if off <= nearly:
            known.remember(found)
            return off
        if surface.looked >= self.looks:
            return None
        apart = congruence_bound_mm(surface, rotation, shift, nearly)
        if apart is not None:
            known.proven(rotation, shift, apart)
        return apart

    def _of_solid(self, one: StableState, other: StableState, found: Sequence[PlanarMotion]) -> float | None:
        """Distance by the first motion that the whole surface allows."""
        for motion in found:
            surface = self.known.surface
            if surface.looked >= self.looks:
                if one not in self.unproven:
                    self.unproven.append(one)
                return None
            rotation, shift = _in_file(one, other, motion)
            apart = congruence_bound_mm(surface, rotation, shift, self.within_mm)
            if apart is not None:
                self.known.proven(rotation, shift, apart)
                return max(apart, motion.apart_mm)
        return None


def _in_file(one: StableState, other: StableState, motion: PlanarMotion) -> tuple[Floats, Floats]:
    """The motion in the file's frame that brings a solid resting as `one`, moved so, to rest as `other`."""
    c, s = np.cos(motion.turn_rad), np.sin(motion.turn_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    rotation = other.rotation.T @ turn @ one.rotation
    there = turn @ one.offset_mm + np.array([*motion.shift_mm, 0.0]) - other.offset_mm
    return rotation, other.rotation.T @ there


def _in_plane(one: StableState, other: StableState, rotation: Floats, shift: Floats) -> tuple[float, Floats]:
    """The turn and shift (2,) of a motion in the file's frame that keeps the vertical: `_in_file`, undone."""
    turn = other.rotation @ rotation @ one.rotation.T
    turn_rad = float(np.arctan2(turn[1, 0], turn[0, 0]))
    there = other.rotation @ shift + other.offset_mm - turn @ one.offset_mm
    return turn_rad, there[:2]


def _heights(height_mm: Floats, within: float) -> Floats:
    """Heights (k,) in the middle between levels of corners that are further apart than a distance."""
    top = float(height_mm.max())
    levels = [0.0]
    for level in np.unique(height_mm):
        if level > levels[-1] + max(within, 1e-4 * top):
            levels.append(float(level))
    middles = (np.array(levels[:-1]) + np.array(levels[1:])) / 2
    chosen = np.linspace(0, len(middles) - 1, min(len(middles), _MAX_HEIGHTS)).round().astype(int)
    result: Floats = middles[chosen]
    return result


def _is_ball(solid: Solid, within: float) -> bool:
    """True if the whole surface is as far from the centre of mass, within a distance."""
    corners = solid.vertices_mm[solid.faces] - centre_of_mass(solid)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    some = area > 1e-9 * area.max()
    planes = (normal[some] * corners[some, 0]).sum(axis=1) / area[some]
    return float(np.linalg.norm(corners, axis=2).max() - planes.min()) <= within
