"""One simulated identification of a study: its number and the study's seed decide all of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from palpate.config import ObjectsFile, RigFile
from palpate.config.study_result import RivalOut, StudyRunOut
from palpate.recognizer import Catalogue, Recognition
from palpate.rig.catalogue.preparation import prepared_catalogue
from palpate.rig.conversion import finger_of, resolution_of
from palpate.rig.emulated.answer_error import compare
from palpate.rig.emulated.scene import draw_placement
from palpate.rig.identification.loop import search
from palpate.rig.identification.observers import Event, Observers, RecognitionEvent, TouchEvent
from palpate.rig.identification.result import hypotheses_of
from palpate.rig.reach.approaches import Reach, reach_of
from palpate.rig.study.simulated_touches import SimulatedTouches
from palpate.vocabulary import Strategy

__all__ = ["Simulation", "held_still"]

_RIVALS_KEPT = 5  # of a run: those that lasted longest
_PLACED_SHARE = (
    0.16  # of the workspace's radius, where a rig file does not say how far from the middle parts lie
)


def held_still(rig: RigFile, objects: ObjectsFile) -> tuple[RigFile, ObjectsFile]:
    """The same rig and catalogue with parts that are held: nothing is declared of how they slide."""
    still = rig.model_copy(update={"search": rig.search.model_copy(update={"part_holds_n": None})})
    return still, replace(objects, objects=tuple(replace(item, holds_n=None) for item in objects.objects))


@dataclass(frozen=True, eq=False)
class Simulation:
    """What all runs of a study share."""

    rig: RigFile
    objects: ObjectsFile
    strategy: Strategy
    seed: int

    @cached_property
    def _catalogue(self) -> Catalogue:
        return prepared_catalogue(self.objects.objects, map(finger_of, self.rig.fingers))

    @cached_property
    def _reach(self) -> Reach:
        return reach_of(self.rig)

    def run(self, number: int) -> StudyRunOut:
        """Draw a part and where it lies, and identify it."""
        rng = np.random.default_rng([self.seed, number])
        placement = draw_placement(self.objects, self._placed_within_mm(), rng)
        watch = _Watch((placement.model.name, placement.state.name))
        touches = SimulatedTouches(placement, resolution_of(self.rig), rng)
        result = search(
            self.rig,
            self._reach,
            touches,
            self._catalogue,
            Observers(record=watch),
            strategy=self.strategy,
            seed=number,
        )
        hypotheses = hypotheses_of(result)
        truth = compare(placement, hypotheses)
        return StudyRunOut(
            number=number,
            object=placement.model.name,
            state=placement.state.name,
            verdict=result.outcome,
            named_object=hypotheses[0].state.object_name if hypotheses else None,
            named_state=hypotheses[0].state.state.name if hypotheses else None,
            inside_bounds=truth.inside_bounds,
            position_error=truth.position_error_mm,
            position_bound=hypotheses[0].bounds.position_half_mm if hypotheses else None,
            grips=len(result.grips),
            touches=result.touches,
            left=tuple(sorted({(item.state.object_name, item.state.state.name) for item in hypotheses})),
            rivals=watch.rivals(),
        )

    def _placed_within_mm(self) -> float:
        emulation = self.rig.emulation
        radius = self.rig.workspace.radius_mm
        return _PLACED_SHARE * radius if emulation is None else emulation.placement_radius_mm


class _Watch:
    """After how many touches each other state was ruled out."""

    def __init__(self, truth: tuple[str, str]) -> None:
        self._truth = truth
        self._touches = 0
        self._last: dict[tuple[str, str], int] = {}

    def __call__(self, event: Event) -> None:
        match event:
            case TouchEvent():
                self._touches += sum(touch.contact.touched for touch in event.touches)
            case RecognitionEvent(_, recognition):
                for name in _names(recognition):
                    self._last[name] = self._touches

    def rivals(self) -> tuple[RivalOut, ...]:
        """Those that lasted longest, with the touches after which they were still possible."""
        others = [(touches, name) for name, touches in self._last.items() if name != self._truth]
        longest: Sequence[tuple[int, tuple[str, str]]] = sorted(others, reverse=True)[:_RIVALS_KEPT]
        return tuple(RivalOut(object=name[0], state=name[1], touches=touches) for touches, name in longest)


def _names(recognition: Recognition) -> set[tuple[str, str]]:
    return {(item.state.object_name, item.state.state.name) for item in recognition.hypotheses}
