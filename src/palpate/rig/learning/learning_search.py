"""Learning search: grips round an unknown part until its outline is known as finely as asked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel
from palpate.config import RigFile
from palpate.recognizer import Contact, Finger, FingerApproach
from palpate.rig.identification.exploration import exploring_grip
from palpate.rig.learning.felt_outline import FeltOutline, felt_outline
from palpate.rig.learning.learned_model import NominalOutline, known_outline, learned_model
from palpate.rig.learning.touch_choice import TouchChooser, open_places_mm
from palpate.rig.reach.approaches import Reach, reach_of

_MOST_PATHS = 5000  # in corners a millimetre more or less decides whether a tip may pass
_AIM_SHARE = 0.9  # of the tolerance that is asked for: touches are wanted until bounds are a little finer
_FIRST_TOUCHES = 3  # by which fingers go to the middle of the table, or of what was touched


@dataclass(frozen=True, eq=False)
class _Kind:
    """Fingers of one tip and height: their approaches, and what their touches say so far."""

    finger: Finger
    reach: Reach
    chooser: TouchChooser
    contacts: tuple[Contact, ...]
    felt: FeltOutline | None

    @cached_property
    def nominal(self) -> NominalOutline | None:
        """The outline between the bounds, where `known_outline` has one."""
        return None if self.felt is None else known_outline(self.felt)

    @property
    def tolerance_mm(self) -> float:
        """Tolerance of what is known so far; infinite while bounds are not closed."""
        return np.inf if self.nominal is None else self.nominal.tolerance_mm

    @property
    def guess(self) -> shapely.Polygon | None:
        """About where the outline is; None before there is enough to guess from."""
        if self.nominal is not None:
            return shapely.Polygon(self.nominal.points_mm)
        if self.felt is None or len(self.felt.touched.middles_mm) < _FIRST_TOUCHES:
            return None
        hull = shapely.MultiPoint(self.felt.touched.middles_mm).convex_hull
        pieces = [
            item
            for item in shapely.get_parts(hull.intersection(self.felt.outer))
            if isinstance(item, shapely.Polygon)
        ]
        return max(pieces, key=lambda item: item.area, default=None)


class LearningSearch:
    """Search under way, by all touches so far."""

    def __init__(self, rig: RigFile, reach: Reach, height_mm: float, tolerance_mm: float) -> None:
        """`height_mm` of the part; `tolerance_mm`: what is asked for.

        Fingers that are above the part stay where they are. Raises InputError for fingers whose touches bound
        no outline.
        """
        self._goal_mm, self._height_mm, self._radius_mm = tolerance_mm, height_mm, rig.workspace.radius_mm
        self._kinds: dict[Finger, _Kind] = {}
        every = [item.finger for item in reach.approaches]
        for finger in dict.fromkeys(item for item in every if item.span_mm[0] < height_mm):
            own = reach.only(np.flatnonzero([item == finger for item in every]))
            self._kinds[finger] = _Kind(finger, own, TouchChooser(own, self._radius_mm), (), None)
        _check_fingers(list(self._kinds))

    @property
    def fingers(self) -> Sequence[Finger]:
        """Fingers that touch the part, one of each tip and height."""
        return list(self._kinds)

    @property
    def felt(self) -> Mapping[Finger, FeltOutline]:
        """Bounds of the outlines that were touched, by the fingers that did."""
        return {finger: kind.felt for finger, kind in self._kinds.items() if kind.felt is not None}

    @property
    def outlines(self) -> Mapping[Finger, NominalOutline]:
        """Outlines between the bounds, by the fingers at whose heights these are closed."""
        return {finger: kind.nominal for finger, kind in self._kinds.items() if kind.nominal is not None}

    @property
    def open_places_mm(self) -> tuple[tuple[float, float], ...]:
        """Places in W where a tip may pass between neighbouring touches, so that an outline is not closed."""
        known = [(kind.felt, kind.guess) for kind in self._kinds.values()]
        found = [
            open_places_mm(felt, guess) for felt, guess in known if felt is not None and guess is not None
        ]
        return tuple((float(x), float(y)) for places in found for x, y in places)

    @property
    def holds_together(self) -> bool:
        """False if touches contradict one another: the part moved."""
        return all(felt.holds_together for felt in self.felt.values())

    @property
    def tolerance_mm(self) -> float:
        """Tolerance of the model so far; infinite while there is none."""
        return max(kind.tolerance_mm for kind in self._kinds.values())

    @property
    def is_done(self) -> bool:
        """True if the model is as fine as asked for."""
        return self.tolerance_mm <= self._goal_mm

    def take(self, contacts: Sequence[Contact]) -> None:
        """Take in contacts and misses. Raises InputError for those of other fingers than the rig's."""
        others = {item.name for item in contacts if item.finger not in self._kinds}
        if others:
            raise InputError(
                f"contacts of {', '.join(sorted(others))}: no finger of this rig has such a tip there"
            )
        for finger, kind in self._kinds.items():
            new = [item for item in contacts if item.finger == finger]
            if new:
                every = (*kind.contacts, *new)
                felt = felt_outline(every, self._radius_mm)
                self._kinds[finger] = _Kind(finger, kind.reach, kind.chooser, every, felt)

    def next(self) -> tuple[FingerApproach, ...]:
        """The next grip; none if no approach would bring bounds closer."""
        for kind in sorted(self._kinds.values(), key=lambda item: -item.tolerance_mm):
            if kind.tolerance_mm <= self._goal_mm:
                continue
            if kind.felt is None or kind.guess is None:
                grip = tuple(exploring_grip(kind.reach, kind.contacts))
            else:
                grip = kind.chooser.grip(kind.contacts, kind.felt, kind.guess, _AIM_SHARE * self._goal_mm)
            if grip:
                return grip
        return ()

    def model(self, name: str, state: str) -> ObjectModel | None:
        """The object of this name in a state as it is known so far; None while some outline is not closed."""
        outlines = {finger.span_mm: item for finger, item in self.outlines.items()}
        if len(outlines) < len(self._kinds):
            return None
        return learned_model(
            (name, state), outlines, self._height_mm, max(finger.tip_radius_mm for finger in self._kinds)
        )


def learning_reach(rig: RigFile) -> Reach:
    """Approaches for learning: at more stage angles than `identify` looks at."""
    return reach_of(rig, most_paths=_MOST_PATHS)


def _check_fingers(fingers: Sequence[Finger]) -> None:
    """Raise InputError unless there are tips, all upright, and those at one height alike."""
    if not fingers:
        raise InputError("the part is lower than all tips")
    if not all(finger.tip.is_upright and not finger.tip.has_face for finger in fingers):
        raise InputError("outlines are learned with upright round tips; balls and pads cannot bound them")
    spans = [finger.span_mm for finger in fingers]
    if len(set(spans)) < len(spans):
        raise InputError(
            "fingers at one height have tips of different radius: learn with tips that are alike"
        )
