"""How a solid rests and what fingers meet then: an import's geometry, state by state.

Between `cad` and `importing`. Stable states that are the same but for a turn about the vertical become one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from palpate.cad.as_drawn import as_drawn
from palpate.cad.merging import MergedState, merged
from palpate.cad.sections import sections_of
from palpate.cad.stable import LeftOut, stable_states
from palpate.cad.values import CrossSection, Solid, StableState
from palpate.config.import_result import ImportedStateOut, LeftOutOut
from palpate.config.objects_text import StateText
from palpate.errors import InputError
from palpate.rig.import_text import bound_mm, edges_of, frame_out, ranges_near, rounded, sections_text

__all__ = ["Shares", "Standing", "Stood", "standing"]

Tell = Callable[[str], None]

_MOST_SECTIONS = 2000  # of a state; a wall that leans by 45° over 100 mm takes half as many at 0.1 mm


@dataclass(frozen=True)
class Shares:
    """What an import may lose: to curves and few sections together, and to states that are made one.

    The rest as `importing.Wanted` has it.
    """

    sections_mm: float
    merged_mm: float
    heights_mm: tuple[float, ...] | None
    least_probability: float
    as_is: bool


@dataclass(frozen=True)
class Standing:
    """A state as it stands in an objects file, and what people are told about it.

    `off_mm`: how far true sections may be from those written, what the surface itself is off included.
    """

    text: StateText
    told: ImportedStateOut
    off_mm: float


@dataclass(frozen=True)
class Stood:
    """Every state of a solid that is written, and what is left out."""

    states: tuple[Standing, ...]
    left_out: tuple[LeftOutOut, ...] = ()
    warnings: tuple[str, ...] = ()


def standing(solid: Solid, shares: Shares, tell: Tell) -> Stood:
    """The states of a solid with their sections; `tell` hears what is being done.

    Raises InputError for sections that the tolerance does not allow.
    """
    if shares.as_is:
        return _as_it_lies(solid, shares, tell)
    tell("stable states")
    stable, left_out = stable_states(solid, shares.least_probability)
    if not stable:
        raise InputError(
            f"{solid.name}: no stable state is as probable as {shares.least_probability:g}: "
            "give a smaller --least-probability, or --states as-is"
        )
    sections = _Sections(solid, shares, tell)
    kept, more = merged(solid, stable, sections.of, shares.merged_mm)
    states = [
        _standing(
            item.state,
            sections.of(item.state),
            solid,
            shares,
            probability=item.state.probability,
            merged=item.count,
            apart_mm=item.apart_mm,
        )
        for item in kept
    ]
    return Stood(tuple(states), _left_out([*left_out, *more]))


def _as_it_lies(solid: Solid, shares: Shares, tell: Tell) -> Stood:
    """The only state of a solid that is not dropped."""
    state = as_drawn(solid)
    warnings = (
        () if state.tipping_angle_rad > 0 else ("would topple as it lies in the file, if nothing held it",)
    )
    sections = _Sections(solid, shares, tell).of(state)
    return Stood((_standing(state, sections, solid, shares),), (), warnings)


class _Sections:
    """Sections of states, each computed once."""

    def __init__(self, solid: Solid, shares: Shares, tell: Tell) -> None:
        self._solid, self._shares, self._tell = solid, shares, tell
        self._known: dict[str, tuple[CrossSection, ...]] = {}

    def of(self, state: StableState) -> tuple[CrossSection, ...]:
        """Those that are written: of all heights, or near those that were asked for."""
        if state.name not in self._known:
            self._tell(f"sections of {state.name}")
            near = self._shares.heights_mm
            ranges = None if near is None else ranges_near(near, _top_mm(self._solid, state))
            self._known[state.name] = sections_of(
                self._solid, state, self._shares.sections_mm, ranges, _MOST_SECTIONS
            )
        return self._known[state.name]


def _top_mm(solid: Solid, state: StableState) -> float:
    return float((solid.vertices_mm @ state.rotation[2]).max() + state.offset_mm[2])


def _standing(
    state: StableState,
    sections: Sequence[CrossSection],
    solid: Solid,
    shares: Shares,
    *,
    probability: float | None = None,
    merged: int = 1,
    apart_mm: float = 0.0,
) -> Standing:
    """A state in the words of the file and of the result."""
    some = sections_text([section for section in sections if section.regions])
    heights = None
    height = max(section.z[1] for section in some)
    if shares.heights_mm is not None:
        top = rounded(_top_mm(solid, state))
        height = max(height, top)
        heights = [(rounded(low), rounded(high)) for low, high in ranges_near(shares.heights_mm, top)]
    tipping = state.tipping_angle_rad or None
    counts = [edges_of(section) for section in some]
    text = StateText(
        name=state.name,
        probability=probability,
        tipping_angle=tipping,
        height=height,
        heights=heights,
        sections=some,
    )
    off = max(section.off_mm for section in sections)
    told = ImportedStateOut(
        name=state.name,
        probability=probability,
        tipping_angle=tipping,
        height=height,
        heights=None if heights is None else tuple(heights),
        sections=len(some),
        edges=(min(counts), max(counts)),
        merged=merged,
        section_tolerance=bound_mm([off - solid.off_mm]),
        merged_tolerance=bound_mm([apart_mm]),
        frame=frame_out(state.rotation, state.offset_mm),
    )
    return Standing(text, told, off + apart_mm)


def _left_out(items: Sequence[LeftOut]) -> tuple[LeftOutOut, ...]:
    """Those of one reason together, the most frequent first."""
    groups: dict[str, list[LeftOut]] = {}
    for item in items:
        groups.setdefault(item.reason.partition(":")[0], []).append(item)
    told = [
        LeftOutOut(reason=reason, states=len(some), probability=sum(item.probability for item in some))
        for reason, some in groups.items()
    ]
    return tuple(sorted(told, key=lambda item: -item.probability))
