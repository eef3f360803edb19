"""Fingers of a rig as used to compare parts: heights, tip radii and the bound on contacts.

States whose sections are not known where fingers touch are left out before anything is recognised or moved:
one that was imported near some heights only has nothing at others, as far as its sections say; a finger there
would take it for free space.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self

from palpate.base.errors import InputError, join_words, quantity
from palpate.base.geometry import ObjectModel, State
from palpate.base.tips import Tip, TipShape
from palpate.config import FingerConfig, RigFile
from palpate.config.objects_checks import heights_in_words
from palpate.config.recognition_results import UnknownStateOut
from palpate.recognizer import Contact
from palpate.rig.conversion import tip_bound_mm
from palpate.rig.fingers import Stage, dent_allowance_mm
from palpate.rig.mechanisms import mechanism_of


@dataclass(frozen=True)
class AtHeight:
    """The fingers at one height over the support plane; `tip_radius_mm` is that of the slimmest.

    Their tips reach `half_length_mm` above it and below: of tips of other lengths there is another value. So
    there is of balls of another radius, and of pads, each of which counts as a disc as wide as it is.
    """

    height_mm: float
    tip_radius_mm: float
    fingers: tuple[str, ...]
    half_length_mm: float = 0.0
    shape: TipShape = TipShape.CYLINDER

    @property
    def tip(self) -> Tip:
        """Facts of tips of their shape."""
        return self.shape.tip

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights (from, to) of the tips' lower and upper ends."""
        return self.height_mm - self.half_length_mm, self.height_mm + self.half_length_mm


@dataclass(frozen=True)
class RigFingers:
    """Fingers by height, ascending. `bound_mm`: a contact is nowhere further off than this."""

    rig_name: str
    at: tuple[AtHeight, ...]
    bound_mm: float

    @property
    def slimmest_mm(self) -> float:
        """Radius of the slimmest tip of the rig."""
        return min(item.tip_radius_mm for item in self.at)

    @property
    def any_upright(self) -> bool:
        """True if some tip of the rig is upright."""
        return any(item.tip.is_upright for item in self.at)

    def another(self, height_mm: float) -> AtHeight:
        """One more finger at a height, with the slimmest, shortest upright tip, or else the smallest ball."""
        kinds = [item for item in self.at if item.tip.is_upright == self.any_upright]
        radius, half = min(item.tip_radius_mm for item in kinds), min(item.half_length_mm for item in kinds)
        shape = TipShape.CYLINDER if self.any_upright else kinds[0].shape
        return AtHeight(height_mm, radius, ("",), half, shape)


def rig_fingers(rig: RigFile) -> RigFingers:
    """The rig's fingers, with the largest bound of a contact that the rig makes about its middle.

    Raises InputError if no finger gets to the middle: there is no such bound then.
    """
    rig.require("identify")
    bound_mm = contact_bound_mm(rig)
    if bound_mm is None:
        raise InputError(
            f"rig {rig.name}: no finger gets to the middle of the table (0, 0), so how far off contacts may "
            "be is not known; check base_mm and the fingers' ranges"
        )
    return RigFingers(rig.name, at_heights(rig), bound_mm)


def contact_bound_mm(rig: RigFile) -> float | None:
    """Largest bound of a contact about the middle of the table; None if no finger gets there."""
    bounds = [_bound_mm(finger, rig) for finger in rig.fingers]
    return max((bound for bound in bounds if math.isfinite(bound)), default=None)


def at_heights(rig: RigFile) -> tuple[AtHeight, ...]:
    """The rig's fingers by height, ascending."""
    alike: dict[tuple[float, float, TipShape], list[FingerConfig]] = {}
    for finger in rig.fingers:
        key = finger.height_mm, finger.tip.half_height_mm, finger.tip.shape
        alike.setdefault(key, []).append(finger)
    at = []
    for (height, half, shape), here in sorted(alike.items(), key=lambda item: item[0]):
        slimmest = min(finger.tip.radius_mm for finger in here)
        at.append(AtHeight(height, slimmest, tuple(finger.name for finger in here), half, shape))
    return tuple(at)


def finger_heights_text(at: Sequence[AtHeight]) -> str:
    """Heights in words, such as "10 mm (f1, f2) and 25 mm (f3)"."""
    words = [f"{item.height_mm:g} mm ({', '.join(item.fingers)})" for item in at]
    return join_words(words)


def _bound_mm(finger: FingerConfig, rig: RigFile) -> float:
    """Bound of a contact in the middle of the table, of all that adds to it; infinite out of reach."""
    own = mechanism_of(finger).middle_bound_mm + Stage.of(rig).planned_turn(0.0).position_bound_mm((0.0, 0.0))
    return own + dent_allowance_mm(finger, rig.closing) + tip_bound_mm(finger)


_SEARCH_SPAN_MM, _SEARCH_STEP_MM = 3.0, 0.01
"""How far a finger may be moved to where states are known, in what steps."""


class HasHeight(Protocol):
    """A finger: how it is called, and its tip's height above the support plane."""

    @property
    def name(self) -> str:
        """Name in messages."""
        ...

    @property
    def height_mm(self) -> float:
        """Height of the tip's middle."""
        ...

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights of the tip's lower and upper end."""
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
            FingerAtHeight(item.name, item.finger.height_mm, item.finger.half_height_mm) for item in contacts
        )
    )


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
    more = quantity(len(unknown) - 1, "more state is", "more states are")
    also = f" ({more} not known where fingers are)" if len(unknown) > 1 else ""
    wanted = ",".join(map(_span_text, sorted({item.span_mm for item in fingers})))
    near = _known_near([state for item in models for state in item.states], finger)
    other = "" if near is None else f", or set the finger to {near:g} mm, where all states are known"
    if finger.span_mm[0] < finger.span_mm[1] and near is None:
        other = ", with a greater tolerance if nearly level walls leave gaps there"
    raise InputError(
        f'object "{model.name}", state "{state.name}" is known at heights '
        f"{heights_in_words(state.heights_mm or ())} only; finger {finger.name} is at "
        f"{_place(finger)}{also}: import it again for heights {wanted}{other}"
    )


_MAX_STATES_SHOWN = 5
_BESIDE_MM = 0.5
"""An import for a height gives sections within so much of it, where walls are not too nearly level."""


@dataclass(frozen=True)
class KnownObjects:
    """Objects with those states alone that are known all along fingers' tips; `left_out`: the others.

    A part in a state that is left out is not recognised, as the `notice` says in one line, if there are any.
    """

    objects: tuple[ObjectModel, ...]
    left_out: tuple[UnknownStateOut, ...] = ()
    notice: str | None = None

    @classmethod
    def of(cls, objects: Sequence[ObjectModel], fingers: Sequence[HasHeight]) -> Self:
        """Raises InputError as `check_known` does if no state is left."""
        kept: list[ObjectModel] = []
        lost: list[UnknownStateOut] = []
        is_known_beside = True
        for model in objects:
            known = [all(state.known_within(item.span_mm) for item in fingers) for state in model.states]
            pairs = list(zip(model.states, known, strict=True))
            lost += [
                UnknownStateOut(object=model.name, state=state.name, probability=state.probability)
                for state, is_known in pairs
                if not is_known
            ]
            is_known_beside &= all(is_known or _is_known_beside(state, fingers) for state, is_known in pairs)
            if all(known):
                kept.append(model)
            elif any(known):
                kept.append(replace(model, states=tuple(state for state, is_known in pairs if is_known)))
        if not lost:
            return cls(tuple(objects))
        if not kept:
            check_known(objects, fingers)
        words = [f"{item.object}, {item.state}{_share_text(item)}" for item in lost[:_MAX_STATES_SHOWN]]
        more = len(lost) - len(words)
        rest = f" and {quantity(more, 'more state', 'more states')}" if more > 0 else ""
        wanted = ",".join(map(_span_text, sorted({item.span_mm for item in fingers})))
        advice = (
            "their walls are too nearly level just there: have fingers higher or lower"
            if is_known_beside
            else f"import them again for heights {wanted}"
        )
        return cls(
            tuple(kept),
            tuple(lost),
            f"left out, as they are not known where fingers are: {'; '.join(words)}{rest}; parts that rest "
            f"so are not recognised; {advice} to have them",
        )


def _is_known_beside(state: State, fingers: Sequence[HasHeight]) -> bool:
    """True of a state that is known next to every finger: it was imported for these heights."""
    return all(
        any(
            low - _BESIDE_MM <= finger.span_mm[0] and finger.span_mm[1] <= high + _BESIDE_MM
            for low, high in state.heights_mm or ()
        )
        for finger in fingers
    )


def _share_text(state: UnknownStateOut) -> str:
    return "" if state.probability is None else f" ({100 * state.probability:.2g} % of cases)"


def _span_text(span_mm: tuple[float, float]) -> str:
    """A height, or a span of heights, as an import is asked for it: "12" or "5-15"."""
    low, high = span_mm
    return f"{low:g}" if low == high else f"{low:g}-{high:g}"


def _place(finger: HasHeight) -> str:
    """Place in words, such as "10 mm (its tip from 5 to 15 mm)"."""
    low, high = finger.span_mm
    along = "" if low == high else f" (its tip from {low:g} to {high:g} mm)"
    return f"{finger.height_mm:g} mm{along}"


def _known_near(states: Sequence[State], finger: HasHeight) -> float | None:
    """The height nearest to a finger's, to 0.01 mm, at which all states are known and some have sections."""
    steps, half = round(_SEARCH_SPAN_MM / _SEARCH_STEP_MM), (finger.span_mm[1] - finger.span_mm[0]) / 2
    for step in sorted(range(-steps, steps + 1), key=abs):
        height = round(finger.height_mm + step * _SEARCH_STEP_MM, 2)
        span = (height - half, height + half)
        if height > 0 and span[0] >= 0 and all(state.known_within(span) for state in states):
            return height if any(height < state.top_mm for state in states) else None
    return None
