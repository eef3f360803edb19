"""Compiled verification: calls of the kernel that judge, rule out and polish configurations.

The same as `verification` and `witness_polish` have by whole arrays.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.region import Cells

__all__ = ["Evidence", "evidence_of", "judged", "polished", "which_may_fit"]


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


def judged(
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


def which_may_fit(
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


def polished(
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
