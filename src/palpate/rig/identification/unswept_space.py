"""Unswept space of a table on which nothing was touched yet: where a part of the catalogue may still lie.

From misses to the next exploring grip, and to giving up. A part that lies inside the workspace has room for a
disc inside of its section, and where a tip has passed no such disc can be. So what is kept is where the
disc's centre may be: the workspace, less all misses grown by tip and disc. Nothing left: no part there.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from palpate.base.geometry import Section, State
from palpate.recognizer import Approach, Catalogue, Contact, Finger, FingerApproach, already_used
from palpate.rig.reach.approaches import Reach

__all__ = ["Disc", "discs_at", "is_swept", "places_left", "sweeping_grip"]

_DISC_TOLERANCE_MM = 0.1
_CHORDS = 32  # in a quarter

Span = tuple[float, float]
"""Heights (from, to) of a tip's ends, mm."""


@dataclass(frozen=True)
class Disc:
    """A disc that fits inside of what one tip can meet of each of these states (indices).

    The radius is negative if a state is so thin that its tolerance leaves nothing for certain, or a ball
    meets it by a circle that is so small.
    """

    radius_mm: float
    states: frozenset[int]


def discs_at(catalogue: Catalogue, fingers: Iterable[Finger]) -> dict[Span, Disc]:
    """The largest such disc beside each tip, by its ends' heights; without tips beside which nothing is."""
    found: dict[Span, Disc] = {}
    for finger in sorted(set(fingers)):
        inscribed = [_inscribed_mm(item.state, finger) for item in catalogue.states]
        met = {
            index: radius - catalogue.states[index].tolerance_mm
            for index, radius in enumerate(inscribed)
            if radius is not None
        }
        if met:
            before = found.get(finger.span_mm)
            least = min([*met.values(), *([] if before is None else [before.radius_mm])])
            states = frozenset(met) if before is None else before.states & frozenset(met)
            found[finger.span_mm] = Disc(least, states)
    return found


def places_left(
    contacts: Sequence[Contact], discs: Mapping[Span, Disc], workspace_radius_mm: float
) -> dict[Span, shapely.Geometry]:
    """Where in W the centre of each tip's disc may be after misses; everything else is certainly free."""
    around = 1 / math.cos(math.pi / (4 * _CHORDS))  # chords of the workspace's rim must not cut it short
    left = {}
    for span, disc in discs.items():
        room = shapely.Point(0, 0).buffer(max(workspace_radius_mm - disc.radius_mm, 0.0) * around, _CHORDS)
        swept = [_corridor(contact, disc) for contact in contacts if contact.finger.span_mm == span]
        left[span] = room.difference(shapely.union_all(swept))
    return left


def is_swept(left: Mapping[Span, shapely.Geometry], discs: Mapping[Span, Disc]) -> bool:
    """Whether no state that some finger can feel lies inside the workspace."""
    felt = frozenset().union(*(disc.states for disc in discs.values()))
    excluded = frozenset().union(*(discs[span].states for span, place in left.items() if place.is_empty))
    return bool(felt) and felt == excluded


def sweeping_grip(
    reach: Reach,
    contacts: Sequence[Contact],
    left: Mapping[Span, shapely.Geometry],
    discs: Mapping[Span, Disc],
) -> list[FingerApproach]:
    """For each finger the unused approach that would free most of the places.

    Fingers that would free nothing stay where they wait.
    """
    remaining, grip = dict(left), []
    used = already_used(contacts, reach.approaches)
    for finger_index in sorted({item.finger_index for item in reach.approaches}):
        own = reach.of_finger(finger_index, reach.middle_rad)
        approaches = [reach.approaches[index] for index in own if not used[index]]
        if not approaches or approaches[0].finger.span_mm not in discs:
            continue
        span = approaches[0].finger.span_mm
        corridors = np.array([_planned_corridor(item, discs[span]) for item in approaches])
        freed = shapely.area(shapely.intersection(remaining[span], corridors))
        best = int(np.argmax(freed))
        if freed[best] > 0:
            remaining[span] = remaining[span].difference(corridors[best])
            grip.append(approaches[best])
    return grip


def _corridor(contact: Contact, disc: Disc) -> shapely.Geometry:
    """Where the disc's centre cannot be, because the tip passed."""
    free_mm = contact.finger.tip_radius_mm - contact.free_path_bound_mm
    if contact.touched or free_mm + disc.radius_mm <= 0:
        return shapely.Polygon()
    return shapely.LineString([contact.start_mm, contact.end_mm]).buffer(free_mm + disc.radius_mm, _CHORDS)


def _planned_corridor(approach: Approach, disc: Disc) -> shapely.Geometry:
    """What `_corridor` will be if the finger goes all the way and touches nothing."""
    (x, y), angle = approach.start_mm, approach.direction_rad
    end = (x + approach.travel_mm * math.cos(angle), y + approach.travel_mm * math.sin(angle))
    miss = Contact("", approach.finger, False, approach.start_mm, end, approach.position_bound_mm)
    return _corridor(miss, disc)


def _inscribed_mm(state: State, finger: Finger) -> float | None:
    """Radius of a disc that fits inside of what a tip can meet; None if there is nothing.

    Beside a ball it is less by what the ball's circle there has less than the ball.
    """
    met = state.sections_within(finger.span_mm)
    if not finger.is_ball:
        return _inscribed_in_mm(met)
    found = []
    for section in met:
        circle, inside = finger.radius_beside_mm(section.z_mm), _inscribed_in_mm([section])
        if circle > 0 and inside is not None:
            found.append(inside + circle - finger.tip_radius_mm)
    return max(found, default=None)


def _inscribed_in_mm(sections: Sequence[Section]) -> float | None:
    polygons = [p for section in sections for p in section.polygons]
    region = shapely.union_all([shapely.Polygon(p.outer, p.holes) for p in polygons])
    if region.is_empty:
        return None
    # The circle that is found lies inside for certain, and is at most the tolerance smaller than the largest.
    radius = float(shapely.length(shapely.maximum_inscribed_circle(region, _DISC_TOLERANCE_MM)))
    return radius if radius > 0 else None
