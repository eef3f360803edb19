"""Known heights: refuses objects whose sections are not known where fingers touch.

An object that was imported near some heights only has nothing at others, as far as its sections say. A finger
there would take it for free space, so such a pair is refused before anything is recognised or moved.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from palpate.config.objects_checks import heights_in_words
from palpate.errors import InputError, counted
from palpate.geometry import ObjectModel, State
from palpate.recognizer import Contact

__all__ = ["FingerAtHeight", "HasHeight", "check_known", "fingers_of"]


_NEAR_MM, _STEP_MM = 3.0, 0.01
"""How far a finger may be moved to where states are known, in what steps."""


class HasHeight(Protocol):
    """A finger: how it is called, and its tip's height above the support plane."""

    @property
    def name(self) -> str:
        """As in messages."""
        ...

    @property
    def height_mm(self) -> float:
        """Of the tip's middle."""
        ...


@dataclass(frozen=True)
class FingerAtHeight:
    """A finger of which only contacts are known."""

    name: str
    height_mm: float


def fingers_of(contacts: Iterable[Contact]) -> list[FingerAtHeight]:
    """The fingers that made contacts, once for each of their heights."""
    return list(dict.fromkeys(FingerAtHeight(item.name, item.finger.height_mm) for item in contacts))


def check_known(objects: Iterable[ObjectModel], fingers: Sequence[HasHeight]) -> None:
    """Raise InputError for the first state whose sections are not known at the height of some finger.

    It says at which height near that finger's all states are known, if there is one.
    """
    models = list(objects)
    unknown = [
        (model, state, finger)
        for model in models
        for state in model.states
        if (finger := next((item for item in fingers if not state.known_at(item.height_mm)), None))
    ]
    if not unknown:
        return
    model, state, finger = unknown[0]
    more = counted(len(unknown) - 1, "more state is", "more states are")
    also = f" ({more} not known where fingers are)" if len(unknown) > 1 else ""
    wanted = ",".join(f"{height:g}" for height in sorted({item.height_mm for item in fingers}))
    near = _known_near([state for item in models for state in item.states], finger.height_mm)
    other = "" if near is None else f", or set the finger to {near:g} mm, where all states are known"
    raise InputError(
        f'object "{model.name}", state "{state.name}" is known at heights '
        f"{heights_in_words(state.heights_mm or ())} only; finger {finger.name} is at "
        f"{finger.height_mm:g} mm{also}: import it again for heights {wanted}{other}"
    )


def _known_near(states: Sequence[State], height_mm: float) -> float | None:
    """The height nearest to another, to 0.01 mm, at which all states are known and some have sections."""
    steps = round(_NEAR_MM / _STEP_MM)
    for step in sorted(range(-steps, steps + 1), key=abs):
        height = round(height_mm + step * _STEP_MM, 2)
        if height > 0 and all(state.known_at(height) for state in states):
            return height if any(height < state.top_mm for state in states) else None
    return None
