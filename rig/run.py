"""One finger during a closing: where it is to go, and where it has been. Between closing and conclusions."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Self

from palpate.drivers.finger import Body, Line, Servos, Turn
from palpate.rig.hand import HostFinger
from palpate.rig.reach import Close

__all__ = ["Run"]

_MOVED_MM = 0.05


@dataclass(eq=False)
class Run:
    """State of one finger's part of a grip; `line` and all places are in the frame that carries the finger.

    `travel_mm` is how far along the line the tip is; `track` where it was seen, if it is steered along.
    """

    finger: HostFinger
    close: Close
    line: Line
    started: Servos = (math.nan, math.nan)
    servos: Servos = (math.nan, math.nan)
    limit_mm: float = 0.0
    travel_mm: float = 0.0
    touched: bool = False
    done: bool = False
    moved_s: float = 0.0
    heard_s: float = 0.0
    track: list[tuple[float, float]] = field(default_factory=list)
    _last_mm: float = 0.0

    @classmethod
    def of(cls, finger: HostFinger, close: Close, turn: Turn) -> Self:
        """A finger's part of a grip, with the stage at the angle that it asks for."""
        return cls(finger, close, turn.line_back(close.line))

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Where the tip's centre was seen last."""
        return self.finger.kinematics.centre_mm(self.servos)

    @property
    def start_mm(self) -> tuple[float, float]:
        """Where the tip's centre was when it had aimed."""
        return self.finger.kinematics.centre_mm(self.started)

    def begin(self, servos: Servos) -> None:
        """Note where the finger stands after aiming."""
        self.started = self.servos = servos

    def seen(self, servos: Servos, now: float) -> None:
        """Note where the servos are."""
        self.servos = servos
        centre = self.centre_mm
        self.travel_mm = self.line.travel_mm(centre)
        if abs(self.travel_mm - self._last_mm) > _MOVED_MM:
            self._last_mm, self.moved_s = self.travel_mm, now
        if self.finger.drive.streams:
            self.track.append(centre)

    def body(self) -> Body:
        """Room that the finger takes up now."""
        return self.finger.kinematics.body(self.servos, self.finger.spec.tip.radius_mm)

    def strayed_mm(self, far_mm: float) -> float:
        """How far the tip was off the straight line from its start to where it is, up to `far_mm` of the way.

        Between two looks it may have been off by half the way between them more.
        """
        way = Line(self.start_mm, _direction(self.start_mm, self.centre_mm))
        seen = [(point, way.travel_mm(point)) for point in self.track]
        counted = [(point, travel) for point, travel in seen if 0 <= travel <= far_mm]
        if not counted:
            return 0.0
        off = max(math.dist(point, way.point_mm(travel)) for point, travel in counted)
        points = [point for point, _ in counted]
        steps = (math.dist(a, b) for a, b in pairwise(points))
        return off + max(steps, default=0.0) / 2


def _direction(start: tuple[float, float], end: tuple[float, float]) -> float:
    return math.atan2(end[1] - start[1], end[0] - start[0])
