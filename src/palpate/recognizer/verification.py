"""Verification: whether a configuration satisfies every contact and every free path, exactly.

It shares nothing with the search that offers the configurations: no facets, no rectangles, no slack. A
contact is satisfied if the tip's centre, as stated, is within the position bound of a place of the true
boundary with a normal that the contact allows; a path, if moved by no more than its bound it does not cut
into the section grown by the radius (docs/recogniser.md, "Hypotheses"). Lengths are rounded outward by
`ALLOWANCE_MM`, normals by `ALLOWANCE_RAD`. Paths are moved in a few ways only: where none of these is free,
another one may be.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.geometry import Bools, Floats, Ints
from palpate.base.geometry.plane import rotate
from palpate.recognizer.contact import Contact
from palpate.recognizer.interpretations import Query
from palpate.recognizer.proximity import (
    ALLOWANCE_MM,
    NEAR_MM,
    Places,
    TipCentres,
    lines_are_free,
    nearest_places,
)
from palpate.recognizer.tables import Table
from palpate.recognizer.true_boundary import TrueBoundary

_MOVE_DIRECTIONS = 8  # directions in which a path is moved by its bound, where as stated it is not free
_BOUND_SHARE = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class Poses(Table):
    """n configurations: `state` (n,), `theta` (n,) rad, `position` s = R(−θ)(p − anchor) (n, 2) mm."""

    state: Ints
    theta: Floats
    position: Floats

    def to_objects(self, point_mm: Floats, anchor_mm: Floats) -> Floats:
        """Points of the table (m, 2) in the centred frames of the objects (n, m, 2)."""
        turned = rotate((point_mm - anchor_mm)[None], -self.theta[:, None])
        result: Floats = turned - self.position[:, None]
        return result


@dataclass(frozen=True, eq=False)
class Verification(Table):
    """Verification of n configurations by m contacts, misses included.

    `fits` (n, m): the contact is satisfied; `holds` (n,): all are, and all paths are free. `gap` (n, m) mm:
    from the stated centre to the nearest place where the tip may be, infinite if there is none near by;
    `offset` (n, m, 2) leads there and `normal` (n, m, 2) is the outward normal there, in the object's frame.
    `limited` (n, m): that is the last normal that the contact allows.
    """

    fits: Bools
    holds: Bools
    gap: Floats
    offset: Floats
    normal: Floats
    limited: Bools


def verify(evidence: Query, poses: Poses, skipped: Bools | None = None) -> Verification:
    """Judge configurations by m contacts and misses; those `skipped` (n, m) are no evidence.

    Paths are looked at where all contacts are satisfied.
    """
    shape = (len(poses), len(evidence.contacts))
    asked = np.ones(shape, dtype=bool) if skipped is None else ~skipped
    places = _places(evidence, poses, asked)
    gap, offset = places.distance.reshape(shape), places.offset.reshape(*shape, 2)
    fits = places.fits.reshape(shape) | ~asked
    holds: Bools = np.all(fits, axis=1)
    asked &= holds[:, None]
    holds &= np.all(_paths_are_free(evidence, poses, asked, offset), axis=1)
    return Verification(
        fits, holds, gap, offset, places.normal.reshape(*shape, 2), places.limited.reshape(shape)
    )


@dataclass(frozen=True, eq=False)
class Nearness:
    """Neighbourhood of n configurations: turned by `turn_rad`, position s off by `shift_mm` (n,), at most."""

    turn_rad: Floats
    shift_mm: Floats


def may_fit(
    evidence: Query, poses: Poses, near: Nearness, skipped: Bools | None = None, most: int | None = None
) -> Bools:
    """Configurations (n,) near which one may satisfy all contacts: False where none can.

    Once `most` pieces of the boundary were found near by for one kind of finger, all others may.
    """
    contacts = evidence.contacts
    shape = (len(poses), len(contacts))
    asked = np.ones(shape, dtype=bool) if skipped is None else ~skipped
    lever = np.hypot(*(_ends(contacts) - evidence.anchor_mm).T)
    more = near.turn_rad[:, None] * lever + near.shift_mm[:, None]
    wider = np.broadcast_to(near.turn_rad[:, None], shape)
    places = _places(evidence, poses, asked, (more, wider), most)
    bound = np.array([contact.position_bound_mm for contact in contacts]) + more
    close = places.distance.reshape(shape) <= bound + ALLOWANCE_MM
    untouched = np.array([not contact.touched for contact in contacts])
    result: Bools = np.all(close | ~asked | untouched, axis=1)
    return result


def _ends(contacts: Sequence[Contact]) -> Floats:
    return np.array([contact.end_mm for contact in contacts])


def _places(
    evidence: Query,
    poses: Poses,
    asked: Bools,
    margins: tuple[Floats, Floats] | None = None,
    most: int | None = None,
) -> Places:
    """Places next to where tips are said to be, for all poses and contacts `asked` (n, m), row by row.

    `margins` (n, m): bounds are larger by so many mm, and ranges of normals wider by so many rad at either
    end.
    """
    contacts = evidence.contacts
    point = poses.to_objects(_ends(contacts), evidence.anchor_mm)
    ranges = [contact.outward_normals() if contact.touched else None for contact in contacts]
    first, last = np.array([(r.lo_rad, r.hi_rad) if r else (0.0, -1.0) for r in ranges]).T
    bound = np.broadcast_to([contact.position_bound_mm for contact in contacts], asked.shape)
    lo, width = first - poses.theta[:, None], np.broadcast_to(last - first, asked.shape)
    if margins is not None:
        more_mm, wider_rad = margins
        bound, lo = bound + more_mm, lo - wider_rad
        width = np.where(width >= 0, width + 2 * wider_rad, width)
    touched = np.array([contact.touched for contact in contacts])
    found = Places.nowhere(asked.size)
    found.fits.reshape(asked.shape)[:, ~touched] = True
    for finger in dict.fromkeys(contact.finger for contact in contacts if contact.touched):
        of = np.array([contact.finger == finger for contact in contacts])
        row, column = np.nonzero(asked & (of & touched))
        at = row, column
        some = nearest_places(
            evidence.catalogue.boundary(finger),
            TipCentres(poses.state[row], point[at], lo[at], width[at], bound[at]),
            NEAR_MM if margins is None else 10 * ALLOWANCE_MM,
            judged=margins is None,
            most=most,
        )
        found.place(row * asked.shape[1] + column, some)
    return found


def _paths_are_free(evidence: Query, poses: Poses, asked: Bools, offset: Floats) -> Bools:
    """Paths (n, m) that are free if they are moved by something, at most their bound; or are not `asked`."""
    contacts, anchor_mm = evidence.contacts, evidence.anchor_mm
    free = ~asked
    start = poses.to_objects(np.array([contact.start_mm for contact in contacts]), anchor_mm)
    end = poses.to_objects(_ends(contacts), anchor_mm)
    bound = np.array([contact.free_path_bound_mm for contact in contacts])
    for finger in dict.fromkeys(contact.finger for contact in contacts):
        of = np.array([contact.finger == finger for contact in contacts])
        row, column = np.nonzero(asked & of)
        if len(row):
            boundary = evidence.catalogue.boundary(finger)
            free[row, column] = _some_way_is_free(
                boundary,
                poses.state[row],
                start[row, column],
                end[row, column],
                bound[column],
                offset[row, column],
            )
    return free


def _some_way_is_free(
    boundary: TrueBoundary, state: Ints, start: Floats, end: Floats, bound: Floats, offset: Floats
) -> Bools:
    """Paths (q,) that are free if they are moved by something, at most their bound.

    Tried are: to where the tip's centre may be, `offset` (q, 2); not at all; and by the whole bound, back and
    to all sides.
    """
    far = np.hypot(*offset.T)
    first = offset * np.minimum(1.0, _BOUND_SHARE * bound / np.maximum(far, 1e-300))[:, None]
    free = lines_are_free(boundary, state, start + first, end + first)
    rows = np.flatnonzero(~free)
    if not len(rows):
        return free
    along = end[rows] - start[rows]
    ahead = along / np.maximum(np.hypot(*along.T), 1e-300)[:, None]
    angle = np.pi + 2 * np.pi * np.arange(_MOVE_DIRECTIONS) / _MOVE_DIRECTIONS
    moves = rotate(ahead[:, None], angle) * (_BOUND_SHARE * bound[rows])[:, None, None]
    moves = np.concatenate([np.zeros((len(rows), 1, 2)), moves], axis=1)
    others = lines_are_free(
        boundary,
        np.repeat(state[rows], 1 + _MOVE_DIRECTIONS),
        (start[rows, None] + moves).reshape(-1, 2),
        (end[rows, None] + moves).reshape(-1, 2),
    )
    free[rows] = others.reshape(-1, 1 + _MOVE_DIRECTIONS).any(axis=1)
    return free
