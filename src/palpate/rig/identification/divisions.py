"""Divisions: ways to divide the touches of a table among several parts, each with what its share says of it.

Every touch was stopped by one part, and for all others it is a way that was free as far as it went. So to
divide touches among parts is to recognise each part by its own touches, with those of the others as misses:
nothing new is needed of the recogniser, and its guarantees hold for each part (docs/several-parts.md). All
divisions that nothing refutes are kept, the true one among them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import shapely

from palpate.recognizer import FREE_MARGIN_MM, Contact, FingerApproach, Recognition, predict
from palpate.rig.identification.grip_evidence import paths_of
from palpate.rig.identification.loop import Search
from palpate.rig.identification.motion_bounds import GripLoads, GripMotion, MotionBounds
from palpate.rig.identification.occupied_room import Core
from palpate.rig.identification.part_count import PartCount
from palpate.rig.motion.touch import Touch

_FIRST_SHARE = 0.01  # of all configurations, that each of the first touches leaves: an order follows from it
_MOST_CORES = 8  # of hypotheses: more overlap with hardly anything all together


@dataclass(frozen=True, eq=False)
class PartSearch:
    """Knowledge of one part from its own touches. `touched`: (grip, finger) of each, grips from 1."""

    search: Search
    touched: frozenset[tuple[int, int]]

    @cached_property
    def counting(self) -> tuple[int, frozenset[tuple[int, int]]]:
        """The grip (from 1) since which touches count, as contacts could be carried over, and these touches.

        Parts for which both are the same are known by the same evidence.
        """
        begin = self.search.moved_before[-1] if self.search.moved_before else 1
        return begin, frozenset(item for item in self.touched if item[0] >= begin)

    @property
    def recognition(self) -> Recognition | None:
        """Recognition as the part lies now; None before enough was touched, or where it may be anywhere."""
        return self.search.recognition

    @cached_property
    def is_refuted(self) -> bool:
        """True if no state of the catalogue fits these touches."""
        return self.search.evidence.is_refuted

    @cached_property
    def cores(self) -> tuple[Core, ...] | None:
        """Region that the part fills by each hypothesis; None: too little is known, or there are too many."""
        return _cores_of(self.recognition) if self._measured_cores else None

    @cached_property
    def _measured_cores(self) -> tuple[Core, ...] | None:
        """The same as it lay when the last grip was measured, as all other parts were."""
        return _cores_of(self.search.evidence.recognition)

    def room(self, span_mm: tuple[float, float]) -> shapely.Geometry:
        """Region in W, between two heights (mm), that the part fills wherever it is; empty if unknown."""
        rooms = [core.within(span_mm) for core in self.cores or ()]
        return shapely.intersection_all(rooms) if rooms else shapely.Polygon()

    def excludes(self, other: "PartSearch") -> bool:
        """Return whether the two cannot be on one table: all of their hypotheses overlap."""
        cores, others = self._measured_cores, other._measured_cores
        if cores is None or others is None:
            return False
        return all(one.overlaps(two) for one in cores for two in others)

    @cached_property
    def log_volume(self) -> float:
        """Logarithm of how much of all configurations its touches leave: small if they agree by much."""
        known = self.search.evidence.recognition
        if known is None or not known.hypotheses:
            return math.log(_FIRST_SHARE) * len(self.touched)
        cells = known.hypotheses.regions.cells
        every = 2 * math.pi * math.pi * self.search.rig.workspace.radius_mm**2
        return math.log(float(cells.volume @ known.catalogue.prior[cells.state]) / every + 1e-300)

    def gap_mm(self, other: "PartSearch") -> float:
        """Distance of the two parts at least, wherever they are; 0 where too little is known."""
        if self.cores is None or other.cores is None:
            return 0.0
        return min(one.gap_mm(two) for one in self.cores for two in other.cores)

    def free_mm(self, touches: Sequence[Touch]) -> list[float]:
        """Distance that each finger kept from the part all along, at least: all that is asked for, or 0."""
        known = self.recognition
        if known is None or not known.hypotheses:
            return [0.0] * len(touches)
        contacts = [touch.contact for touch in touches]
        wide = [
            replace(item, position_bound_mm=item.position_bound_mm + FREE_MARGIN_MM)
            for item in paths_of(contacts)
        ]
        met = predict(known.catalogue, known.hypotheses, known.anchor_mm, wide).earliest.min(axis=1)
        far = [
            max(contact.travel_mm, 0.0 if touch.trace is None else float(max(touch.trace.travel_mm)))
            for contact, touch in zip(contacts, touches, strict=True)
        ]
        return [FREE_MARGIN_MM if way > there else 0.0 for way, there in zip(met.tolist(), far, strict=True)]

    @property
    def pushed_mm(self) -> float:
        """Distance by which the last grip has moved any point of the part, at most."""
        return self.search.pushed_mm

    def may_have_met(self, grip: "TakenGrip", own: frozenset[int]) -> bool:
        """Return whether touches of the next grip (indices) may be this part's, as far as is quickly told."""
        contacts = [contact for k in sorted(own) for contact in grip.touches[k].evidence]
        return self.search.may_have_met(contacts, grip.motion)

    def grow(self, grip: "TakenGrip", own: frozenset[int], *, is_apart: bool) -> "PartSearch":
        """The same after one more grip, of which the touches `own` (indices) met this part.

        `is_apart`: no other part was pushed into this one.
        """
        free_mm = self.free_mm(grip.touches) if is_apart else [None] * len(grip.touches)
        seen = grip.view(own, free_mm)
        search = self.search.copy()
        search.take(grip.approaches, seen, grip.loads(seen))
        if not own:
            search.evidence.keep_judgement_of(self.search.evidence)
        elif not is_apart and search.pushed_mm:
            search.evidence.idle = self.search.evidence.idle  # what it gained, others may have taken away
        number = len(search.made_grips)
        return PartSearch(search, self.touched | {(number, k) for k in own})


def _cores_of(known: Recognition | None) -> tuple[Core, ...] | None:
    if known is None or not 0 < len(known.hypotheses) <= _MOST_CORES:
        return None
    return tuple(map(Core, known.hypotheses))


@dataclass(frozen=True, eq=False)
class Division:
    """One way to divide all touches among parts; a part that nothing has touched yet is not in it."""

    parts: tuple[PartSearch, ...]

    @cached_property
    def log_volume(self) -> float:
        """Sum over its parts: the division that explains most by least comes first."""
        return sum(part.log_volume for part in self.parts)


def as_free_way(touch: Touch, free_mm: float | None) -> Touch:
    """A touch of another part, as a part sees it that was not touched: a free way up to its end.

    `free_mm`: the finger kept so far away from this part, and nothing was pushed into it; None: what the
    finger pressed counts all the same, as the other part may have been pushed into this one.
    """
    points = tuple(_free_way(point) for point in touch.points)
    seen = replace(touch, contact=_free_way(touch.contact), points=points)
    if free_mm is None or touch.trace is None:
        return seen
    return replace(seen, trace=touch.trace.of_nothing_felt(max(free_mm, 0.0)))


def _free_way(contact: Contact) -> Contact:
    return replace(contact, touched=False, normal=None, friction=None) if contact.touched else contact


@dataclass(frozen=True, eq=False)
class TakenGrip:
    """One grip as parts see it: their own touches as they are, those of others as free ways.

    What it did is worked out once for all parts that see the same of it.
    """

    approaches: Sequence[FingerApproach]
    touches: Sequence[Touch]
    bounds: MotionBounds
    _free_ways: dict[tuple[int, float | None], Touch] = field(default_factory=dict)
    _loads: dict[tuple[int, ...], Sequence[GripLoads]] = field(default_factory=dict)

    def view(self, own: frozenset[int], free_mm: Sequence[float | None]) -> tuple[Touch, ...]:
        """Touches as a part sees them that met `own` (indices) of them; `free_mm` as in `as_free_way`."""
        return tuple(
            touch if k in own else self._free_way(k, free_mm[k]) for k, touch in enumerate(self.touches)
        )

    def _free_way(self, number: int, free_mm: float | None) -> Touch:
        key = number, free_mm
        if key not in self._free_ways:
            self._free_ways[key] = as_free_way(self.touches[number], free_mm)
        return self._free_ways[key]

    def loads(self, seen: Sequence[Touch]) -> Sequence[GripLoads]:
        """Loads of the touches that `view` has returned."""
        key = tuple(id(touch.trace) for touch in seen)
        if key not in self._loads:
            self._loads[key] = self.bounds.loads(seen)
        return self._loads[key]

    @cached_property
    def motion(self) -> GripMotion:
        """Motion of any part, if all that pressed may have pressed it anywhere."""
        return self.bounds.of_grip(self.touches, loads=self.loads(self.touches))


@dataclass(frozen=True, eq=False)
class GripDivider:
    """Divides the touches of one grip. What parts have in common in several divisions is worked out once."""

    grip: TakenGrip
    _possible: dict[tuple[int, frozenset[int]], bool] = field(default_factory=dict)
    _grown: dict[tuple[int, frozenset[int], bool], PartSearch] = field(default_factory=dict)
    _excluded: dict[tuple[int, int], bool] = field(default_factory=dict)
    _gaps_mm: dict[tuple[int, int], float] = field(default_factory=dict)

    def divide(
        self, divisions: Sequence[Division], untouched: PartSearch, count: PartCount
    ) -> tuple[list[Division], PartSearch]:
        """All divisions after the grip, and what is known of a part that nothing has touched."""
        met = [k for k, touch in enumerate(self.grip.touches) if touch.contact.touched]
        found: dict[object, Division] = {}
        for division in divisions:
            # Where other parts may lie unknown, any of them may carry a push on.
            known = count.exactly and len(division.parts) == count.most
            for shares in _shares(len(division.parts), count.most, met):
                more = len(shares) - len(division.parts)
                parts = self._parts((*division.parts, *[untouched] * more), shares, all_known=known)
                if parts is not None:
                    found.setdefault(frozenset(part.counting for part in parts), Division(parts))
        return list(found.values()), self._part(untouched, frozenset(), is_apart=False)

    def _parts(
        self, before: Sequence[PartSearch], shares: Sequence[frozenset[int]], *, all_known: bool
    ) -> tuple[PartSearch, ...] | None:
        """The parts after the grip; None if they cannot be on one table."""
        if not all(self._may_have_met(*item) for item in zip(before, shares, strict=True)):
            return None
        if all_known and all(self._gap_mm(*pair) > 0 for pair in combinations(before, 2)):
            # What the touches of others say of a part counts only once they are known to keep apart.
            parts = [self._part(*item, is_apart=True) for item in zip(before, shares, strict=True)]
            if self._keep_apart(before, parts):
                return tuple(parts) if self._are_possible(parts) else None
        return self._grow(before, shares)

    def _grow(
        self, before: Sequence[PartSearch], shares: Sequence[frozenset[int]]
    ) -> tuple[PartSearch, ...] | None:
        # What is worked out already may spare the rest.
        for part, own in sorted(zip(before, shares, strict=True), key=lambda item: not self._is_grown(*item)):
            if self._part(part, own, is_apart=False).is_refuted:
                return None
        parts = tuple(self._part(*item, is_apart=False) for item in zip(before, shares, strict=True))
        return parts if self._are_possible(parts) else None

    def _is_grown(self, part: PartSearch, own: frozenset[int]) -> bool:
        return (id(part), own, False) in self._grown

    def _may_have_met(self, part: PartSearch, own: frozenset[int]) -> bool:
        key = id(part), own
        if key not in self._possible:
            self._possible[key] = not own or part.may_have_met(self.grip, own)
        return self._possible[key]

    def _are_possible(self, parts: Sequence[PartSearch]) -> bool:
        """Return whether all of the parts may be on one table."""
        if any(part.is_refuted for part in parts):
            return False
        return not any(self._exclude(*pair) for pair in combinations(parts, 2))

    def _part(self, part: PartSearch, own: frozenset[int], *, is_apart: bool) -> PartSearch:
        key = id(part), own, is_apart
        if key not in self._grown:
            self._grown[key] = part.grow(self.grip, own, is_apart=is_apart)
        return self._grown[key]

    def _exclude(self, one: PartSearch, two: PartSearch) -> bool:
        key = id(one), id(two)
        if key not in self._excluded:
            self._excluded[key] = one.excludes(two)
        return self._excluded[key]

    def _keep_apart(self, before: Sequence[PartSearch], after: Sequence[PartSearch]) -> bool:
        """Return whether no part can have been pushed into another.

        Until two parts meet, each is moved by its own touches alone: together by less than their distance.
        """
        return all(
            self._gap_mm(before[k], before[m]) > after[k].pushed_mm + after[m].pushed_mm
            for k, m in combinations(range(len(before)), 2)
        )

    def _gap_mm(self, one: PartSearch, two: PartSearch) -> float:
        key = id(one), id(two)
        if key not in self._gaps_mm:
            self._gaps_mm[key] = one.gap_mm(two)
        return self._gaps_mm[key]


def _shares(parts: int, most_parts: int, met: Sequence[int]) -> Iterator[list[frozenset[int]]]:
    """Every way to share touches out among parts that there are, and further ones."""

    def assign(left: Sequence[int], owners: list[int], count: int) -> Iterator[list[int]]:
        if not left:
            yield owners
            return
        for owner in range(min(count + 1, most_parts)):
            yield from assign(left[1:], [*owners, owner], max(count, owner + 1))

    for owners in assign(met, [], parts):
        count = max([parts, *(owner + 1 for owner in owners)])
        yield [
            frozenset(k for k, owner in zip(met, owners, strict=True) if owner == part)
            for part in range(count)
        ]
