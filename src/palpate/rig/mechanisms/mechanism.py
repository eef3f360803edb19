"""Mechanism of a finger: everything that depends on its kind, with the numbers of the rig file.

A kind of finger is a `Mechanism` (kinematics, servos, where it waits, on which paths it can go) with a
`Drive`. A `Drive` is given a path; a mover asks it every sample for the goals to write then (`goals`), and at
the end where its servos should stand (`targets`). Limits are written before torque goes on.

All places are in the frame that carries the finger's base: W, or the turning stage's ring at angle 0.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from palpate.base.errors import InputError
from palpate.base.geometry import Bools, Floats
from palpate.config import FingerConfig, RigFile
from palpate.config.rig_servos import AimConfig, SlideConfig
from palpate.drivers.dynamixel import OperatingMode, Servo, ServoGoals
from palpate.drivers.kinematics import TICK_RAD, FingerBody, FingerKinematics, Line, Servos
from palpate.drivers.slide_kinematics import SlideKinematics
from palpate.rig.conversion import tip_bound_mm
from palpate.rig.mechanisms.swept_volume import BodyCapsules

AIM_CURRENT_A = 0.6
AIM_TOLERANCE_RAD = 4 * TICK_RAD
"""How near to its goal an aiming servo must settle. Friction holds the emulated one 2 to 3 steps off."""

STREAM_TOLERANCE_RAD = 2 * TICK_RAD
"""How far a servo that is steered along a line is off it. 1.4 steps were seen on the emulated bench."""

AIM_SPEED_RAD_S = 3.0
CIRCLE_SPEED_MM_S = 40.0
"""Speed of a tip on the circle where it waits."""

ACCELERATION_RAD_S2 = 6.0


@dataclass(frozen=True, slots=True)
class ServoLimits:
    """Limits in a servo's EEPROM before torque goes on: runs write them, set-up and check know them.

    `problem`: why the servo cannot do what the rig file asks of it, None if it can.
    """

    mode: OperatingMode
    current_a: float
    problem: str | None = None

    def write(self, servo: Servo) -> None:
        """Write what differs, with torque off, and read it back. Raises InputError as `eeprom`."""
        self.eeprom(servo)
        servo.prepare(self.mode, self.current_a)

    def eeprom(self, servo: Servo) -> dict[str, int]:
        """The items and their values. Raises InputError for limits that the model cannot keep."""
        if self.problem is not None:
            raise InputError(self.problem)
        try:
            wanted = servo.eeprom(self.mode, self.current_a)
        except ValueError as error:
            do = "lower max_force_n in the rig file, or take a stronger model"
            raise InputError(f"{error}; {do}") from error
        try:
            for name, value in wanted.items():
                servo.model.check(name, value)
        except ValueError as error:
            do = "correct zero or range of its joint in the rig file, or mount its horn turned"
            raise InputError(f"{error} (servo {servo.dxl_id}); {do}") from error
        return wanted


class Drive(Protocol):
    """Drive of one finger.

    Parameters are given by position, so that a kind of drive may name those that it does not use `_…`.
    """

    @property
    def servos(self) -> tuple[Servo, Servo]:
        """Both servos, the one next to the base first."""
        ...

    @property
    def closing_servos(self) -> tuple[Servo, ...]:
        """Servos that move while the finger closes; the others only aim it."""
        ...

    @property
    def streams(self) -> bool:
        """True if goals change with time, so that `goals` must be asked every sample."""
        ...

    def limits(self) -> Mapping[Servo, ServoLimits]:
        """Limits of each servo."""
        ...

    def prepare(self) -> None:
        """Write modes and limits; torque is off."""
        ...

    def retract(self) -> ServoGoals:
        """Begin to go back to where the finger waits, if it may be elsewhere; what to write at once."""
        ...

    def aim(self, line: Line, present: Servos, now: float, /) -> ServoGoals:
        """Begin to go to where a line starts, from where the finger is; what to write at once."""
        ...

    def go(self, line: Line, from_mm: float, to_mm: float, speed_mm_s: float, now: float, /) -> ServoGoals:
        """Begin to go along a line, on which the finger is at `from_mm`; what to write at once."""
        ...

    def follow(self, postures_rad: Floats, travel_mm: Floats, speed_mm_s: float, now: float, /) -> ServoGoals:
        """Begin to go through postures (m, 2) at travels (m,) of the tip; what to write at once."""
        ...

    def slow_down(self, speed_mm_s: float, now: float, /) -> ServoGoals:
        """Go on along the line more slowly, without a jerk; what to write at once."""
        ...

    def slowing_mm(self, from_mm_s: float, to_mm_s: float, /) -> float:
        """Travel of the tip while it changes from one speed to a lower one."""
        ...

    def goals(self, now: float, /) -> ServoGoals:
        """Goals to write now; empty if the servos know enough."""
        ...

    def under_way(self, now: float, /) -> bool:
        """True if further goals will come."""
        ...

    def targets(self) -> ServoGoals:
        """Goals of the servos that move, at the end."""
        ...

    def tolerance_rad(self, servo: Servo, gap_mm: float, /) -> float:
        """Angle by which a servo is off its target if the tip is off by about `gap_mm`."""
        ...


@dataclass(frozen=True, eq=False)
class ApproachPath:
    """Straight path of finger `finger_index` along `line` in the ring's frame, at most `travel_mm`.

    `aiming_s`: rough time of turning to its start. `capsules` are what it sweeps, counted from travels
    `since` (s,) on; those that `grow` (s,) have ends that move along the line.
    """

    finger_index: int
    line: Line
    travel_mm: float
    aiming_s: float
    capsules: BodyCapsules
    since: Floats
    grows: Bools

    def up_to(self, travel_mm: float) -> "ApproachPath":
        """The same path, not as far."""
        return replace(self, travel_mm=travel_mm)


@dataclass(frozen=True, eq=False)
class StandbyPoses:
    """A finger at its sampled aims (m,): what room it takes there (`capsules.owner`: the aim), and its home.

    `home`: index of the aim at which the finger must stand when it is switched on.
    """

    aims_rad: Floats
    capsules: BodyCapsules
    home: int


@dataclass(frozen=True)
class HardStops:
    """Travel of a slide between its hard stops at `back_mm` and `front_mm` from the base."""

    aim: AimConfig
    slide: SlideConfig
    kinematics: SlideKinematics
    back_mm: float
    front_mm: float


@dataclass(frozen=True)
class TestMove:
    """Small move of a joint to `goal_rad`: the tip goes away from the base if `outward`, else to its left.

    `key`: of the rig file, whose sign says which way the joint turns.
    """

    key: str
    goal_rad: float
    outward: bool


class Mechanism(ABC):
    """Mechanism of one finger, whose two servos place its tip.

    Aims are angles that number the places where it waits. `radius_mm`, of methods: of the circle round W's
    origin that holds the workspace at every angle of the stage.
    """

    spec: FingerConfig
    kinematics: FingerKinematics
    aim: AimConfig | None = None
    """Servo that turns the finger while it waits and holds it on its path; None if both servos move there."""
    push: SlideConfig | None = None
    """Servo that alone moves the tip along its path; None if both do."""
    homing: HardStops | None = None
    """Stops that tell its turn; None if it has none."""
    lowest_link_mm: float = math.inf
    """Height above the table at which its links pass above the parts."""
    swing_mm: float = 0.0
    """Distance from its base to its furthest part behind it."""
    settling_rad: float = AIM_TOLERANCE_RAD
    """How far the servos that keep the tip on its path are off at most."""
    restart_advice: str = "then start again"
    """Words for an operator after the servo at the tip's end has lost its turns."""

    def __init__(self, spec: FingerConfig, kinematics: FingerKinematics) -> None:
        self.spec, self.kinematics = spec, kinematics

    @property
    @abstractmethod
    def ranges_rad(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Servo angles at the ends of both ranges, the servo next to the base first."""

    @property
    @abstractmethod
    def levers(self) -> Sequence[tuple[str, float]]:
        """Model of each servo that moves the tip on its path, with the largest travel (mm) per rad of it."""

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float, float, float]:
        """Sector that the tip reaches: directions from and to (deg, from the heading), distances (mm)."""

    @abstractmethod
    def drive(self, servos: tuple[Servo, Servo], rig: RigFile) -> Drive:
        """Drive of the finger by its servos."""

    @abstractmethod
    def start_problem(
        self, radius_mm: float, dxl_ids: tuple[int, int], angles_rad: Servos, *, is_homed: bool
    ) -> str | None:
        """Reason why the finger must not start from where it stands; None if it may.

        `is_homed`: it is homed and comes to standby before it moves otherwise.
        """

    @abstractmethod
    def start_rad(self, radius_mm: float) -> Servos:
        """Servo angles at which people leave the finger before it is switched on."""

    @abstractmethod
    def draw_posture(self, rng: np.random.Generator) -> Servos:
        """Random servo angles within the ranges."""

    @abstractmethod
    def home(self, radius_mm: float) -> Line:
        """Path that starts at the finger's home, where it stands at power-up and when a stage turns."""

    @abstractmethod
    def standby(self, radius_mm: float) -> StandbyPoses:
        """Places where the finger may wait between approaches, sampled."""

    @abstractmethod
    def is_waiting(self, servos_rad: Servos, aims_rad: tuple[float, float], radius_mm: float) -> bool:
        """Tell whether the finger waits, or once retracted will wait, between two aims."""

    @abstractmethod
    def ways_to_standby(self, start: Servos, aims_rad: Floats, radius_mm: float) -> list[Floats]:
        """Ways from a posture to places where it waits, each as postures (m, 2)."""

    @abstractmethod
    def paths(
        self, finger_index: int, aims_rad: tuple[float, float], count: int, radius_mm: float
    ) -> list[ApproachPath]:
        """Paths from aims between two, about `count` for a finger with one path from each."""

    @abstractmethod
    def test_moves(self, at: Servos) -> tuple[TestMove, TestMove]:
        """Small move of each joint, by which a person sees that it turns the right way."""

    @property
    def middle_bound_mm(self) -> float:
        """Bound on the tip's centre in the middle of the table; nan if it does not get there."""
        x, y = self.spec.base_mm
        servos = self.kinematics.servos_rad(Line((x, y), math.atan2(-y, -x)), math.hypot(x, y))
        return self.kinematics.position_bound_mm(servos)

    def body(self, servos_rad: Servos) -> FingerBody:
        """Room that the finger may take up, with what its place, tip and aim may be off."""
        body = self.kinematics.body(servos_rad, self.spec.tip.half_width_mm)
        unsure = self.kinematics.position_bound_mm(servos_rad) + self.kinematics.cross_track_bound_mm(
            servos_rad, AIM_TOLERANCE_RAD
        )
        return FingerBody(body.start, body.end, body.half_width + (unsure + tip_bound_mm(self.spec)))


def crossing_mm(line: Line, radius_mm: float) -> float:
    """Travel at which a line leaves the circle round the origin; 0 if it misses it."""
    middle = line.travel_mm((0.0, 0.0))
    miss = math.hypot(*line.point_mm(middle))
    return 0.0 if miss >= radius_mm else middle + math.sqrt(radius_mm**2 - miss**2)
