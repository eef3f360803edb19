"""Grown edges: states grown for one kind of finger, with the slack that each edge needs.

A round state, every outline of which is a circle about one centre, needs no polygon of many sides. A circle
is searched in a few chords and the *anchor*, a chord so short that it is a point of the circle. Turned about
its centre the state lies as before, so it may be taken to be turned such that the first contact is at the
anchor: that one stands for all (`representative`). How far the circle stands out over a chord, and how its
normals turn, is part of the chord's slack and span, as with the arcs of grown outlines.

A tip of radius r cannot enter what is deeper than δ in the circle of radius R, and touches nothing that is
more than δ outside. So its centre is from R + r − δ to R + r + δ away from the circle's, whatever the outline
is between, and it is paired with the chord at which its centre is. Only normals depend on how rough the
outline is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Circle, Floats, Ints, Section
from palpate.base.geometry.outlines import region_of
from palpate.base.geometry.plane import cross, rotation_matrix
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import ROUNDING_MM, ROUNDING_RAD, CatalogueState, EdgeSet
from palpate.recognizer.minkowski import grow, simplify_outline
from palpate.recognizer.offset_curves import GrownSection
from palpate.recognizer.tables import Table
from palpate.recognizer.tip_clearance import clearance_tilts_rad
from palpate.recognizer.tip_obstacle import is_exact, tip_obstacle, uncovered_circles, union_circles
from palpate.recognizer.tolerance_band import PairingEdges, ToleranceBand, pairing_edges

ROUND_ORDER = 48
"""Of the turns that take a round state to itself. Polygons that stand for circles have as many sides."""

_CHORDS_PER_CIRCLE = 24
"""Fewer are more slack, more are more ways to pair a contact that is unsure by a millimetre."""

_ANCHOR_HALF_RAD = 1e-4
_CHORD_ENDS_RAD: Floats = np.append(
    -_ANCHOR_HALF_RAD, np.linspace(_ANCHOR_HALF_RAD, 2 * np.pi - _ANCHOR_HALF_RAD, _CHORDS_PER_CIRCLE + 1)
)
"""Where chords end, from the one before the anchor to the same again."""


def round_outlines(section: Section, radius_mm: float, *, united: bool = False) -> GrownSection:
    """The section's circles grown by a radius; of polygons that overlap, those that bound their union."""
    circles = _circles(section)
    bounds = union_circles(section.polygons) if united else (True,) * len(circles)
    parts = [
        _chords(circle, circle.radius_mm + sign * radius_mm, sign, number)
        for number, (circle, sign) in enumerate(circles)
        if bounds[number] and circle.radius_mm + sign * radius_mm > 0
    ]
    return GrownSection.join(parts)


def _round_pairing_edges(
    section: Section, radius_mm: float, band: ToleranceBand, *, united: bool = False
) -> PairingEdges:
    """Places of a tip's centre that touches the section's circles; a hole that it does not enter has none.

    Of polygons that overlap (`united`) those circles have none either that others are certain to cover.
    """
    solid = region_of(section.polygons)
    rings = [ring for polygon in section.polygons for ring in polygon.rings]
    bare = uncovered_circles(section.polygons, band.off_mm) if united else (True,) * len(rings)
    parts = [
        _pairing_chords(solid, ring, circle, sign, number, radius_mm, band)
        for number, (ring, (circle, sign)) in enumerate(zip(rings, _circles(section), strict=True))
        if bare[number] and circle.radius_mm + sign * radius_mm + band.off_mm > 0
    ]
    return PairingEdges.join(parts)


def _circles(section: Section) -> list[tuple[Circle, int]]:
    """The circle that each ring stands for, and 1; −1 for a hole."""
    found = []
    for polygon in section.polygons:
        for number, curve in enumerate(polygon.curves):
            assert isinstance(curve, Circle), "the state is round"
            found.append((curve, -1 if number else 1))
    return found


def _pairing_chords(
    solid: shapely.Geometry,
    ring: Floats,
    circle: Circle,
    sign: int,
    number: int,
    radius_mm: float,
    band: ToleranceBand,
) -> PairingEdges:
    grown = circle.radius_mm + sign * radius_mm
    chords = _chords(circle, max(grown, 0.0), sign, number)
    chords.span[:] = np.minimum(chords.span + _tilt_rad(solid, ring[::sign], radius_mm, band), np.pi)
    off = band.off_mm + max(-grown, 0.0)
    return PairingEdges(chords, off + chords.dent, off + chords.bulge, np.full(len(chords), off))


def _tilt_rad(solid: shapely.Geometry, ring: Floats, radius_mm: float, band: ToleranceBand) -> float:
    """Largest deviation of normals from the circle's, β: as declared, or by its sides, and by the tip."""
    start, end = ring, np.roll(ring, -1, axis=0)
    half = math.pi / len(ring)
    sides = band.turns_rad(np.hypot(*(end - start).T))
    by_tip = clearance_tilts_rad(solid, start, end, radius_mm, band.off_mm)
    return min(float(np.minimum(sides, by_tip).max()) + half, math.pi)


def _chords(circle: Circle, radius_mm: float, sign: int, number: int) -> GrownSection:
    """Chords of a circle, the anchor first, the solid on their left: inside, if `sign` is 1, or around."""
    half = np.diff(_CHORD_ENDS_RAD) / 2
    angle = sign * _CHORD_ENDS_RAD[:-1]
    corner = np.array(circle.centre_mm) + radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    middle = angle + sign * half
    sagitta, nothing = radius_mm * (1 - np.cos(half)), np.zeros(len(half))
    return GrownSection(
        start=corner,
        end=np.roll(corner, -1, axis=0),
        direction=sign * np.column_stack([-np.sin(middle), np.cos(middle)]),
        length=2 * radius_mm * np.sin(half),
        bulge=sagitta if sign > 0 else nothing,
        dent=nothing if sign > 0 else sagitta,
        span=half,
        feature=np.full(len(half), number),
    )


def _anchor_mask(chords: GrownSection) -> Bools:
    """Mask of chords (n,) that are anchors: the shortest of each circle."""
    shortest = np.zeros(len(chords), dtype=bool)
    for number in np.unique(chords.feature):
        of_circle = np.flatnonzero(chords.feature == number)
        shortest[of_circle[np.argmin(chords.length[of_circle])]] = True
    return shortest


_MAX_EDGES = 2000
"""Of one state; finer outlines are coarsened, at the price of a stated slack."""


@dataclass(frozen=True, eq=False)
class _Part(Table):
    """The grown edges of one state, sorted by normal, and the slack of each (n,) mm but for rounding."""

    edges: GrownSection
    slack_in: Floats
    slack_out: Floats
    slack_along: Floats


_NONE, _NOWHERE = np.empty(0), np.empty((0, 2))
_NO_EDGES = GrownSection(_NOWHERE, _NOWHERE, _NOWHERE, _NONE, _NONE, _NONE, _NONE, np.empty(0, np.int64))
_NOTHING = _Part(_NO_EDGES, _NONE, _NONE, _NONE)


def outline_set(states: Sequence[CatalogueState], finger: Finger, facet_error_mm: float) -> EdgeSet:
    """Grow what every state has along the finger's tip by its radius: outlines that stop it on its way.

    Arcs bulge by at most `facet_error_mm`. An object with a tolerance δ is grown by r − δ only: its true
    outline is between 0 and 2δ outside of that.
    """
    return _join_parts(states, finger, [_outline_part(state, finger, facet_error_mm) for state in states])


def pairing_set(
    states: Sequence[CatalogueState], finger: Finger, facet_error_mm: float, outlines: EdgeSet
) -> EdgeSet:
    """Edges that a contact of the finger may be paired with: the `outlines` if no state has a tolerance."""
    exact = [is_exact(state, finger) for state in states]
    if all(exact):
        return outlines
    return _join_parts(
        states,
        finger,
        [
            _outline_part(state, finger, facet_error_mm)
            if known
            else _pairing_part(state, finger, facet_error_mm)
            for state, known in zip(states, exact, strict=True)
        ],
    )


def _join_parts(states: Sequence[CatalogueState], finger: Finger, parts: Sequence[_Part]) -> EdgeSet:
    """The edges of all states. What is true of one is said of its symmetric images, too: where a symmetry
    turns normals by some angle, places of the tip's centre are off by its radius times that.
    """
    part = _Part.join(parts)
    edges, direction = part.edges, part.edges.direction
    count = [len(each) for each in parts]
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    rounding = np.repeat([state.rounding_mm for state in states], count)
    lean = np.repeat([state.symmetry.lean_rad for state in states], count)
    sunk = rounding + finger.tip_radius_mm * (1 - np.cos(lean))
    aside = rounding + finger.tip_radius_mm * np.sin(np.minimum(lean, np.pi / 2))
    return EdgeSet(
        state=np.repeat(np.arange(len(states)), count),
        start=edges.start,
        end=edges.end,
        direction=direction,
        normal=normal,
        length=edges.length,
        slack_in=part.slack_in + sunk,
        slack_out=part.slack_out + rounding,
        slack_along=part.slack_along + aside,
        normal_rad=np.arctan2(normal[:, 1], normal[:, 0]) % (2 * np.pi),
        span=np.minimum(edges.span + lean + ROUNDING_RAD, np.pi),
        feature=edges.feature,
        representative=np.concatenate(
            [_representative(p.edges, s) for p, s in zip(parts, states, strict=True)]
        ),
        first=np.cumsum([0, *count]),
    )


def _outline_part(item: CatalogueState, finger: Finger, facet_error_mm: float) -> _Part:
    met = tip_obstacle(item, finger, 0.0)
    if met is None:
        return _NOTHING
    delta, tip = met.tolerance_mm, met.radius_mm
    radius = max(0.0, tip - delta)
    if item.state.is_round:
        grown = round_outlines(met.section, radius, united=met.united)
    else:
        grown = simplify_outline(grow(met.section, radius, facet_error_mm), _MAX_EDGES, facet_error_mm / 4)
    grown = grown.select(_normal_order(grown)).translate(-item.origin_mm)
    return _Part(
        edges=grown,
        slack_in=grown.dent + max(0.0, delta - tip),
        slack_out=grown.bulge + tip + delta - radius,
        slack_along=grown.dent + 2 * delta,
    )


def _pairing_part(item: CatalogueState, finger: Finger, facet_error_mm: float) -> _Part:
    met = tip_obstacle(item, finger)
    if met is None:
        return _NOTHING
    band = ToleranceBand(met.tolerance_mm, met.normal_bound_rad)
    parts, before = [], 0
    for section, radius in met.layers:
        if item.state.is_round:
            part = _round_pairing_edges(section, radius, band, united=met.united)
        else:
            part = pairing_edges(section, radius, band, facet_error_mm, united=met.united)
        parts.append(replace(part, edges=_renumber_features(part.edges, before)))
        before += sum(map(len, section.rings))
    found = PairingEdges.join(parts)
    found = found.select(_normal_order(found.edges))
    return _Part(
        edges=found.edges.translate(-item.origin_mm),
        slack_in=found.inward,
        slack_out=found.outward,
        slack_along=found.along,
    )


def _renumber_features(edges: GrownSection, by: int) -> GrownSection:
    """The same edges with numbers of features that are greater by so much, those of vertices, too."""
    return replace(edges, feature=np.where(edges.feature < 0, edges.feature - by, edges.feature + by))


def _normal_order(grown: GrownSection) -> Ints:
    return np.argsort(np.arctan2(-grown.direction[:, 0], grown.direction[:, 1]) % (2 * np.pi), kind="stable")


def _representative(part: GrownSection, item: CatalogueState) -> Bools:
    """One edge of each orbit under the state's rotations: those whose midpoints lie in one sector.

    The sector starts in the widest gap between midpoints, so that rounding cannot put two edges of an orbit
    in it, or none. Where midpoints leave no clear gap, or edges are no exact images of one another, all are
    kept: slower, never wrong. So they are where the state as a whole is not exactly symmetric: a finger of
    another radius or height might meet edges that have no images, as in a notch that it only just enters.
    """
    if item.state.is_round:
        return _anchor_mask(part)
    order = item.symmetry.order
    everything = np.ones(len(part.length), dtype=bool)
    if order == 1 or not len(part.length) or not item.is_exactly_symmetric:
        return everything
    middle = part.start + part.direction * part.length[:, None] / 2
    sector = 2 * np.pi / order
    angle = np.arctan2(middle[:, 1], middle[:, 0]) % (2 * np.pi)
    folded = np.sort(angle % sector)
    gaps = np.diff(np.append(folded, folded[0] + sector))
    widest = int(np.argmax(gaps))
    begin = folded[widest] + gaps[widest] / 2
    chosen: Bools = (angle - begin) % (2 * np.pi) < sector
    clear = gaps[widest] > 1e-3 and float(np.min(np.linalg.norm(middle, axis=1))) > 1e-2
    if not clear or np.sum(chosen) * order != len(chosen):
        return everything
    return chosen if _maps_onto_edges(part, chosen, order) else everything


def _maps_onto_edges(part: GrownSection, chosen: Bools, order: int) -> bool:
    """Return whether turning the chosen edges by every multiple of 2π/order gives exactly the others."""
    edges = np.column_stack([part.start, part.end])
    tree = cKDTree(edges)
    for step in range(1, order):
        turn = rotation_matrix(-2 * math.pi * step / order)
        image = np.column_stack([part.start[chosen] @ turn, part.end[chosen] @ turn])
        away, match = tree.query(image)
        leaning = np.abs(cross(part.direction[chosen] @ turn, part.direction[match]))
        if float(np.max(away)) > ROUNDING_MM / 2 or float(np.max(leaning)) > ROUNDING_RAD / 2:
            return False
    return True
