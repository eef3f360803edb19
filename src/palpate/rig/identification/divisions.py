"""Divisions: ways to divide the touches of a table among several parts, each with what its share says of it.

Every touch was stopped by one part, and for all others it is a way that was free as far as it went. So to
divide touches among parts is to recognise each part by its own touches, with those of the others as misses:
nothing new is needed of the recogniser, and its guarantees hold for each part (docs/several-parts.md). All
divisions that nothing refutes are kept, the true one among them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import shapely

from palpate.base.vocabulary import RecognitionVerdict
from palpate.recognizer import Contact, FingerApproach, Recognition
from palpate.rig.identification.loop import Search
from palpate.rig.identification.occupied_room import Core
from palpate.rig.motion.touch import Touch

_FIRST_SHARE = 0.01  # of all configurations, that each of the first touches leaves: an order follows from it
_MOST_CORES = 8  # of hypotheses: more overlap with hardly anything all together


@dataclass(frozen=True, eq=False)
class PartSearch:
    """What the touches of one part say of it. `touched`: (grip, finger) of each, grips from 1."""

    search: Search
    touched: frozenset[tuple[int, int]]

    @property
    def recognition(self) -> Recognition | None:
        """Recognition as the part lies now; None before enough was touched, or where it may be anywhere."""
        return self.search.recognition

    @cached_property
    def is_refuted(self) -> bool:
        """True if no state of the catalogue fits these touches."""
        known = self.search.evidence.recognition
        return known is not None and known.verdict is RecognitionVerdict.NONE

    @cached_property
    def cores(self) -> tuple[Core, ...] | None:
        """What the part fills by each hypothesis; None where too little is known, or there are too many."""
        known = self.recognition
        if known is None or not 0 < len(known.hypotheses) <= _MOST_CORES:
            return None
        return tuple(map(Core, known.hypotheses))

    def room(self, span_mm: tuple[float, float]) -> shapely.Geometry:
        """Region in W, between two heights (mm), that the part fills wherever it is; empty if unknown."""
        rooms = [core.within(span_mm) for core in self.cores or ()]
        return shapely.intersection_all(rooms) if rooms else shapely.Polygon()

    def excludes(self, other: "PartSearch") -> bool:
        """Return whether the two cannot be on one table: all of their hypotheses overlap."""
        if self.cores is None or other.cores is None:
            return False
        return all(one.overlaps(two) for one in self.cores for two in other.cores)

    @cached_property
    def log_volume(self) -> float:
        """Logarithm of how much of all configurations its touches leave: small if they agree by much."""
        known = self.search.evidence.recognition
        if known is None or not known.hypotheses:
            return math.log(_FIRST_SHARE) * len(self.touched)
        cells = known.hypotheses.regions.cells
        every = 2 * math.pi * math.pi * self.search.rig.workspace.radius_mm**2
        return math.log(float(cells.volume @ known.catalogue.prior[cells.state]) / every + 1e-300)

    def grown(
        self, grip: Sequence[FingerApproach], touches: Sequence[Touch], own: frozenset[int]
    ) -> "PartSearch":
        """The same after one more grip, of which the touches `own` (indices) met this part."""
        search = self.search.copy()
        search.take(grip, tuple(touch if k in own else passed(touch) for k, touch in enumerate(touches)))
        number = len(search.made_grips)
        return PartSearch(search, self.touched | {(number, k) for k in own})


@dataclass(frozen=True, eq=False)
class Division:
    """One way to divide all touches among parts; a part that nothing has touched yet is not in it."""

    parts: tuple[PartSearch, ...]

    @cached_property
    def log_volume(self) -> float:
        """Sum over its parts: the division that explains most by least comes first."""
        return sum(part.log_volume for part in self.parts)


def passed(touch: Touch) -> Touch:
    """A touch of another part, as a part sees it that was not touched: a free way up to its end.

    What the finger pressed counts all the same: the other part may have been pushed into this one.
    """
    points = tuple(_free_way(point) for point in touch.points)
    return replace(touch, contact=_free_way(touch.contact), points=points)


def _free_way(contact: Contact) -> Contact:
    return replace(contact, touched=False, normal=None, friction=None) if contact.touched else contact


def divide(
    divisions: Sequence[Division],
    untouched: PartSearch,
    most_parts: int,
    grip: Sequence[FingerApproach],
    touches: Sequence[Touch],
) -> tuple[list[Division], PartSearch]:
    """All divisions after one more grip, and what is known of a part that nothing has touched."""
    met = [k for k, touch in enumerate(touches) if touch.contact.touched]
    known: dict[tuple[int, frozenset[int]], PartSearch] = {}
    exclude: dict[tuple[int, int], bool] = {}

    def grown(part: PartSearch, own: frozenset[int]) -> PartSearch:
        key = id(part), own
        if key not in known:
            known[key] = part.grown(grip, touches, own)
        return known[key]

    def clash(one: PartSearch, two: PartSearch) -> bool:
        key = id(one), id(two)
        if key not in exclude:
            exclude[key] = one.excludes(two)
        return exclude[key]

    found = []
    for division in divisions:
        for shares in _shares(len(division.parts), most_parts, met):
            before = (*division.parts, *[untouched] * (len(shares) - len(division.parts)))
            parts = []
            for part, own in zip(before, shares, strict=True):
                parts.append(grown(part, own))
                if parts[-1].is_refuted or any(clash(item, parts[-1]) for item in parts[:-1]):
                    break
            else:
                found.append(Division(tuple(parts)))
    return found, grown(untouched, frozenset())


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
