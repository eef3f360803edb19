"""Learning an unknown part on a rig: grip after grip round it, until an object model of it can be written."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.base.errors import InputError, quantity
from palpate.base.file_io import write_text
from palpate.base.geometry import ObjectModel
from palpate.base.vocabulary import IdentificationVerdict, RunLimit
from palpate.config import ObjectsFile, RigFile
from palpate.config.fields import to_json
from palpate.config.learning_result import LearningOut
from palpate.jobs.ready_rig import ReadyRig
from palpate.recognizer import Contact
from palpate.rig.identification.rig_recognition import MadeGrip, RigRecognition
from palpate.rig.learning.felt_outline import FeltOutline
from palpate.rig.learning.learned_model import with_further_states
from palpate.rig.learning.learning_search import LearningSearch, learning_reach
from palpate.views.felt_outline import felt_outline_picture


@dataclass(frozen=True, eq=False, repr=False)
class LearnedObject:
    """Outcome of learning: the model, None while tips have not passed all round; and what it rests on.

    `grips`: contacts of all, misses and those that were known before included. `limit`: which one ended it,
    if one did. `fits_together`: False if touches contradict one another, as where the part was moved.
    `open_places_mm`: where a tip may pass between neighbouring touches, in W. `verdict`: of the recognition
    among the objects that were known before, None if there was none; only an *unknown* part is learned.
    `state`: the way it lies. `known`: those objects, and `left`: which of them it may be, by name. `session`:
    its folder, if one is kept.
    """

    name: str
    state: str
    model: ObjectModel | None
    goal_mm: float
    grips: tuple[tuple[Contact, ...], ...]
    rig_seconds: float
    limit: RunLimit | None
    fits_together: bool
    felt: tuple[FeltOutline, ...]
    open_places_mm: tuple[tuple[float, float], ...]
    known: ObjectsFile
    verdict: IdentificationVerdict | None = None
    left: tuple[str, ...] = ()
    session: Path | None = None

    @property
    def goal_met(self) -> bool:
        """True if the model's tolerance is what was asked for, or the part is one that was known before."""
        if self.model is None:
            return self.verdict is not None and self.verdict.is_answer
        return self.model.tolerance_mm <= self.goal_mm

    @property
    def objects(self) -> ObjectsFile:
        """The objects that were known before with the model. Raises InputError if there is no model."""
        if self.model is None:
            raise InputError(f"{self.name}: {self.text}")
        others = tuple(item for item in self.known.objects if item.name != self.name)
        before = next((item for item in self.known.objects if item.name == self.name), None)
        model = self.model if before is None else with_further_states(before, self.model)
        return ObjectsFile((*others, model))

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
        if self.verdict not in (None, IdentificationVerdict.UNKNOWN):
            names = f": {', '.join(self.left)}" if self.left else ""
            return f"{self.verdict}{names}; only what is unknown is learned ({spent})"
        if not self.fits_together:
            return f"touches contradict one another, the part was moved: hold it, and begin again ({spent})"
        if not self.touch_count:
            return f"nothing was touched ({spent})"
        if self.model is None:
            where = ""
            if self.open_places_mm:
                x, y = self.open_places_mm[0]
                places = quantity(len(self.open_places_mm), "place", "places")
                where = f" at {places}, such as x {x:.0f} mm, y {y:.0f} mm"
            return f"the outline is not closed{where}: give it more time, or a stage that turns ({spent})"
        asked = "" if self.goal_met else f", for a goal of {self.goal_mm:g} mm"
        return f"learned with a tolerance of {self.model.tolerance_mm:.2f} mm{asked} ({spent})"

    def to_json(self) -> str:
        """JSON of the result, format `palpate/learning@1`."""
        return to_json(
            LearningOut(
                format="palpate/learning@1",
                name=self.name,
                state=self.state,
                tolerance=None if self.model is None else self.model.tolerance_mm,
                goal=self.goal_mm,
                goal_met=self.goal_met,
                fits_together=self.fits_together,
                limit=self.limit,
                grips=len(self.grips),
                touches=self.touch_count,
                rig_seconds=self.rig_seconds,
                verdict=self.verdict,
                objects=self.left,
            )
        )

    def picture(self) -> str:
        """SVG of the bounds, of what was touched, and of the model."""
        return felt_outline_picture(self.name, self.felt, self.open_places_mm, self.text)

    def _repr_svg_(self) -> str:
        return self.picture()

    def __repr__(self) -> str:
        return f"<LearnedObject {self.name}: {self.text}>"


@dataclass(frozen=True)
class LearningRequest:
    """Request for a model of a part that is `height_mm` high, as it lies (`state`), in so much time at most.

    `contacts`: made before, while it lay there. `objects`: what is known already; without contacts the part
    is recognised among them first.
    """

    name: str
    state: str
    height_mm: float
    tolerance_mm: float
    max_seconds: float
    contacts: tuple[tuple[Contact, ...], ...]
    objects: ObjectsFile


def begin_learning(rig: RigFile, request: LearningRequest) -> LearningSearch:
    """A search that knows the contacts of the request.

    Raises InputError for a rig on which nothing can be learned, or limits that mean nothing.
    """
    check_learning(rig, request.height_mm, request.tolerance_mm, request.max_seconds)
    before = [item for item in request.objects.objects if item.name == request.name]
    if any(state.name == request.state for item in before for state in item.states):
        raise InputError(
            f'object {request.name} has a state "{request.state}" already; name the way it lies now otherwise'
        )
    search = LearningSearch(rig, learning_reach(rig), request.height_mm, request.tolerance_mm)
    search.take([contact for grip in request.contacts for contact in grip])
    return search


def check_learning(rig: RigFile, height_mm: float, tolerance_mm: float, max_seconds: float) -> None:
    """Raise InputError for a rig on which nothing can be learned, or limits that mean nothing.

    `LearningSearch` refuses fingers whose touches bound no outline.
    """
    for name, value in (
        ("height_mm", height_mm),
        ("tolerance_mm", tolerance_mm),
        ("max_seconds", max_seconds),
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


def learn(
    rig: ReadyRig, search: LearningSearch, request: LearningRequest, progress: Callable[[str], None]
) -> LearnedObject:
    """Touch what lies on the table until it is known as finely as asked for, or a limit is reached."""
    grips, begun_s = list[MadeGrip](), rig.time_s
    limit, verdict = None, None
    if request.objects.objects and not request.contacts:
        recognition = _recognise(rig, request.objects, progress)
        grips, verdict = list(recognition.grips), recognition.verdict
        if verdict is not IdentificationVerdict.UNKNOWN:
            left = dict.fromkeys(item.state.object_name for item in recognition.hypotheses)
            return replace(
                _outcome(request, search, grips, rig.time_s - begun_s), verdict=verdict, left=tuple(left)
            )
        search.take([contact for grip in grips for contact in grip])
    while limit is None and not search.is_done and search.holds_together and (approaches := search.next()):
        grips.append(rig.carry_out(approaches))
        search.take(grips[-1])
        progress(_progress_text(search, grips))
        limit = RunLimit.MAX_SECONDS if rig.time_s - begun_s > request.max_seconds else None
    return replace(
        _outcome(request, search, grips, rig.time_s - begun_s),
        model=search.model(request.name, request.state) if search.holds_together else None,
        limit=None if search.is_done else limit,
        verdict=verdict,
    )


def keep_result(learned: LearnedObject, folder: Path) -> LearnedObject:
    """Keep result and picture in a session's folder. Raises as `write_text`."""
    kept = replace(learned, session=folder)
    write_text(folder / "result.json", kept.to_json() + "\n")
    write_text(folder / "picture.svg", kept.picture())
    return kept


def _recognise(rig: ReadyRig, objects: ObjectsFile, progress: Callable[[str], None]) -> RigRecognition:
    """Recognition of the part among objects, as `identify` would end."""
    recognition = rig.recognise(objects)
    while approaches := rig.plan(recognition):
        recognition = recognition.extend(rig.grip(approaches))
        progress(repr(recognition).strip("<>").removeprefix("RigRecognition "))
    return recognition


def _outcome(
    request: LearningRequest, search: LearningSearch, grips: Sequence[MadeGrip], seconds: float
) -> LearnedObject:
    """Outcome of so many grips, without a model."""
    return LearnedObject(
        request.name,
        request.state,
        None,
        request.tolerance_mm,
        (*request.contacts, *map(tuple, grips)),
        seconds,
        None,
        search.holds_together,
        tuple(search.felt.values()),
        search.open_places_mm,
        request.objects,
    )


def _progress_text(search: LearningSearch, grips: Sequence[MadeGrip]) -> str:
    touched = sum(contact.touched for grip in grips for contact in grip)
    known = f"±{search.tolerance_mm:.1f} mm" if np.isfinite(search.tolerance_mm) else "not closed"
    return f"{quantity(len(grips), 'grip', 'grips')}, {quantity(touched, 'touch', 'touches')}: {known}"
