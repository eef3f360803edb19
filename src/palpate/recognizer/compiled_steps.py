"""Search steps implemented by the compiled kernel, C code in `recognizer/kernel`.

They return the same as the numpy steps (see docs/adr/0038-a-compiled-kernel.md). The module can be imported
only if the kernel was compiled. Arrays that the kernel derives from large values are kept for the lifetime
of these.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.approach import Approach, Facing, Rays
from palpate.recognizer.boundary_pieces import block_circles, segment_circles
from palpate.recognizer.budget import BudgetSpentError
from palpate.recognizer.connected_components import Boxes, component_labels, few_in_each, region_boxes
from palpate.recognizer.constraints import Constraints, free_paths_of
from palpate.recognizer.contact import Contact, NormalRange
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.interpretations import Children, Interpretations, Query, TreeLevel
from palpate.recognizer.pose_region import (
    LEVER_MM,
    MAX_TRIPLED_CONTACTS,
    PARTS_PER_CELL,
    Cells,
    Intervals,
    Regions,
    WitnessedCells,
    intervals_to_probe,
)
from palpate.recognizer.strip_trees import StripForest
from palpate.recognizer.true_boundary import TrueBoundary
from palpate.recognizer.verification import Nearness, Poses

_KERNEL = import_module("palpate.recognizer._kernel")
_CHILD = np.dtype([("parent", np.int64), ("edge", np.int64), ("lo", np.float64), ("hi", np.float64)])

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


def _memoize(make: Callable[[_Key], _Value]) -> Callable[[_Key], _Value]:
    """Keep what is made of an object as long as the object lives."""
    values: WeakKeyDictionary[_Key, _Value] = WeakKeyDictionary()

    def get(key: _Key) -> _Value:
        found = values.get(key)
        if found is None:
            found = values[key] = make(key)
        return found

    return get


def edge_arrays(edges: EdgeSet) -> tuple[NDArray[Any], ...]:
    """Arrays that the kernel takes of an edge set, in the order of `recognizer/kernel/edges.h`."""
    return _contiguous(
        edges.first,
        edges.representative,
        edges.start,
        edges.end,
        edges.direction,
        edges.normal,
        edges.length,
        edges.normal_rad,
        edges.span,
        edges.middle[:, 0],
        edges.middle[:, 1],
        edges.half_across,
        edges.half_along,
        np.hypot(edges.half_across, edges.half_along),
        edges.side_limits,
        edges.slack_mm,
        edges.centre[:, 0],
        edges.centre[:, 1],
        edges.state_reach_mm,
        edges.state_slack_mm,
        np.array([float(np.max(edges.span, initial=0.0))]),
    )


@_memoize
def _prepared_edges(edges: EdgeSet) -> object:
    return _KERNEL.prepared_edges(edge_arrays(edges))


@_memoize
def _prepared_boundary(boundary: TrueBoundary) -> object:
    """A boundary as the kernel takes it, in the order of `recognizer/kernel/boundary.c`."""
    pieces, sides = boundary.pieces, boundary.sides
    last = pieces.normal_rad + pieces.turn_rad
    rows = (
        pieces.start,
        pieces.along,
        np.column_stack([pieces.length, pieces.normal_rad % (2 * np.pi), pieces.turn_rad, pieces.off]),
        pieces.radius[:, None],
        np.column_stack([np.cos(pieces.normal_rad), np.sin(pieces.normal_rad), np.cos(last), np.sin(last)]),
    )
    of_pieces = pieces.circles
    first_piece_block, of_piece_blocks = block_circles(of_pieces, boundary.first_piece)
    side_circles = segment_circles(sides.start, sides.end)
    first_side_block, of_side_blocks = block_circles(side_circles, boundary.first_side)
    return _KERNEL.prepared_boundary(
        _contiguous(
            boundary.radius_mm,
            boundary.clearance_mm,
            np.concatenate(rows, axis=1),
            np.concatenate([sides.start, sides.end], axis=1),
            of_pieces,
            boundary.first_piece,
            boundary.first_side,
            first_piece_block,
            first_side_block,
            of_piece_blocks,
            of_side_blocks,
        )
    )


@_memoize
def evidence_arrays(evidence: Query) -> tuple[tuple[object, ...], Floats]:
    """Contacts and misses (m) as the kernel takes them: boundaries of their fingers, and rows (m, 9).

    Whether it touched, start and end from the anchor, bounds of position and path in mm, lowest outward
    normal and width of its range in rad; negative: none is allowed.
    """
    x, y = evidence.anchor_mm.tolist()
    rows = np.array([_evidence_row(contact, x, y) for contact in evidence.contacts], dtype=np.float64)
    boundaries = (evidence.catalogue.boundary(contact.finger) for contact in evidence.contacts)
    return tuple(_prepared_boundary(boundary) for boundary in boundaries), rows.reshape(-1, 9)


def _evidence_row(contact: Contact, x: float, y: float) -> tuple[float, ...]:
    normals = contact.outward_normals() if contact.touched else None
    return (
        float(contact.touched),
        contact.start_mm[0] - x,
        contact.start_mm[1] - y,
        contact.end_mm[0] - x,
        contact.end_mm[1] - y,
        contact.position_bound_mm,
        contact.free_path_bound_mm,
        normals.lo_rad if normals else 0.0,
        normals.hi_rad - normals.lo_rad if normals else -1.0,
    )


@_memoize
def _free_paths(evidence: Query) -> tuple[tuple[object, ...], Floats]:
    """Outlines that may be in the way of m paths; start from the anchor, heading, bound and travel (m, 6)."""
    outlines = (evidence.catalogue.outlines(contact.finger) for contact in evidence.contacts)
    x, y = evidence.anchor_mm.tolist()
    rows = [_path_row(path, x, y) for path in free_paths_of(evidence.contacts)]
    return tuple(_prepared_edges(edges) for edges in outlines), np.array(rows, dtype=np.float64)


def _path_row(path: Approach, x: float, y: float) -> tuple[float, ...]:
    return (
        path.start_mm[0] - x,
        path.start_mm[1] - y,
        math.cos(path.direction_rad),
        math.sin(path.direction_rad),
        path.position_bound_mm,
        path.travel_mm,
    )


def _paths_of(constraints: Constraints) -> tuple[object, ...]:
    """Free paths of the evidence, and for which interpretations they are no evidence."""
    return *_free_paths(constraints.evidence), constraints.null_evidence


def _pairings(query: Query, nodes: Interpretations, *, states: bool = False) -> tuple[object, ...]:
    """Interpretations as the kernel takes them: edge sets and tips of contacts, edges, states, number."""
    return (
        *_edges_and_tips(query),
        np.ascontiguousarray(nodes.edges),
        np.ascontiguousarray(nodes.state) if states else None,
        len(nodes),
    )


@_memoize
def _edges_and_tips(query: Query) -> tuple[tuple[object, ...], tuple[tuple[float, float, float], ...]]:
    """Edge sets that contacts are paired with, and where the contacts are."""
    return (
        tuple(_prepared_edges(edges) for edges in query.edges),
        tuple(_tip(contact, query.anchor_mm) for contact in query.contacts),
    )


def _tip(contact: Contact, anchor_mm: Floats | None) -> tuple[float, float, float]:
    """Position of a contact, seen from the anchor, and its bound: x, y, bound (mm)."""
    x, y = contact.end_mm
    if anchor_mm is not None:
        x, y = x - float(anchor_mm[0]), y - float(anchor_mm[1])
    return x, y, contact.position_bound_mm


def _tip_with_normals(
    contact: Contact, normals: NormalRange, anchor_mm: Floats | None = None
) -> tuple[float, float, float, float, float]:
    return *_tip(contact, anchor_mm), normals.lo_rad, normals.hi_rad


def _contiguous(*arrays: Any) -> tuple[Any, ...]:
    """The arrays as the kernel takes them."""
    return tuple(np.ascontiguousarray(item) for item in arrays)


def _level(found: tuple[int, int, int, bytearray]) -> TreeLevel:
    spent, looked_up, near, data = found
    if spent:
        raise BudgetSpentError
    rows = np.frombuffer(data, dtype=_CHILD)
    return TreeLevel(Children(*_contiguous(*(rows[name] for name in _CHILD.fields or ()))), looked_up, near)


def second_level(
    query: Query,
    normals: Sequence[NormalRange],
    most: int | None,
    *,
    modelled: bool,
    first: EdgeSet | None = None,
) -> TreeLevel:
    """Pairings of the second contact under each representative edge of the first, which is their `parent`.

    Unless they are `modelled`, the model test is left out. `first`: the first contact's edges, some of which
    only may represent their orbits; None: as the catalogue has them. Raises BudgetSpentError if more than
    `most` are to be looked at; None: there cannot be too many.
    """
    limit = -1 if most is None else most
    one, two = (_tip_with_normals(*item) for item in zip(query.contacts, normals, strict=True))
    edges = _prepared_edges(first or query.edges[0]), _prepared_edges(query.edges[1])
    return _level(_KERNEL.second_level(*edges, one, two, limit, modelled))


def third_level(
    query: Query, normals: Sequence[NormalRange], nodes: Interpretations, *, modelled: bool
) -> TreeLevel:
    """Pairings of the third contact under interpretations of two; otherwise like `second_level`."""
    tips = [
        _tip_with_normals(contact, of, query.anchor_mm)
        for contact, of in zip(query.contacts, normals, strict=True)
    ]
    sets = tuple(_prepared_edges(edges) for edges in query.edges)
    rows = _contiguous(nodes.state, nodes.edges, nodes.lo, nodes.hi)
    most = query.budget.candidates
    return _level(_KERNEL.third_level(sets, *tips, *rows, len(nodes), most, modelled))


def extend(query: Query, normals: NormalRange, cells: Cells, point: Floats, reach: Floats) -> TreeLevel:
    """Pairings of the last contact under k cells, which are their `parent`.

    In the object's frame it lies within `reach` (k,) mm of `point` (k, 2). Raises BudgetSpentError where
    there are too many to look at.
    """
    arrays = _contiguous(cells.state, cells.lo, cells.hi, point, reach)
    tip = _tip_with_normals(query.contacts[-1], normals)
    edges, most = _prepared_edges(query.edges[-1]), query.budget.candidates
    return _level(_KERNEL.extend(edges, tip, *arrays, len(cells), most))


def narrow(query: Query, paired: Ints, lo: Floats, hi: Floats) -> tuple[Floats, Floats]:
    """Intervals of θ, narrowed by the model test of two or three contacts on edges `paired` (n, 2 or 3)."""
    # Two contacts are seen from each other, three from the anchor.
    anchor_mm = query.anchor_mm if len(query.contacts) > 2 else None
    tips = tuple(_tip(contact, anchor_mm) for contact in query.contacts)
    sets = tuple(_prepared_edges(edges) for edges in query.edges)
    low, high = _KERNEL.narrow(sets, tips, *_contiguous(paired, lo, hi), len(lo))
    return np.frombuffer(low), np.frombuffer(high)


def cut_cells(query: Query, nodes: Interpretations, intervals: Intervals) -> tuple[Cells, Ints]:
    """Cells of the intervals, empty ones left out; and which interval each belongs to."""
    node, lo, hi = _contiguous(intervals.node, intervals.lo, intervals.hi)
    most, rows, points = _KERNEL.cut_cells(_pairings(query, nodes), node, lo, hi, len(node))
    alive = np.frombuffer(rows, np.int64)
    node, polygon = node[alive], np.frombuffer(points).reshape(-1, most, 2)
    return Cells(node, nodes.state[node], lo[alive], hi[alive], polygon), alive


def refine_intervals(
    query: Query, nodes: Interpretations, cells: Cells, parts: Ints
) -> tuple[Intervals, Ints]:
    """Intervals of cells (k,), each in `parts` (k,), as the model test leaves them; and the cell of each."""
    rows = _contiguous(cells.node, cells.lo, cells.hi)
    triples = len(query.contacts) <= MAX_TRIPLED_CONTACTS
    owner, lo, hi = _KERNEL.refine(
        _pairings(query, nodes), *rows, np.ascontiguousarray(parts, dtype=np.int64), len(parts), triples
    )
    owner = np.frombuffer(owner, np.int64)
    return Intervals(cells.node[owner], np.frombuffer(lo), np.frombuffer(hi)), owner


def _witnessed_cells(node: Ints, state: Ints, found: tuple[Any, ...]) -> tuple[WitnessedCells, Ints]:
    """Cells that the kernel found, of rows with a `node` and a `state` (n,); and which row each is of."""
    row, lo, hi, polygon, vertices, spot, holds = found
    row = np.frombuffer(row, np.int64)
    polygons = np.frombuffer(polygon).reshape(-1, vertices, 2)
    cells = Cells(node[row], state[row], np.frombuffer(lo), np.frombuffer(hi), polygons)
    return WitnessedCells(cells, np.frombuffer(spot).reshape(-1, 2), np.frombuffer(holds, dtype=bool)), row


def _parts(
    cells: Cells, lever_mm: float, parts: int, paths: tuple[object, ...] | None
) -> tuple[WitnessedCells, Ints]:
    lo, hi, polygon = _contiguous(cells.lo, cells.hi, cells.polygon)
    found = _KERNEL.sift_parts(lo, hi, polygon, *polygon.shape[:2], lever_mm, parts, paths)
    return _witnessed_cells(cells.node, cells.state, found)


def divide_cells(cells: Cells, lever_mm: float, parts: int) -> tuple[Cells, Ints]:
    """Each cell in `parts` along whichever of its sides is longest; and which cell each part is of."""
    found, owner = _parts(cells, lever_mm, parts, None)
    return found.cells, owner


def enclose_stops(edges: EdgeSet, strips: StripForest, rays: Rays, facing: Facing) -> Floats:
    """Earliest, latest and furthest stop of r rays (mm), and least and greatest normal there: (5, r)."""
    del strips  # edges lie in blocks
    rows = _contiguous(rays.state, rays.start, rays.heading, rays.rho)
    seen = _contiguous(facing.against, facing.half_width, facing.lean, facing.vague)
    return np.frombuffer(_KERNEL.enclose_stops(_prepared_edges(edges), *rows, *seen, len(rays))).reshape(
        5, -1
    )


def sift_intervals(constraints: Constraints, intervals: Intervals, *, corners: bool) -> WitnessedCells:
    """Cells of intervals that the free paths leave, and candidates in some; with `corners` more of them."""
    tried, nodes = intervals_to_probe(intervals), constraints.nodes
    asked = None if len(tried) == len(intervals) else np.bincount(tried, minlength=len(intervals)) > 0
    found = _KERNEL.sift_intervals(
        _pairings(constraints.paired, nodes, states=True),
        *_paths_of(constraints),
        *_contiguous(intervals.node, intervals.lo, intervals.hi),
        asked,
        len(intervals),
        corners,
    )
    return _witnessed_cells(intervals.node, nodes.state[intervals.node], found)[0]


def sift_parts(constraints: Constraints, cells: Cells) -> WitnessedCells:
    """Cells in parts along whichever of their sides is longest: those that the free paths leave."""
    rows = _contiguous(cells.state, cells.node)
    by = (*_paths_of(constraints), len(constraints.nodes), *rows)
    return _parts(cells, LEVER_MM, PARTS_PER_CELL, by)[0]


def free_cells(evidence: Query, cells: Cells, skipped: Bools | None) -> Bools:
    """Cells (k,) that free paths (m) do not rule out altogether, except for those `skipped` (k, m)."""
    outlines, paths = _free_paths(evidence)
    rows = _contiguous(cells.state, cells.lo, cells.hi, cells.polygon)
    found = _KERNEL.free_paths(outlines, paths, *rows, *cells.polygon.shape[:2], _mask(skipped))
    return np.frombuffer(found, dtype=bool)


def _mask(skipped: Bools | None) -> Bools | None:
    return None if skipped is None else np.ascontiguousarray(skipped)


def may_fit(
    evidence: Query, poses: Poses, near: Nearness, skipped: Bools | None = None, most: int | None = None
) -> Bools:
    """Configurations (n,) near which one may satisfy all contacts: False where none can.

    Once `most` pieces of the boundary were found near by for one kind of finger, all others may.
    """
    rows = _contiguous(poses.state, poses.theta, poses.position, near.turn_rad, near.shift_mm)
    limit = -1 if most is None else most
    found = _KERNEL.may_fit(evidence_arrays(evidence), *rows, len(poses), _mask(skipped), limit)
    return np.frombuffer(found, dtype=bool)


def can_be_verified(constraints: Constraints, cells: Cells) -> Bools:
    """Cells (k,) that may hold a configuration which satisfies all contacts; in the others none does."""
    poses = Poses(cells.state, cells.middle, cells.centre)
    near, skipped = Nearness(cells.half_width, cells.radius), constraints.null_rows(cells.node)
    return may_fit(constraints.evidence, poses, near, skipped, constraints.budget.pieces)


def position_boxes(cells: Cells, origin_mm: Floats, anchor_mm: Floats) -> tuple[Floats, Floats]:
    """Smallest boxes (k, 2) in W that contain every position of `origin_mm` (k, 2), rounded outward."""
    polygon, *rows = _contiguous(cells.polygon, origin_mm, cells.lo, cells.hi)
    furthest = np.frombuffer(_KERNEL.furthest(polygon, *polygon.shape[:2], *rows)).reshape(-1, 4)
    return anchor_mm - furthest[:, 2:] - 1e-9, anchor_mm + furthest[:, :2] + 1e-9


def group_boxes(boxes: Boxes, order: Ints, asked: tuple[Ints, Ints, Ints]) -> Ints:
    """Components of boxes: a `Group`."""
    arrays = _contiguous(boxes.state, boxes.middle, boxes.half_width, boxes.turn, boxes.lo, boxes.hi)
    rows = [np.ascontiguousarray(item, dtype=np.int64) for item in asked]
    found = _KERNEL.groups(
        *arrays, len(boxes.state), np.ascontiguousarray(order), len(order), *rows, len(rows[0])
    )
    return np.frombuffer(found, np.int64)


def search_round(
    constraints: Constraints, found: WitnessedCells, *, refinable: bool
) -> tuple[Regions, Cells]:
    """Regions that are done, and the cells of those that are to be cut finer: none unless `refinable`."""
    cells, nodes, component = found.cells, constraints.nodes, None
    if not few_in_each(cells.state):
        position = position_boxes(cells, np.zeros((len(cells), 2)), constraints.anchor_mm)
        component = component_labels(region_boxes(constraints, cells, position), group_boxes)
    rows = _contiguous(cells.node, cells.state, cells.lo, cells.hi, cells.polygon, found.spot, found.holds)
    null = constraints.null_evidence
    orders = constraints.catalogue.symmetry_orders
    row, lo, hi, polygon, *of_regions, again = _KERNEL.regions(
        evidence_arrays(constraints.evidence),
        (*rows, component, *cells.polygon.shape[:2]),
        (
            orders,
            constraints.anchor_mm,
            None if null is None else nodes.edges < 0,
            null,
            len(orders),
            *nodes.edges.shape,
        ),
        (constraints.budget.refinements, constraints.budget.pieces, refinable, constraints.has_unpaired),
    )
    unturned = cells.select(np.frombuffer(row, np.int64))
    polygon = np.frombuffer(polygon).reshape(-1, *cells.polygon.shape[1:])
    turned = replace(unturned, lo=np.frombuffer(lo), hi=np.frombuffer(hi), polygon=polygon)
    first, theta, position, verified, node = of_regions
    regions = Regions(
        turned,
        unturned,
        np.frombuffer(first, np.int64),
        np.frombuffer(theta),
        np.frombuffer(position).reshape(-1, 2),
        np.frombuffer(verified, dtype=bool),
        np.frombuffer(node, np.int64),
    )
    return regions, cells.select(np.frombuffer(again, np.int64))
