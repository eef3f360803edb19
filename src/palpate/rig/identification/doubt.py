"""Doubt of the set-up: rigs wrong in one thing that explain the contacts of a run which fits nothing.

What servos and arrays said is worked out again for rigs that are not as their file says, and recognised in
the same catalogue, with the same bounds. What explains every contact is a hint beside the verdict and never
an answer: the part may be none of the catalogue, and a part that is larger on one side looks like a finger
that stands nearer. So what may have any value is only looked for where other fingers agree without the
finger in question, and of no other; and nothing is said where much would explain the contacts.
"""

import math
from collections.abc import Callable, Container, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import rotate
from palpate.base.vocabulary import IdentificationVerdict, SetUpFault
from palpate.calibration.finger_doubt import (
    SIZE_FACTORS,
    TRAVEL_FACTORS,
    rotary_joints,
    with_offset,
    with_sign,
    with_tip,
    with_travel,
)
from palpate.config import FingerConfig, RigFile
from palpate.config.rig_servos import RotaryConfig
from palpate.drivers.kinematics import FingerKinematics, Line, Turn
from palpate.recognizer import (
    Budget,
    Catalogue,
    Contact,
    Motion,
    NormalRange,
    Recognition,
    contact_after_motion,
    recognise,
)
from palpate.rig.conversion import finger_of
from palpate.rig.fingers import Stage
from palpate.rig.identification.outcome import Identification
from palpate.rig.mechanisms import kinematics_of
from palpate.rig.motion.touch import Touch

_MIN_GRIPS, _MIN_CONTACTS = 3, 6  # fewer are explained by something too often
_MIN_OF_ARRAY = 10  # the same, without a finger's normals
_MIN_OTHERS, _MIN_OWN = 7, 3  # contacts of other fingers and of one that is doubted alone
_MOST_SUSPECTS = 2  # fingers without any of which the others agree: more contradict too little
_MAX_DOUBTS = 3  # what more set-ups explain says nothing of any
_MAX_STATES, _MAX_STATES_OF_TIPS = 150, 40  # of a catalogue: more take longer than is worth a hint
_FINEST_MM = 0.3  # to which values are looked for
_MAX_TRIALS = 64  # for one value
_STARTS = 8  # parts of a range that are looked at first
_ROUNDING = 1.02, 0.02  # share, mm: of how far contacts move within a small interval of a value
_OFFSET_MM, _OFFSET_RAD = 10.0, math.radians(20.0)


@dataclass(frozen=True)
class SetUpDoubt:
    """A rig, wrong in one thing, that explains all `explains` contacts of a run.

    `finger`: its name, None: of all. `joint`: which of its servos. `value`: from, to: by how much a joint is
    off (mm or rad), an array is turned (rad), or the factor of a size or travel.
    """

    what: SetUpFault
    finger: str | None
    explains: int
    joint: str | None = None
    value: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class _Mounting:
    """A finger as it may really be: its table, and its array mirrored or turned on its tip, or anyhow."""

    spec: FingerConfig
    mirrored: bool = False
    turned_rad: float = 0.0
    measures_normals: bool = True

    @cached_property
    def kinematics(self) -> FingerKinematics:
        return kinematics_of(self.spec)

    def at_tip(self, off_mm: Floats, told_rad: float, real_rad: float) -> Floats:
        """Offsets (n, 2) from the tip's centre, of a finger that faces `real_rad` instead of `told_rad`."""
        off = rotate(off_mm, np.array(-told_rad)) * ([1.0, -1.0] if self.mirrored else 1.0)
        return rotate(off, np.array(real_rad + self.turned_rad))

    def normal(self, told: NormalRange | None, told_rad: float, real_rad: float) -> NormalRange | None:
        """A range of normals of such a finger."""
        if told is None or not self.measures_normals:
            return None
        lo, hi = told.lo_rad - told_rad, told.hi_rad - told_rad
        lo, hi = (-hi, -lo) if self.mirrored else (lo, hi)
        return NormalRange(lo + real_rad + self.turned_rad, hi + real_rad + self.turned_rad)


@dataclass(frozen=True, eq=False)
class _WrongSetUp:
    """A rig that is wrong in one thing, as its fingers may really be."""

    what: SetUpFault
    finger: str | None
    fingers: Sequence[_Mounting]
    joint: str | None = None
    value: float | None = None

    @property
    def shared_by(self) -> str | None:
        """The finger that must have touched what others touched, too."""
        return self.finger if self.what in (SetUpFault.TIP_SIZE, SetUpFault.TRAVEL_SCALE) else None

    def doubt(self, explains: int) -> SetUpDoubt:
        """The doubt, if it explains as many contacts."""
        value = None if self.value is None else (self.value, self.value)
        return SetUpDoubt(self.what, self.finger, explains, self.joint, value)


def doubt_set_up(rig: RigFile, catalogue: Catalogue, result: Identification) -> tuple[SetUpDoubt, ...]:
    """Wrong set-ups that explain all contacts of a run; none if something of the catalogue fits, too few
    contacts were made, or too much would explain them.
    """
    if result.outcome not in (IdentificationVerdict.UNKNOWN, IdentificationVerdict.MOVING):
        return ()
    return _Doubter(rig, catalogue, result).doubts()


class _Doubter:
    """Contacts of a run, and what explains them."""

    def __init__(self, rig: RigFile, catalogue: Catalogue, result: Identification) -> None:
        self._rig, self._catalogue = rig, catalogue
        self._told = [_Mounting(spec) for spec in rig.fingers]
        self._touches = list(_touches_in_place(result))
        self._budget = Budget(rig.search.budget)

    def doubts(self) -> tuple[SetUpDoubt, ...]:
        """As `doubt_set_up` has it."""
        grips = {number for number, touch, _ in self._touches if touch.contact.touched}
        if len(grips) < _MIN_GRIPS or self._count() < _MIN_CONTACTS:
            return ()
        if len(self._catalogue.states) > _MAX_STATES or self._explains(self._told):
            return ()
        known = self._others
        if len(known) > _MOST_SUSPECTS:
            return ()
        found = self._of_few_ways({None, *(self._rig.fingers[k].name for k in known)})
        for k, others in known.items() if len(known) == 1 else ():
            if self._count() - self._count(k) >= _MIN_OTHERS and self._count(k) >= _MIN_OWN:
                found += self._offsets(k, others) or ([] if found else self._finger(k, others))
        return tuple(found) if len(found) <= _MAX_DOUBTS else ()

    def _of_few_ways(self, suspects: Container[str | None]) -> list[SetUpDoubt]:
        """Set-ups that are wrong in what has few ways, at one of the suspect fingers, or at all (None)."""
        found: list[SetUpDoubt] = []
        for item in _wrong_set_ups(self._rig):
            if item.finger not in suspects:
                continue
            if item.what is SetUpFault.TIP_SIZE and len(self._catalogue.states) > _MAX_STATES_OF_TIPS:
                continue  # their edges would have to be grown first
            if item.what is SetUpFault.ARRAY and not self._array_is_in_doubt(item.finger, found):
                continue
            if self._explains(item.fingers, item.shared_by):
                found.append(item.doubt(self._count()))
        return found

    def _array_is_in_doubt(self, finger: str | None, found: Sequence[SetUpDoubt]) -> bool:
        """Return whether more than one contact's normal is wrong, and nothing found explains it."""
        if len(self._others) != (finger is not None) or self._count() < _MIN_OF_ARRAY:
            return False
        if any(finger in (None, doubt.finger) for doubt in found):
            return False
        return not recognise(self._catalogue, self._contacts(self._told), 1, self._budget).hypotheses

    def _count(self, finger: int | None = None) -> int:
        """Touches that met something, of one finger or of all."""
        return sum(
            touch.contact.touched and finger in (None, touch.finger_index) for _, touch, _ in self._touches
        )

    def _contacts(self, fingers: Sequence[_Mounting], some: Sequence[int] | None = None) -> list[Contact]:
        """All contacts, or those of some fingers (indices), if the fingers are so."""
        stage, found = Stage.of(self._rig), []
        for _, touch, moved in self._touches:
            k = touch.finger_index
            if some is None or k in some:
                turn = stage.planned_turn(touch.stage_rad)
                contacts = _contacts_seen(touch, self._told[k], fingers[k], turn)
                found += [self._carry(contact, moved) for contact in contacts]
        return found

    def _carry(self, contact: Contact, moved: tuple[float, float]) -> Contact:
        """A contact of a part that may have moved since by (mm, rad)."""
        if not any(moved):
            return contact
        states = np.arange(len(self._catalogue.states))
        motion = Motion(np.full(len(states), moved[0]), np.full(len(states), moved[1]))
        return contact_after_motion(motion, self._catalogue, contact, states)

    def _explains(self, fingers: Sequence[_Mounting], shared_by: str | None = None) -> bool:
        found = recognise(self._catalogue, self._contacts(fingers), budget=self._budget)
        return _has_witness(found) and (shared_by is None or _shares_edges(found, shared_by))

    @cached_property
    def _others(self) -> dict[int, Recognition]:
        """What the others' contacts leave, of each finger without which they agree."""
        found = {}
        for k in range(len(self._told)):
            others = [j for j in range(len(self._told)) if j != k]
            left = recognise(self._catalogue, self._contacts(self._told, others), budget=self._budget)
            if _has_witness(left):
                found[k] = left
        return found

    def _finger(self, k: int, known: Recognition) -> list[SetUpDoubt]:
        """A finger that contradicts all others, on edges that they touched, too."""
        name = self._rig.fingers[k].name
        near = [
            replace(item, position_bound_mm=_OFFSET_MM, path_bound_mm=_OFFSET_MM, normal=None)
            for item in self._contacts(self._told, [k])
        ]
        if not _shares_edges(known.extend(near), name):
            return []
        return [SetUpDoubt(SetUpFault.FINGER, name, self._count() - self._count(k))]

    def _offsets(self, k: int, known: Recognition) -> list[SetUpDoubt]:
        """Offsets of a finger's joints with which it agrees with the others."""
        spec, fits = self._rig.fingers[k], dict[str, tuple[float, float]]()
        for joint, servo in spec.servos.items():
            turns = isinstance(servo, RotaryConfig)
            half = _OFFSET_RAD if turns else _OFFSET_MM
            value = self._fit(known, k, partial(with_offset, spec, joint), (-half, half))
            if value is not None:
                fits[joint] = value
        if any(lo <= 0 <= hi for lo, hi in fits.values()):
            return []
        return [
            SetUpDoubt(SetUpFault.JOINT_OFFSET, spec.name, self._count(), joint, value)
            for joint, value in fits.items()
        ]

    def _fit(
        self,
        known: Recognition,
        k: int,
        change: Callable[[float], FingerConfig],
        within: tuple[float, float],
    ) -> tuple[float, float] | None:
        """Values between which all lie that make a finger agree with what is known; None if none does.

        All values, if those that agree are too many, or do what a part does that is larger on one side.
        Intervals are halved as long as contacts, widened by what an interval moves them, agree.
        """

        def contacts(value: float) -> list[Contact]:
            return self._contacts([*self._told[:k], _Mounting(change(value)), *self._told[k + 1 :]], [k])

        ends, name = np.linspace(*within, _STARTS + 1).tolist(), self._rig.fingers[k].name
        told = self._contacts(self._told, [k])
        left, found, trials = list(pairwise(ends)), list[tuple[float, float]](), 0
        while left and trials < _MAX_TRIALS:
            lo, hi = left.pop()
            trials += 1
            wide, moved_mm = _over_interval(contacts((lo + hi) / 2), contacts(lo), contacts(hi))
            both = known.extend(wide)
            if not both.hypotheses:
                continue
            if moved_mm >= _FINEST_MM:
                left += [(lo, (lo + hi) / 2), ((lo + hi) / 2, hi)]
            elif _is_across(told, contacts((lo + hi) / 2)) or _shares_edges(both, name):
                found.append((lo, hi))
            else:
                return -math.inf, math.inf
        if left:
            return -math.inf, math.inf
        return None if not found else (min(lo for lo, _ in found), max(hi for _, hi in found))


def _has_witness(found: Recognition) -> bool:
    return any(item.verified for item in found.hypotheses)


def _shares_edges(found: Recognition, finger: str) -> bool:
    """Return whether a finger touched an edge, or a vertex, that another one touched, too, in any case.

    Only then is its contradicting them not as well explained by a part that is different on its side.
    """
    names = [contact.name for contact in found.contacts if contact.touched]
    for row in (row for item in found.hypotheses for row in item.features):
        paired = [(name, at) for name, at in zip(names, row, strict=True) if at is not None]
        if not {at for name, at in paired if name == finger} & {at for name, at in paired if name != finger}:
            return False
    return bool(found.hypotheses)


def _is_across(told: Sequence[Contact], real: Sequence[Contact]) -> bool:
    """Return whether contacts are elsewhere rather across their ways than along them.

    That is not what a part does that is larger or smaller on one side.
    """
    for one, other in zip(told, real, strict=True):
        x, y = np.subtract(other.end_mm, one.end_mm)
        along = x * math.cos(one.direction_rad) + y * math.sin(one.direction_rad)
        if one.touched and abs(along) > math.hypot(x, y) / 2:
            return False
    return True


def _touches_in_place(result: Identification) -> Iterator[tuple[int, Touch, tuple[float, float]]]:
    """Every touch with the number of its grip, and how far (mm, rad) the part may have been moved since.

    Latest first: what the part may have moved since widens a contact, and wide ones that are paired first
    cost a recognition a hundred times as much. Without those before a motion that has no bound, and without
    touches that were only made again: they say nothing new of the set-up.
    """
    again = {item.repeated_in for item in result.contradictions}
    motions = result.motions or ((0.0, 0.0),) * len(result.grips)
    for number, grip in reversed(list(enumerate(result.grips))):
        since = motions[number:]
        known = [item for item in since if item is not None]
        if len(known) == len(since) and number + 1 not in again:
            moved = sum(item[0] for item in known), sum(item[1] for item in known)
            yield from ((number, touch, moved) for touch in grip)


def _contacts_seen(touch: Touch, told: _Mounting, real: _Mounting, turn: Turn) -> list[Contact]:
    """What the contacts of a touch are, if the finger is not as it was told.

    Servos stood as they did. What its skin was dented by, and where its array was touched, goes with the tip.
    A way that is no straight one then is known as much less as it is bent.
    """
    contact, point = touch.contact, turn.point_mm
    begin, end = (turn.line_back(Line(at, 0.0)).start_mm for at in (contact.start_mm, contact.end_mm))
    if contact.touched:
        end = told.kinematics.centre_mm(touch.servos)
    way, far = Line(begin, math.atan2(end[1] - begin[1], end[0] - begin[0])), math.dist(begin, end)
    servos = [told.kinematics.servos_rad(way, share * far) for share in (0.0, 0.5, 1.0)]
    if contact.touched:
        servos[2] = touch.servos
    if np.isnan(servos).any():
        return []
    real_way = np.array([point(real.kinematics.centre_mm(item)) for item in servos])
    bent_mm = float(np.hypot(*(real_way[1] - (real_way[0] + real_way[2]) / 2)))
    facing = [finger.kinematics.facing_rad(servos[2]) + turn.angle_rad for finger in (told, real)]
    found = []
    for item in touch.evidence:
        offs = np.subtract([item.start_mm, item.end_mm], [contact.start_mm, point(end)])
        (x0, y0), (x1, y1) = (real_way[[0, 2]] + real.at_tip(offs, *facing)).tolist()
        moved = replace(
            item,
            finger=finger_of(real.spec) if item.finger == finger_of(told.spec) else item.finger,
            start_mm=(x0, y0),
            end_mm=(x1, y1),
            normal=real.normal(item.normal, *facing),
            path_bound_mm=item.free_path_bound_mm + bent_mm,
        )
        found.append(moved)
    return found


def _over_interval(
    middle: Sequence[Contact], first: Sequence[Contact], last: Sequence[Contact]
) -> tuple[list[Contact], float]:
    """Contacts widened to those at both ends of an interval, and by how many mm at most."""
    share, least_mm = _ROUNDING
    wide, most = [], 0.0
    for item, *ends in zip(middle, first, last, strict=True):
        at = share * max(math.dist(item.end_mm, other.end_mm) for other in ends) + least_mm
        before = share * max(math.dist(item.start_mm, other.start_mm) for other in ends) + least_mm
        normal, most = item.normal, max(most, at)
        if normal is not None:
            turned = share * max(abs(normal.lo_rad - e.normal.lo_rad) for e in ends if e.normal is not None)
            lo, hi = normal.lo_rad - turned, normal.hi_rad + turned
            normal = NormalRange(lo, hi) if hi - lo < 2 * math.pi else None
        bound, path = item.position_bound_mm + at, item.free_path_bound_mm + max(at, before)
        wide.append(replace(item, position_bound_mm=bound, path_bound_mm=path, normal=normal))
    return wide, most


def _wrong_set_ups(rig: RigFile) -> Iterator[_WrongSetUp]:
    """Rigs that are wrong in one thing of which there are few ways."""
    specs = rig.fingers
    every = [_Mounting(spec) for spec in specs]

    def each(
        what: SetUpFault, changed: Sequence[_Mounting], joint: str | None = None, value: float | None = None
    ) -> Iterator[_WrongSetUp]:
        """Each finger alone, and all of them."""
        for k, spec in enumerate(specs if len(specs) > 1 else ()):
            fingers = [*every[:k], changed[k], *every[k + 1 :]]
            yield _WrongSetUp(what, spec.name, fingers, joint, value)
        yield _WrongSetUp(what, None, changed, joint, value)

    yield from each(SetUpFault.ARRAY_MIRRORED, [_Mounting(spec, mirrored=True) for spec in specs])
    for turned in (math.pi / 2, math.pi, -math.pi / 2):
        fingers = [_Mounting(spec, turned_rad=turned) for spec in specs]
        yield from each(SetUpFault.ARRAY_TURNED, fingers, None, turned)
    yield from each(SetUpFault.ARRAY, [_Mounting(spec, measures_normals=False) for spec in specs])
    for joint in dict.fromkeys(joint for spec in specs for joint in rotary_joints(spec)):
        yield from each(SetUpFault.JOINT_SIGN, [_Mounting(with_sign(spec, joint)) for spec in specs], joint)
    for mirror in (_mirror, lambda spec: _with_signs(_mirror(spec))):
        yield _WrongSetUp(SetUpFault.FRAME_MIRRORED, None, [_Mounting(mirror(spec)) for spec in specs])
    for factor in SIZE_FACTORS:
        fingers = [_Mounting(with_tip(spec, factor)) for spec in specs]
        yield from each(SetUpFault.TIP_SIZE, fingers, None, factor)
    for factor in TRAVEL_FACTORS:
        fingers = [_Mounting(with_travel(spec, factor)) for spec in specs]
        yield from each(SetUpFault.TRAVEL_SCALE, fingers, None, factor)


def _with_signs(spec: FingerConfig) -> FingerConfig:
    for joint in rotary_joints(spec):
        spec = with_sign(spec, joint)
    return spec


def _mirror(spec: FingerConfig) -> FingerConfig:
    """The finger in a frame whose y axis points the other way."""
    x, y = spec.base_mm
    return spec.model_copy(update={"base_mm": (x, -y), "heading_deg": -spec.heading_deg})
