"""Simulated touches of a part that lies still: straight ways against its outline, without devices.

A thousand identifications in the time of a few on emulated ones.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely

from palpate.drivers.emulators.part import IN_PLACE
from palpate.recognizer import FingerApproach, Resolution
from palpate.rig.emulated.scene import Placement, shape_of
from palpate.rig.motion.guarded_approach import GripPhase, Touch
from palpate.rig.study.mismeasurement import FingerErrors

__all__ = ["PlacedShapes", "SimulatedTouches"]


@dataclass(eq=False)
class PlacedShapes:
    """Shape of a part in W, as it was put, beside every tip that is asked for."""

    placement: Placement
    _found: dict[tuple[float, float], shapely.Geometry] = field(default_factory=dict)

    def within(self, span_mm: tuple[float, float]) -> shapely.Geometry:
        """Between a tip's ends at some heights (mm), prepared for distances."""
        if span_mm not in self._found:
            sections = self.placement.state.sections_within(span_mm)
            shape = shapely.union_all([shape_of(self.placement, item) for item in sections])
            shapely.prepare(shape)
            self._found[span_mm] = shape
        return self._found[span_mm]


class SimulatedTouches:
    """Carries out grips on a part, as `search` has them carried out.

    A touch declares the rig's `resolution`; its place and its normal are off by less than that.
    """

    def __init__(self, placement: Placement, resolution: Resolution, rng: np.random.Generator) -> None:
        self.placement = placement
        self.seconds: float | None = None  # no time passes
        self._shapes, self._errors = PlacedShapes(placement), FingerErrors(resolution, rng)

    def __call__(
        self, grip: Sequence[FingerApproach], tell: Callable[[GripPhase], None] | None = None
    ) -> list[Touch]:
        """What the fingers of a grip feel."""
        del tell
        return [self._touch(approach) for approach in grip]

    def _touch(self, approach: FingerApproach) -> Touch:
        error = self._errors.draw(approach)
        shape, far = self._shapes.within(approach.finger.span_mm), approach.travel_mm
        contact = error.contact(approach, shape, IN_PLACE, far) or error.miss(approach, far)
        return Touch(approach.finger_index, contact, None, (math.nan, math.nan))
