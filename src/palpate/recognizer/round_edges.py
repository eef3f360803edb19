"""Edges of round states: every outline is a circle about one centre, and so is every grown outline.

A circle needs no polygon of many sides. It is searched in a few chords and the *anchor*, a chord so short
that it is a point of the circle. Turned about its centre the state lies as before, so it may be taken to be
turned such that the first contact is at the anchor: that one stands for all (`representative`). How far the
circle stands out over a chord, and how its normals turn, is part of the chord's slack and span, as with the
arcs of grown outlines.

A tip of radius r cannot enter what is deeper than δ in the circle of radius R, and touches nothing that is
more than δ outside. So its centre is from R + r − δ to R + r + δ away from the circle's, whatever the outline
is between, and it is paired with the chord at which its centre is. Only normals depend on how rough the
outline is.
"""

import math

import numpy as np
import shapely

from palpate.base.geometry import Bools, Circle, Floats, Section
from palpate.recognizer.met_section import uncertain_circles, united_circles
from palpate.recognizer.minkowski import GrownSection
from palpate.recognizer.tip_clearance import clearance_tilts_rad
from palpate.recognizer.tolerance_band import ToleranceBand, Touchable

__all__ = ["ROUND_ORDER", "anchors", "round_outlines", "round_touchable"]

ROUND_ORDER = 48
"""Of the turns that take a round state to itself. Polygons that stand for circles have as many sides."""

_CHORDS = 24
"""Fewer are more slack, more are more ways to pair a contact that is unsure by a millimetre."""

_ANCHOR_HALF_RAD = 1e-4
_ENDS: Floats = np.append(
    -_ANCHOR_HALF_RAD, np.linspace(_ANCHOR_HALF_RAD, 2 * np.pi - _ANCHOR_HALF_RAD, _CHORDS + 1)
)
"""Where chords end, from the one before the anchor to the same again."""


def round_outlines(section: Section, radius_mm: float, *, united: bool = False) -> GrownSection:
    """The section's circles grown by a radius; of polygons that overlap, those that bound their union."""
    circles = _circles(section)
    bounds = united_circles(section.polygons) if united else (True,) * len(circles)
    parts = [
        _chords(circle, circle.radius_mm + sign * radius_mm, sign, number)
        for number, (circle, sign) in enumerate(circles)
        if bounds[number] and circle.radius_mm + sign * radius_mm > 0
    ]
    return GrownSection.joined(parts)


def round_touchable(
    section: Section, radius_mm: float, band: ToleranceBand, *, united: bool = False
) -> Touchable:
    """Places of a tip's centre that touches the section's circles; a hole that it does not enter has none.

    Of polygons that overlap (`united`) those circles have none either that others are certain to cover.
    """
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons])
    rings = [ring for polygon in section.polygons for ring in polygon.rings]
    bare = uncertain_circles(section.polygons, band.off_mm) if united else (True,) * len(rings)
    parts = [
        _touchable(solid, ring, circle, sign, number, radius_mm, band)
        for number, (ring, (circle, sign)) in enumerate(zip(rings, _circles(section), strict=True))
        if bare[number] and circle.radius_mm + sign * radius_mm + band.off_mm > 0
    ]
    return Touchable.joined(parts)


def _circles(section: Section) -> list[tuple[Circle, int]]:
    """The circle that each ring stands for, and 1; −1 for a hole."""
    found = []
    for polygon in section.polygons:
        for number, curve in enumerate(polygon.curves):
            assert isinstance(curve, Circle), "the state is round"
            found.append((curve, -1 if number else 1))
    return found


def _touchable(
    solid: shapely.Geometry,
    ring: Floats,
    circle: Circle,
    sign: int,
    number: int,
    radius_mm: float,
    band: ToleranceBand,
) -> Touchable:
    grown = circle.radius_mm + sign * radius_mm
    chords = _chords(circle, max(grown, 0.0), sign, number)
    chords.span[:] = np.minimum(chords.span + _tilt_rad(solid, ring[::sign], radius_mm, band), np.pi)
    off = band.off_mm + max(-grown, 0.0)
    return Touchable(chords, off + chords.dent, off + chords.bulge, np.full(len(chords), off))


def _tilt_rad(solid: shapely.Geometry, ring: Floats, radius_mm: float, band: ToleranceBand) -> float:
    """By how much normals may be off those of the circle, β: as declared, or by its sides, and by the tip."""
    start, end = ring, np.roll(ring, -1, axis=0)
    half = math.pi / len(ring)
    sides = band.turns_rad(np.hypot(*(end - start).T))
    by_tip = clearance_tilts_rad(solid, start, end, radius_mm, band.off_mm)
    return min(float(np.minimum(sides, by_tip).max()) + half, math.pi)


def _chords(circle: Circle, radius_mm: float, sign: int, number: int) -> GrownSection:
    """Chords of a circle, the anchor first, the solid on their left: inside, if `sign` is 1, or around."""
    half = np.diff(_ENDS) / 2
    angle = sign * _ENDS[:-1]
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


def anchors(chords: GrownSection) -> Bools:
    """Which chords (n,) are anchors: the shortest of each circle."""
    shortest = np.zeros(len(chords), dtype=bool)
    for number in np.unique(chords.feature):
        of_circle = np.flatnonzero(chords.feature == number)
        shortest[of_circle[np.argmin(chords.length[of_circle])]] = True
    return shortest
