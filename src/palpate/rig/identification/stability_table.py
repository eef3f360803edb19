"""Stabilities of the states of a catalogue against a rig's fingers, and which of them bounds do not cover."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palpate.base.geometry import Floats, Ints
from palpate.base.vocabulary import PushResponse
from palpate.config import RigFile
from palpate.recognizer import Catalogue, Recognition
from palpate.rig.contact_peak import expected_peak_n
from palpate.rig.identification.motion_bounds import MotionBounds
from palpate.rig.identification.stability import DIRECTIONS, FRICTION_MOST, RESERVE, Stability, stability_of

__all__ = ["NotBounded", "StabilityTable"]


@dataclass(frozen=True)
class NotBounded:
    """A state of an answer in which the part may have tipped or rolled, and why, in one line."""

    object_name: str
    state_name: str
    response: PushResponse
    why: str


@dataclass(frozen=True, eq=False)
class StabilityTable:
    """Stabilities of a catalogue's states on a rig, each computed when it is first asked for.

    `bounds`: those of the same run, whose supports are used; None: they are worked out again.
    """

    rig: RigFile
    catalogue: Catalogue
    bounds: MotionBounds | None = None

    def of(self, state: int) -> Stability:
        """Stability of the state of an index."""
        return self._of(state)[0]

    def safe_heights_mm(self, states: Ints) -> Floats:
        """As `palpate.recognizer.PushLimits` has it."""
        result: Floats = np.array([self._of(state)[1] for state in states.tolist()]).reshape(-1, DIRECTIONS)
        return result

    def slide_shares(self, states: Ints) -> Floats:
        """As `palpate.recognizer.PushLimits` has it."""
        return self._slide_shares[states]

    @cached_property
    def _slide_shares(self) -> Floats:
        bounds = self.bounds or MotionBounds(self.rig, self.catalogue)
        force_n = expected_peak_n(self.rig, self.rig.closing.touch_speed_mm_s)
        slide = force_n / bounds.supports.holds_n
        return np.column_stack([slide, slide * bounds.supports.turn_rad_per_mm])

    def not_bounded(self, recognition: Recognition | None, pushed_n: float) -> tuple[NotBounded, ...]:
        """States that are left in which the part may have tipped or rolled, each once, the heaviest first.

        `pushed_n`: the largest force that fingers together have put on it.
        """
        found = []
        hypotheses = () if recognition is None else recognition.hypotheses
        for index in dict.fromkeys(item.state_index for item in hypotheses):
            item, stability = self.catalogue.states[index], self.of(index)
            if stability.response is not PushResponse.SLIDES and not self._stood(index, pushed_n):
                names = item.object_name, item.state.name
                found.append(NotBounded(*names, stability.response, stability.why))
        return tuple(found)

    def _stood(self, state: int, pushed_n: float) -> bool:
        """Whether a state has not tipped: a part that holds F weighs F / μ at least."""
        stability, item = self.of(state), self.catalogue.states[state]
        holds = item.holds_n or self.rig.search.part_holds_n
        if holds is None or stability.response is PushResponse.MAY_ROLL:
            return False
        weight = holds / FRICTION_MOST
        return pushed_n * stability.height_mm * RESERVE <= weight * stability.margin_mm

    @cached_property
    def _found(self) -> dict[int, tuple[Stability, Floats]]:
        return {}

    def _of(self, state: int) -> tuple[Stability, Floats]:
        if state not in self._found:
            item = self.catalogue.states[state]
            spans = [finger.span_mm for finger in self.rig.fingers]
            stability = stability_of(item.state, item.tolerance_mm, spans)
            self._found[state] = stability, stability.safe_heights_mm()
        return self._found[state]
