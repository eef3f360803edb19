"""Wiring of a rig: from what people saw of pressed and moved tips to the one thing to change in its file.

A wiring says which array and which servos a finger at a place has, which way its joints go, and how its array
is mounted. What was seen leaves few wirings; of those that explain all of it, the one with the fewest changes
to the rig file counts, and none if several need as few. Places of the same array and servos, all of them
elsewhere, are one change (a ring assigned round), and so is a frame that was measured mirrored.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from itertools import product
from typing import TypeVar

from palpate.config import ArmFingerConfig, FingerConfig, RigFile

_ANGLE_TOLERANCE_DEG = 44.0
"""How far from where they were asked to people press; the next turn of an array is 90° away."""
_EDGE_DEG = 25.0  # of an array's edge: a press there may be felt or not
_TURNS_DEG = (0.0, 180.0, 90.0, -90.0)
_MAX_CHANGES = 4
"""More changes than these explain anything: then no cause is named."""

_T = TypeVar("_T")

Pair = tuple[int, int]
"""Of both joints, the one next to the base first."""


class Side(Enum):
    """Side of a tip, by its angle (deg) from the direction away from its base, counter-clockwise."""

    FRONT = 0.0
    LEFT = 90.0
    RIGHT = -90.0


class Way(Enum):
    """Way of a tip, seen from its base: the joint that moves it so (0: next to the base), and its sense."""

    LEFT = (0, 1)
    RIGHT = (0, -1)
    OUT = (1, 1)
    IN = (1, -1)


@dataclass(frozen=True)
class TipPress:
    """Press on the tip that stands where the rig file puts finger `asked`; `stood`: one does.

    `arrays`: fingers of the file whose arrays felt it. `angle_deg`: where on that array, from its middle;
    `low`: on its lower half, None if that is not clear.
    """

    asked: str
    side: Side
    arrays: tuple[str, ...] = ()
    angle_deg: float | None = None
    low: bool | None = None
    stood: bool = True


@dataclass(frozen=True)
class TipMove:
    """Move of joint `joint` (0: next to the base) of the file's `finger`, left or outward by the file.

    `base_mm`: about where the base of the tip is that moved, None if none did; `way`: which way it went.
    """

    finger: str
    joint: int
    base_mm: tuple[float, float] | None
    way: Way | None


@dataclass(frozen=True)
class Seen:
    """All that was seen. `turns`: of each servo, where fingers stood, as the rig file counts them."""

    presses: tuple[TipPress, ...] = ()
    moves: tuple[TipMove, ...] = ()
    turns: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FingerWiring:
    """Wiring of a finger. `signs`: sense of a tip, left or outward, as its joints' servos count upwards.

    `array_deg`: where the array's middle looks from the finger's direction; `mirrored`, `inverted`: its
    columns, its rows are counted the other way round, which those of a contact source cannot be.
    """

    name: str
    base_mm: tuple[float, float]
    heading_deg: float
    port: str
    ids: Pair
    signs: Pair
    array_deg: float
    mirrored: bool
    inverted: bool
    coverage_deg: float
    has_face: bool
    reports_contacts: bool = False

    @classmethod
    def of(cls, spec: FingerConfig) -> "FingerWiring":
        """Wiring of a finger as the rig file has it."""
        near, far = spec.servos.values()
        first = spec.array.first_texel or "lower-left"
        return cls(
            spec.name,
            spec.base_mm,
            spec.heading_deg,
            spec.array.port,
            (near.dxl_id, far.dxl_id),
            (_sign(spec, 0), _sign(spec, 1)),
            spec.array.heading_deg,
            first.endswith("right"),
            first.startswith("upper"),
            spec.array.coverage_deg,
            spec.tip.kind.has_face,
            spec.array.reports_contacts,
        )

    @property
    def function(self) -> tuple[object, ...]:
        """All that matters but for its name."""
        place = (*(round(value, 3) + 0.0 for value in self.base_mm), round(self.heading_deg % 360, 3) % 360)
        array = (self.port, round(self.array_deg % 360, 3) % 360, self.mirrored, self.inverted)
        return (*place, *array, self.ids, self.signs)


def _sign(spec: FingerConfig, joint: int) -> int:
    sign = int(math.copysign(1, tuple(spec.servos.values())[joint].ratio))
    if isinstance(spec, ArmFingerConfig) and joint:  # the tip goes outward as the elbow straightens
        return -sign * int(math.copysign(1, sum(spec.elbow.range_deg)))
    return sign


def wiring_of(rig: RigFile) -> tuple[FingerWiring, ...]:
    """Wiring that a rig file describes."""
    return tuple(FingerWiring.of(spec) for spec in rig.fingers)


def standing_at(bases_mm: Sequence[tuple[float, float]], place_mm: tuple[float, float]) -> int | None:
    """Index of the base at a place, as people see it: nearer than half the way to any other; None if none."""
    near_mm = min((math.dist(a, b) for k, a in enumerate(bases_mm) for b in bases_mm[:k]), default=math.inf)
    index = min(range(len(bases_mm)), key=lambda k: math.dist(bases_mm[k], place_mm))
    return index if math.dist(bases_mm[index], place_mm) < min(near_mm / 2, 100.0) else None


def press_explains(told: FingerWiring, true: FingerWiring, press: TipPress) -> bool:
    """True if an array mounted as `true` says is felt like that by one who believes `told`."""
    expected = press.side.value - true.array_deg
    if told.mirrored != true.mirrored:
        expected = -expected
    expected = math.remainder(expected, 360)
    edge = true.coverage_deg / 2
    if press.angle_deg is None:
        return not true.has_face and abs(expected) > edge - _EDGE_DEG
    if abs(expected) > edge + _EDGE_DEG:
        return False
    low = press.low if told.inverted == true.inverted or press.low is None else not press.low
    is_low = press.side is not Side.FRONT or low is not False
    return is_low and abs(math.remainder(press.angle_deg - expected, 360)) < _ANGLE_TOLERANCE_DEG


class MeasuredFrame(Enum):
    """Frame in which places and directions were measured: as it should be, or with an axis mirrored."""

    RIGHT = (1, 1)
    Y_MIRRORED = (1, -1)
    X_MIRRORED = (-1, 1)


_FRAME_COSTS = {MeasuredFrame.RIGHT: 0.0, MeasuredFrame.Y_MIRRORED: 1.02, MeasuredFrame.X_MIRRORED: 1.6}
"""An axis x the other way round is rare beside two fingers that are exchanged, and may look the same."""


@dataclass(frozen=True)
class Candidate:
    """A wiring that explains what was seen, finger by finger of the file, and how it differs from the file.

    `told`: as the file has them; `base`: the same as they would be measured in the right frame, each at the
    place (`places`) of another; `true`: as they are. `with_joints`: their senses were measured in `frame`,
    too.
    """

    told: tuple[FingerWiring, ...]
    base: tuple[FingerWiring, ...]
    true: tuple[FingerWiring, ...]
    frame: MeasuredFrame
    with_joints: bool
    places: tuple[int, ...]

    @property
    def moved_places(self) -> list[str]:
        """Fingers that stand at another's place."""
        return [item.name for k, item in enumerate(self.told) if self.places[k] != k]

    def differing(self, of: Callable[[FingerWiring], object]) -> list[str]:
        """Fingers of which something is not as it would be if they only stood elsewhere."""
        return [a.name for a, b in zip(self.base, self.true, strict=True) if of(a) != of(b)]

    @property
    def reversed_joints(self) -> list[tuple[str, int]]:
        """Fingers and joints that go the other way."""
        pairs = [(a, b, k) for a, b in zip(self.base, self.true, strict=True) for k in (0, 1)]
        return [(a.name, k) for a, b, k in pairs if a.signs[k] != b.signs[k]]

    @property
    def cost(self) -> float:
        """Number of changes to the rig file; of equals, that of fewer fingers is less."""
        groups = self.moved_places, self.differing(lambda a: a.port), self.differing(lambda a: a.ids)
        cost = sum(1 + 0.01 * len(group) for group in groups if group)
        cost += len(self.reversed_joints) + len(self.differing(mounting))
        return cost + _FRAME_COSTS[self.frame]

    @property
    def function(self) -> frozenset[tuple[object, ...]]:
        """What it does, whatever fingers are called."""
        return frozenset(item.function for item in self.true)


def mounting(item: FingerWiring) -> tuple[object, ...]:
    """How a finger's array sits on its tip."""
    return round(math.remainder(item.array_deg, 360) % 360, 3), item.mirrored, item.inverted


def _mirror(item: FingerWiring, frame: MeasuredFrame, *, with_joints: bool) -> FingerWiring:
    """A finger that was described in a mirrored frame, in the right one."""
    if frame is MeasuredFrame.RIGHT:
        return item
    (x, y), (across, up) = item.base_mm, frame.value
    heading = -item.heading_deg if frame is MeasuredFrame.Y_MIRRORED else 180 - item.heading_deg
    signs = (-item.signs[0], item.signs[1]) if with_joints else item.signs
    return replace(
        item,
        base_mm=(across * x + 0.0, up * y + 0.0),
        heading_deg=heading % 360,
        array_deg=-item.array_deg + 0.0,
        signs=signs,
    )


def explain(told: Sequence[FingerWiring], seen: Seen) -> list[Candidate]:
    """The wirings with the fewest changes that explain all that was seen, one for each that acts otherwise.

    None if none does with a few changes. Without any press or without any move several do more often.
    """
    found: list[Candidate] = []
    frames = [
        (MeasuredFrame.RIGHT, False),
        *product((MeasuredFrame.Y_MIRRORED, MeasuredFrame.X_MIRRORED), (True, False)),
    ]
    for frame, with_joints in frames:
        found += _fit(_Case(tuple(told), seen, frame, with_joints))
    found.sort(key=lambda item: item.cost)
    best = [item for item in found if item.cost < min(found[0].cost, _MAX_CHANGES) + 0.5]
    different = {item.function: item for item in reversed(best)}
    return sorted(different.values(), key=lambda item: item.cost)


@dataclass(frozen=True)
class _Case:
    """What was seen, and a frame in which the file's places may have been measured."""

    told: tuple[FingerWiring, ...]
    seen: Seen
    frame: MeasuredFrame
    with_joints: bool

    @property
    def in_frame(self) -> tuple[FingerWiring, ...]:
        """The file's fingers, from that frame."""
        return tuple(_mirror(item, self.frame, with_joints=self.with_joints) for item in self.told)

    def index(self, name: str) -> int:
        """Index of the file's finger."""
        return next(k for k, item in enumerate(self.told) if item.name == name)

    def place(self, at_mm: tuple[float, float]) -> int | None:
        """Index of the finger that stands somewhere."""
        return standing_at([item.base_mm for item in self.in_frame], at_mm)

    def presses_at(self, place: int) -> list[TipPress]:
        """Presses on the tip at a place."""
        asked = ((self.told[self.index(press.asked)].base_mm, press) for press in self.seen.presses)
        return [press for at_mm, press in asked if self.place(at_mm) == place]

    def order(self, places: Sequence[int]) -> tuple[FingerWiring, ...]:
        """The file's fingers, each at the place of another."""
        fingers = self.in_frame
        return tuple(
            replace(item, base_mm=fingers[place].base_mm, heading_deg=fingers[place].heading_deg)
            for item, place in zip(fingers, places, strict=True)
        )


def _fit(case: _Case) -> Iterator[Candidate]:
    """Wirings that explain what was seen if places were measured in the case's frame."""
    arrays, servos, count = _arrays_at(case), _servos_at(case), range(len(case.told))
    if arrays is None or servos is None:
        return
    by_array = {array: place for place, array in arrays.items()}
    by_servo = {servos[place, 0][0]: place for place in count if servos[place, 0][0] == servos[place, 1][0]}
    orders = {tuple(count), *(tuple(by.get(k, -1) for k in count) for by in (by_array, by_servo))}
    for places in sorted(order for order in orders if -1 not in order):
        base = case.order(places)
        if not case.seen.presses:  # then arrays are wherever their fingers are
            arrays = {place: k for k, place in enumerate(places)}
        if not case.seen.moves:
            servos = {(place, joint): (k, joint) for k, place in enumerate(places) for joint in (0, 1)}
        moved = [_with_servos(case, servos, item, place) for item, place in zip(base, places, strict=True)]
        choices = [
            _with_array(case, case.told[arrays[place]], item, place)
            for item, place in zip(moved, places, strict=True)
        ]
        for true in product(*choices):
            yield Candidate(case.told, base, true, case.frame, case.with_joints, places)


def _arrays_at(case: _Case) -> dict[int, int] | None:
    """Array at each place, by the file's finger; None if the frame does not explain what was seen."""
    found: dict[int, int] = {}
    for press in case.seen.presses:
        place = case.place(case.told[case.index(press.asked)].base_mm)
        if (place is None) is press.stood or len(press.arrays) > 1:
            return None
        if place is None or not press.arrays:
            continue
        array = case.index(press.arrays[0])
        if found.setdefault(place, array) != array:
            return None
    return _complete(found, list(range(len(case.told))))


def _servos_at(case: _Case) -> dict[Pair, Pair] | None:
    """Servo of each place and joint, by the file's finger and joint; likewise."""
    found: dict[Pair, Pair] = {}
    for move in case.seen.moves:
        place = None if move.base_mm is None else case.place(move.base_mm)
        if place is None or move.way is None:
            return None
        own = (case.index(move.finger), move.joint)
        if found.setdefault((place, move.way.value[0]), own) != own:
            return None
    return _complete(found, [(k, joint) for k in range(len(case.told)) for joint in (0, 1)])


def _complete(found: dict[_T, _T], every: Sequence[_T]) -> dict[_T, _T] | None:
    """The same for all, as the file says where it was not seen; None if two places have one thing."""
    if len(set(found.values())) < len(found):
        return None
    left = [item for item in every if item not in found.values()]
    unseen = [item for item in every if item not in found]
    same = {item: item for item in unseen if item in left}
    others = [item for item in unseen if item not in same], [item for item in left if item not in same]
    return found | same | dict(zip(*others, strict=True))


def _with_servos(case: _Case, servos: Mapping[Pair, Pair], item: FingerWiring, place: int) -> FingerWiring:
    """A finger at a place with the servos that move it, and their senses."""
    own = servos[place, 0], servos[place, 1]
    signs = list(item.signs)
    for move in case.seen.moves:
        source = (case.index(move.finger), move.joint)
        if source in own and move.way is not None:
            joint, sense = move.way.value
            signs[joint] = sense * case.told[source[0]].signs[source[1]]
    ids = case.told[own[0][0]].ids[own[0][1]], case.told[own[1][0]].ids[own[1][1]]
    return replace(item, ids=ids, signs=(signs[0], signs[1]))


def _with_array(case: _Case, array: FingerWiring, item: FingerWiring, place: int) -> list[FingerWiring]:
    """A finger with the file's `array` on it, in the simplest mountings that explain presses at a place."""
    presses, here = case.presses_at(place), replace(item, port=array.port)
    found: dict[int, list[FingerWiring]] = {0: [], 1: [], 2: []}
    turns = _TURNS_DEG[:1] if item.has_face else _TURNS_DEG
    flips = (False,) if item.reports_contacts else (False, True)
    for turn_deg, mirrored, inverted in product(turns, flips, flips):
        mounted = replace(
            here,
            array_deg=here.array_deg + turn_deg,
            mirrored=here.mirrored != mirrored,
            inverted=here.inverted != inverted,
        )
        if all(press_explains(array, mounted, press) for press in presses):
            found[(turn_deg != 0) + (mirrored or inverted)].append(mounted)
    return found[0] or found[1] or found[2]
