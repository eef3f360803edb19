"""Reachability of a catalogue: states that a rig's fingers cannot touch, or may confuse with others.

One line per kind of problem, or a refusal before anything moves. Looks at heights and sizes only, never at
poses, so it costs next to nothing before a run. A tip of which no length is known is taken to be as thin as
a disc: beside a step or a wall that leans it meets more than that, and answers may be false. Of a ball that
meets a state beside its equator, a height counts as a place does; more than 60° from its equator is refused.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property
from itertools import groupby

import numpy as np
import shapely

from palpate.base.errors import InputError, quantity
from palpate.base.geometry import Floats, ObjectModel, State
from palpate.config import RigFile
from palpate.recognizer import CatalogueState, Symmetry, ball_obstacle
from palpate.rig.catalogue.finger_model import at_heights, contact_bound_mm, finger_heights_text
from palpate.rig.catalogue.section_stack import region_within
from palpate.rig.conversion import finger_of
from palpate.rig.mechanisms import lowest_links

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

_OF_SECTION = frozenset({Trouble.OVERSIZED, Trouble.STICKS_OUT, Trouble.TINY})
"""Troubles with how large a state is at the fingers' heights, rather than with how high it is."""


@dataclass(frozen=True)
class Finding:
    """Finding about one state of one object.

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
    """Findings, at most one a state, in the catalogue's order; none for states that the rig can feel.

    A finger along whose tip a state's sections are not known (`State.known_within`) counts as one that feels
    it.
    """
    bench = _RigLimits(rig)
    found = []
    for model in models:
        lying = [_ScaledState(bench, state) for state in model.states]
        scale = None if any(item.is_usable for item in lying) else _plausible_scale(bench, model)
        found += [
            Finding(model.name, state.name, item.trouble, item.size_mm, item.fingers, scale)
            for state, item in zip(model.states, lying, strict=True)
            if item.trouble is not None
        ]
    return tuple(found)


def felt_objects(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[ObjectModel, ...]:
    """The objects without states that a rig cannot feel (`HOPELESS`); all as they are if it can feel none."""
    hopeless = {
        (item.object_name, item.state_name) for item in findings_of(rig, models) if item.trouble in HOPELESS
    }
    felt = []
    for model in models:
        states = tuple(state for state in model.states if (model.name, state.name) not in hopeless)
        if states:
            felt.append(model if len(states) == len(model.states) else replace(model, states=states))
    return tuple(felt or models)


class _RigLimits:
    """Limits of a rig that decide which states it can feel; lengths in mm."""

    def __init__(self, rig: RigFile) -> None:
        self.fingers = [(finger.name, finger.span_mm) for finger in rig.fingers]
        self.across = 2 * rig.workspace.radius_mm
        self.unsure = 2 * (contact_bound_mm(rig) or 0.0)
        self.links, _ = lowest_links(rig)


class _ScaledState:
    """A state with all of its coordinates multiplied by a scale, as a rig's fingers meet it."""

    def __init__(self, bench: _RigLimits, state: State, scale: float = 1.0) -> None:
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
        return self._across_mm if self.trouble in _OF_SECTION else self._top_mm

    @property
    def fingers(self) -> tuple[str, ...]:
        return self._fingers

    def _holds_disc(self, across_mm: float) -> bool:
        return not self._met.buffer(-across_mm / 2 / self._scale).is_empty


def _plausible_scale(bench: _RigLimits, model: ObjectModel) -> float | None:
    """Mistake with units that would explain why no state can be felt, if a usual one does.

    None is guessed of what is known near some heights only: imports have said their units.
    """
    if any(state.heights_mm is not None for state in model.states):
        return None
    for scale in _SCALES:
        if any(_ScaledState(bench, state, scale).is_usable for state in model.states):
            return scale
    return None


_TIP_HALF_SPAN_MM = 5.0  # above a tip's middle and below it: few are shorter than 10 mm
_OVERHANG_THRESHOLD_MM = 0.05  # beside the outlines' tolerances; silhouettes are given to hundredths
_SAMPLE_SPACING_MM = 2.0
_MAX_OVERHANGS_SHOWN = 5


@dataclass(frozen=True)
class Overhang:
    """A state that stands out by `out_mm` beside a tip at `height_mm`, from what is at just that height.

    Infinite, if nothing is at that height.
    """

    object_name: str
    state_name: str
    height_mm: float
    out_mm: float


def overhangs_of(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[Overhang, ...]:
    """Worst overhang of each state, at fingers whose tips' length is not known; none if walls are upright."""
    heights = sorted(
        {
            finger.height_mm
            for finger in rig.fingers
            if finger.tip.length_mm is None and finger.tip.kind.is_upright
        }
    )
    found = []
    for model in models:
        for state in model.states:
            off = 2 * (model.tolerance_mm + state.curves_off_mm) + _OVERHANG_THRESHOLD_MM
            out = [(_overhang_mm(state, height), height) for height in heights]
            most, height = max(out, default=(0.0, 0.0))
            if most > off:
                found.append(Overhang(model.name, state.name, height, most))
    return tuple(found)


def _overhang_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """One line if there are any, else none."""
    found = overhangs_of(rig, models)
    if not found:
        return []
    shown = "; ".join(_words(item) for item in found[:_MAX_OVERHANGS_SHOWN])
    more = len(found) - _MAX_OVERHANGS_SHOWN
    rest = f" and {quantity(more, 'more state', 'more states')}" if more > 0 else ""
    return [
        f"{shown}{rest}: walls are not upright beside the tips; if tips are longer than discs, state their "
        "length_mm under [fingers.tip], or answers may be false"
    ]


def _words(item: Overhang) -> str:
    beside = f"within {_TIP_HALF_SPAN_MM:g} mm of {item.height_mm:g} mm"
    if item.out_mm == np.inf:
        return f"{item.object_name}, {item.state_name} (stands only {beside})"
    return f"{item.object_name}, {item.state_name} (up to {item.out_mm:.2g} mm wider {beside})"


def _overhang_mm(state: State, height_mm: float) -> float:
    """Reach of sections beside a tip out of the one at its middle."""
    beside = max(height_mm - _TIP_HALF_SPAN_MM, 0.0), height_mm + _TIP_HALF_SPAN_MM
    at = state.sections_at(height_mm)
    # What ends just there is not beside the tip.
    others = [
        item
        for item in state.sections_within(beside)
        if item not in at and item.z_mm[1] > beside[0] and item.z_mm[0] < beside[1]
    ]
    if not at:
        return np.inf if others and state.known_at(height_mm) else 0.0
    out = _silhouette_overhang_mm(state, height_mm, beside)
    if not others:
        return out
    region = region_within(state, (height_mm, height_mm))
    shapely.prepare(region)
    rings = [shapely.LinearRing(polygon.outer) for item in others for polygon in item.polygons]
    points = shapely.points(shapely.get_coordinates(shapely.segmentize(rings, _SAMPLE_SPACING_MM)))
    return max(out, float(shapely.distance(points, region).max()))


def _silhouette_overhang_mm(state: State, height_mm: float, beside_mm: tuple[float, float]) -> float:
    """The same as far as the silhouette shows it, for parts that are known near some heights only."""
    own, along = (_ends_mm(state, span) for span in ((height_mm, height_mm), beside_mm))
    if own is None or along is None:
        return 0.0
    return max(own[0] - along[0], along[1] - own[1])


def _ends_mm(state: State, span_mm: tuple[float, float]) -> tuple[float, float] | None:
    """Ends of the silhouette across, somewhere in a span of heights."""
    across = np.concatenate([*_crossings(state, span_mm), np.empty(0)])
    return (float(across.min()), float(across.max())) if len(across) else None


def _crossings(state: State, span_mm: tuple[float, float]) -> Iterator[Floats]:
    """Places across at which a silhouette's lines pass the ends of a span, or have a corner between."""
    low, high = span_mm
    for ring in state.side_mm:
        begin, end = ring, np.roll(ring, -1, axis=0)
        yield ring[(ring[:, 1] >= low) & (ring[:, 1] <= high), 0]
        for z in {low, high}:
            passes = (begin[:, 1] - z) * (end[:, 1] - z) < 0
            share = (z - begin[passes, 1]) / (end[passes, 1] - begin[passes, 1])
            yield begin[passes, 0] + share * (end[passes, 0] - begin[passes, 0])


_WARNING_LATITUDE_RAD = math.radians(20.0)  # up to which a height counts for a third of a place
_MAX_OBLIQUE_SHOWN = 5
_ROUNDING = 1e-9


@dataclass(frozen=True)
class ObliqueTouch:
    """A state that a finger's ball may meet up to `latitude_rad` from its equator."""

    object_name: str
    state_name: str
    finger: str
    latitude_rad: float


def _oblique_touches(rig: RigFile, models: Sequence[ObjectModel]) -> tuple[ObliqueTouch, ...]:
    """Worst touch of each state. Raises InputError, which names the finger, for one that is too oblique."""
    balls = {
        (finger_of(finger), finger.tip.least_share): finger.name
        for finger in reversed(rig.fingers)
        if not finger.tip.kind.is_upright
    }
    found = []
    for model, state in [(item, state) for item in models for state in item.states]:
        worst = ObliqueTouch(model.name, state.name, "", 0.0)
        item = _of_catalogue(model, state)
        for (ball, least_share), name in balls.items():
            try:
                met = ball_obstacle(item, ball)
            except InputError as error:
                raise InputError(f"finger {name}: {error}") from error
            least = ball.tip_radius_mm if met is None else met.radius_mm - 2 * item.tolerance_mm
            share = min(least / ball.tip_radius_mm, 1.0)
            if share < least_share - _ROUNDING:
                raise InputError(
                    f'finger {name}: object "{model.name}", state "{state.name}": its ball may touch up to '
                    f"{math.degrees(math.acos(share)):.1f}° from its equator, more than tip.max_latitude_deg "
                    f"({math.degrees(math.acos(least_share)):g}); give that another value, at most 60"
                )
            if math.acos(share) > worst.latitude_rad:
                worst = ObliqueTouch(model.name, state.name, name, math.acos(share))
        if worst.latitude_rad > _WARNING_LATITUDE_RAD:
            found.append(worst)
    return tuple(found)


def _oblique_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """One line if there are any, else none. Raises InputError as `oblique_touches`."""
    found = sorted(_oblique_touches(rig, models), key=lambda item: -item.latitude_rad)
    if not found:
        return []
    shown = "; ".join(
        f"{item.object_name}, {item.state_name} "
        f"(finger {item.finger}, {math.degrees(item.latitude_rad):.0f}°)"
        for item in found[:_MAX_OBLIQUE_SHOWN]
    )
    more = len(found) - _MAX_OBLIQUE_SHOWN
    rest = f" and {quantity(more, 'more state', 'more states')}" if more > 0 else ""
    worst = math.tan(found[0].latitude_rad)
    return [
        f"{shown}{rest}: balls meet these beside their equators; what height_mm and the sections' heights "
        f"are off by puts a contact off by up to {worst:.1f} times as much, which no bound contains"
    ]


def _of_catalogue(model: ObjectModel, state: State) -> CatalogueState:
    return CatalogueState(
        model.name,
        state,
        np.zeros(2),
        Symmetry(),
        model.tolerance_mm + state.curves_off_mm,
        normal_bound_rad=model.normal_bound_rad,
    )


_MAX_STATES_SHOWN = 5
_UNITS = {
    1000.0: "if coordinates are metres, multiply them by 1000",
    25.4: "if coordinates are inches, multiply them by 25.4",
    1 / 25.4: "if mm were taken for inches, divide coordinates by 25.4",
    1 / 1000: "if mm were taken for metres, divide coordinates by 1000",
}


def finding_lines(rig: RigFile, models: Sequence[ObjectModel], name: str) -> list[str]:
    """Say what the operator should know of the objects of the file `name` before a run on a rig.

    Empty if all states can be felt by all fingers, and as what they are. Raises InputError if none can be by
    any, one is met by a ball too far from its equator, or is moved by pads.
    """
    moved = next((model.name for model in models if model.holds_n is not None), None)
    if moved is not None and (why := rig.why_not("move parts")) is not None:
        raise InputError(f'object "{moved}" declares part_holds_n; {why}: hold parts down, and leave it out')
    found = findings_of(rig, models)
    lines = [_line(rig, group) for group in _groups(found)]
    states = sum(len(model.states) for model in models)
    if sum(finding.trouble in HOPELESS for finding in found) == states:
        raise InputError(f'{name}: rig "{rig.name}" cannot identify anything in it: {"; ".join(lines)}')
    lines += [*_overhang_lines(rig, models), *_oblique_lines(rig, models)]
    return [f"{name}: {line}" for line in lines]


def untouched_lines(rig: RigFile, models: Sequence[ObjectModel]) -> list[str]:
    """Say what to look at if fingers touched nothing, or hardly anything."""
    tops = sorted({state.top_mm for model in models for state in model.states})
    high = f"{tops[0]:.3g}" if len(tops) == 1 else f"{tops[0]:.3g} to {tops[-1]:.3g}"
    return [
        f"is a part on the table, and inside {workspace_words(rig)}?",
        f"do fingers pass above it? they are at {finger_heights_text(at_heights(rig))}, "
        f"the catalogue's states are {high} mm high",
        "do the arrays feel it if they are pressed? `palpate watch` shows them",
    ]


def workspace_words(rig: RigFile) -> str:
    """The region where parts may lie."""
    return f"the workspace, a circle of {2 * rig.workspace.radius_mm:g} mm across round (0, 0)"


def _groups(found: Sequence[Finding]) -> list[list[Finding]]:
    """Groups of findings of which one line can tell."""

    def kind(item: Finding) -> tuple[str, float, tuple[str, ...]]:
        return item.trouble.name, item.scale or 0.0, item.fingers

    return [list(group) for _, group in groupby(sorted(found, key=kind), kind)]


def _line(rig: RigFile, group: Sequence[Finding]) -> str:
    first = group[0]
    line = f"{_names(group)}: {_reason(rig, first)}"
    return line if first.scale is None else f"{line}; {_UNITS[first.scale]}"


def _names(group: Sequence[Finding]) -> str:
    size = "across" if group[0].trouble in _OF_SECTION else "high"
    shown = [
        f"{item.object_name}, {item.state_name} ({item.size_mm:.3g} mm {size})"
        for item in group[:_MAX_STATES_SHOWN]
    ]
    more = len(group) - len(shown)
    return "; ".join(shown) + (f" and {quantity(more, 'more state', 'more states')}" if more else "")


def _reason(rig: RigFile, finding: Finding) -> str:
    heights = finger_heights_text(at_heights(rig))
    match finding.trouble:
        case Trouble.MISSED:
            return f"nothing at the height of any finger, {heights}"
        case Trouble.SOME_FINGERS:
            return f"touched by {', '.join(finding.fingers)} only; fingers are at {heights}"
        case Trouble.LINKS:
            return "too high for the arms' links to pass above (links_height_mm)"
        case Trouble.OVERSIZED:
            return f"larger in all directions than {workspace_words(rig)}"
        case Trouble.STICKS_OUT:
            return f"too long for {workspace_words(rig)}: fingers may hit what sticks out of it"
        case Trouble.TINY:
            off_mm = 2 * (contact_bound_mm(rig) or 0.0)
            return f"smaller than {off_mm:.2g} mm, by which two touches may be off"
