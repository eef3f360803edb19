"""Exploring grips, made before there is anything to plan with, and the space that they leave unswept.

The first ones go towards the table's middle, or what was touched: then by fingers that do not stop one
another before they are there. A part that lies inside the workspace has room for a disc inside of its
section, and where a tip has passed no such disc can be. So what is kept of misses is where the disc's centre
may be: the workspace, less all misses grown by tip and disc. The next grip frees most of that, first of what
is near the middle; nothing left: no part there.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely

from palpate.base.geometry import Floats, Section, State
from palpate.base.geometry.outlines import region_of
from palpate.recognizer import (
    Approach,
    Catalogue,
    Contact,
    Finger,
    FingerApproach,
    approach_lines,
    offset_from_lines,
    used_approaches,
)
from palpate.rig.reach.approaches import Reach

_MIN_SPACING_MM = 6.0  # approaches keep this far from earlier ones of the same finger
_INWARD_MM = 6.0
_WAY_STEP_MM = 1.0


def exploring_grip(reach: Reach, contacts: Sequence[Contact]) -> list[FingerApproach]:
    """Grip of each finger's approach that passes nearest to the target.

    None that passes too near to an earlier one of that finger is taken, and none that meets a nearer one of
    another finger before what was touched.
    """
    target = _exploration_target(contacts)
    used = used_approaches(contacts, reach.approaches)
    nearest = []
    for finger_index in sorted({item.finger_index for item in reach.approaches}):
        own = reach.of_finger(finger_index, reach.middle_rad)
        start, angle = approach_lines([reach.approaches[k] for k in own])
        offset = dict(zip(own, offset_from_lines(start, angle, target).tolist(), strict=True))
        taken = [offset[k] for k in own if used[k]]
        free = [k for k in own if all(abs(offset[k] - other) >= _MIN_SPACING_MM for other in taken)]
        if free:
            nearest.append(min((abs(offset[k]), k) for k in free))
    if not any(contact.touched for contact in contacts):
        return [reach.approaches[k] for _, k in nearest]
    chosen: list[int] = []
    for _, k in sorted(nearest):
        ways = [_until_beside(reach.approaches[j], target) for j in (k, *chosen)]
        if all(_keep_apart(ways[0], other, reach.closing.clearance_mm) for other in ways[1:]):
            chosen.append(k)
    return [reach.approaches[k] for k in sorted(chosen)]


def _until_beside(approach: FingerApproach, target: Floats) -> FingerApproach:
    """The approach, as far as it may go before it touches what is round the target."""
    heading = np.array([math.cos(approach.direction_rad), math.sin(approach.direction_rad)])
    beside = float((target - np.array(approach.start_mm)) @ heading)
    return approach.up_to(max(beside - approach.finger.tip_radius_mm - _INWARD_MM, 0.0))


def _keep_apart(one: Approach, two: Approach, clearance_mm: float) -> bool:
    """Return whether tips that advance at one speed, each to its end, keep a clearance."""
    far = np.arange(0.0, max(one.travel_mm, two.travel_mm) + _WAY_STEP_MM, _WAY_STEP_MM)
    (ax, ay), (bx, by) = (
        (
            item.start_mm[0] + np.minimum(far, item.travel_mm) * math.cos(item.direction_rad),
            item.start_mm[1] + np.minimum(far, item.travel_mm) * math.sin(item.direction_rad),
        )
        for item in (one, two)
    )
    radii = one.finger.tip_radius_mm + two.finger.tip_radius_mm
    return bool(np.hypot(ax - bx, ay - by).min() >= radii + clearance_mm)


def fast_to_workspace(approach: FingerApproach, workspace_radius_mm: float) -> FingerApproach:
    """The approach, fast as far as the tip is certainly outside of the workspace."""
    (x, y), angle = approach.start_mm, approach.direction_rad
    reach = workspace_radius_mm + approach.finger.tip_radius_mm + approach.position_bound_mm
    along = -(x * math.cos(angle) + y * math.sin(angle))
    beside = math.hypot(x, y) ** 2 - along**2
    inside = math.sqrt(max(reach**2 - beside, 0.0))
    return replace(approach, fast_mm=min(max(along - inside, 0.0), approach.travel_mm))


def _exploration_target(contacts: Sequence[Contact]) -> Floats:
    """A little inside of what was touched; the table's middle if nothing was."""
    inward = []
    for contact in contacts:
        if contact.touched:
            angle = contact.middle_normal_rad
            inward.append(
                np.array(contact.end_mm) - _INWARD_MM * np.array([math.cos(angle), math.sin(angle)])
            )
    result: Floats = np.mean(inward, axis=0) if inward else np.zeros(2)
    return result


_DISC_TOLERANCE_MM = 0.1
_MIDDLE_SHARES = 0.2, 0.4, 1.0  # of the radius of what is left: discs about the middle that count alike
_CHORDS_PER_QUARTER = 32  # in a quarter

TipSpan = tuple[float, float]
"""Heights (from, to) of a tip's ends, mm."""


@dataclass(frozen=True)
class InscribedDisc:
    """A disc that fits inside of what one tip can meet of each of these states (indices).

    The radius is negative if a state is so thin that its tolerance leaves nothing for certain, or a ball
    meets it by a circle that is so small.
    """

    radius_mm: float
    states: frozenset[int]


def inscribed_discs(catalogue: Catalogue, fingers: Iterable[Finger]) -> dict[TipSpan, InscribedDisc]:
    """The largest such disc beside each tip, by its ends' heights; without tips beside which nothing is."""
    found: dict[TipSpan, InscribedDisc] = {}
    for finger in sorted(set(fingers)):
        inscribed = [_disc_radius_mm(item.state, finger) for item in catalogue.states]
        met = {
            index: radius - catalogue.states[index].tolerance_mm
            for index, radius in enumerate(inscribed)
            if radius is not None
        }
        if met:
            before = found.get(finger.span_mm)
            least = min([*met.values(), *([] if before is None else [before.radius_mm])])
            states = frozenset(met) if before is None else before.states & frozenset(met)
            found[finger.span_mm] = InscribedDisc(least, states)
    return found


def unswept_places(
    contacts: Sequence[Contact], discs: Mapping[TipSpan, InscribedDisc], workspace_radius_mm: float
) -> dict[TipSpan, shapely.Geometry]:
    """Places in W where the centre of each tip's disc may be after misses; all others are certainly free."""
    around = 1 / math.cos(
        math.pi / (4 * _CHORDS_PER_QUARTER)
    )  # chords of the workspace's rim must not cut it short
    left = {}
    for span, disc in discs.items():
        room = shapely.Point(0, 0).buffer(
            max(workspace_radius_mm - disc.radius_mm, 0.0) * around, _CHORDS_PER_QUARTER
        )
        swept = [_corridor(contact, disc) for contact in contacts if contact.finger.span_mm == span]
        left[span] = room.difference(shapely.union_all(swept))
    return left


def is_swept(left: Mapping[TipSpan, shapely.Geometry], discs: Mapping[TipSpan, InscribedDisc]) -> bool:
    """Return whether no state that some finger can feel lies inside the workspace."""
    felt = frozenset().union(*(disc.states for disc in discs.values()))
    excluded = frozenset().union(*(discs[span].states for span, place in left.items() if place.is_empty))
    return bool(felt) and felt == excluded


def sweeping_grip(
    reach: Reach,
    contacts: Sequence[Contact],
    left: Mapping[TipSpan, shapely.Geometry],
    discs: Mapping[TipSpan, InscribedDisc],
) -> list[FingerApproach]:
    """Grip of each finger's unused approach that would free most of the places.

    Places near the middle, where parts are mostly put, count more. Fingers that would free nothing, or meet
    another one on their way, stay where they wait.
    """
    remaining, grip = dict(left), list[FingerApproach]()
    corners = np.concatenate([np.zeros((1, 2)), *map(shapely.get_coordinates, left.values())])
    rim = float(np.hypot(*corners.T).max())
    discs_of_middle = [shapely.Point(0, 0).buffer(share * rim) for share in _MIDDLE_SHARES]
    used = used_approaches(contacts, reach.approaches)
    for finger_index in sorted({item.finger_index for item in reach.approaches}):
        own = reach.of_finger(finger_index, reach.middle_rad)
        approaches = [reach.approaches[index] for index in own if not used[index]]
        if not approaches or approaches[0].finger.span_mm not in discs:
            continue
        span = approaches[0].finger.span_mm
        corridors = np.array([_planned_corridor(item, discs[span]) for item in approaches])
        freed = sum(
            shapely.area(shapely.intersection(remaining[span].intersection(middle), corridors))
            / max(middle.area, 1e-9)
            for middle in discs_of_middle
        )
        apart = [
            all(_keep_apart(item, other, reach.closing.clearance_mm) for other in grip) for item in approaches
        ]
        freed = np.where(apart, freed, 0.0)
        best = int(np.argmax(freed))
        if freed[best] > 0:
            remaining[span] = remaining[span].difference(corridors[best])
            grip.append(approaches[best])
    return grip


def _corridor(contact: Contact, disc: InscribedDisc) -> shapely.Geometry:
    """Region where the disc's centre cannot be, because the tip passed."""
    free_mm = contact.finger.tip_radius_mm - contact.free_path_bound_mm
    if contact.touched or free_mm + disc.radius_mm <= 0:
        return shapely.Polygon()
    return shapely.LineString([contact.start_mm, contact.end_mm]).buffer(
        free_mm + disc.radius_mm, _CHORDS_PER_QUARTER
    )


def _planned_corridor(approach: Approach, disc: InscribedDisc) -> shapely.Geometry:
    """Corridor that will be free if the finger goes all the way and touches nothing."""
    (x, y), angle = approach.start_mm, approach.direction_rad
    end = (x + approach.travel_mm * math.cos(angle), y + approach.travel_mm * math.sin(angle))
    miss = Contact("", approach.finger, False, approach.start_mm, end, approach.position_bound_mm)
    return _corridor(miss, disc)


def _disc_radius_mm(state: State, finger: Finger) -> float | None:
    """Radius of a disc that fits inside of what a tip can meet; None if there is nothing.

    Beside a ball it is less by what the ball's circle there has less than the ball.
    """
    met = state.sections_within(finger.span_mm)
    if finger.tip.is_upright:
        return _disc_radius_in_mm(met)
    found = []
    for section in met:
        circle, inside = finger.radius_beside_mm(section.z_mm), _disc_radius_in_mm([section])
        if circle > 0 and inside is not None:
            found.append(inside + circle - finger.tip_radius_mm)
    return max(found, default=None)


def _disc_radius_in_mm(sections: Sequence[Section]) -> float | None:
    polygons = [p for section in sections for p in section.polygons]
    region = region_of(polygons)
    if region.is_empty:
        return None
    # The circle that is found lies inside for certain, and is at most the tolerance smaller than the largest.
    radius = float(shapely.length(shapely.maximum_inscribed_circle(region, _DISC_TOLERANCE_MM)))
    return radius if radius > 0 else None
