"""Simulated identification of a study, determined entirely by its number and the study's seed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Floats, ObjectModel
from palpate.base.vocabulary import ErrorSource, PartMotion, Strategy
from palpate.config import ObjectsFile, RigFile
from palpate.config.emulation import EmulatedPartConfig
from palpate.config.study_result import RivalOut, StudyRunOut
from palpate.drivers.emulators import Parts
from palpate.recognizer import Catalogue, Recognition, Resolution, fewest_touches
from palpate.rig.catalogue.preparation import prepare_catalogue
from palpate.rig.conversion import finger_of, goals_of
from palpate.rig.emulated.driven_tips import ArrayNoise, noise_of
from palpate.rig.emulated.ground_truth import compare_answer, sticks_out_mm
from palpate.rig.emulated.hidden_truth import draw_parts, parts_of
from palpate.rig.emulated.scene import Placement, put_down
from palpate.rig.fingers import resolution_of
from palpate.rig.identification.events import Event, Observers, RecognitionEvent, TouchEvent
from palpate.rig.identification.grip_choice import GripChooser, PushTables, strategy_rng
from palpate.rig.identification.identify import search_with
from palpate.rig.identification.result import hypotheses_of
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.study.pushing_touches import PushingTouches
from palpate.rig.study.simulated_touches import SimulatedTouches

_PLACEMENT_RADIUS_SHARE = (
    0.16  # of the workspace's radius, where a rig file does not say how far from the middle parts lie
)


def placement_radius_mm(rig: RigFile) -> float:
    """Largest distance of a part's centre of area from the middle of the workspace, by the rig file."""
    emulation = rig.emulation
    return (
        _PLACEMENT_RADIUS_SHARE * rig.workspace.radius_mm
        if emulation is None
        else emulation.placement_radius_mm
    )


def has_probabilities(model: ObjectModel) -> bool:
    """Return whether all states of an object have a probability, and one of them is not 0."""
    known = [item.probability for item in model.states if item.probability is not None]
    return len(known) == len(model.states) and sum(known) > 0


def state_shares(objects: ObjectsFile) -> Mapping[tuple[str, str], float]:
    """Shares of all runs by object and state: objects evenly, states by their probabilities or evenly."""
    count = len(objects.objects)
    return {
        (model.name, state.name): share / count
        for model in objects.objects
        for state, share in zip(model.states, _shares(model).tolist(), strict=True)
    }


def draw_placement(
    objects: ObjectsFile, radius_mm: float, rng: np.random.Generator, workspace_mm: float
) -> Placement:
    """An object, one of its states, and where it lies within `radius_mm` of the middle.

    Unlike a scene of the emulated bench, whose states are all as frequent, this follows probabilities.
    """
    model = objects.objects[int(rng.integers(len(objects.objects)))]
    if has_probabilities(model):
        state = model.states[int(rng.choice(len(model.states), p=_shares(model)))]
    else:
        state = model.states[int(rng.integers(len(model.states)))]
    return put_down(model, state, radius_mm, rng, workspace_mm)


def _shares(model: ObjectModel) -> Floats:
    """Shares of an object's runs by state (s,); probabilities of states that were left out are shared."""
    if not has_probabilities(model):
        return np.full(len(model.states), 1 / len(model.states))
    found: Floats = np.array([item.probability for item in model.states], dtype=float)
    return found / float(found.sum())


_MAX_RIVALS = 5  # of a run: those that lasted longest
_MAX_DRAWS = 10  # of a part's feet, on which it may not be able to stand


def motion_of(rig: RigFile) -> PartMotion:
    """Return whether the emulated part moves, by the rig file."""
    part = None if rig.emulation is None else rig.emulation.part
    return PartMotion.STILL if part is None or part.engine == "still" else PartMotion.MOVING


def with_motion(rig: RigFile, objects: ObjectsFile, motion: PartMotion) -> tuple[RigFile, ObjectsFile]:
    """The same rig and catalogue with parts that move, or that are held.

    Of parts that are held nothing is declared of how they slide. Raises InputError for a rig that says
    nothing of emulated devices, if parts are to move, and for one with balls or pads.
    """
    rig.require("simulate")
    if motion is PartMotion.MOVING and motion_of(rig) is motion:
        return rig, objects
    if motion is PartMotion.MOVING:
        if rig.emulation is None:
            raise InputError(
                f'rig "{rig.name}" describes real devices, and nothing of parts that move; add [emulation] '
                "with [emulation.part] (docs/emulated-rig.md), or let parts lie still"
            )
        part = rig.emulation.part or EmulatedPartConfig(engine="quasi-static")
        return _with_part(rig, part.model_copy(update={"engine": "quasi-static"})), objects
    still = rig.model_copy(update={"search": rig.search.model_copy(update={"part_holds_n": None})})
    return (
        _with_part(still, None),
        replace(objects, objects=tuple(replace(item, holds_n=None) for item in objects.objects)),
    )


def _with_part(rig: RigFile, part: EmulatedPartConfig | None) -> RigFile:
    if rig.emulation is None:
        return rig
    return rig.model_copy(update={"emulation": rig.emulation.model_copy(update={"part": part})})


@dataclass(frozen=True, eq=False)
class Simulation:
    """Simulation that all runs of a study share. `halved`: an error (or the reach) that is half as large.

    `placed_within_mm`: how far from the middle of the workspace parts are put, None: as the rig file says.
    """

    rig: RigFile
    objects: ObjectsFile
    strategy: Strategy
    seed: int
    halved: ErrorSource | None = None
    placed_within_mm: float | None = None

    @property
    def within_mm(self) -> float:
        """Largest distance of a part's centre of area from the middle of the workspace."""
        return placement_radius_mm(self.rig) if self.placed_within_mm is None else self.placed_within_mm

    @cached_property
    def _catalogue(self) -> Catalogue:
        objects = self.objects.objects
        if self.halved is ErrorSource.TOLERANCE:
            objects = tuple(replace(item, tolerance_mm=item.tolerance_mm / 2) for item in objects)
        return prepare_catalogue(objects, map(finger_of, self.rig.fingers))

    @cached_property
    def _reach(self) -> Reach:
        reach = reach_of(self.rig)
        if self.halved is ErrorSource.POSITION:
            finer = [replace(item, position_bound_mm=item.position_bound_mm / 2) for item in reach.approaches]
            return replace(reach, approaches=tuple(finer))
        return _middle_half(reach) if self.halved is ErrorSource.REACH else reach

    @cached_property
    def _resolution(self) -> Resolution:
        found = resolution_of(self.rig)
        if self.halved is ErrorSource.POSITION:
            return replace(found, distance_mm=found.distance_mm / 2)
        if self.halved is ErrorSource.NORMAL:
            return replace(found, normal_half_rad=found.normal_half_rad / 2)
        return found

    @cached_property
    def _pushes(self) -> PushTables:
        return PushTables.of(self.rig, self._catalogue)

    def _chooser(self, number: int) -> GripChooser:
        tables, rng = {self._catalogue: self._pushes.stability}, strategy_rng(number)
        return GripChooser(self.rig, self._reach, self.strategy, rng, self._resolution, tables)

    @cached_property
    def _noise(self) -> tuple[ArrayNoise, ...]:
        return tuple(noise_of(self.rig, finger) for finger in self.rig.fingers)

    def run(self, number: int, variation: str = "") -> StudyRunOut:
        """Draw a part and where it lies, and identify it. `variation`: how this simulation is called."""
        rng = np.random.default_rng([self.seed, number])
        placement = draw_placement(self.objects, self.within_mm, rng, self.rig.workspace.radius_mm)
        watch = _RunRecorder((placement.model.name, placement.state.name))
        touches = self._touches(placement, rng)
        result = search_with(
            self._chooser(number),
            touches,
            self._catalogue,
            self._pushes,
            Observers(record=watch),
            lambda: touches.seconds or 0.0,
        )
        hypotheses = hypotheses_of(result)
        (lies,) = touches.placements
        truth = compare_answer(lies, hypotheses)
        best = hypotheses[0] if hypotheses else None
        return StudyRunOut(
            number=number,
            variation=variation,
            object=placement.model.name,
            state=placement.state.name,
            verdict=result.outcome,
            named_object=best.state.object_name if best else None,
            named_state=best.state.state.name if best else None,
            inside_bounds=truth.inside_bounds,
            position_error=truth.position_error_mm,
            position_bound=best.bounds.position_half_mm if best else None,
            orientation_bound=best.bounds.orientation_half_rad if best else None,
            moved=float(np.hypot(lies.x_mm - placement.x_mm, lies.y_mm - placement.y_mm)),
            grips=len(result.grips),
            touches=result.touches,
            left=tuple(sorted({(item.state.object_name, item.state.state.name) for item in hypotheses})),
            rivals=watch.rivals(),
            sticks_out=sticks_out_mm(self.rig, placement) > 0,
            grip_seconds=touches.seconds,
            fewest=self._fewest(watch, placement),
        )

    def _fewest(self, watch: "_RunRecorder", placement: Placement) -> int | None:
        """Touches up to the first that met the part, and those that any strategy needs beyond."""
        if watch.first is None:
            return None
        touches, recognition = watch.first
        goals = goals_of(self.rig)
        return min(
            (
                touches + fewest_touches(recognition, self._reach, self._resolution, goals, number)
                for number, item in enumerate(recognition.hypotheses)
                if (item.state.object_name, item.state.state.name)
                == (placement.model.name, placement.state.name)
            ),
            default=None,
        )

    def _touches(self, placement: Placement, rng: np.random.Generator) -> SimulatedTouches | PushingTouches:
        emulation = self.rig.emulation
        if emulation is None or motion_of(self.rig) is PartMotion.STILL:
            return SimulatedTouches([placement], self._resolution, rng)
        parts, tip_friction = _part(emulation.part, placement, rng)
        return PushingTouches(self.rig, [placement], parts, tip_friction, self._noise, rng, self._resolution)


def _part(
    config: EmulatedPartConfig | None, placement: Placement, rng: np.random.Generator
) -> tuple[Parts, float]:
    """A part that stands, and the friction at tips."""
    for draw in range(_MAX_DRAWS):
        (truth,) = draw_parts(config, [placement], int(rng.integers(2**31)))
        try:
            return parts_of([truth], [placement]), truth.tip_friction
        except InputError:
            if draw == _MAX_DRAWS - 1:
                raise
    raise AssertionError("unreachable")


def _middle_half(reach: Reach) -> Reach:
    """Half the aims of every finger at every angle of the stage: those in the middle."""
    kept: list[int] = []
    for angle in np.unique(reach.stage_rad).tolist():
        for finger in np.unique(reach.finger).tolist():
            own = reach.of_finger(finger, angle)
            kept += own[len(own) // 4 : len(own) - len(own) // 4]
    return reach.only(np.array(sorted(kept), dtype=np.int64))


class _RunRecorder:
    """After how many touches and grips each other state was ruled out; what the `first` ones left."""

    def __init__(self, truth: tuple[str, str]) -> None:
        self._truth = truth
        self._touches = self._grips = 0
        self._last: dict[tuple[str, str], tuple[int, int]] = {}
        self._made = 0
        self.first: tuple[int, Recognition] | None = None

    def __call__(self, event: Event) -> None:
        match event:
            case TouchEvent():
                touched = sum(touch.contact.touched for touch in event.touches)
                self._made += len(event.touches)
                self._touches += touched
                self._grips += touched > 0
            case RecognitionEvent(_, recognition):
                self.first = self.first or (self._made, recognition)
                for name in _names(recognition):
                    self._last[name] = self._touches, self._grips

    def rivals(self) -> tuple[RivalOut, ...]:
        """Rivals that lasted longest, with the touches after which they were still possible."""
        others = [(*lasted, name) for name, lasted in self._last.items() if name != self._truth]
        longest: Sequence[tuple[int, int, tuple[str, str]]] = sorted(others, reverse=True)[:_MAX_RIVALS]
        return tuple(
            RivalOut(object=name[0], state=name[1], touches=touches, grips=grips)
            for touches, grips, name in longest
        )


def _names(recognition: Recognition) -> set[tuple[str, str]]:
    """Names of the states that are left; hypotheses themselves would have to be bounded for it."""
    states = recognition.catalogue.states
    left = (states[k] for k in np.unique(recognition.interpretations.state).tolist())
    return {(item.object_name, item.state.name) for item in left}
