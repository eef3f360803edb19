"""Learning an unknown part on a rig: grip after grip round it, until an object model of it can be written."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from palpate.base.errors import InputError, quantity
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import RunLimit
from palpate.config import ObjectsFile, RigFile
from palpate.config.fields import to_json
from palpate.config.learning_result import LearningOut
from palpate.jobs.ready_rig import ReadyRig
from palpate.recognizer import Contact
from palpate.rig.identification.rig_recognition import MadeGrip
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.learning_search import LearningSearch, learning_reach
from palpate.views.felt_outline import felt_outline_picture


@dataclass(frozen=True, eq=False, repr=False)
class LearnedObject:
    """Outcome of learning: the model, None while tips have not passed all round; and what it rests on.

    `grips`: contacts of all, misses and those that were known before included. `limit`: which one ended it,
    if one did. `fits_together`: False if touches contradict one another, as where the part was moved.
    """

    name: str
    model: ObjectModel | None
    goal_mm: float
    grips: tuple[tuple[Contact, ...], ...]
    rig_seconds: float
    limit: RunLimit | None
    fits_together: bool
    felt: tuple[FeltOutline, ...]

    @property
    def goal_met(self) -> bool:
        """True if the model's tolerance is what was asked for."""
        return self.model is not None and self.model.tolerance_mm <= self.goal_mm

    @property
    def objects(self) -> ObjectsFile:
        """The model as a catalogue of its own. Raises InputError if there is none."""
        if self.model is None:
            raise InputError(f"{self.name}: {self.text}")
        return ObjectsFile((self.model,))

    @property
    def touch_count(self) -> int:
        """Number of touches that met the part."""
        return sum(contact.touched for grip in self.grips for contact in grip)

    @property
    def text(self) -> str:
        """Outcome in one line."""
        grips, touches = (
            quantity(len(self.grips), "grip", "grips"),
            quantity(self.touch_count, "touch", "touches"),
        )
        spent = f"{grips}, {touches}, {self.rig_seconds:.0f} s"
        if not self.fits_together:
            return f"touches contradict one another, the part was moved: hold it, and begin again ({spent})"
        if not self.touch_count:
            return f"nothing was touched ({spent})"
        if self.model is None:
            return f"the outline is not closed: more time, or a stage that turns, would close it ({spent})"
        asked = "" if self.goal_met else f", for a goal of {self.goal_mm:g} mm"
        return f"learned with a tolerance of {self.model.tolerance_mm:.2f} mm{asked} ({spent})"

    def to_json(self) -> str:
        """JSON of the result, format `palpate/learning@1`."""
        return to_json(
            LearningOut(
                format="palpate/learning@1",
                name=self.name,
                tolerance=None if self.model is None else self.model.tolerance_mm,
                goal=self.goal_mm,
                goal_met=self.goal_met,
                fits_together=self.fits_together,
                limit=self.limit,
                grips=len(self.grips),
                touches=self.touch_count,
                rig_seconds=self.rig_seconds,
            )
        )

    def picture(self) -> str:
        """SVG of the bounds, of what was touched, and of the model."""
        return felt_outline_picture(self.name, self.felt, self.text)

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        return f"<LearnedObject {self.name}: {self.text}>"


@dataclass(frozen=True)
class LearningRequest:
    """Request for a model of a part that is `height_mm` high, in so much time at most.

    `known`: contacts that were made before, while it lay there.
    """

    name: str
    height_mm: float
    tolerance_mm: float
    max_seconds: float
    known: tuple[tuple[Contact, ...], ...] = ()


def begin_learning(rig: RigFile, request: LearningRequest) -> LearningSearch:
    """A search that knows the contacts of the request.

    Raises InputError for a rig on which nothing can be learned, or limits that mean nothing.
    """
    for name, value in (
        ("height_mm", request.height_mm),
        ("tolerance_mm", request.tolerance_mm),
        ("max_seconds", request.max_seconds),
    ):
        if not 0 < value < math.inf:
            raise InputError(f"{name} is {value:g}; it must be more than 0")
    rig.require_arrays()
    emulated = None if rig.emulation is None else rig.emulation.part
    if rig.search.part_holds_n is not None or (emulated is not None and emulated.engine != "still"):
        raise InputError(
            f'parts on rig "{rig.name}" may slide (search.part_holds_n, emulation.part): an outline is '
            "learned of a part that is held, with a rig file that declares neither"
        )
    search = LearningSearch(rig, learning_reach(rig), request.height_mm, request.tolerance_mm)
    search.take([contact for grip in request.known for contact in grip])
    return search


def learn(
    rig: ReadyRig, search: LearningSearch, request: LearningRequest, progress: Callable[[str], None]
) -> LearnedObject:
    """Touch what lies on the table until it is known as finely as asked for, or a limit is reached."""
    now, grips = rig.hand.clock.now, list[MadeGrip]()
    begun_s, limit = now(), None
    while limit is None and not search.is_done and search.holds_together and (approaches := search.next()):
        grips.append(rig.carry_out(approaches))
        search.take(grips[-1])
        progress(_progress_text(search, grips))
        limit = RunLimit.MAX_SECONDS if now() - begun_s > request.max_seconds else None
    return LearnedObject(
        request.name,
        search.model(request.name) if search.holds_together else None,
        request.tolerance_mm,
        (*request.known, *(tuple(grip) for grip in grips)),
        now() - begun_s,
        None if search.is_done else limit,
        search.holds_together,
        tuple(search.felt),
    )


def _progress_text(search: LearningSearch, grips: Sequence[MadeGrip]) -> str:
    touched = sum(contact.touched for grip in grips for contact in grip)
    known = f"±{search.tolerance_mm:.1f} mm" if np.isfinite(search.tolerance_mm) else "not closed"
    return f"{quantity(len(grips), 'grip', 'grips')}, {quantity(touched, 'touch', 'touches')}: {known}"
