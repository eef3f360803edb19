"""Contact: the measurement of one finger's approach, the recogniser's input.

Positions are those of the tip's centre in the support-plane frame W, because growing the cross sections by
the tip radius turns the finger into a point (memo footnote 3).
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from palpate.base.errors import InputError
from palpate.base.short_repr import ShortRepr, show_point
from palpate.base.tips import Tip, TipShape, tip_of

LARGEST_MM = 1e4
"""No coordinate, radius or bound may be larger: rounding allowances and running times hold up to here."""

_LARGEST_TIP_MM = 1e3  # larger ones would need ever more facets


@dataclass(frozen=True)
class NormalRange:
    """Outward surface normals that a contact allows, as directions in W: counter-clockwise from lo to hi.

    Raises InputError unless both are finite and 0 ≤ hi − lo ≤ 2π.
    """

    lo_rad: float
    hi_rad: float

    def __post_init__(self) -> None:
        try:
            is_finite = math.isfinite(self.lo_rad) and math.isfinite(self.hi_rad)
        except TypeError:
            is_finite = False
        if not is_finite:
            raise InputError("a normal range must be two finite angles in rad")
        if not 0.0 <= self.hi_rad - self.lo_rad <= 2 * math.pi + 1e-9:
            raise InputError(
                f"a normal range runs counter-clockwise from lo to hi with 0 ≤ hi − lo ≤ 2π, "
                f"not from {self.lo_rad:.6g} to {self.hi_rad:.6g}"
            )


@dataclass(frozen=True, order=True)
class Finger:
    """Properties of a finger that decide which grown cross section it meets (memo §3.1 and footnote 3).

    The tip is an upright cylinder of length 2 `half_length_mm`, its middle at `height_mm`; 0: a disc. It
    meets the union of all cross sections along its length (docs/recogniser.md, "A tip of some length"). Or it
    is a ball with its equator at `height_mm` (the same page, "A ball"). Or a pad: an upright flat face across
    its travel, `tip_radius_mm` half of its width ("A pad"); then it is its `face_point` that outlines are
    made for.
    """

    tip_radius_mm: float
    height_mm: float
    half_length_mm: float = 0.0
    shape: TipShape = TipShape.CYLINDER

    def __post_init__(self) -> None:
        try:
            self._check()
        except TypeError:
            raise InputError(f"a finger's radius, height and half length must be numbers: {self}") from None

    def _check(self) -> None:
        if not 0 <= self.tip_radius_mm <= _LARGEST_TIP_MM:
            raise InputError(
                f"a finger's tip radius must be from 0 to {_LARGEST_TIP_MM:g} mm, not {self.tip_radius_mm:g}"
            )
        if not math.isfinite(self.height_mm):
            raise InputError("a finger's height must be finite")
        if not 0 <= self.half_length_mm <= LARGEST_MM:
            raise InputError(
                f"half the length of a finger's tip must be from 0 to {LARGEST_MM:g} mm, "
                f"not {self.half_length_mm:g}"
            )
        if self.half_length_mm and "length_mm" in self.tip.lacks:
            raise InputError(f"the length of a finger's tip {self.tip.lacks['length_mm']}")

    @property
    def tip(self) -> Tip:
        """Facts of tips of its shape."""
        return tip_of(self.shape)

    @property
    def face_half_mm(self) -> float:
        """Half of the width of the tip's flat face; 0 if it has none."""
        return self.tip_radius_mm if self.tip.has_face else 0.0

    @property
    def face_point(self) -> "Finger":
        """Any point of a tip's face, as a finger of its own; tips without a face themselves."""
        return Finger(0.0, self.height_mm, self.half_length_mm) if self.tip.has_face else self

    @property
    def touches_vertices(self) -> bool:
        """True if it is a point, which can rest on a vertex with the normal of either edge there."""
        return self.tip_radius_mm == 0

    @property
    def half_height_mm(self) -> float:
        """Distance from the tip's middle to its lower and upper end."""
        return self.tip.half_height_mm(self.tip_radius_mm, self.half_length_mm)

    @property
    def span_mm(self) -> tuple[float, float]:
        """Heights (from, to) of the tip's lower and upper end."""
        return self.height_mm - self.half_height_mm, self.height_mm + self.half_height_mm

    def radius_beside_mm(self, z_mm: tuple[float, float]) -> float:
        """Radius of the tip's largest circle at heights (from, to); 0 above it and below."""
        low, high = self.span_mm
        if z_mm[0] > high or z_mm[1] < low:
            return 0.0
        away = max(z_mm[0] - self.height_mm, self.height_mm - z_mm[1], 0.0)
        return self.tip.radius_at_mm(self.tip_radius_mm, away)


@dataclass(frozen=True, repr=False)
class Contact(ShortRepr):
    """One approach that was carried out: the tip's centre went straight from `start` to `end`.

    If `touched`, it was stopped at `end` by the object, and by nothing before; otherwise the whole way was
    free. The true centre is within `position_bound_mm` of the given one all along the path. A real tip may
    be dented a little before a contact is detected: `path_bound_mm` is the position bound with that
    allowance, for the free path only (None: none needed). `normal` is None where nothing is known of it.
    `friction`: the largest coefficient that friction may have, if the finger came to rest by it alone (None:
    it may also have been stopped, by its drive or by a corner, where it would have slid).
    `turn_bound_rad`: how far the direction of travel, seen from the part, may be off for reasons of its own:
    the part was turned since, or moved while the finger travelled.

    A contact of a pad says where the middle of its face went. It is no evidence by itself: that is what
    points of its face met (`pad_face`).
    """

    name: str
    finger: Finger
    touched: bool
    start_mm: tuple[float, float]
    end_mm: tuple[float, float]
    position_bound_mm: float
    normal: NormalRange | None = None
    path_bound_mm: float | None = None
    friction: float | None = None
    turn_bound_rad: float = 0.0

    def __post_init__(self) -> None:
        try:
            self._check()
        except TypeError:
            raise InputError(
                f"contact of {self.name}: start and end must be pairs of numbers, bounds and friction numbers"
            ) from None

    def _check(self) -> None:
        if not isinstance(self.finger, Finger):
            raise InputError(f"contact of {self.name}: finger must be a palpate.Finger, not {self.finger!r}")
        if self.touched not in (True, False):
            raise InputError(f"contact of {self.name}: touched must be True or False, not {self.touched!r}")
        if not len(self.start_mm) == len(self.end_mm) == 2:
            raise InputError(f"contact of {self.name}: start and end must each be x and y in mm")
        for value in (*self.start_mm, *self.end_mm):
            if not abs(value) <= LARGEST_MM:
                raise InputError(
                    f"contact of {self.name}: positions must be finite and within ±{LARGEST_MM:g} mm, "
                    f"not {value:g}"
                )
        for bound in (self.position_bound_mm, self.free_path_bound_mm):
            if not 0 <= bound <= LARGEST_MM:
                raise InputError(
                    f"contact of {self.name}: bounds must be from 0 to {LARGEST_MM:g} mm, not {bound:g}"
                )

        if self.friction is not None and not 0 <= self.friction < math.inf:
            raise InputError(f"contact of {self.name}: friction must be a number from 0 on")

    def _facts(self) -> Iterator[str]:
        where = (
            f"touched at {show_point(self.end_mm)}"
            if self.touched
            else f"missed to {show_point(self.end_mm)}"
        )
        yield f"{self.name} {where} mm"
        yield f"from {show_point(self.start_mm)} mm"
        if self.normal is not None:
            lo = math.remainder(self.normal.lo_rad, 2 * math.pi)
            hi = lo + self.normal.hi_rad - self.normal.lo_rad
            yield f"normals {math.degrees(lo):.1f}° to {math.degrees(hi):.1f}°"

    @property
    def free_path_bound_mm(self) -> float:
        """Bound that holds for the path before its end."""
        return self.position_bound_mm if self.path_bound_mm is None else self.path_bound_mm

    @property
    def travel_mm(self) -> float:
        """Length of the path in mm."""
        return math.dist(self.start_mm, self.end_mm)

    @property
    def direction_rad(self) -> float:
        """Direction of travel φ in W."""
        return math.atan2(self.end_mm[1] - self.start_mm[1], self.end_mm[0] - self.start_mm[0])

    @property
    def direction_bound_rad(self) -> float:
        """Largest deviation of the true direction of travel.

        The end is within the position bound, the start within the path's, which may be larger.
        """
        both = self.position_bound_mm + max(self.position_bound_mm, self.free_path_bound_mm)
        if self.travel_mm <= both:
            return math.pi
        return min(math.asin(both / self.travel_mm) + self.turn_bound_rad, math.pi)

    @property
    def middle_normal_rad(self) -> float:
        """Middle of the normal's range; against the travel if nothing is known of it."""
        if self.normal is None:
            return self.direction_rad + math.pi
        return (self.normal.lo_rad + self.normal.hi_rad) / 2

    def outward_normals(self) -> NormalRange | None:
        """Normals that both the sensor and the approach allow; None if together they allow nothing.

        A finger that came to rest on a surface moved against its outward normal, so the normal lies within
        a quarter turn of −φ; where friction alone held it, within the friction cone, atan μ (memo §2.2.2).
        Where the two ranges meet in two pieces the shorter range stands for both: wider than need be, never
        too narrow. A point on a vertex has the normal of either edge there, and one of these may face away
        from where the point came: a point's measured normal stands alone.
        """
        return self._outward_normals

    @cached_property
    def _outward_normals(self) -> NormalRange | None:
        if self.normal is not None and self.finger.touches_vertices:
            return self.normal
        cone = math.pi / 2 if self.friction is None else math.atan(self.friction)
        half = min(math.pi, cone + self.direction_bound_rad + 1e-9)
        against = self.direction_rad + math.pi
        approach = NormalRange(against - half, against + half)
        if self.normal is None:
            return approach
        return _intersect_ranges(self.normal, approach)


def _intersect_ranges(first: NormalRange, second: NormalRange) -> NormalRange | None:
    width_1 = first.hi_rad - first.lo_rad
    width_2 = second.hi_rad - second.lo_rad
    offset = (second.lo_rad - first.lo_rad) % (2 * math.pi)
    pieces = []
    if offset <= width_1:
        pieces.append((offset, min(width_1, offset + width_2)))
    if offset + width_2 >= 2 * math.pi:
        pieces.append((0.0, min(width_1, offset + width_2 - 2 * math.pi)))
    if not pieces:
        return None
    if len(pieces) == 2:
        return first if width_1 <= width_2 else second
    lo, hi = pieces[0]
    return NormalRange(first.lo_rad + lo, first.lo_rad + hi)
