"""Pads: the touched points of a pad's face.

A pad that was touched gives contacts of points, where something certainly pressed, and the free ways of all
points that stand for its face (docs/recogniser.md, "A pad"). Left is along the face, seen along the travel;
names say how far to the left of its middle points are.
"""

import math
from dataclasses import dataclass, replace

from palpate.config import TipConfig
from palpate.drivers.tactile import ContactPatch
from palpate.recognizer import Contact, Finger, NormalRange, face_offsets_mm, point_to_left

_MIN_SPACING_MM = 2.5  # places that are nearer say little beside each other

Range = tuple[float, float]


@dataclass(frozen=True)
class PadTouch:
    """A pad that something stopped: its face's middle went from `start_mm` to `stop_mm`, in W.

    `facing_rad`: where the face looked, within `tilt_rad`. The skin was dented by `deepest_mm` at most.
    `bound_mm` is that of the middle where it stopped, `path_bound_mm` on its way, with dents that are not
    felt.
    """

    name: str
    finger: Finger
    start_mm: tuple[float, float]
    stop_mm: tuple[float, float]
    facing_rad: float
    tilt_rad: float
    deepest_mm: float
    bound_mm: float
    path_bound_mm: float

    @property
    def way(self) -> Contact:
        """Way on which nothing was in front of the face."""
        far = math.dist(self.start_mm, self.stop_mm)
        share = max(far - self.deepest_mm, 0.0) / max(far, 1e-9)
        (x, y), (u, v) = self.start_mm, self.stop_mm
        end = x + share * (u - x), y + share * (v - y)
        return Contact(
            self.name, self.finger, False, self.start_mm, end, self.bound_mm, path_bound_mm=self.path_bound_mm
        )


def face_points_of(way: Contact, tip: TipConfig, facing_rad: float, tilt_rad: float) -> tuple[Contact, ...]:
    """The free ways of points of a face that looks along `facing_rad`, from that of its middle."""
    # Edges that may be further in than the file says are not taken to have passed further out.
    places = face_offsets_mm(tip.radius_mm) * (1 - tip.radius_bound_mm / tip.radius_mm)
    off = tilt_rad * tip.radius_mm
    return tuple(
        replace(
            way,
            name=f"{way.name} ({left:+.2f} mm, passed)",
            finger=way.finger.face_point,
            start_mm=point_to_left(way.start_mm, facing_rad, left),
            end_mm=point_to_left(way.end_mm, facing_rad, left),
            position_bound_mm=way.position_bound_mm + off,
            path_bound_mm=way.free_path_bound_mm + off,
        )
        for left in places.tolist()
    )


def touched_points(touch: PadTouch, patch: ContactPatch, tip: TipConfig) -> tuple[Contact, ...]:
    """Contacts of the first and the last place across the face where something certainly presses.

    One if these are near each other, or if it is not known where: then it may be anywhere on the face.
    """
    widest = tip.radius_mm + tip.radius_bound_mm
    ranges = [_clip_to_face(item, widest) for item in patch.pressed_mm or ((-widest, widest),)]
    if _middle(ranges[-1]) - _middle(ranges[0]) <= _MIN_SPACING_MM:
        ranges = ranges[:1]
    return tuple(_touched_point(touch, item, widest) for item in ranges)


def face_contact(touch: PadTouch, point_bound_mm: float) -> Contact:
    """The contact of the pad itself: the middle of its face, with the bound of that; no normal is measured.

    Its path is compared with predictions, and bounded as a touched point, by `point_bound_mm`.
    """
    return Contact(
        touch.name,
        touch.finger,
        True,
        touch.start_mm,
        touch.stop_mm,
        touch.bound_mm,
        path_bound_mm=max(point_bound_mm, touch.path_bound_mm),
    )


def _touched_point(touch: PadTouch, across_mm: Range, widest_mm: float) -> Contact:
    """Point of the part that presses, within its range across and up to the deepest dent in the skin."""
    left, half = _middle(across_mm), (across_mm[1] - across_mm[0]) / 2
    off = math.hypot(half, touch.deepest_mm / 2) + touch.tilt_rad * widest_mm
    x, y = point_to_left(touch.stop_mm, touch.facing_rad, left)
    dent = touch.deepest_mm / 2
    # A point of the part that the face meets first has an edge that looks at the face.
    against, half_turn = touch.facing_rad + math.pi, math.pi / 2 + touch.tilt_rad
    return Contact(
        name=f"{touch.name} ({left:+.2f} mm)",
        finger=touch.finger.face_point,
        touched=True,
        start_mm=point_to_left(touch.start_mm, touch.facing_rad, left),
        end_mm=(x - dent * math.cos(touch.facing_rad), y - dent * math.sin(touch.facing_rad)),
        position_bound_mm=touch.bound_mm + off,
        normal=NormalRange(against - half_turn, against + half_turn),
        path_bound_mm=touch.path_bound_mm + off,
    )


def _clip_to_face(across_mm: Range, widest_mm: float) -> Range:
    """Part of a range that is on the face; all of the face if none is."""
    low, high = max(across_mm[0], -widest_mm), min(across_mm[1], widest_mm)
    return (low, high) if low <= high else (-widest_mm, widest_mm)


def _middle(item: Range) -> float:
    return (item[0] + item[1]) / 2
