"""Making edge sets: states grown for one kind of finger, with the slack that each edge needs."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotation_matrix
from palpate.base.geometry.segments import cross
from palpate.recognizer.ball_section import is_exact
from palpate.recognizer.contact import Finger
from palpate.recognizer.edges import ROUNDING_MM, ROUNDING_RAD, CatalogueState, EdgeSet
from palpate.recognizer.met_section import met_section
from palpate.recognizer.minkowski import GrownSection, grow
from palpate.recognizer.round_edges import anchors, round_outlines, round_touchable
from palpate.recognizer.simplification import simplify_outline
from palpate.recognizer.tables import Table
from palpate.recognizer.tolerance_band import ToleranceBand, Touchable, touchable_edges

__all__ = ["MOST_EDGES", "outline_set", "pairing_set"]

MOST_EDGES = 2000
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
    return _joined(states, finger, [_outline(state, finger, facet_error_mm) for state in states])


def pairing_set(
    states: Sequence[CatalogueState], finger: Finger, facet_error_mm: float, outlines: EdgeSet
) -> EdgeSet:
    """Edges that a contact of the finger may be paired with: the `outlines` if no state has a tolerance."""
    exact = [is_exact(state, finger) for state in states]
    if all(exact):
        return outlines
    return _joined(
        states,
        finger,
        [
            _outline(state, finger, facet_error_mm) if known else _touchable(state, finger, facet_error_mm)
            for state, known in zip(states, exact, strict=True)
        ],
    )


def _joined(states: Sequence[CatalogueState], finger: Finger, parts: Sequence[_Part]) -> EdgeSet:
    """The edges of all states. What is true of one is said of its symmetric images, too: where a symmetry
    turns normals by some angle, places of the tip's centre are off by its radius times that.
    """
    part = _Part.joined(parts)
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


def _outline(item: CatalogueState, finger: Finger, facet_error_mm: float) -> _Part:
    met = met_section(item, finger, 0.0)
    if met is None:
        return _NOTHING
    delta, tip = met.tolerance_mm, met.radius_mm
    radius = max(0.0, tip - delta)
    if item.state.is_round:
        grown = round_outlines(met.section, radius, united=met.united)
    else:
        grown = simplify_outline(grow(met.section, radius, facet_error_mm), MOST_EDGES, facet_error_mm / 4)
    grown = grown.select(_normal_order(grown)).moved(-item.origin_mm)
    return _Part(
        edges=grown,
        slack_in=grown.dent + max(0.0, delta - tip),
        slack_out=grown.bulge + tip + delta - radius,
        slack_along=grown.dent + 2 * delta,
    )


def _touchable(item: CatalogueState, finger: Finger, facet_error_mm: float) -> _Part:
    met = met_section(item, finger)
    if met is None:
        return _NOTHING
    band = ToleranceBand(met.tolerance_mm, met.normal_bound_rad)
    parts, before = [], 0
    for section, radius in met.layers:
        if item.state.is_round:
            part = round_touchable(section, radius, band, united=met.united)
        else:
            part = touchable_edges(section, radius, band, facet_error_mm, united=met.united)
        parts.append(replace(part, edges=_renumbered(part.edges, before)))
        before += sum(map(len, section.rings))
    found = Touchable.joined(parts)
    found = found.select(_normal_order(found.edges))
    return _Part(
        edges=found.edges.moved(-item.origin_mm),
        slack_in=found.inward,
        slack_out=found.outward,
        slack_along=found.along,
    )


def _renumbered(edges: GrownSection, by: int) -> GrownSection:
    """With numbers of features that are greater by so much, those of vertices, too."""
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
        return anchors(part)
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
    return chosen if _turned_onto_edges(part, chosen, order) else everything


def _turned_onto_edges(part: GrownSection, chosen: Bools, order: int) -> bool:
    """Whether turning the chosen edges by every multiple of 2π/order gives exactly the others."""
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
