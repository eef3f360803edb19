"""The emulated bench: fingers, a table and the part on it, in one common time.

Joins the emulated servos and arrays. Every device calls `Bench.advance` before it answers; the bench then
lets the mechanics catch up in steps of one millisecond, then what stands on the table, and hands every
streaming array its samples. A turning stage, if any, carries all fingers.
"""

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.base.tips import TipShape
from palpate.drivers.emulators.mechanics import (
    ArmTruth,
    EmulatedStage,
    FingerTruth,
)
from palpate.drivers.emulators.pad import FaceLoad, PadFace
from palpate.drivers.emulators.part import IN_PLACE, Displacement, Part, PointForce, StillPart
from palpate.drivers.emulators.servo import EmulatedServo
from palpate.drivers.emulators.skin import Press, Shear, Skin, SkinLoad
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


_STEP_S = 1e-3
_MAX_STEPS = 64
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


class EmulatedFinger:
    """One finger: two servos, the mechanics between them and the tip, and the array on it.

    `outline` is the section of what stands on the table at the finger's height, as it was put, None for
    nothing. `press` is what touches the tip now, `hardest_n` the largest force on its axis so far.
    `hardest_on_taxels_n`: the largest sum of what its taxels bear, while `weighs_taxels`, which takes time;
    two walls press against each other. `is_held`: by a hand, so that what presses on its skin does not move
    it.
    """

    def __init__(
        self,
        truth: FingerTruth | ArmTruth,
        servos: tuple[EmulatedServo, EmulatedServo],
        array: SampledArray,
        outline: PartSection | None,
        stage: EmulatedStage | None = None,
        tip_friction: float = 0.0,
    ) -> None:
        """`servos`: the one next to the base first. `stage`: what carries the base, None for the table."""
        self.truth = truth
        self._tip_friction = tip_friction
        self._shear: Shear | None = None
        self._sheared: Shear | None = None  # before the step
        self.outline = outline
        self._skin = self._skin_beside(outline)
        self.array = array
        self.press: SkinLoad | None = None
        self.hardest_n = self.hardest_on_taxels_n = 0.0
        self.weighs_taxels = self.is_held = False
        self._stage = stage
        self._mechanics = truth.mechanics(*servos)
        self._free_centre = np.full(2, np.inf)
        self._free_mm = 0.0
        self._pressed_centre = np.full(2, np.inf)
        self._seen_centre: Floats | None = None
        self._displacement = IN_PLACE
        self._loads: dict[_Place, Press[SkinLoad] | None] = {}  # of this step
        self._no_force_n = np.zeros((array.description.rows, array.description.cols))
        self._no_force_n.flags.writeable = False

    def put(self, outline: PartSection | None) -> None:
        """Let something else, or the same elsewhere, stand on the table; nothing may touch the tip now."""
        self.servos[0].catch_up()
        self.outline = outline
        self._skin = self._skin_beside(outline)
        self._free_centre = np.full(2, np.inf)
        self._seen_centre = None
        self._shear = self._sheared = None
        self._loads.clear()

    def _skin_beside(self, outline: PartSection | None) -> Skin | PadFace:
        """The skin of the disc that meets an outline, of the tip or of a ball's circle; or a pad's face."""
        if self.truth.shape.tip.has_face:
            return PadFace(self.truth.tip_radius_mm, self.truth.stiffness_n_per_mm)
        disc = None if outline is None else outline.disc_mm
        radius = self.truth.tip_radius_mm if disc is None else disc
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
        self._sheared = None if self.press is None else self._shear
        self._loads.clear()
        force = None if self.press is None or self.is_held else self.press.force_n
        if force is not None and self._stage:
            force = self._stage.back(force)
        self._mechanics.step(dt_s, force)

    def free_steps(self, dt_s: float, most: int, displacement: Displacement) -> int:
        """Number of steps of `dt_s` (at most so many) that certainly do not let the tip meet the part."""
        within_mm = math.inf
        if self.outline is not None:
            within_mm = self._free_mm - math.dist(displacement.back(self.stepped_mm), self._free_centre)
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

    def touch(self, displacement: Displacement) -> None:
        """Let the skin meet the part where it is now."""
        self.press = None if self.outline is None else self._touch(self.outline, displacement)
        if self.press is not None:
            self.hardest_n = max(self.hardest_n, float(np.hypot(*self.press.force_n)))
            if self.weighs_taxels:
                self.hardest_on_taxels_n = max(self.hardest_on_taxels_n, float(self.press.on_skin_n.sum()))

    def forces_on(self, displacement: Displacement) -> list[PointForce]:
        """Forces of the tip on the part at a displacement; none if it would not touch it."""
        if self.outline is None:
            return []
        if math.dist(displacement.back(self.stepped_mm), self._free_centre) < self._free_mm:
            return []
        found = self._load(self.outline, displacement)
        return [] if found is None else found.on_part(self.stepped_mm, displacement, self.truth.height_mm)

    def sample(self, now: float) -> None:
        """Hand the array the forces on its taxels at `now`."""
        if self.press is None or self.outline is None:
            self.array.sample(now, self._no_force_n)
        else:
            self.array.sample(now, self._taxels(self.press, self.outline))

    def _touch(self, outline: PartSection, displacement: Displacement) -> SkinLoad | None:
        # An outline that was further away than tip and part have moved since cannot have been reached.
        now_at = self.stepped_mm
        if now_at is self._seen_centre and displacement is self._displacement:
            return self.press  # both stand still
        self._seen_centre, self._displacement = now_at, displacement
        centre = displacement.back(now_at)
        if math.dist(centre, self._free_centre) < self._free_mm:
            return None
        if self.press is not None and displacement.is_none and np.array_equal(centre, self._pressed_centre):
            return self.press
        self._pressed_centre = self._free_centre = centre
        self._free_mm = separation_mm(outline, centre) - self._skin.radius_mm
        if self._free_mm > 0:
            return None
        found = self._load(outline, displacement)
        if found is None:
            return None
        self._shear = found.shear
        return found.load

    def _load(self, outline: PartSection, displacement: Displacement) -> Press[SkinLoad] | None:
        """Load of a part that has moved on the tip; a part that looks for its place asks for some twice."""
        place = (*displacement.shift_mm.tolist(), displacement.turn_rad)
        if place not in self._loads:
            self._loads[place] = self._press_of(outline, displacement)
        return self._loads[place]

    def _press_of(self, outline: PartSection, displacement: Displacement) -> Press[SkinLoad] | None:
        if isinstance(self._skin, PadFace):
            return self._skin.press(outline, self.stepped_mm, self._looks_rad, displacement)
        return self._skin.press(outline, self.stepped_mm, displacement, self._sheared)

    @property
    def _looks_rad(self) -> float:
        """Direction in which the array's middle looks, in W."""
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
        middle = self._looks_rad
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


class Bench:
    """All fingers round one table, in one time, and `part`, which stands on it.

    `happenings`: what is to happen at which instants (s), in their order. `supply`: called in each step, sets
    the servos' supply; None: it stays as it is.
    """

    def __init__(
        self,
        fingers: Sequence[EmulatedFinger],
        stage: EmulatedStage | None = None,
        part: Part | None = None,
    ) -> None:
        """`part`: how what stands on the table moves, None: not at all."""
        self.fingers = tuple(fingers)
        self.stage = stage
        self.part = part or StillPart()
        self.servos = [servo for finger in self.fingers for servo in finger.servos]
        self.servos += [] if stage is None else [stage.servo]
        for servo in self.servos:
            servo.lag(self.catch_up)
        self._steps = self._due = self._free = 0
        self._now = -math.inf
        self.happenings: list[tuple[float, Callable[[], None]]] = []
        self.supply: Callable[[], None] | None = None

    def put(
        self,
        section_at: Callable[[float, float, float, TipShape], PartSection | None],
        part: Part | None = None,
    ) -> None:
        """Let something else stand on the table; nothing may touch a tip now.

        `section_at`: its section in W, as it is put, beside a tip with its middle at a height (mm), half of
        its length, its radius and its shape.
        """
        self.catch_up()
        self.part = part or StillPart()
        for finger in self.fingers:
            truth = finger.truth
            finger.put(section_at(truth.height_mm, truth.half_length_mm, truth.tip_radius_mm, truth.shape))

    def advance(self, now: float) -> None:
        """Let the world go on to `now` (s), which never runs backwards.

        Mechanics move in whole steps; arrays sample at their own instants what the last step left. As long as
        no tip can meet the part and nothing else can happen, arrays sample no force, and mechanics lag behind
        until they are looked at.
        """
        if now <= self._now:
            return  # devices ask several times at one instant
        while self.happenings and self.happenings[0][0] <= now:
            at, happens = self.happenings.pop(0)
            if at > self._now:
                self.advance(at)
            happens()
        self._now = now
        self._due = int(now / _STEP_S + 1e-6)
        while self._due > self._steps + self._free:
            self._run(self._free)
            self._free = self._free_steps()
            if not self._free:
                self._step()
        self._sample_until(max(now, self._due * _STEP_S))

    def catch_up(self) -> None:
        """Let mechanics that lag behind step to the instant to which the world has gone on.

        What is done to a servo or to the part now may end their free motion.
        """
        if self._free:
            self._run(self._due - self._steps)
            self._free = 0

    def _free_steps(self) -> int:
        """Number of steps that can be taken at once: none lets a tip meet the part, the last may end
        otherwise.
        """
        if not self.part.at_rest or any(finger.press is not None for finger in self.fingers):
            return 0
        if self.supply is not None:
            return 0  # it follows what motors take in each step
        steps = min(servo.quiet_steps(_STEP_S) for servo in self.servos)
        steps = min(steps, _MAX_STEPS)
        for finger in self.fingers:
            steps = finger.free_steps(_STEP_S, steps, self.part.displacement)
        return steps

    def _run(self, steps: int) -> None:
        """Take free steps: as so many times `_step`."""
        if steps <= 0:
            return
        self._steps += steps
        self._free -= steps
        self._sample_until(self._steps * _STEP_S)
        if self.stage is not None:
            self.stage.run(_STEP_S, steps)
        for finger in self.fingers:
            finger.run(_STEP_S, steps)
        if self.supply is not None:
            self.supply()
        self.part.step(self._tip_forces, False, _STEP_S)

    def _step(self) -> None:
        self._steps += 1
        self._sample_until(self._steps * _STEP_S)
        if self.stage is not None:
            self.stage.step(_STEP_S, self._torque_nm(self.stage))
        if self.supply is not None:
            self.supply()
        for finger in self.fingers:
            finger.step(_STEP_S)
            finger.touch(self.part.displacement)
        self._push(_STEP_S)

    def _push(self, dt_s: float) -> None:
        """Let tips push the part, and meet it where it is then."""
        before = self.part.displacement
        self.part.step(self._tip_forces, any(finger.press is not None for finger in self.fingers), dt_s)
        if self.part.displacement is not before:
            for finger in self.fingers:
                finger.touch(self.part.displacement)

    def _tip_forces(self, displacement: Displacement) -> list[PointForce]:
        return [force for finger in self.fingers for force in finger.forces_on(displacement)]

    def _torque_nm(self, stage: EmulatedStage) -> float:
        """Torque of all touched tips on the ring."""
        return sum(
            stage.torque_nm(finger.stepped_mm, finger.press.force_n)
            for finger in self.fingers
            if finger.press is not None
        )

    def _sample_until(self, now: float) -> None:
        for finger in self.fingers:
            array = finger.array
            while (due := array.next_sample_s()) is not None and due <= now:
                finger.sample(due)
