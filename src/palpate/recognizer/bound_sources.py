"""Sources of an answer's bounds: how much narrower they would be if one of them were nil.

To first order about the answer, a contact with outward normal n, lever arm l of n about the centroid, and
bound e allows displacements (x, y, θ) of the part with |n · (x, y) + l θ| ≤ e; a measured normal allows
|θ| up to half of its range. A motion since is a displacement of its own, within its bounds. The half-widths
are optima of linear programs; those without a source, in proportion to those with all, say what it costs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import cross, rotate
from palpate.base.vocabulary import BoundSource
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import Contact
from palpate.recognizer.hypotheses import Hypothesis
from palpate.recognizer.outline_deviations import places_on_outlines

_DIRECTIONS = 16  # sides of the polygon round the disc of a shift
_FULL_SHARE = 0.99  # a source that leaves so much of every width is none


@dataclass(frozen=True, eq=False)
class MeasuredContact:
    """A contact as it was measured, not carried over motions; it touched.

    `dent_mm`: the part of its position bound that the touch adds to that of the tip's place. `shift_mm`,
    `turn_rad`: how far the part may have moved since.
    """

    contact: Contact
    dent_mm: float
    shift_mm: float
    turn_rad: float


@dataclass(frozen=True)
class HalfWidths:
    """Half-widths of bounds: of position (the wider of x and y), and of orientation."""

    position_mm: float
    orientation_rad: float


def widths_without_source(
    catalogue: Catalogue, found: Hypothesis, contacts: Sequence[MeasuredContact]
) -> dict[BoundSource, HalfWidths]:
    """Half-widths that a hypothesis's bounds would have if one source were nil, by sources that matter.

    `contacts`: in the order in which they were measured. Empty for round states, and where contacts do not
    bound the part by themselves.
    """
    if found.state.state.is_round or not contacts:
        return {}
    system = _ContactSystem.of(catalogue, found, contacts)
    whole = system.half_widths(None)
    if not (np.isfinite(whole).all() and whole.all()):
        return {}
    stated, result = found.bounds, {}
    for source in BoundSource:
        without = system.half_widths(source)
        position = without[:2].max() / whole[:2].max()
        orientation = without[2] / whole[2]
        if min(position, orientation) < _FULL_SHARE:
            result[source] = HalfWidths(
                min(float(position), 1.0) * stated.position_half_mm,
                min(float(orientation), 1.0) * stated.orientation_half_rad,
            )
    return result


@dataclass(frozen=True, eq=False)
class _ContactSystem:
    """Constraints of n contacts on displacements of a part.

    `row` (n, 3): what x, y and θ move at each along its normal; `bound_mm` (3, n): of fingers, dents and
    tolerance; `normal_rad` (n,): half ranges; `shift_mm`, `turn_rad` (n,): motions since; `aim` (3, 3): x, y
    and θ of the object's origin by those of its centroid.
    """

    row: Floats
    bound_mm: Floats
    normal_rad: Floats
    shift_mm: Floats
    turn_rad: Floats
    aim: Floats

    @classmethod
    def of(cls, catalogue: Catalogue, found: Hypothesis, contacts: Sequence[MeasuredContact]) -> Self:
        items = [item.contact for item in contacts]
        at, theta = found.configuration, np.array(found.configuration.theta_rad)
        origin = rotate(found.state.origin_mm, theta)  # the centroid, from the object's origin
        arms = np.array([item.end_mm for item in items]) - (np.array([at.x_mm, at.y_mm]) + origin)
        own = rotate(arms, -theta)[None]
        spans = [item.finger.span_mm for item in items]
        places = places_on_outlines(catalogue, np.array([found.state_index]), spans, own)
        normal = rotate(places.normal[0], theta)
        dents = np.array([item.dent_mm for item in contacts])
        fingers = np.array([item.position_bound_mm for item in items]) - dents
        ranges = [
            np.inf if item.normal is None else item.normal.hi_rad - item.normal.lo_rad for item in items
        ]
        return cls(
            np.column_stack([normal, cross(arms, normal)]),
            np.stack([fingers, dents, np.full(len(items), found.state.tolerance_mm)]),
            np.array(ranges) / 2,
            np.array([item.shift_mm for item in contacts]),
            np.array([item.turn_rad for item in contacts]),
            np.array([[1.0, 0.0, origin[1]], [0.0, 1.0, -origin[0]], [0.0, 0.0, 1.0]]),
        )

    def half_widths(self, without: BoundSource | None) -> Floats:
        """Half-widths (3,) of x, y and θ of the object's origin, one source left out; infinite: no bound."""
        from scipy.optimize import linprog  # noqa: PLC0415  (slow to import)

        matrix, limit = self._constraints(without)
        aims = np.pad(self.aim, ((0, 0), (0, matrix.shape[1] - 3)))
        found = [linprog(-aim, matrix, limit, bounds=(None, None)) for aim in aims]
        return np.array([np.inf if item.fun is None else max(-item.fun, 0.0) for item in found])

    def _constraints(self, without: BoundSource | None) -> tuple[Floats, Floats]:
        """Matrix (c, v) and limits (c,) of displacements: the part's, then one for each motion."""
        parts = (BoundSource.FINGERS, BoundSource.DENTS, BoundSource.TOLERANCE)
        bound = self.bound_mm[[item is not without for item in parts]].sum(axis=0)
        normal = np.zeros_like(bound) if without is BoundSource.NORMALS else self.normal_rad
        moves = 0.0 if without is BoundSource.MOTION else 1.0
        since, index = np.unique(moves * self.shift_mm, return_inverse=True)
        turns = np.array([moves * self.turn_rad[index == k].max() for k in range(len(since))])
        count = len(since)
        # The motion since a contact is all smaller ones together.
        later = np.tril(np.ones((count, count)))[index]
        rows = np.hstack([self.row, *(-later[:, [k]] * self.row for k in range(count))])
        turn = np.array([0.0, 0.0, 1.0])
        turned = np.hstack([np.tile(turn, (len(bound), 1)), *(-later[:, [k]] * turn for k in range(count))])
        finite = np.isfinite(normal)
        own, own_limit = self._motion_limits(
            np.diff(since, prepend=0.0), np.maximum(np.diff(turns, prepend=0.0), 0.0)
        )
        matrix = np.vstack([rows, -rows, turned[finite], -turned[finite], own])
        limit = np.concatenate([bound, bound, normal[finite], normal[finite], own_limit])
        return matrix, limit

    def _motion_limits(self, shift_mm: Floats, turn_rad: Floats) -> tuple[Floats, Floats]:
        """Matrix and limits of the motions (k,) alone."""
        angle = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
        ways = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_DIRECTIONS)])
        each = np.vstack([ways, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
        matrix = np.hstack([np.zeros((len(each) * len(shift_mm), 3)), np.kron(np.eye(len(shift_mm)), each)])
        round_ = np.cos(np.pi / _DIRECTIONS)
        limits = [
            [shift / round_] * _DIRECTIONS + [turn] * 2
            for shift, turn in zip(shift_mm, turn_rad, strict=True)
        ]
        return matrix, np.concatenate(limits)
