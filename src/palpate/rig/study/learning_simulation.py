"""Simulated learning of a part, determined entirely by its number and the study's seed, judged by shapely.

A part of a catalogue is learned as if nobody had drawn it: by the search of `learn`, with simulated touches.
The catalogue is used for the truth alone.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.base.errors import InputError
from palpate.base.geometry import State
from palpate.config import ObjectsFile, RigFile
from palpate.config.learning_study_result import LearningRunOut, LearningStepOut, ToleranceCostOut
from palpate.recognizer import Finger
from palpate.rig.catalogue.section_stack import region_within
from palpate.rig.emulated.ground_truth import sticks_out_mm
from palpate.rig.emulated.scene import Placement
from palpate.rig.fingers import resolution_of
from palpate.rig.learning.learning_search import LearningSearch
from palpate.rig.reach.approaches import Reach
from palpate.rig.study.simulated_touches import SimulatedTouches
from palpate.rig.study.simulation import draw_placement, placement_radius_mm

_TOLERANCES_MM = (6.0, 4.0, 3.0, 2.0, 1.5, 1.0)  # of which the cost is summed up
_MAX_DRAWS = 100  # of a part and its place, until it lies inside the workspace
_CHORDS_PER_QUARTER = 128
_ROUNDING_MM = 1e-3  # more than circles of such chords are off


def learnable_objects(objects: ObjectsFile, fingers: Sequence[Finger]) -> tuple[ObjectsFile, tuple[str, ...]]:
    """The objects without states that are not one piece along all tips, or not known there; these by name."""
    kept, names = [], []
    for model in objects.objects:
        states = tuple(state for state in model.states if _is_learnable(state, fingers))
        names += [f"{model.name}, {state.name}" for state in model.states if state not in states]
        if states:
            kept.append(replace(model, states=states))
    return replace(objects, objects=tuple(kept)), tuple(names)


def _is_learnable(state: State, fingers: Sequence[Finger]) -> bool:
    spans = [finger.span_mm for finger in fingers]
    return all(
        state.known_within(span) and isinstance(region_within(state, span), shapely.Polygon) for span in spans
    )


@dataclass(frozen=True, eq=False)
class LearningSimulation:
    """Simulation that all runs of a study share. `objects`: those that can be learned.

    `height_mm`, `tolerance_mm`, `max_seconds`: as of `Rig.learn`; `reach`: approaches for learning.
    """

    rig: RigFile
    reach: Reach
    objects: ObjectsFile
    height_mm: float
    tolerance_mm: float
    max_seconds: float
    seed: int

    def run(self, number: int) -> LearningRunOut:
        """Draw a part and where it lies, and learn it. Raises InputError if none fits into the workspace."""
        rng = np.random.default_rng([self.seed, number])
        placement = self._draw(rng)
        touches = SimulatedTouches([placement], resolution_of(self.rig), rng)
        search = LearningSearch(self.rig, self.reach, self.height_mm, self.tolerance_mm)
        grips, touched, seconds, falling = 0, 0, 0.0, list[LearningStepOut]()
        while self._goes_on(search, seconds) and (grip := search.next()):
            contacts = [item.contact for item in touches(grip)]
            search.take(contacts)
            seconds += self.reach.grip_seconds(grip, [item.travel_mm for item in contacts])
            grips, touched = grips + 1, touched + sum(item.touched for item in contacts)
            if search.tolerance_mm < min((item.tolerance for item in falling), default=math.inf):
                falling.append(
                    LearningStepOut(touches=touched, rig_seconds=seconds, tolerance=search.tolerance_mm)
                )
        return LearningRunOut(
            number=number,
            object=placement.model.name,
            state=placement.state.name,
            grips=grips,
            touches=touched,
            rig_seconds=seconds,
            tolerance=search.tolerance_mm if math.isfinite(search.tolerance_mm) else None,
            goal_met=search.is_done,
            inside_bounds=is_inside_bounds(search, placement),
            falling=tuple(falling),
        )

    def _draw(self, rng: np.random.Generator) -> Placement:
        within_mm = placement_radius_mm(self.rig)
        for _ in range(_MAX_DRAWS):
            drawn = draw_placement(self.objects, within_mm, rng, self.rig.workspace.radius_mm)
            if not sticks_out_mm(self.rig, drawn):
                return drawn
        raise InputError(
            f'no part fits into the workspace of rig "{self.rig.name}", with its centre within {within_mm:g} '
            "mm of the middle"
        )

    def _goes_on(self, search: LearningSearch, seconds: float) -> bool:
        return seconds <= self.max_seconds and not search.is_done and search.holds_together


def is_inside_bounds(search: LearningSearch, lies: Placement) -> bool:
    """Return whether what tips can feel of a part is as the search says; by shapely alone.

    The inner bound is within the closing of the true section by the tip's radius, the section within the
    outer bound, and the closing's outline within the tolerance of the outline of the model.
    """
    for finger, felt in search.felt.items():
        section = lies.region_within(finger.span_mm)
        true = _felt_shape(section, finger.tip_radius_mm)
        model = search.outlines.get(finger)
        if not (
            felt.inner.difference(true.buffer(_ROUNDING_MM)).is_empty
            and section.difference(felt.outer.buffer(_ROUNDING_MM)).is_empty
        ):
            return False
        if model is not None:
            band = shapely.LinearRing(model.points_mm).buffer(
                model.tolerance_mm + _ROUNDING_MM, _CHORDS_PER_QUARTER
            )
            if not true.exterior.difference(band).is_empty:
                return False
    return search.holds_together


def _felt_shape(section: shapely.Geometry, radius_mm: float) -> shapely.Polygon:
    """All that no disc of a radius, coming from outside, can cover without meeting a section."""
    closing = section.buffer(radius_mm, _CHORDS_PER_QUARTER).buffer(-radius_mm, _CHORDS_PER_QUARTER)
    return shapely.Polygon(max(shapely.get_parts(closing), key=shapely.area).exterior)


def tolerance_costs(runs: Sequence[LearningRunOut], goal_mm: float) -> tuple[ToleranceCostOut, ...]:
    """Cost of each tolerance down to the one that was asked for, coarse ones first."""
    finest = sorted({item for item in _TOLERANCES_MM if item > goal_mm} | {goal_mm}, reverse=True)
    return tuple(_cost_of(item, runs) for item in finest)


def _cost_of(tolerance_mm: float, runs: Sequence[LearningRunOut]) -> ToleranceCostOut:
    firsts = [
        first
        for run in runs
        if (first := next((item for item in run.falling if item.tolerance <= tolerance_mm), None)) is not None
    ]
    return ToleranceCostOut(
        tolerance=tolerance_mm,
        runs=len(firsts),
        touches=float(np.median([item.touches for item in firsts])) if firsts else None,
        rig_seconds=float(np.median([item.rig_seconds for item in firsts])) if firsts else None,
    )
