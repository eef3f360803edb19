"""Kinematics of fingers: servo angles for a point on a line, and the tip's position for given angles.

The interface between servos and contacts, and between plan and servos. `slide_kinematics` and
`arm_kinematics` are the kinds there are; both have two servos. Everything is in the frame that carries the
finger's base: W, or the turning stage's ring at angle 0 (`Turn` leads from there to W).
"""

import math
from dataclasses import dataclass
from typing import Protocol

from palpate.base.geometry import Floats

TICK_RAD = 2 * math.pi / 4096
"""Encoder step of a servo (e-Manual)."""


_ENCODER_ROUNDS = 12
"""Of the inverse: errors of 5° are then below 1e-9 rad, those of 1.5° below 1e-15."""

Servos = tuple[float, float]
"""Angles of a finger's two servos (rad), counted from Goal Position 2048, the one next to the base first."""


@dataclass(frozen=True)
class Encoder:
    """Encoder of a servo, whose magnet, not quite centred, makes errors of one and of two periods a turn.

    The angle is what it reads and a cos + b sin of that + c cos + d sin of twice that, `harmonics_rad` being
    a, b, c, d as calibration finds them; it is within `bound_rad` of this.
    """

    harmonics_rad: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    bound_rad: float = 0.0

    def angle_rad(self, read_rad: float) -> float:
        """Angle for what the servo reads."""
        if not any(self.harmonics_rad):
            return read_rad
        c1, s1, c2, s2 = self.harmonics_rad
        once = c1 * math.cos(read_rad) + s1 * math.sin(read_rad)
        return read_rad + once + c2 * math.cos(2 * read_rad) + s2 * math.sin(2 * read_rad)

    def read_rad(self, angle_rad: float) -> float:
        """What the servo reads at an angle."""
        read = angle_rad
        for _ in range(_ENCODER_ROUNDS if any(self.harmonics_rad) else 0):
            read += angle_rad - self.angle_rad(read)
        return read


NO_ENCODER_ERROR = Encoder()


@dataclass(frozen=True)
class Line:
    """A straight way of the tip's centre: from `start_mm` along `direction_rad`."""

    start_mm: tuple[float, float]
    direction_rad: float

    def point_mm(self, travel_mm: float) -> tuple[float, float]:
        """Centre after `travel_mm`."""
        return (
            self.start_mm[0] + travel_mm * math.cos(self.direction_rad),
            self.start_mm[1] + travel_mm * math.sin(self.direction_rad),
        )

    def travel_mm(self, point_mm: tuple[float, float]) -> float:
        """Distance of a point along the line."""
        x, y = point_mm[0] - self.start_mm[0], point_mm[1] - self.start_mm[1]
        return x * math.cos(self.direction_rad) + y * math.sin(self.direction_rad)

    def aside_mm(self, point_mm: tuple[float, float]) -> float:
        """Distance of a point to the left of the line."""
        x, y = point_mm[0] - self.start_mm[0], point_mm[1] - self.start_mm[1]
        return y * math.cos(self.direction_rad) - x * math.sin(self.direction_rad)


@dataclass(frozen=True, eq=False)
class FingerBody:
    """Room that a finger takes up, from above: straight pieces (k, 2) to (k, 2) with half widths (k,)."""

    start: Floats
    end: Floats
    half_width: Floats


class FingerKinematics(Protocol):
    """A finger whose two servos place its tip in the plane; mm, rad.

    The bounds hold for the play, the encoders' errors and the tolerances that the rig file declares.
    """

    @property
    def direction_bound_rad(self) -> float:
        """Bound of the error of the direction that carries the array."""
        ...

    def servos_rad(self, line: Line, travel_mm: float) -> Servos:
        """Servo angles that put the tip's centre `travel_mm` along a line; nan where it cannot get there."""
        ...

    def centre_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Tip's centre for servo angles."""
        ...

    def facing_rad(self, servos_rad: Servos) -> float:
        """Direction from which `array.heading_deg` counts."""
        ...

    def levers_mm(self, servos_rad: Servos) -> tuple[float, float]:
        """Travel of the tip's centre per rad of each servo."""
        ...

    def position_bound_mm(self, servos_rad: Servos) -> float:
        """Bound of the true centre's distance from `centre_mm`."""
        ...

    def cross_track_bound_mm(self, servos_rad: Servos, off_rad: float) -> float:
        """Largest distance of the tip from its line if the servos that keep it there are off by `off_rad`."""
        ...

    def body(self, servos_rad: Servos, tip_radius_mm: float) -> FingerBody:
        """Room that the finger takes up."""
        ...


@dataclass(frozen=True)
class Turn:
    """The turning stage at an angle: from the ring's frame to W. Without a stage: angle 0, no bounds."""

    centre_mm: tuple[float, float] = (0.0, 0.0)
    angle_rad: float = 0.0
    angle_bound_rad: float = 0.0
    centre_bound_mm: float = 0.0

    def point_mm(self, point_mm: tuple[float, float]) -> tuple[float, float]:
        """A point of the ring in W."""
        return self._rotate(point_mm, self.angle_rad)

    def line(self, line: Line) -> Line:
        """A line of the ring in W."""
        return Line(self.point_mm(line.start_mm), line.direction_rad + self.angle_rad)

    def line_back(self, line: Line) -> Line:
        """A line of W in the ring's frame."""
        return Line(self._rotate(line.start_mm, -self.angle_rad), line.direction_rad - self.angle_rad)

    def position_bound_mm(self, point_mm: tuple[float, float]) -> float:
        """Bound that the errors of the stage's angle and centre add for a point of the ring.

        About a centre that is elsewhere by c, a turn by φ brings every point elsewhere by 2 c sin(φ/2).
        """
        shifted = 2 * abs(math.sin(self.angle_rad / 2)) * self.centre_bound_mm
        return self.angle_bound_rad * (math.dist(point_mm, self.centre_mm) + self.centre_bound_mm) + shifted

    def _rotate(self, point_mm: tuple[float, float], angle_rad: float) -> tuple[float, float]:
        if angle_rad == 0.0:
            return point_mm
        x, y = point_mm[0] - self.centre_mm[0], point_mm[1] - self.centre_mm[1]
        c, s = math.cos(angle_rad), math.sin(angle_rad)
        return (self.centre_mm[0] + c * x - s * y, self.centre_mm[1] + s * x + c * y)
