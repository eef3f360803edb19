"""Hidden truth of emulated fingers: their actual geometry, drawn within what `[emulation]` allows.

A kind of finger has its `TruthDraws`, in `DRAWS`.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from palpate.base.errors import InputError
from palpate.config import ArmFingerConfig, EmulationConfig, FingerConfig, JointConfig, SlideFingerConfig
from palpate.drivers.emulators import ArmTruth, FingerTruth, JointCompliance, JointTruth
from palpate.drivers.tactile import Description, Shape
from palpate.rig.mechanisms.slide import slide_kinematics

_TOUCHABLE_RAD = math.radians(60.0)
_REACH_FACTOR = 1.02  # slides are off by a little: no tip is further out than that


def draw(span: tuple[float, float] | None, absent: float, rng: np.random.Generator) -> float:
    """Draw a value from a range; `absent` if there is none, with as many draws."""
    share = float(rng.uniform())
    return absent if span is None else span[0] + share * (span[1] - span[0])


_FingerT = TypeVar("_FingerT", bound=FingerConfig)
_TruthT = TypeVar("_TruthT", FingerTruth, ArmTruth)


@dataclass(frozen=True)
class TruthDraws(ABC, Generic[_FingerT, _TruthT]):
    """Draws of how a finger of one kind is really built.

    Each method that draws has a generator of its own or one that came with it: a seed keeps what it drew.
    """

    finger: _FingerT
    emulation: EmulationConfig

    @abstractmethod
    def place(self, base_mm: tuple[float, float], heading_rad: float, rng: np.random.Generator) -> _TruthT:
        """Finger at a place, with its plays, its links and its skin."""

    @abstractmethod
    def with_zeros_off(self, truth: _TruthT, rng: np.random.Generator) -> _TruthT:
        """The same, what turns servo angles into places being off."""

    @abstractmethod
    def with_yield(
        self, truth: _TruthT, softness: float, holds_n: float, rng: np.random.Generator
    ) -> _TruthT:
        """The same, giving way to a force on the tip by `softness` (mm per N) furthest out."""

    def with_cables(self, truth: _TruthT, _rng: np.random.Generator) -> _TruthT:
        """The same, pulled by a cable and giving way along its travel; joints are not."""
        return truth

    @staticmethod
    def heading_rad(_finger: _FingerT, truth: _TruthT) -> float:
        """True heading, as a calibration has it."""
        return truth.heading_rad

    @property
    def half_length_mm(self) -> float:
        """Length of half a tip: the rig file's, unless [emulation] has another; none reaches the table."""
        if self.emulation.tip_length_mm is None or "length_mm" in self.finger.tip.kind.lacks:
            return self.finger.tip.half_length_mm
        return min(self.emulation.tip_length_mm / 2, self.finger.height_mm)

    def stiffness_n_per_mm(self, rng: np.random.Generator) -> float:
        """Draw the stiffness of its skin."""
        return self.finger.tip.stiffness_n_per_mm * (1 + self.emulation.stiffness_spread * rng.uniform(-1, 1))


class SlideDraws(TruthDraws[SlideFingerConfig, FingerTruth]):
    """Draws of an aim and slide finger."""

    def place(
        self, base_mm: tuple[float, float], heading_rad: float, rng: np.random.Generator
    ) -> FingerTruth:
        """Finger with play of aim and slide."""
        nominal = slide_kinematics(self.finger)
        return FingerTruth(
            base_mm=base_mm,
            heading_rad=heading_rad,
            height_mm=self.finger.height_mm,
            gear_ratio=nominal.gear_ratio,
            aim_zero_rad=nominal.aim_zero_rad,
            aim_play_rad=math.radians(self.emulation.aim_backlash_deg) * rng.uniform(0.3, 1),
            mm_per_rad=nominal.mm_per_rad,
            zero_mm=nominal.zero_mm,
            slide_play_mm=self.emulation.backlash_mm * rng.uniform(0.3, 1),
            tip_radius_mm=self.finger.tip.radius_mm,
            stiffness_n_per_mm=self.stiffness_n_per_mm(rng),
            array_heading_rad=math.radians(self.finger.array.heading_deg),
            stops_mm=self.finger.slide.stops_mm,
            half_length_mm=self.half_length_mm,
            shape=self.finger.tip.shape,
        )

    def with_zeros_off(self, truth: FingerTruth, rng: np.random.Generator) -> FingerTruth:
        """Slide with zero and travel per turn off; the file's zero holds half a turn before the shaft's."""
        zero_off = self.emulation.zero_error_mm * rng.uniform(-1, 1)
        mm_per_rad = truth.mm_per_rad * (1 + self.emulation.mm_per_turn_error * rng.uniform(-1, 1))
        zero = truth.zero_mm + zero_off + (mm_per_rad - truth.mm_per_rad) * math.pi
        return replace(truth, mm_per_rad=mm_per_rad, zero_mm=zero)

    def with_yield(
        self, truth: FingerTruth, softness: float, holds_n: float, _rng: np.random.Generator
    ) -> FingerTruth:
        """Slide whose aim gives way."""
        furthest_mm = _REACH_FACTOR * self.finger.slide.range_mm[1]
        return replace(truth, aim_yield=JointCompliance(softness / furthest_mm**2, holds_n))

    def with_cables(self, truth: FingerTruth, rng: np.random.Generator) -> FingerTruth:
        """Slide that is pulled by a cable and gives way along its travel."""
        drawn = self.emulation.mechanics
        if drawn is None:
            return truth
        cable, soft = draw(drawn.cable_n, 0.0, rng), draw(drawn.slide_deflection_mm_per_n, 0.0, rng)
        return replace(truth, cable_n=cable, slide_yield_mm_per_n=soft)


class ArmDraws(TruthDraws[ArmFingerConfig, ArmTruth]):
    """Draws of an arm."""

    def place(self, base_mm: tuple[float, float], heading_rad: float, rng: np.random.Generator) -> ArmTruth:
        """Arm with links and plays of its joints."""

        def joint(servo: JointConfig) -> JointTruth:
            return joint_truth(servo.gear_ratio, servo.zero_deg, self.emulation.joint_backlash_deg, rng)

        return ArmTruth(
            base_mm=base_mm,
            heading_rad=heading_rad,
            height_mm=self.finger.height_mm,
            upper_mm=self.finger.links.upper_mm + self.emulation.link_error_mm * rng.uniform(-1, 1),
            fore_mm=self.finger.links.fore_mm + self.emulation.link_error_mm * rng.uniform(-1, 1),
            shoulder=joint(self.finger.shoulder),
            elbow=joint(self.finger.elbow),
            tip_radius_mm=self.finger.tip.radius_mm,
            stiffness_n_per_mm=self.stiffness_n_per_mm(rng),
            array_heading_rad=math.radians(self.finger.array.heading_deg),
            half_length_mm=self.half_length_mm,
            shape=self.finger.tip.shape,
        )

    def with_zeros_off(self, truth: ArmTruth, rng: np.random.Generator) -> ArmTruth:
        """Arm with both joints' zeros off.

        Where nothing may be off, nothing is drawn: seeds keep what they drew.
        """
        most = math.radians(self.emulation.joint_zero_error_deg)
        if most == 0:
            return truth

        def off(joint: JointTruth) -> JointTruth:
            return replace(joint, zero_rad=joint.zero_rad + joint.gear_ratio * most * rng.uniform(-1, 1))

        return replace(truth, shoulder=off(truth.shoulder), elbow=off(truth.elbow))

    def with_yield(
        self, truth: ArmTruth, softness: float, holds_n: float, rng: np.random.Generator
    ) -> ArmTruth:
        """Arm whose joints give way, each a share of it."""
        share = rng.uniform(0.2, 0.8)
        upper = JointCompliance(share * softness / (truth.upper_mm + truth.fore_mm) ** 2, holds_n)
        fore = JointCompliance((1 - share) * softness / truth.fore_mm**2, holds_n)
        return replace(
            truth,
            shoulder=replace(truth.shoulder, yields=upper),
            elbow=replace(truth.elbow, yields=fore),
        )

    @staticmethod
    def heading_rad(finger: ArmFingerConfig, truth: ArmTruth) -> float:
        """True heading with the shoulder's zero."""
        described_rad = math.radians(finger.shoulder.zero_deg) - math.pi
        return truth.heading_rad + (described_rad - truth.shoulder.zero_rad) / finger.shoulder.gear_ratio


DRAWS: dict[type, type[TruthDraws[Any, Any]]] = {SlideFingerConfig: SlideDraws, ArmFingerConfig: ArmDraws}
"""Draws for each kind of finger, by the model of its table in the rig file."""


def draws_of(finger: FingerConfig, emulation: EmulationConfig) -> TruthDraws[Any, Any]:
    """Draws for a finger. Raises InputError for a kind that is not emulated."""
    if type(finger) not in DRAWS:
        raise InputError(f"finger {finger.name}: palpate does not emulate fingers of its type yet")
    return DRAWS[type(finger)](finger, emulation)


def truth_of(
    finger: FingerConfig, emulation: EmulationConfig, rng: np.random.Generator, newer: np.random.Generator
) -> FingerTruth | ArmTruth:
    """Draw how a finger really is built.

    `newer` draws the errors of tips, arrays, slides and joints' zeros: they came later, and a seed
    keeps what it has drawn from `rng`.
    """
    draws = draws_of(finger, emulation)
    away, bearing = emulation.base_error_mm * math.sqrt(rng.uniform()), rng.uniform(0, 2 * math.pi)
    turn = math.radians(emulation.heading_error_deg) * rng.uniform(-1, 1)
    base = (
        finger.base_mm[0] + away * math.cos(bearing),
        finger.base_mm[1] + away * math.sin(bearing),
    )
    built = draws.place(base, math.radians(finger.heading_deg) + turn, rng)
    radius = finger.tip.radius_mm + emulation.tip_radius_error_mm * newer.uniform(-1, 1)
    turned = math.radians(emulation.array_heading_error_deg) * newer.uniform(-1, 1)
    built = replace(built, tip_radius_mm=radius, array_heading_rad=built.array_heading_rad + turned)
    found: FingerTruth | ArmTruth = draws.with_zeros_off(built, newer)
    return found


def with_yield(
    truth: FingerTruth | ArmTruth,
    finger: FingerConfig,
    emulation: EmulationConfig,
    rng: np.random.Generator,
) -> FingerTruth | ArmTruth:
    """Return the finger with joints that give way to forces on the tip, if the rig file says so.

    Furthest out, a tip gives way by what was drawn, and by less nearer to its joints.
    """
    if emulation.deflection_mm_per_n == 0 and emulation.play_holds_n is None:
        return truth
    softness = emulation.deflection_mm_per_n * rng.uniform(0.3, 1)
    holds = math.inf if emulation.play_holds_n is None else rng.uniform(*emulation.play_holds_n)
    found: FingerTruth | ArmTruth = draws_of(finger, emulation).with_yield(truth, softness, holds, rng)
    return found


def dead_taxels(
    description: Description, count: int, rng: np.random.Generator
) -> tuple[tuple[int, int], ...]:
    """Rows and columns of `count` taxels that are dead, drawn where touches are felt: near the middle.

    InputError if the array has not so many there.
    """
    is_round = description.shape is Shape.CYLINDER
    columns = np.flatnonzero(np.logical_or(not is_round, np.abs(description.columns) <= _TOUCHABLE_RAD))
    felt = [(row, int(col)) for row in range(description.rows) for col in columns]
    if count > len(felt):
        raise InputError(
            f"emulation.dead_taxels: is {count}; an emulated array has {len(felt)} taxels within 60° of its "
            "middle; let fewer be dead"
        )
    return tuple(felt[k] for k in rng.choice(len(felt), count, replace=False))


def joint_truth(gear_ratio: float, zero_deg: float, play_deg: float, rng: np.random.Generator) -> JointTruth:
    """A joint behind a gear; the file counts servo angles from Goal Position 0, emulated shafts from 2048."""
    return JointTruth(
        gear_ratio, math.radians(zero_deg) - math.pi, math.radians(play_deg) * rng.uniform(0.3, 1)
    )
