"""Emulated finger: two servos, mechanics, a tip whose skin meets the parts on the table, and its array.

A tip presses on each part that it meets as if that were alone: forces on the tip, and on its taxels, add up.
"""

import math
from collections.abc import Iterable
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.drivers.emulators.mechanics import (
    ArmTruth,
    EmulatedStage,
    FingerTruth,
)
from palpate.drivers.emulators.pad import FaceLoad, PadFace
from palpate.drivers.emulators.part import IN_PLACE, Displacement, Displacements, PointForce
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.skin import Press, Shear, Skin, SkinLoad, SkinLoads
from palpate.drivers.emulators.tip import PartSection, TipLoad, separation_mm
from palpate.drivers.tactile.description import Description
from palpate.drivers.transport.wire import Device


def facing_row_shares(row_mm: Floats, z_mm: Floats) -> Floats:
    """Share (m, rows) of each of m rays' force that rows at some heights (rows,) bear.

    `z_mm` (m, 2): from which height to which what a ray meets stands. The rows in between bear it evenly; if
    there are none, the nearest one does.
    """
    facing = (z_mm[:, :1] <= row_mm) & (row_mm <= z_mm[:, 1:])
    nearest = np.argmin(np.abs(row_mm - z_mm.mean(axis=1)[:, None]), axis=1)
    none = ~facing.any(axis=1)
    facing[none, nearest[none]] = True
    result: Floats = facing / facing.sum(axis=1, keepdims=True)
    return result


_ROUNDING_MM = 1e-9  # far above that of any place on a bench


_Place = tuple[float, ...]
"""Where a part is: shift (mm) and turn (rad)."""


class SampledArray(Device, Protocol):
    """An emulated array, whatever its protocol."""

    @property
    def description(self) -> Description:
        """The truth about its taxels."""
        ...

    def next_sample_s(self) -> float | None:
        """Instant at which it samples next, or None while it does not."""
        ...

    def sample(self, now: float, force_n: Floats) -> None:
        """Sample forces, N per taxel, shape (rows, cols)."""
        ...

    def restart(self, now: float) -> None:
        """Begin anew at `now`, as when power comes on: no stream, and nothing remembered."""
        ...


class _PartContact:
    """A finger's tip and one part: `outline`, its section as it was put, and `load`, None if they are apart.

    What they do to each other is worked out again only where one of them has moved.
    """

    def __init__(self, outline: PartSection, skin: Skin | PadFace, finger: "EmulatedFinger") -> None:
        self.outline = outline
        self.load: SkinLoad | None = None
        self._skin, self._finger = skin, finger
        self._shear: Shear | None = None
        self._sheared: Shear | None = None  # before the step
        self._free_centre = np.full(2, np.inf)
        self._free_mm = 0.0
        self._pressed_centre = np.full(2, np.inf)
        self._seen_centre: Floats | None = None
        self._displacement = IN_PLACE
        self._presses: dict[_Place, Press[SkinLoad] | None] = {}  # of this step

    def begin_step(self) -> None:
        """Let the skin be sheared as it was when the last step ended."""
        self._sheared = None if self.load is None else self._shear
        self._presses.clear()

    def free_mm(self, displacement: Displacement) -> float:
        """Distance (mm) over which the tip may certainly move without meeting the part."""
        return self._free_mm - math.dist(displacement.back(self._finger.stepped_mm), self._free_centre)

    def touch(self, displacement: Displacement) -> None:
        """Let the skin meet the part where it is now."""
        self.load = self._touch(displacement)

    def forces_on(self, displacement: Displacement) -> list[PointForce]:
        """Forces of the tip on the part at a displacement; none if it would not touch it."""
        at = self._finger.stepped_mm
        if math.dist(displacement.back(at), self._free_centre) < self._free_mm:
            return []
        found = self._press(displacement)
        return [] if found is None else found.on_part(at, displacement, self._finger.truth.height_mm)

    def _touch(self, displacement: Displacement) -> SkinLoad | None:
        # An outline that was further away than tip and part have moved since cannot have been reached.
        now_at = self._finger.stepped_mm
        if now_at is self._seen_centre and displacement is self._displacement:
            return self.load  # both stand still
        self._seen_centre, self._displacement = now_at, displacement
        centre = displacement.back(now_at)
        if math.dist(centre, self._free_centre) < self._free_mm:
            return None
        if self.load is not None and displacement.is_none and np.array_equal(centre, self._pressed_centre):
            return self.load
        self._pressed_centre = self._free_centre = centre
        self._free_mm = separation_mm(self.outline, centre) - self._skin.radius_mm
        if self._free_mm > 0:
            return None
        found = self._press(displacement)
        if found is None:
            return None
        self._shear = found.shear
        return found.load

    def _press(self, displacement: Displacement) -> Press[SkinLoad] | None:
        """Press of a part that has moved on the tip; a part that looks for its place asks for some twice."""
        place = (*displacement.shift_mm.tolist(), displacement.turn_rad)
        if place not in self._presses:
            self._presses[place] = self._press_of(displacement)
        return self._presses[place]

    def _press_of(self, displacement: Displacement) -> Press[SkinLoad] | None:
        at = self._finger.stepped_mm
        if isinstance(self._skin, PadFace):
            return self._skin.press(self.outline, at, self._finger.looks_rad, displacement)
        return self._skin.press(self.outline, at, displacement, self._sheared)


class EmulatedFinger:
    """One finger: two servos, the mechanics between them and the tip, and the array on it.

    `press` is what touches the tip now, `hardest_n` the largest force on its axis so far.
    `hardest_on_taxels_n`: the largest sum of what its taxels bear, while `weighs_taxels`, which takes time;
    two walls press against each other. `is_held`: by a hand, so that what presses on its skin does not move
    it.
    """

    def __init__(
        self,
        truth: FingerTruth | ArmTruth,
        servos: tuple[EmulatedServo, EmulatedServo],
        array: SampledArray,
        outlines: Iterable[PartSection | None],
        stage: EmulatedStage | None = None,
        tip_friction: float = 0.0,
    ) -> None:
        """`servos`: the one next to the base first. `stage`: what carries the base, None for the table.

        `outlines`: sections of the parts at the finger's height, as they were put, None of one that is lower.
        """
        self.truth = truth
        self._tip_friction = tip_friction
        self.array = array
        self.press: SkinLoad | SkinLoads | None = None
        self.hardest_n = self.hardest_on_taxels_n = 0.0
        self.weighs_taxels = self.is_held = False
        self._stage = stage
        self._mechanics = truth.mechanics(*servos)
        self._contacts = self._contacts_with(outlines)
        self._no_force_n = np.zeros((array.description.rows, array.description.cols))
        self._no_force_n.flags.writeable = False

    def put(self, outlines: Iterable[PartSection | None]) -> None:
        """Let something else, or the same elsewhere, stand on the table; nothing may touch the tip now."""
        self.servos[0].catch_up()
        self._contacts = self._contacts_with(outlines)

    @property
    def outlines(self) -> tuple[PartSection | None, ...]:
        """Sections of the parts at the finger's height, as they were put."""
        return tuple(None if contact is None else contact.outline for contact in self._contacts)

    def _contacts_with(self, outlines: Iterable[PartSection | None]) -> tuple[_PartContact | None, ...]:
        return tuple(
            None if outline is None else _PartContact(outline, self._skin_beside(outline), self)
            for outline in outlines
        )

    def _skin_beside(self, outline: PartSection) -> Skin | PadFace:
        """The skin of the disc that meets an outline, of the tip or of a ball's circle; or a pad's face."""
        if self.truth.shape.tip.has_face:
            return PadFace(self.truth.tip_radius_mm, self.truth.stiffness_n_per_mm)
        radius = self.truth.tip_radius_mm if outline.disc_mm is None else outline.disc_mm
        return Skin(radius, self.truth.stiffness_n_per_mm, self._tip_friction)

    def slip(self, by_mm: float) -> None:
        """Let the horn of its slide's servo slip; arms have none."""
        self.servos[0].catch_up()
        self._mechanics.slip(by_mm)

    @property
    def servos(self) -> tuple[EmulatedServo, EmulatedServo]:
        """The servo next to the base, and the other one."""
        return self._mechanics.servos

    @property
    def facing_rad(self) -> float:
        """True direction in W from which the array's heading counts."""
        self.servos[0].catch_up()
        return self._facing_rad

    @property
    def centre_mm(self) -> Floats:
        """True position (2,) of the tip's axis in W."""
        self.servos[0].catch_up()
        return self.stepped_mm

    @property
    def _facing_rad(self) -> float:
        return self._mechanics.facing_rad + (self._stage.at_rad if self._stage else 0.0)

    @property
    def stepped_mm(self) -> Floats:
        """`centre_mm` as mechanics have stepped it."""
        centre = self._mechanics.centre_mm
        return self._stage.place(centre) if self._stage else centre

    def step(self, dt_s: float) -> None:
        """Let servos and couplings move on by `dt_s`."""
        for contact in self._contacts:
            if contact is not None:
                contact.begin_step()
        force = None if self.press is None or self.is_held else self.press.force_n
        if force is not None and self._stage:
            force = self._stage.back(force)
        self._mechanics.step(dt_s, force)

    def free_steps(self, dt_s: float, most: int, displacements: Displacements) -> int:
        """Number of steps of `dt_s` (at most so many) that certainly do not let the tip meet a part."""
        within_mm = math.inf
        for contact, displacement in zip(self._contacts, displacements, strict=True):
            if contact is not None:
                within_mm = min(within_mm, contact.free_mm(displacement))
        steps = most
        while steps and not self._reach_mm(dt_s, steps) + _ROUNDING_MM < within_mm:
            steps //= 2
        return steps

    def _reach_mm(self, dt_s: float, steps: int) -> float:
        reach = self._mechanics.reach_mm(dt_s, steps)
        if self._stage is None:
            return reach
        return reach + self._stage.reach_mm(dt_s, steps, self.stepped_mm)

    def run(self, dt_s: float, steps: int) -> None:
        """So many times `step`, within `free_steps` and the servos' `quiet_steps`."""
        self._mechanics.run(dt_s, steps)

    def touch(self, displacements: Displacements) -> None:
        """Let the skin meet the parts where they are now."""
        loads = []
        for contact, displacement in zip(self._contacts, displacements, strict=True):
            if contact is not None:
                contact.touch(displacement)
                loads += [] if contact.load is None else [contact.load]
        self.press = None if not loads else loads[0] if len(loads) == 1 else SkinLoads(tuple(loads))
        if self.press is not None:
            self.hardest_n = max(self.hardest_n, float(np.hypot(*self.press.force_n)))
            if self.weighs_taxels:
                self.hardest_on_taxels_n = max(self.hardest_on_taxels_n, float(self.press.on_skin_n.sum()))

    def forces_on(self, number: int, displacement: Displacement) -> list[PointForce]:
        """Forces of the tip on a part at a displacement; none if it would not touch it."""
        contact = self._contacts[number]
        return [] if contact is None else contact.forces_on(displacement)

    def sample(self, now: float) -> None:
        """Hand the array the forces on its taxels at `now`."""
        force_n = self._no_force_n
        for contact in self._contacts:
            if contact is not None and contact.load is not None:
                force_n = force_n + self._taxels(contact.load, contact.outline)
        self.array.sample(now, force_n)

    @property
    def looks_rad(self) -> float:
        """Direction in which the array's middle looks, in W, as mechanics have stepped it."""
        return self._facing_rad + self.truth.array_heading_rad

    def _taxels(self, touch: SkinLoad, outline: PartSection) -> Floats:
        """Force (rows, cols) N on each taxel, column by column, shared by the rows below the top."""
        if isinstance(touch, TipLoad):
            return self._taxels_of_rays(touch, outline)
        assert isinstance(touch, FaceLoad)
        by_column = touch.by_column_n(np.asarray(self.array.description.columns))
        below = self._row_mm <= outline.top_mm
        result: Floats = (below / max(int(below.sum()), 1))[:, None] * by_column
        return result

    @property
    def _row_mm(self) -> Floats:
        """Heights (rows,) of the array's rows, whose middle is the tip's."""
        heights = np.asarray(self.array.description.row_heights_mm)
        result: Floats = heights + (self.truth.height_mm - float(heights.mean()))
        return result

    def _taxels_of_rays(self, touch: TipLoad, outline: PartSection) -> Floats:
        """The same of a round tip: rays sorted into columns."""
        d = self.array.description
        columns = np.asarray(d.columns)
        pitch = columns[1] - columns[0]
        middle = self.looks_rad
        seen = wrap_angle(touch.angle - middle)
        slot = np.floor((seen - columns[0]) / pitch + 0.5).astype(np.int64)
        on_array = (slot >= 0) & (slot < d.cols)
        on_skin = touch.on_skin_n
        by_column = np.bincount(slot[on_array], on_skin[on_array], minlength=d.cols)
        below = self._row_mm <= outline.top_mm
        z_mm = touch.contact.heights_mm
        if z_mm is None:
            rows = below / max(int(below.sum()), 1)
            result: Floats = rows[:, None] * by_column
            return result
        facing = facing_row_shares(self._row_mm, z_mm[on_array])
        found = np.zeros((d.rows, d.cols))
        np.add.at(found.T, slot[on_array], facing * on_skin[on_array, None])
        return found
