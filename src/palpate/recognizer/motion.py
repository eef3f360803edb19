"""Motion between contacts: how far a part may have been moved, and what that leaves of earlier contacts.

A contact of a part that has moved since is a contact of the part as it lies now, of a finger that was moved
with it: the *carried* contact. It is as far from the measured one as the part was moved there
(docs/recogniser.md, "A part that moves").
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.recognizer.catalogue import Catalogue
from palpate.recognizer.contact import LARGEST_MM, Contact, NormalRange

__all__ = ["Motion", "carried_by", "felt_in_motion"]


@dataclass(frozen=True, eq=False)
class Motion:
    """Bounds on one motion of the part, for each of a catalogue's S states: all (S,).

    Its centroid is moved by at most `shift_mm`, and it is turned by at most `turn_rad`.
    """

    shift_mm: Floats
    turn_rad: Floats

    @classmethod
    def none(cls, catalogue: Catalogue) -> "Motion":
        """No motion."""
        return cls(np.zeros(len(catalogue.states)), np.zeros(len(catalogue.states)))

    def __bool__(self) -> bool:
        return bool(self.shift_mm.any() or self.turn_rad.any())

    def furthest_mm(self, catalogue: Catalogue, states: Ints) -> float:
        """How far any point of the part, in one of `states` (indices), may be moved; infinite: no bound."""
        return _most(self.shift_mm + self.turn_rad * catalogue.reach_mm, states)

    def __add__(self, other: "Motion") -> "Motion":
        """One motion after the other."""
        return Motion(self.shift_mm + other.shift_mm, self.turn_rad + other.turn_rad)


def carried_by(
    motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints, distance_mm: Floats | None = None
) -> Contact:
    """The contact after a motion of the part, which is in one of `states` (indices).

    Position, path, normal and direction of travel are widened by what the motion may have been.
    `distance_mm` (S,): from the centroid to where the contact was, at most; None: as far as the part reaches.
    """
    at_end, on_path = _displacements_mm(motion, catalogue, contact, states)
    if distance_mm is not None:
        at_end = min(at_end, _most(motion.shift_mm + motion.turn_rad * distance_mm, states))
    turn = _most(motion.turn_rad, states)
    normal = contact.normal
    if normal is not None:
        lo, hi = normal.lo_rad - turn, normal.hi_rad + turn
        normal = NormalRange(lo, hi) if hi - lo < 2 * math.pi else None
    return replace(
        contact,
        position_bound_mm=min(contact.position_bound_mm + at_end, LARGEST_MM),
        path_bound_mm=min(contact.free_path_bound_mm + on_path, LARGEST_MM),
        normal=normal,
        turn_bound_rad=min(contact.turn_bound_rad + turn, math.pi),
    )


def felt_in_motion(motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints) -> Contact:
    """A contact of a grip that may have moved the part, in one of `states`, before the contact was measured.

    Where the tip was, and the normal, are those of the part as it lay then. The path was free of a part that
    lay elsewhere, and the part may have been pushed against the tip from any side.
    """
    _, on_path = _displacements_mm(motion, catalogue, contact, states)
    if not on_path:
        return contact
    bound = min(contact.free_path_bound_mm + on_path, LARGEST_MM)
    return replace(contact, path_bound_mm=bound, turn_bound_rad=math.pi)


def _displacements_mm(
    motion: Motion, catalogue: Catalogue, contact: Contact, states: Ints
) -> tuple[float, float]:
    """How far a motion takes the tip with it: at its contact, and anywhere on its path beside the part."""
    shift, turn = motion.shift_mm, motion.turn_rad
    lever = catalogue.reach_mm + contact.finger.tip_radius_mm
    # A point of the path that can be beside the moved part was no further from it before than it has moved.
    beside = lever + shift + contact.free_path_bound_mm
    return _most(shift + turn * lever, states), _most(shift + turn * beside, states)


def _most(values: Floats, states: Ints) -> float:
    return float(np.max(values[states], initial=0.0))
