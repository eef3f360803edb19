"""Kernel calls that judge: free paths, configurations, and a round of the witness search.

The same as `constraints`, `verification`, `witness_candidates` and `witness_search` have by whole arrays.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.approach import Approach
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.compiled_search import contiguous
from palpate.recognizer.contact import Contact
from palpate.recognizer.edges import EdgeSet
from palpate.recognizer.pose_region import Cells


def stop_intervals(
    kernel: ModuleType,
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    approaches: Sequence[Approach],
    skipped: Bools | None,
) -> tuple[Floats, Floats]:
    """Earliest and latest stop (k, m) of approaches on their outlines; infinite where `skipped` (k, m)."""
    found = kernel.sweep(*_arguments(outlines, cells, anchor_mm, approaches, skipped))
    earliest, latest = (np.frombuffer(data).reshape(len(cells), len(approaches)) for data in found)
    return earliest, latest


def free_cells(
    kernel: ModuleType,
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    paths: Sequence[Approach],
    skipped: Bools | None,
) -> Bools:
    """Cells (k,) in which no path has to stop before its end."""
    found = kernel.free_paths(*_arguments(outlines, cells, anchor_mm, paths, skipped))
    return np.frombuffer(found, dtype=bool)


def path_rows(paths: Sequence[Approach], anchor_mm: Floats) -> Floats:
    """Approaches (m, 6) as the kernel takes them: start from the anchor, heading, bound, travel; mm."""
    x, y = anchor_mm.tolist()
    rows = [
        (
            path.start_mm[0] - x,
            path.start_mm[1] - y,
            math.cos(path.direction_rad),
            math.sin(path.direction_rad),
            path.position_bound_mm,
            path.travel_mm,
        )
        for path in paths
    ]
    return np.array(rows, dtype=np.float64)


def _arguments(
    outlines: Sequence[EdgeSet],
    cells: Cells,
    anchor_mm: Floats,
    paths: Sequence[Approach],
    skipped: Bools | None,
) -> tuple[object, ...]:
    return (
        tuple(item.prepared for item in outlines),
        path_rows(paths, anchor_mm),
        np.ascontiguousarray(cells.state),
        np.ascontiguousarray(cells.lo),
        np.ascontiguousarray(cells.hi),
        np.ascontiguousarray(cells.polygon),
        len(cells),
        cells.polygon.shape[1],
        None if skipped is None else np.ascontiguousarray(skipped),
    )


@dataclass(frozen=True, eq=False)
class Evidence:
    """Contacts and misses (m) as the kernel takes them.

    `boundaries`: prepared ones of their fingers. `rows` (m, 9): whether it touched, start and end from the
    anchor, bounds of position and path in mm, lowest outward normal and width of its range in rad; negative:
    none is allowed.
    """

    boundaries: tuple[object, ...]
    rows: Floats

    def __len__(self) -> int:
        return len(self.boundaries)


def evidence_of(catalogue: Catalogue, contacts: Sequence[Contact], anchor_mm: Floats) -> Evidence:
    """Everything that configurations are judged by."""
    x, y = anchor_mm.tolist()
    rows = np.array([_row(contact, x, y) for contact in contacts], dtype=np.float64).reshape(-1, 9)
    return Evidence(tuple(catalogue.boundary(contact.finger).prepared for contact in contacts), rows)


def _row(contact: Contact, x: float, y: float) -> tuple[float, ...]:
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


def judge_poses(
    kernel: ModuleType,
    evidence: Evidence,
    state: Ints,
    theta: Floats,
    position: Floats,
    skipped: Bools | None,
) -> tuple[Bools, Bools, Floats, Floats, Floats, Bools]:
    """What `verification.Verification` has of configurations (n,), in its order."""
    shape = (len(state), len(evidence))
    fits, holds, gap, offset, normal, limited = kernel.verify(
        (evidence.boundaries, evidence.rows), *_poses(state, theta, position), len(state), _mask(skipped)
    )
    return (
        np.frombuffer(fits, dtype=bool).reshape(shape),
        np.frombuffer(holds, dtype=bool),
        np.frombuffer(gap).reshape(shape),
        np.frombuffer(offset).reshape(*shape, 2),
        np.frombuffer(normal).reshape(*shape, 2),
        np.frombuffer(limited, dtype=bool).reshape(shape),
    )


def poses_may_fit(
    kernel: ModuleType,
    evidence: Evidence,
    state: Ints,
    theta: Floats,
    position: Floats,
    turn_rad: Floats,
    shift_mm: Floats,
    skipped: Bools | None,
    most: int | None,
) -> Bools:
    """Configurations (n,) near which one may satisfy all contacts, as `verification.may_fit` says."""
    found = kernel.may_fit(
        (evidence.boundaries, evidence.rows),
        *_poses(state, theta, position),
        np.ascontiguousarray(turn_rad),
        np.ascontiguousarray(shift_mm),
        len(state),
        _mask(skipped),
        -1 if most is None else most,
    )
    return np.frombuffer(found, dtype=bool)


def polish_poses(
    kernel: ModuleType,
    evidence: Evidence,
    cells: Cells,
    first: Ints,
    null: Bools,
    region: Ints,
    cell: Ints,
    poses: tuple[Ints, Floats, Floats],
    skipped: Bools | None,
) -> tuple[Floats, Floats, Bools]:
    """θ (n,) and positions (n, 2) of candidates as they are polished, and which hold.

    `poses`: their states, θ and positions. Candidates are in cells `cell` of the regions `region` (n,), which
    begin at `first`; `null` (nodes, touched): spurious contacts of interpretations.
    """
    regions = (
        np.ascontiguousarray(cells.node),
        np.ascontiguousarray(cells.lo),
        np.ascontiguousarray(cells.hi),
        np.ascontiguousarray(cells.polygon),
        np.ascontiguousarray(first),
        None if skipped is None else np.ascontiguousarray(null),
        len(cells),
        cells.polygon.shape[1],
        len(first) - 1,
        *null.shape,
    )
    theta, position, holds = kernel.polish(
        (evidence.boundaries, evidence.rows),
        regions,
        np.ascontiguousarray(region),
        np.ascontiguousarray(cell),
        *_poses(*poses),
        len(region),
        _mask(skipped),
    )
    return np.frombuffer(theta), np.frombuffer(position).reshape(-1, 2), np.frombuffer(holds, dtype=bool)


def _poses(state: Ints, theta: Floats, position: Floats) -> tuple[Ints, Floats, Floats]:
    return np.ascontiguousarray(state), np.ascontiguousarray(theta), np.ascontiguousarray(position)


def _mask(skipped: Bools | None) -> Bools | None:
    return None if skipped is None else np.ascontiguousarray(skipped)


@dataclass(frozen=True, eq=False)
class RegionRules:
    """What holds for all rounds: symmetry `orders` (S,) of states, and the `anchor_mm` (2,).

    Contacts that are spurious in interpretations: among those `paired` with edges (n, p), and among `all`
    (n, m); None if none is. `shape` (n, p). Whether something was touched that is `unpaired`. `pieces` of the
    boundary that are looked at, at most.
    """

    orders: Ints
    anchor_mm: Floats
    paired: Bools | None
    all: Bools | None
    shape: tuple[int, int]
    unpaired: bool
    pieces: int


@dataclass(frozen=True, eq=False)
class RegionArrays:
    """h regions that are done, and the cells to be cut finer, `again`, by their rows.

    Of their cells (k): `row`, and on the region's branch of the symmetry `lo`, `hi` (k,), `polygon`
    (k, v, 2). `first` (h + 1,): where regions begin; `theta` (h,), `position` (h, 2), `verified` (h,) and
    `node` (h,).
    """

    row: Ints
    lo: Floats
    hi: Floats
    polygon: Floats
    first: Ints
    theta: Floats
    position: Floats
    verified: Bools
    node: Ints
    again: Ints


def search_regions(
    kernel: ModuleType,
    evidence: Evidence,
    rules: RegionRules,
    cells: tuple[Ints, Ints, Floats, Floats, Floats, Floats, Bools],
    component: Ints | None,
    room: int,
    *,
    refinable: bool,
) -> RegionArrays:
    """A round of the witness search over cells: node, state, lo, hi, polygon, spot, holds, each (k, …).

    `component` (k,): of each cell, None where states have few each, to be found by comparing all of these.
    `room`: so many cells, times contacts, may be cut finer, if they are `refinable`.
    """
    shape = cells[4].shape[:2]
    found = kernel.regions(
        (evidence.boundaries, evidence.rows),
        (*contiguous(*cells), component, *shape),
        (rules.orders, rules.anchor_mm, rules.paired, rules.all, len(rules.orders), *rules.shape),
        (room, rules.pieces, refinable, rules.unpaired),
    )
    row, lo, hi, polygon, first, theta, position, verified, node, again = found
    return RegionArrays(
        np.frombuffer(row, np.int64),
        np.frombuffer(lo),
        np.frombuffer(hi),
        np.frombuffer(polygon).reshape(-1, shape[1], 2),
        np.frombuffer(first, np.int64),
        np.frombuffer(theta),
        np.frombuffer(position).reshape(-1, 2),
        np.frombuffer(verified, dtype=bool),
        np.frombuffer(node, np.int64),
        np.frombuffer(again, np.int64),
    )
