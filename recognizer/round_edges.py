"""Edges of round states: every outline is a circle about one centre, and so is every grown outline.

A circle needs no polygon of many sides. It is searched in 48 chords that turn into each other exactly: one of
them stands for all (`representative`). How far the circle stands out over a chord, and how its normals turn,
is part of the chord's slack and span, as with the arcs of grown outlines.

A tip of radius r that touches the true outline at q has its centre at q + r n. By what the model promises, q
is within δ of a point p of the circle, and the normal n within β of that at p. So the centre is within
δ + r sin β along the grown circle from p + r n(p), within δ + r (1 − cos β) inside of it, and δ outside.
"""

import math

import numpy as np
import shapely

from palpate.geometry import Circle, Floats, Section
from palpate.recognizer.minkowski import GrownSection
from palpate.recognizer.tip_clearance import clearance_tilts_rad
from palpate.recognizer.tolerance_band import ToleranceBand, Touchable

__all__ = ["ROUND_ORDER", "round_outlines", "round_touchable"]

ROUND_ORDER = 48
"""Chords of a circle. Polygons that stand for circles have as many sides, or a multiple."""

_HALF_RAD = math.pi / ROUND_ORDER


def round_outlines(section: Section, radius_mm: float) -> GrownSection:
    """The section's circles grown by a radius."""
    parts = [
        _chords(circle, circle.radius_mm + sign * radius_mm, sign, number)
        for number, (circle, sign) in enumerate(_circles(section))
        if circle.radius_mm + sign * radius_mm > 0
    ]
    return GrownSection.joined(parts)


def round_touchable(section: Section, radius_mm: float, band: ToleranceBand) -> Touchable:
    """Places of a tip's centre that touches the section's circles; a hole that it does not enter has none."""
    solid = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in section.polygons])
    rings = [ring for polygon in section.polygons for ring in polygon.rings]
    parts = [
        _touchable(solid, ring, circle, sign, number, radius_mm, band)
        for number, (ring, (circle, sign)) in enumerate(zip(rings, _circles(section), strict=True))
        if circle.radius_mm + sign * radius_mm + band.off_mm > 0
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
    beta = _tilt_rad(solid, ring[::sign], radius_mm, band)
    chords = _chords(circle, max(grown, 0.0), sign, number)
    chords.span[:] = np.minimum(chords.span + beta, np.pi)
    off = band.off_mm + max(-grown, 0.0)
    sunk = radius_mm * (1 - math.cos(beta))
    aside = radius_mm * math.sin(min(beta, math.pi / 2))
    every = np.ones(len(chords))
    return Touchable(chords, off + sunk + chords.dent, off + chords.bulge, (off + aside) * every)


def _tilt_rad(solid: shapely.Geometry, ring: Floats, radius_mm: float, band: ToleranceBand) -> float:
    """By how much normals may be off those of the circle, β: as declared, or by its sides, and by the tip."""
    start, end = ring, np.roll(ring, -1, axis=0)
    half = math.pi / len(ring)
    sides = band.turns_rad(np.hypot(*(end - start).T))
    by_tip = clearance_tilts_rad(solid, start, end, radius_mm, band.off_mm)
    return min(float(np.minimum(sides, by_tip).max()) + half, math.pi)


def _chords(circle: Circle, radius_mm: float, sign: int, number: int) -> GrownSection:
    """Chords of a circle, the solid on their left: on its inside, if `sign` is 1, or around it."""
    angle = sign * 2 * np.pi * np.arange(ROUND_ORDER) / ROUND_ORDER
    corner = np.array(circle.centre_mm) + radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])
    middle = angle + sign * _HALF_RAD
    sagitta = np.full(ROUND_ORDER, radius_mm * (1 - math.cos(_HALF_RAD)))
    nothing = np.zeros(ROUND_ORDER)
    return GrownSection(
        start=corner,
        end=np.roll(corner, -1, axis=0),
        direction=sign * np.column_stack([-np.sin(middle), np.cos(middle)]),
        length=np.full(ROUND_ORDER, 2 * radius_mm * math.sin(_HALF_RAD)),
        bulge=sagitta if sign > 0 else nothing,
        dent=nothing if sign > 0 else sagitta.copy(),
        span=np.full(ROUND_ORDER, _HALF_RAD),
        feature=np.full(ROUND_ORDER, number),
    )
