"""The emulated bench: fingers, a table and the parts on it, in one common time.

Joins the emulated servos and arrays. Every device calls `Bench.advance` before it answers; the bench then
lets the mechanics catch up in steps of one millisecond, then what stands on the table, and hands every
streaming array its samples. A turning stage, if any, carries all fingers.
"""

import math
from collections.abc import Callable, Iterable, Sequence

from palpate.base.tips import TipShape
from palpate.drivers.emulators.finger import EmulatedFinger
from palpate.drivers.emulators.mechanics import EmulatedStage
from palpate.drivers.emulators.part import Displacements, Parts, PointForce, StillParts
from palpate.drivers.emulators.tip import PartSection

_STEP_S = 1e-3
_MAX_STEPS = 64


class Bench:
    """All fingers round one table, in one time, and `parts`, which stand on it.

    `happenings`: what is to happen at which instants (s), in their order. `supply`: called in each step, sets
    the servos' supply; None: it stays as it is.
    """

    def __init__(
        self,
        fingers: Sequence[EmulatedFinger],
        stage: EmulatedStage | None = None,
        parts: Parts | None = None,
    ) -> None:
        """`parts`: how what stands on the table moves; None: nothing stands there."""
        self.fingers = tuple(fingers)
        self.stage = stage
        self.parts = parts or StillParts(0)
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
    ) -> None:
        """Let one other thing stand on the table, and stay there; nothing may touch a tip now.

        `section_at`: its section in W, as it is put, beside a tip with its middle at a height (mm), half of
        its length, its radius and its shape.
        """
        truths = [finger.truth for finger in self.fingers]
        self.put_beside(
            [
                section_at(truth.height_mm, truth.half_length_mm, truth.tip_radius_mm, truth.shape)
                for truth in truths
            ]
        )

    def put_beside(self, outlines: Iterable[PartSection | None]) -> None:
        """Let one other thing stay there, with such a section in W beside each finger, None for none."""
        self.catch_up()
        self.parts = StillParts(1)
        for finger, outline in zip(self.fingers, outlines, strict=True):
            finger.put([outline])

    def advance(self, now: float) -> None:
        """Let the world go on to `now` (s), which never runs backwards.

        Mechanics move in whole steps; arrays sample at their own instants what the last step left. As long as
        no tip can meet a part and nothing else can happen, arrays sample no force, and mechanics lag behind
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

        What is done to a servo or to a part now may end their free motion.
        """
        if self._free:
            self._run(self._due - self._steps)
            self._free = 0

    def _free_steps(self) -> int:
        """Number of steps that can be taken at once: none lets a tip meet a part, the last may end
        otherwise.
        """
        if not self.parts.at_rest or any(finger.press is not None for finger in self.fingers):
            return 0
        if self.supply is not None:
            return 0  # it follows what motors take in each step
        steps = min(servo.quiet_steps(_STEP_S) for servo in self.servos)
        steps = min(steps, _MAX_STEPS)
        for finger in self.fingers:
            steps = finger.free_steps(_STEP_S, steps, self.parts.displacements)
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
        self.parts.step(self._tip_forces, False, _STEP_S)

    def _step(self) -> None:
        self._steps += 1
        self._sample_until(self._steps * _STEP_S)
        if self.stage is not None:
            self.stage.step(_STEP_S, self._torque_nm(self.stage))
        if self.supply is not None:
            self.supply()
        for finger in self.fingers:
            finger.step(_STEP_S)
            finger.touch(self.parts.displacements)
        self._push(_STEP_S)

    def _push(self, dt_s: float) -> None:
        """Let tips push the parts, and meet them where they are then."""
        before = self.parts.displacements
        self.parts.step(self._tip_forces, any(finger.press is not None for finger in self.fingers), dt_s)
        if self.parts.displacements is not before:
            for finger in self.fingers:
                finger.touch(self.parts.displacements)

    def _tip_forces(self, displacements: Displacements) -> list[list[PointForce]]:
        return [
            [force for finger in self.fingers for force in finger.forces_on(number, displacement)]
            for number, displacement in enumerate(displacements)
        ]

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
