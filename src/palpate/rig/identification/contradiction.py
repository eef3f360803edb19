"""Contradictions: grips that nothing in the catalogue explains together, and touches made again to say why.

Either the part was moved in between, or it is none of the catalogue. Touches that are made again show where
it lies now, whatever its shape. If two of them or more come out otherwise it was moved; a single one may have
grazed a corner. If all come out as before, a part of the catalogue moved by as little as need not show, or in
a way that these touches cannot show, but then the last grip goes together with them. If nothing in the
catalogue explains the grips either way, it is none of the catalogue. (A part that was moved, and then back to
where it had been, is taken for that, unless it was seen to move before.)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry.plane import wrap_angle
from palpate.base.vocabulary import ContradictionCause
from palpate.recognizer import (
    Catalogue,
    Contact,
    Motion,
    contact_after_motion,
    is_explained,
    recognise,
)
from palpate.rig.motion.touch import Touch

_MIN_DISPLACED = 2  # touches that come out otherwise: a single one may have grazed a corner
_MIN_MET = 2  # touches, to say anything
_LEVER_MM = 20.0  # over which a small motion of one end turns a part
_NORMALS, _ROUNDING_RAD = 33, 1e-9  # of a range that are tried


@dataclass(frozen=True)
class Contradiction:
    """Grips that nothing in the catalogue explains together; `grip` (from 1) contradicts the earlier ones.

    `repeated_in`: the grip in which the touches of an earlier one were made again, `touches` of which met
    something; None if there was none. `apart_mm`: the largest distance between two places where such a touch
    stopped, infinite if it met something only once. `hidden_mm`: the surfaces that they met may have moved
    as far without their showing it; infinite if they met none.
    """

    grip: int
    cause: ContradictionCause = ContradictionCause.EITHER
    repeated_in: int | None = None
    touches: int = 0
    apart_mm: float = 0.0
    hidden_mm: float = math.inf

    def of_what_moves(self) -> "Contradiction":
        """The same, of what was moved before, and may have been moved there and back."""
        still = self.cause is ContradictionCause.NOT_IN_CATALOGUE
        return replace(self, cause=ContradictionCause.EITHER) if still else self


def grip_to_repeat(grips: Sequence[Sequence[Touch]], begin: int) -> int | None:
    """Index of the first of the grips from `begin` on in which most touches met something; None: none did."""
    met = [sum(touch.contact.touched for touch in grip) for grip in grips[begin:]]
    return begin + met.index(max(met)) if any(met) else None


@dataclass(frozen=True, eq=False)
class RepeatedTouches:
    """Touches (n) made twice by the same fingers on the same ways: `first`, and `again`."""

    first: Sequence[Contact]
    again: Sequence[Contact]

    @classmethod
    def of(cls, first: Sequence[Touch], again: Sequence[Touch]) -> Self:
        """Touches of two grips on the same ways."""
        later = {touch.finger_index: touch.contact for touch in again}
        return cls([touch.contact for touch in first], [later[touch.finger_index] for touch in first])

    @cached_property
    def hits(self) -> list[tuple[Contact, Contact]]:
        """Those that met something both times."""
        return [(one, other) for one, other in self._pairs if one.touched and other.touched]

    @property
    def _pairs(self) -> list[tuple[Contact, Contact]]:
        return list(zip(self.first, self.again, strict=True))

    @property
    def displaced(self) -> int:
        """Number of touches that came out as they cannot have on one surface that lies still."""
        return sum(
            not _is_same_surface(one, other)
            if one.touched and other.touched
            else one.touched != other.touched
            for one, other in self._pairs
        )

    @property
    def apart_mm(self) -> float:
        """Largest distance between two stops of a touch; infinite if one met something only once."""
        if any(one.touched != other.touched for one, other in self._pairs):
            return math.inf
        return max((math.dist(one.end_mm, other.end_mm) for one, other in self.hits), default=0.0)

    @property
    def hidden_mm(self) -> float:
        """Distance by which the surfaces that were met may have moved; infinite if nothing was met."""
        return max((_slack_mm(one, other) for one, other in self.hits), default=math.inf)

    def contradiction(self, grip: int, repeated_in: int, grips: "ContradictoryGrips") -> Contradiction:
        """What the touches, made again in one grip, say of another that contradicts the earlier ones."""
        cause = ContradictionCause.EITHER
        if self.displaced >= _MIN_DISPLACED:
            cause = ContradictionCause.MOVED
        elif not self.displaced and len(self.hits) >= _MIN_MET and not grips.may_have_moved(self.hidden_mm):
            cause = ContradictionCause.NOT_IN_CATALOGUE
        return Contradiction(grip, cause, repeated_in, len(self.hits), self.apart_mm, self.hidden_mm)


@dataclass(frozen=True, eq=False)
class ContradictoryGrips:
    """Contacts of a `last` grip, which contradict `earlier` ones, and those of touches made `again` since."""

    catalogue: Catalogue
    earlier: Sequence[Contact]
    last: Sequence[Contact]
    again: Sequence[Contact]

    def may_have_moved(self, hidden_mm: float) -> bool:
        """Return whether a motion that touches made again do not show can explain the contradiction.

        Either a small one, or any before the last grip: then this goes together with the touches made again,
        in some state that the earlier ones had left.
        """
        if is_explained(self.catalogue, [*self._carry(self.earlier, hidden_mm), *self.last]):
            return True
        return bool(
            self._states(self.earlier) & self._states([*self._carry(self.last, hidden_mm), *self.again])
        )

    def _carry(self, contacts: Sequence[Contact], way_mm: float) -> list[Contact]:
        """Contacts of which every point may have moved by as much since."""
        states = np.arange(len(self.catalogue.states))
        shift, at_contact = np.full(len(states), way_mm), np.zeros(len(states))
        motion = Motion(shift, shift / _LEVER_MM)
        return [contact_after_motion(motion, self.catalogue, item, states, at_contact) for item in contacts]

    def _states(self, contacts: Sequence[Contact]) -> set[int]:
        """States (indices) that explain contacts; all, where they say too little."""
        try:
            return {item.state_index for item in recognise(self.catalogue, contacts).hypotheses}
        except InputError:
            return set(range(len(self.catalogue.states)))


def _slack_mm(one: Contact, other: Contact) -> float:
    """The most that a surface may have moved along its normal between two touches."""
    angle = other.middle_normal_rad
    gap = np.array(other.end_mm) - one.end_mm
    along = abs(math.cos(angle) * gap[0] + math.sin(angle) * gap[1])
    return float(along) + one.position_bound_mm + other.position_bound_mm


def _is_same_surface(one: Contact, other: Contact) -> bool:
    """Return whether one surface that lies still can have stopped a finger at both places."""
    first, second = one.outward_normals(), other.outward_normals()
    if first is None or second is None:
        return False
    middle = (first.lo_rad + first.hi_rad) / 2
    turned = wrap_angle((second.lo_rad + second.hi_rad) / 2 - middle)
    halves = (first.hi_rad - first.lo_rad) / 2, (second.hi_rad - second.lo_rad) / 2
    if abs(turned) > sum(halves) + _ROUNDING_RAD:
        return False
    lo, hi = min(-halves[0], turned - halves[1]), max(halves[0], turned + halves[1])
    angles = middle + np.linspace(lo, hi, _NORMALS)
    gap = np.array(other.end_mm) - one.end_mm
    along = np.cos(angles) * gap[0] + np.sin(angles) * gap[1]
    allowed = one.position_bound_mm + other.position_bound_mm
    return bool(along.min() <= allowed and along.max() >= -allowed)
