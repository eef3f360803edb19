"""Reachability of a catalogue: states that the fingers of a rig cannot touch, or only some of them.

Looks at heights and sizes only, never at poses, so it costs next to nothing before a run.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

import shapely

from palpate.base.geometry import ObjectModel, State
from palpate.config import ArmFingerConfig, RigFile
from palpate.rig.catalogue.finger_model import contact_bound_mm
from palpate.rig.catalogue.section_stack import region_within

__all__ = ["HOPELESS", "OF_SECTION", "Finding", "Trouble", "findings_of"]

_SCALES = (1000.0, 25.4, 1 / 25.4, 1 / 1000)  # metres, inches, and both converted once too often
_TOLERANCE_MM = 1e-6


class Trouble(Enum):
    """Why a state cannot be felt, or not as it should; the first that applies."""

    MISSED = "nothing at any finger's height"
    LINKS = "an arm's links run into it"
    OVERSIZED = "a disc larger than the workspace fits into it"
    STICKS_OUT = "does not fit into the workspace in any pose"
    TINY = "smaller than two contacts may be off by"
    SOME_FINGERS = "nothing at the heights of some fingers"


HOPELESS = frozenset({Trouble.MISSED, Trouble.LINKS, Trouble.OVERSIZED})
"""Fingers pass such a state by, or run into it. With other troubles a state may still be identified."""

OF_SECTION = frozenset({Trouble.OVERSIZED, Trouble.STICKS_OUT, Trouble.TINY})
"""Troubles with how large a state is at the fingers' heights, rather than with how high it is."""


@dataclass(frozen=True)
class Finding:
    """What is wrong with one state of one object.

    `size_mm`: for a trouble `OF_SECTION` the diameter of the smallest circle round its sections at the
    fingers' heights, else its height. `fingers`: those that may feel it. `scale`: none of the object's states
    can be used, but with coordinates multiplied by this some could; None if no usual unit does that.
    """

    object_name: str
    state_name: str
    trouble: Trouble
    size_mm: float
    fingers: tuple[str, ...] = ()
    scale: float | None = None


def findings_of(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[Finding, ...]:
    """At most one finding a state, in the catalogue's order; none for states that the rig can feel.

    A finger along whose tip a state's sections are not known (`State.known_within`) counts as one that feels
    it.
    """
    bench = _Bench(rig)
    found = []
    for model in models:
        lying = [_Lying(bench, state) for state in model.states]
        scale = None if any(item.is_usable for item in lying) else _plausible_scale(bench, model)
        found += [
            Finding(model.name, state.name, item.trouble, item.size_mm, item.fingers, scale)
            for state, item in zip(model.states, lying, strict=True)
            if item.trouble is not None
        ]
    return tuple(found)


class _Bench:
    """What of a rig decides which states it can feel; lengths in mm."""

    def __init__(self, rig: RigFile) -> None:
        self.fingers = [(finger.name, finger.span_mm) for finger in rig.fingers]
        self.across = 2 * rig.workspace.radius_mm
        self.unsure = 2 * (contact_bound_mm(rig) or 0.0)
        links = [arm.links.links_height_mm for arm in rig.fingers if isinstance(arm, ArmFingerConfig)]
        self.links = min(links, default=math.inf)


class _Lying:
    """A state with all of its coordinates multiplied by a scale, as a rig's fingers meet it."""

    def __init__(self, bench: _Bench, state: State, scale: float = 1.0) -> None:
        self._bench, self._scale = bench, scale
        self._top_mm = scale * state.top_mm
        spans = {span: (span[0] / scale, span[1] / scale) for _, span in bench.fingers}
        regions = {span: region_within(state, scaled) for span, scaled in spans.items()}
        self._fingers = tuple(
            name
            for name, span in bench.fingers
            if not regions[span].is_empty or not state.known_within(spans[span])
        )
        self._met = shapely.union_all(list(regions.values()))
        self._across_mm = 2 * scale * float(shapely.minimum_bounding_radius(self._met))

    @property
    def is_usable(self) -> bool:
        return self.trouble in (None, Trouble.SOME_FINGERS)

    @cached_property
    def trouble(self) -> Trouble | None:
        if not self._fingers:
            return Trouble.MISSED
        if self._top_mm >= self._bench.links:
            return Trouble.LINKS
        if self._across_mm > self._bench.across + _TOLERANCE_MM:
            return Trouble.OVERSIZED if self._holds_disc(self._bench.across) else Trouble.STICKS_OUT
        if not self._met.is_empty and self._across_mm < self._bench.unsure:
            return Trouble.TINY
        return Trouble.SOME_FINGERS if len(self._fingers) < len(self._bench.fingers) else None

    @property
    def size_mm(self) -> float:
        return self._across_mm if self.trouble in OF_SECTION else self._top_mm

    @property
    def fingers(self) -> tuple[str, ...]:
        return self._fingers

    def _holds_disc(self, across_mm: float) -> bool:
        return not self._met.buffer(-across_mm / 2 / self._scale).is_empty


def _plausible_scale(bench: _Bench, model: ObjectModel) -> float | None:
    """Of the usual mistakes with units, the one that would explain why no state can be felt.

    None is guessed of what is known near some heights only: imports have said their units.
    """
    if any(state.heights_mm is not None for state in model.states):
        return None
    for scale in _SCALES:
        if any(_Lying(bench, state, scale).is_usable for state in model.states):
            return scale
    return None
