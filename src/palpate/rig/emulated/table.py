"""Table of an emulated rig: parts side by side, from a scene file, or drawn from the catalogue by a seed.

Parts may touch, and reach over each other, but not overlap at any height.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import shapely
from shapely import affinity

from palpate.base.errors import InputError
from palpate.base.geometry import ObjectModel, Section, State
from palpate.base.geometry.outlines import polygons_of
from palpate.base.tips import TipShape
from palpate.config import ObjectsFile, Scene, load_objects
from palpate.config.emulation import ConfigurationText, ScenePart
from palpate.drivers.emulators import Parts, PartSection, StillParts
from palpate.rig.emulated.scene import (
    Placement,
    draw_placement,
    draw_pose,
    is_inside,
    outline_at,
    shape_of,
)

_TOUCHING_MM = 1e-3  # parts that touch are no further apart, and overlap by no more than twice that
_MAX_TRIES = 50  # times that a part is put somewhere beside others
_MAX_TABLES = 50  # times that all are put anew
_BRIDGE_MM = 1.0  # skin spans joints that a disc of this radius does not enter
_BRIDGE_CHORDS = 16  # in a quarter of it
_HAIR_MM = 1e-6
_TOUCHES_MM, _ANY_MM = (0.0, 0.5), (0.0, math.inf)
_TOUCHING_SHARE = 0.25


def placements_of(scene: Scene, catalogue: ObjectsFile) -> tuple[Placement, ...]:
    """Placements by a scene file.

    Raises InputError for an object or a state that there is none of, and for parts that overlap.
    """
    found = tuple(_placement_of(entry, catalogue) for entry in scene.entries)
    check_apart(found)
    return found


def _placement_of(entry: ScenePart, catalogue: ObjectsFile) -> Placement:
    objects = catalogue if entry.objects is None else load_objects(entry.objects)
    models = {model.name: model for model in objects.objects}
    model = models.get(entry.object)
    if model is None:
        raise InputError(f'scene: no object "{entry.object}"; there are {_name_list(models)}')
    states = {state.name: state for state in model.states}
    name = entry.state or (model.states[0].name if len(model.states) == 1 else "")
    if name not in states:
        what = f'no state "{entry.state}"' if entry.state else "give the state"
        raise InputError(f'scene: object "{entry.object}": {what}; there are {_name_list(states)}')
    at, part = entry.configuration, entry.part
    return Placement(model, states[name], at.x, at.y, at.theta, part.mass_kg, part.friction)


def scene_of(placements: Sequence[Placement]) -> Scene:
    """The scene that puts catalogued parts where they lie."""
    entries = [
        ScenePart(
            object=lies.model.name,
            configuration=ConfigurationText(x=lies.x_mm, y=lies.y_mm, theta=lies.theta_rad),
            state=lies.state.name,
        )
        for lies in placements
    ]
    if len(entries) > 1:
        return Scene(format="palpate/scene@1", parts=entries)
    (one,) = entries
    return Scene(
        format="palpate/scene@1", object=one.object, configuration=one.configuration, state=one.state
    )


def check_apart(placements: Sequence[Placement]) -> None:
    """Raise InputError if two parts overlap at any height; they may touch."""
    for (k, one), (m, other) in combinations(enumerate(placements), 2):
        if overlap(one, other):
            names = [f'parts[{number}] ("{lies.model.name}")' for number, lies in ((k, one), (m, other))]
            raise InputError(f"scene: {names[0]} and {names[1]} overlap; move one away, they may touch")


def overlap(one: Placement, other: Placement) -> bool:
    """Return whether two parts overlap at a height at which both have a section, by more than rounding."""
    return any(
        not shapely.intersection(shape, beside).buffer(-_TOUCHING_MM).is_empty
        for shape, beside in _shapes_side_by_side(one, other)
    )


def clearance_mm(one: Placement, other: Placement) -> float:
    """Least distance between two parts over the heights at which both have a section."""
    return min(
        (float(shapely.distance(*pair)) for pair in _shapes_side_by_side(one, other)), default=math.inf
    )


def _shapes_side_by_side(
    one: Placement, other: Placement
) -> Iterator[tuple[shapely.Geometry, shapely.Geometry]]:
    """Shapes in W of each two sections of two parts that share heights."""
    for section in one.state.sections:
        for beside in other.state.sections:
            if max(section.z_mm[0], beside.z_mm[0]) < min(section.z_mm[1], beside.z_mm[1]):
                yield shape_of(one, section), shape_of(other, beside)


def outlines_beside(
    placements: Sequence[Placement],
    parts: Parts,
    height_mm: float,
    half_length_mm: float,
    radius_mm: float,
    shape: TipShape,
) -> list[PartSection | None]:
    """Outlines of parts as `outline_at` has them, one for each; `parts`: how they move.

    Across a joint between two walls in line, skin is pressed once. So parts that stand still, as high as each
    other, with a gap that skin bridges, have one outline, in the place of the first of them.
    """
    lying: list[Placement | None] = list(placements)
    if isinstance(parts, StillParts):
        lying = _join_parts(lying, min(_BRIDGE_MM, radius_mm / 2))
    beside = height_mm, half_length_mm, radius_mm, shape
    return [None if lies is None else outline_at(lies, *beside) for lies in lying]


def _join_parts(lying: list[Placement | None], bridge_mm: float) -> list[Placement | None]:
    """The parts, those joined that a disc of a radius does not pass between; None where another has taken it
    in.
    """
    for (k, one), (m, other) in combinations(enumerate(lying), 2):
        if one is None or other is None or one.state.top_mm != other.state.top_mm:
            continue
        if clearance_mm(one, other) < 2 * bridge_mm:
            both = _join(one, other, bridge_mm)
            rest = [None if number == m else lies for number, lies in enumerate(lying)]
            return _join_parts([both if number == k else lies for number, lies in enumerate(rest)], bridge_mm)
    return lying


def _join(one: Placement, other: Placement, bridge_mm: float) -> Placement:
    """Two parts as one, with what is between them out of reach of a disc of a radius."""
    cuts = sorted({z for lies in (one, other) for section in lies.state.sections for z in section.z_mm})
    sections = []
    for low, high in pairwise(cuts):
        shapes = [_shape_between(lies, low, high) for lies in (one, other)]
        whole = shapely.union_all(shapes)
        grown = whole.buffer(bridge_mm, quad_segs=_BRIDGE_CHORDS)
        closed = grown.buffer(-bridge_mm, quad_segs=_BRIDGE_CHORDS)
        fills = [
            # By a hair wider, so that no slit is left.
            fill.buffer(_HAIR_MM)
            for fill in shapely.get_parts(shapely.difference(closed, whole))
            if all(shapely.distance(fill, shape) < _HAIR_MM for shape in shapes)
        ]
        polygons = polygons_of(shapely.union_all([whole, *fills]))
        sections += [Section((low, high), polygons)] if polygons else []
    state = State("joined", tuple(sections), height_mm=one.state.height_mm)
    return Placement(ObjectModel(f"{one.model.name} and {other.model.name}", (state,)), state, 0.0, 0.0, 0.0)


def _shape_between(lies: Placement, low_mm: float, high_mm: float) -> shapely.Geometry:
    """Region in W that a part fills all the way between two heights."""
    shapes = [
        shape_of(lies, section)
        for section in lies.state.sections
        if section.z_mm[0] <= low_mm and section.z_mm[1] >= high_mm
    ]
    return shapely.union_all(shapes)


def draw_placements(
    objects: ObjectsFile,
    count: int,
    radius_mm: float,
    rng: np.random.Generator,
    workspace_mm: float = math.inf,
    gap_mm: tuple[float, float] | None = None,
) -> tuple[Placement, ...]:
    """Any objects in any states, side by side, with their centres of area within `radius_mm` of the middle.

    `gap_mm`: least and largest distance of each part, but the first, from the nearest of those before it;
    None: a share of parts touches, the others lie as it happens. Objects may occur more than once. Raises
    InputError if no room is found for them. One part lies as `draw_placement` draws it.
    """
    if count == 1:
        return (draw_placement(objects, radius_mm, rng, workspace_mm),)
    for _ in range(_MAX_TABLES):
        drawn: list[Placement] = []
        for _ in range(count):
            gap = gap_mm or (_TOUCHES_MM if rng.uniform() < _TOUCHING_SHARE else _ANY_MM)
            any_pose = draw_placement(objects, radius_mm, rng)
            lies = _draw_beside(any_pose, drawn, radius_mm, gap, workspace_mm, rng)
            if lies is None:
                break
            drawn.append(lies)
        else:
            return tuple(drawn)
    apart = "" if gap_mm is None else f", {gap_mm[0]:g} mm to {gap_mm[1]:g} mm from each other"
    raise InputError(
        f"no room was found for {count} parts with their middles within {radius_mm:g} mm{apart}; let that "
        "be more (emulation.placement_radius_mm), or put fewer or smaller parts there"
    )


def _draw_beside(
    first: Placement,
    others: Sequence[Placement],
    radius_mm: float,
    gap: tuple[float, float],
    workspace_mm: float,
    rng: np.random.Generator,
) -> Placement | None:
    """The object of a placement beside others, with a gap within limits; None if no place was found."""
    for _ in range(_MAX_TRIES):
        lies: Placement | None = draw_pose(first.model, first.state, radius_mm, rng)
        assert lies is not None
        if others and math.isfinite(gap[1]):
            lies = _slide_up_to(lies, others, float(rng.uniform(*gap)), float(rng.uniform(0, 2 * math.pi)))
        if lies is None or not _is_within(lies, radius_mm, workspace_mm):
            continue
        nearest_mm = min((clearance_mm(lies, other) for other in others), default=gap[0])
        is_apart = not any(overlap(lies, other) for other in others)
        if is_apart and gap[0] <= nearest_mm <= gap[1] + _TOUCHING_MM:
            return lies
    return None


def _is_within(lies: Placement, radius_mm: float, workspace_mm: float) -> bool:
    """Return whether the centre of area is within a radius of the middle, and all of it in the workspace."""
    centre = shape_of(lies, lies.state.sections[0]).centroid
    return math.hypot(centre.x, centre.y) <= radius_mm and is_inside(lies, workspace_mm)


def _slide_up_to(
    lies: Placement, others: Sequence[Placement], gap: float, bearing_rad: float
) -> Placement | None:
    """The part where it stops, on its way from far out at a bearing through its place, at a gap from others.

    None if it passes them all by.
    """
    pairs = [pair for other in others for pair in _shapes_side_by_side(lies, other)]
    if not pairs:
        return None
    out = np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    far = sum(float(np.hypot(*shapely.get_coordinates(shape).T).max()) for pair in pairs for shape in pair)
    at = far
    while at > -far:
        shift = at * out
        nearest_mm = min(
            float(shapely.distance(affinity.translate(own, *shift), other)) for own, other in pairs
        )
        if nearest_mm <= gap + _TOUCHING_MM:
            return replace(lies, x_mm=lies.x_mm + float(shift[0]), y_mm=lies.y_mm + float(shift[1]))
        at -= nearest_mm - gap
    return None


def _name_list(names: object) -> str:
    every = sorted(str(name) for name in names)  # type: ignore[attr-defined]
    return ", ".join(every[:12]) + (f" and {len(every) - 12} more" if len(every) > 12 else "")
