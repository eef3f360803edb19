"""Known heights: refuses objects whose sections are not known where fingers touch.

An object that was imported near some heights only has nothing at others, as far as its sections say. A finger
there would take it for free space, so such a pair is refused before anything is recognised or moved.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from palpate.base.errors import InputError, counted
from palpate.base.geometry import ObjectModel, State
from palpate.config.objects_checks import heights_in_words
from palpate.recognizer import Contact, Finger

__all__ = ["FingerAtHeight", "HasHeight", "check_known", "fingers_of", "span_text"]


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

    @property
    def span_mm(self) -> tuple[float, float]:
        """Of the tip's lower and upper end."""
        ...


@dataclass(frozen=True)
class FingerAtHeight:
    """A finger of which only contacts are known."""

    name: str
    height_mm: float
    half_length_mm: float = 0.0

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights (from, to) of the tip's lower and upper end."""
        return self.height_mm - self.half_length_mm, self.height_mm + self.half_length_mm


def fingers_of(contacts: Iterable[Contact]) -> list[FingerAtHeight]:
    """The fingers that made contacts, once for each of their heights."""
    return list(
        dict.fromkeys(
            FingerAtHeight(item.name, item.finger.height_mm, _half_height_mm(item.finger))
            for item in contacts
        )
    )


def _half_height_mm(finger: Finger) -> float:
    return finger.tip_radius_mm if finger.is_ball else finger.half_length_mm


def check_known(objects: Iterable[ObjectModel], fingers: Sequence[HasHeight]) -> None:
    """Raise InputError for the first state whose sections are not known all along some finger's tip.

    It says at which height near that finger's all states are known, if there is one.
    """
    models = list(objects)
    unknown = [
        (model, state, finger)
        for model in models
        for state in model.states
        if (finger := next((item for item in fingers if not state.known_within(item.span_mm)), None))
    ]
    if not unknown:
        return
    model, state, finger = unknown[0]
    more = counted(len(unknown) - 1, "more state is", "more states are")
    also = f" ({more} not known where fingers are)" if len(unknown) > 1 else ""
    wanted = ",".join(map(span_text, sorted({item.span_mm for item in fingers})))
    near = _known_near([state for item in models for state in item.states], finger)
    other = "" if near is None else f", or set the finger to {near:g} mm, where all states are known"
    if finger.span_mm[0] < finger.span_mm[1] and near is None:
        other = ", with a greater tolerance if nearly level walls leave gaps there"
    raise InputError(
        f'object "{model.name}", state "{state.name}" is known at heights '
        f"{heights_in_words(state.heights_mm or ())} only; finger {finger.name} is at "
        f"{_place(finger)}{also}: import it again for heights {wanted}{other}"
    )


def span_text(span_mm: tuple[float, float]) -> str:
    """A height, or a span of heights, as an import is asked for it: "12" or "5-15"."""
    low, high = span_mm
    return f"{low:g}" if low == high else f"{low:g}-{high:g}"


def _place(finger: HasHeight) -> str:
    """Such as "10 mm (its tip from 5 to 15 mm)"."""
    low, high = finger.span_mm
    along = "" if low == high else f" (its tip from {low:g} to {high:g} mm)"
    return f"{finger.height_mm:g} mm{along}"


def _known_near(states: Sequence[State], finger: HasHeight) -> float | None:
    """The height nearest to a finger's, to 0.01 mm, at which all states are known and some have sections."""
    steps, half = round(_NEAR_MM / _STEP_MM), (finger.span_mm[1] - finger.span_mm[0]) / 2
    for step in sorted(range(-steps, steps + 1), key=abs):
        height = round(finger.height_mm + step * _STEP_MM, 2)
        span = (height - half, height + half)
        if height > 0 and span[0] >= 0 and all(state.known_within(span) for state in states):
            return height if any(height < state.top_mm for state in states) else None
    return None
