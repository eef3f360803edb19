"""The catalogue: every state of every object, grown for each kind of finger, in flat arrays.

Work done once per catalogue and kept: grown edges sorted by normal within a state, so that the angle test is
a range look-up, and the ranges of distance between the edges of each state (memo §2.2.1).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from palpate.errors import InputError
from palpate.recognizer.arrays import Bools, Floats, Ints, expand_ranges
from palpate.recognizer.contact import Finger
from palpate.recognizer.grown import GrownSection, grow
from palpate.recognizer.model import ObjectModel, Section, State
from palpate.recognizer.segments import cross, distance_range
from palpate.recognizer.symmetry import centroid, symmetry_order

__all__ = ["Catalogue", "CatalogueState", "EdgeSet", "PairRanges"]

ROUNDING_MM = 1e-6
"""Allowance for floating-point error in every comparison of lengths; coordinates are below 10⁴ mm."""

SYMMETRY_TOLERANCE_MM = 1e-3
_KEY_STRIDE = 16.0  # rad between the sorted normals of one state and the next: more than two turns


@dataclass(frozen=True, eq=False)
class CatalogueState:
    """One state of one object, as hypotheses name it.

    `origin_mm` is the centroid in the frame of the object's file; inside the recogniser the centroid is the
    origin, so that a symmetry turns the object about its own origin. `slack_mm` is by how much a modelled
    edge may be off: the object's tolerance, the symmetry's, and rounding.
    """

    object_name: str
    state: State
    origin_mm: Floats
    symmetry_order: int
    slack_mm: float


@dataclass(frozen=True, eq=False)
class EdgeSet:
    """The grown edges that one kind of finger can meet, over the whole catalogue; n edges, S states.

    `state` (n,), `start`, `end`, `direction` and outward `normal` (n, 2), `length` (n,), all in the centred
    object frames in mm, neighbours meeting in the same numbers; `slack_in` and `slack_out` (n,): how far the
    tip's centre may lie inside or outside of the edge's line though nothing is mismeasured; `normal_rad`
    (n,) in [0, 2π), ascending within a state; `span` (n,) half-turn of the normal on the edge;
    `representative` (n,): one edge of each symmetric orbit; `first` (S + 1,): where each state begins.
    """

    state: Ints
    start: Floats
    end: Floats
    direction: Floats
    normal: Floats
    length: Floats
    slack_in: Floats
    slack_out: Floats
    normal_rad: Floats
    span: Floats
    feature: Ints
    representative: Bools
    first: Ints

    @property
    def count(self) -> Ints:
        """Edges in each state, shape (S,)."""
        return np.diff(self.first)

    @cached_property
    def _keys(self) -> Floats:
        once = self.state * _KEY_STRIDE + self.normal_rad
        keys: Floats = np.sort(np.concatenate([once, once + 2 * np.pi]))
        return keys

    def by_normal(self, state: Ints, lo_rad: Floats, width_rad: Floats) -> tuple[Ints, Ints]:
        """Edges of `state` (m,) whose normal angle lies in [lo, lo + width] (m,), widths at most 2π.

        Returns (owner, edge), flat, owner indexing the m queries.
        """
        lo = lo_rad % (2 * np.pi) + state * _KEY_STRIDE
        first = np.searchsorted(self._keys, lo - 1e-12, side="left")
        last = np.searchsorted(self._keys, lo + width_rad + 1e-12, side="right")
        # In each state's stretch of keys the edges come twice, a turn apart; a full turn meets each once.
        count = np.minimum(last - first, self.count[state])
        owner, key = expand_ranges(first, count)
        begin = self.first[state[owner]]
        size = self.count[state[owner]]
        return owner, begin + (key - 2 * begin) % size


@dataclass(frozen=True, eq=False)
class PairRanges:
    """Shortest and longest distance (mm) between the edges of one set and those of another, by state."""

    first: Ints
    row: Ints
    columns: Ints
    origin: Ints
    shortest: Floats
    longest: Floats

    def look_up(self, state: Ints, edge_a: Ints, edge_b: Ints, begin_b: Ints) -> tuple[Floats, Floats]:
        """The ranges for pairs (m,): edge_a of the first set, edge_b of the second, both of `state`."""
        index = self.first[state] + (edge_a - self.row[state]) * self.columns[state] + edge_b - begin_b[state]
        return self.shortest[index], self.longest[index]


class Catalogue:
    """Known objects, prepared. Grown edges and distance ranges are made when a finger first needs them.

    `facet_error_mm`: how far an arc may bulge over its facet; part of the error bound, so small, but every
    halving makes the arcs' facets 1.4 times as many. Raises InputError for an empty catalogue.
    """

    def __init__(self, objects: Sequence[ObjectModel], *, facet_error_mm: float = 0.1) -> None:
        if not objects:
            raise InputError("the catalogue is empty: at least one object is needed")
        self.states: tuple[CatalogueState, ...] = tuple(
            _prepare(item, state) for item in objects for state in item.states
        )
        self.facet_error_mm = facet_error_mm
        self._edges: dict[Finger, EdgeSet] = {}
        self._ranges: dict[tuple[Finger, Finger], PairRanges] = {}

    def edges(self, finger: Finger) -> EdgeSet:
        """The grown edges that `finger` can meet."""
        if finger not in self._edges:
            self._edges[finger] = _edge_set(self.states, finger, self.facet_error_mm)
        return self._edges[finger]

    def ranges(self, first: Finger, second: Finger) -> PairRanges:
        """Distance ranges between the edges for `first` and those for `second`."""
        key = (first, second)
        if key not in self._ranges:
            self._ranges[key] = _pair_ranges(self.edges(first), self.edges(second))
        return self._ranges[key]


def _prepare(item: ObjectModel, state: State) -> CatalogueState:
    origin = centroid(state)
    order = symmetry_order(state, origin, SYMMETRY_TOLERANCE_MM)
    slack = item.tolerance_mm + ROUNDING_MM + (SYMMETRY_TOLERANCE_MM if order > 1 else 0.0)
    return CatalogueState(item.name, state, origin, order, slack)


def _edge_set(states: Sequence[CatalogueState], finger: Finger, facet_error_mm: float) -> EdgeSet:
    parts = [_state_edges(state, finger, facet_error_mm) for state in states]
    first = np.cumsum([0] + [len(part.length) for part in parts])
    slack = np.repeat([state.slack_mm for state in states], np.diff(first))
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("start", "end", "direction", "length", "bulge", "span", "feature")
    }
    direction = joined["direction"]
    normal = np.column_stack([direction[:, 1], -direction[:, 0]])
    return EdgeSet(
        state=np.repeat(np.arange(len(states)), np.diff(first)),
        start=joined["start"],
        end=joined["end"],
        direction=direction,
        normal=normal,
        length=joined["length"],
        slack_in=slack,
        slack_out=slack + joined["bulge"],
        normal_rad=np.arctan2(normal[:, 1], normal[:, 0]) % (2 * np.pi),
        span=joined["span"] + 1e-9,
        feature=joined["feature"],
        representative=np.concatenate(
            [_representative(part, state.symmetry_order) for part, state in zip(parts, states, strict=True)]
        ),
        first=first.astype(np.int64),
    )


def _state_edges(item: CatalogueState, finger: Finger, facet_error_mm: float) -> GrownSection:
    """Grown edges of one state at the finger's height, sorted by normal; none where nothing is that high."""
    height = finger.height_mm
    at_height = [s for s in item.state.sections if s.z_lo_mm <= height <= s.z_hi_mm]
    if not at_height:
        none, nowhere = np.empty(0), np.empty((0, 2))
        return GrownSection(nowhere, nowhere, nowhere, none, none, none, np.empty(0, np.int64))
    # Where two sections meet, the finger meets whichever stands out.
    polygons = tuple(polygon for section in at_height for polygon in section.polygons)
    grown = grow(Section(height, height, polygons), finger.tip_radius_mm, facet_error_mm)
    order = np.argsort(np.arctan2(-grown.direction[:, 0], grown.direction[:, 1]) % (2 * np.pi), kind="stable")
    return GrownSection(
        start=grown.start[order] - item.origin_mm,
        end=grown.end[order] - item.origin_mm,
        direction=grown.direction[order],
        length=grown.length[order],
        bulge=grown.bulge[order],
        span=grown.span[order],
        feature=grown.feature[order],
    )


def _representative(part: GrownSection, order: int) -> Bools:
    """One edge of each orbit under the state's rotations: those whose midpoints lie in one sector.

    The sector starts in the widest gap between midpoints, so that rounding cannot put two edges of an orbit
    in it, or none. Where midpoints leave no clear gap, or edges are no exact images of one another (the
    symmetry itself has a tolerance), every edge is kept: slower, never wrong.
    """
    everything = np.ones(len(part.length), dtype=bool)
    if order == 1 or not len(part.length):
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
        cos, sin = math.cos(2 * math.pi * step / order), math.sin(2 * math.pi * step / order)
        turn = np.array([[cos, sin], [-sin, cos]])
        image = np.column_stack([part.start[chosen] @ turn, part.end[chosen] @ turn])
        away, match = tree.query(image)
        leaning = np.abs(cross(part.direction[chosen] @ turn, part.direction[match]))
        if float(np.max(away)) > ROUNDING_MM / 2 or float(np.max(leaning)) > 5e-10:
            return False
    return True


def _pair_ranges(a: EdgeSet, b: EdgeSet) -> PairRanges:
    pairs = a.count * b.count
    state, within = expand_ranges(np.zeros_like(pairs), pairs)
    width = b.count[state]
    edge_a = a.first[state] + within // np.maximum(width, 1)
    edge_b = b.first[state] + within % np.maximum(width, 1)
    shortest, longest = distance_range(
        a.start[edge_a],
        a.start[edge_a] + a.direction[edge_a] * a.length[edge_a, None],
        b.start[edge_b],
        b.start[edge_b] + b.direction[edge_b] * b.length[edge_b, None],
    )
    first = np.cumsum(np.append(0, pairs))[:-1]
    return PairRanges(first, a.first[:-1], b.count, b.first[:-1], shortest, longest)
