"""The next grip for a rig and the contacts it has felt so far: what `palpate plan` works out.

Between a recognition with a rig file and the words, values and pictures that tell of the plan.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.config import RigFile
from palpate.errors import InputError
from palpate.geometry import Bools
from palpate.recognizer import (
    Catalogue,
    Contact,
    Grip,
    Recognition,
    Resolution,
    next_grip,
    recognise,
    twins,
    used_by,
)
from palpate.rig.conversion import finger_of, goals_of, resolution_of
from palpate.rig.reach.approaches import reach_of
from palpate.vocabulary import RecognitionVerdict, Strategy

__all__ = ["Planned", "plan_for", "sets_alike"]


@dataclass(frozen=True, eq=False)
class Planned:
    """What is left after some contacts, and the grip that comes next; None if there is none.

    `alike`: sets of hypotheses, by ascending index, of which no approach that is left tells any two apart.
    `fine`: every hypothesis is placed as finely as the rig file's goals ask.
    """

    rig: RigFile
    strategy: Strategy
    recognition: Recognition
    grip: Grip | None
    resolution: Resolution
    alike: tuple[tuple[int, ...], ...]
    fine: bool

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the grip's approaches in the order of the rig's fingers; none without a grip."""
        if self.grip is None:
            return ()
        fingers = [item.finger_index for item in self.grip.approaches]
        return tuple(sorted(range(len(fingers)), key=fingers.__getitem__))

    @property
    def hopeless(self) -> bool:
        """Whether several hypotheses are left, and nothing within reach tells any of them apart."""
        count = len(self.recognition.hypotheses)
        return count > 1 and any(len(group) == count for group in self.alike)

    @property
    def is_help(self) -> bool:
        """Whether the grip may change the answer, or the answer needs no change."""
        if self.recognition.verdict is RecognitionVerdict.NONE or self.hopeless:
            return False
        return self.grip is not None or (self.recognition.verdict is RecognitionVerdict.UNIQUE and self.fine)


def plan_for(
    rig: RigFile, catalogue: Catalogue, contacts: Sequence[Contact], strategy: Strategy, seed: int
) -> Planned:
    """Recognise `contacts`, misses included, and choose the next grip. `seed` matters to `random` only.

    Raises InputError if no finger touched anything, or one of them is none of the rig's.
    """
    _check_fingers(rig, contacts)
    recognition = recognise(catalogue, contacts)
    resolution, goals = resolution_of(rig), goals_of(rig)
    if recognition.verdict is RecognitionVerdict.NONE:
        return Planned(rig, strategy, recognition, None, resolution, (), False)
    reach = reach_of(rig)
    rng = np.random.default_rng([seed, 2])
    # As `identify` does: a grip that may be the last one meets the part from two sides.
    fingers = 2 if recognition.verdict is RecognitionVerdict.UNIQUE else 1
    grip = next_grip(strategy, recognition, reach, resolution, goals, rng, fingers)
    used = used_by(recognition.contacts, reach.approaches)
    fine = all(goals.met_by(item.bounds) for item in recognition.hypotheses)
    alike = sets_alike(twins(recognition, reach, resolution, used))
    return Planned(rig, strategy, recognition, grip, resolution, alike, fine)


def sets_alike(alike: Bools) -> tuple[tuple[int, ...], ...]:
    """Sets, of two at least, in which any two are alike: (h, h), symmetric. Every such pair is in one.

    Being alike to within what can be felt is not transitive, so sets may overlap.
    """
    open_pairs = np.triu(alike, 1)
    found = []
    while open_pairs.any():
        first, second = divmod(int(np.argmax(open_pairs)), len(alike))
        group = [first, second]
        fits = alike[first] & alike[second]
        fits[group] = False
        while fits.any():
            group.append(int(np.argmax(fits)))
            fits = fits & alike[group[-1]]
            fits[group] = False
        open_pairs[np.ix_(group, group)] = False
        found.append(tuple(sorted(group)))
    return tuple(found)


def _check_fingers(rig: RigFile, contacts: Sequence[Contact]) -> None:
    """Refuse contacts that none of the rig's fingers can have felt: approaches used would not be known."""
    own = list(dict.fromkeys(finger_of(finger) for finger in rig.fingers))
    for contact in contacts:
        if contact.finger not in own:
            has = ", ".join(f"{item.tip_radius_mm:g} mm at {item.height_mm:g} mm" for item in own)
            raise InputError(
                f"finger {contact.name} has a tip of radius {contact.finger.tip_radius_mm:g} mm at height "
                f'{contact.finger.height_mm:g} mm; rig "{rig.name}" has none like it, only: {has}'
            )
