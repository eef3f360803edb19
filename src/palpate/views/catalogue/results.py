"""Pairs of twins and separating heights as values of the JSON results."""

from collections.abc import Sequence

from palpate.config.objects_result import (
    PairOut,
    RigHeightOut,
    RigHeightsOut,
    SeparatingOut,
    StateNameOut,
    UnknownHeightOut,
)
from palpate.rig.catalogue.finger_model import RigFingers
from palpate.rig.catalogue.section_stack import StateSections
from palpate.rig.catalogue.separating_heights import SeparatingHeights
from palpate.rig.catalogue.twins import Pair

__all__ = ["name_out", "not_known_out", "pair_out", "rig_out", "separating_out"]


def rig_out(fingers: RigFingers, *, shipped: bool) -> RigHeightsOut:
    """The rig's heights."""
    return RigHeightsOut(
        name=fingers.rig_name,
        shipped=shipped,
        heights=tuple(RigHeightOut.of(at, tip_shape=at.shape) for at in fingers.at),
        contact_bound_mm=fingers.bound_mm,
    )


def name_out(state: StateSections) -> StateNameOut:
    """A state by its names."""
    return StateNameOut(object=state.object_name, state=state.state.name)


def pair_out(pair: Pair) -> PairOut:
    """A pair without its heights."""
    return PairOut.of(
        pair,
        first=name_out(pair.first.state),
        second=name_out(pair.second.state),
        likeness=pair.likeness.value,
        compared_mm=tuple(at.height_mm for at in pair.compared),
    )


def separating_out(pair: Pair, found: SeparatingHeights) -> SeparatingOut:
    """A pair with the heights that would tell its states apart."""
    return SeparatingOut.of(found, **pair_out(pair).model_dump(), separating_mm=found.heights_mm)


def not_known_out(states: Sequence[StateSections], fingers: RigFingers) -> tuple[UnknownHeightOut, ...]:
    """States that are not known at the height of some finger."""
    found = []
    for state in states:
        heights = tuple(at.height_mm for at in fingers.at if not state.state.known_within(at.span_mm))
        if heights:
            found.append(UnknownHeightOut(state=name_out(state), heights_mm=heights))
    return tuple(found)
