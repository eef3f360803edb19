"""State of one finger during a grip: its planned approach, its line, and where its tip has been."""

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.config import ARM_MARGIN_MM
from palpate.drivers.finger import Body, Line, Servos, Turn
from palpate.drivers.tactile.messages import Shape
from palpate.recognizer import FingerApproach
from palpate.rig.conversion import array_bound_rad, line_of, measured_force_share, shear_rad
from palpate.rig.host_finger import HostFinger
from palpate.rig.motion.contact_load import ContactLoad, LoadTrace, drag_shares, friction_factor, friction_of
from palpate.rig.motion.load_meter import LoadMeter

__all__ = ["ApproachState"]

_MOVED_MM = 0.05
_FACINGS = 9  # places of a way at which is looked where the array faces


@dataclass(eq=False)
class ApproachState:
    """State of one finger's part of a grip; `line` and all places are in the frame that carries the finger.

    `travel_mm` is how far along the line the tip is, `advance_mm` what it has come since the last look, 0 on
    its way back; `track` where it was seen, if it is steered along;
    `meter`: what loads the part, None where loads are not asked for.
    """

    finger: HostFinger
    approach: FingerApproach
    line: Line
    started: Servos = (math.nan, math.nan)
    servos: Servos = (math.nan, math.nan)
    travel_mm: float = 0.0
    advance_mm: float = 0.0
    touched: bool = False
    searching: bool = False
    moved_s: float = 0.0
    track: list[tuple[float, float]] = field(default_factory=list)
    meter: LoadMeter | None = None
    _centre_mm: tuple[float, float] = (math.nan, math.nan)
    _last_mm: float = 0.0
    _body: tuple[Servos, Body] | None = None

    @classmethod
    def of(cls, finger: HostFinger, approach: FingerApproach, turn: Turn) -> Self:
        """A finger's part of a grip, with the stage at the angle that it asks for."""
        return cls(finger, approach, turn.line_back(line_of(approach)))

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Where the tip's centre was seen last."""
        return self._centre_mm

    @property
    def start_mm(self) -> tuple[float, float]:
        """Where the way began that is known to be straight.

        A tip that is steered along may stand a little beside its line until friction is overcome; it does so
        outside of the workspace, where it waits.
        """
        for point in self.track:
            if self.line.travel_mm(point) >= ARM_MARGIN_MM:
                return point
        return self.finger.kinematics.centre_mm(self.started)

    def begin(self, servos: Servos) -> None:
        """Note where the finger stands after aiming."""
        self.started = servos
        self._stand(servos)
        self.advance_mm = 0.0

    def seen(self, servos: Servos, now: float) -> None:
        """Note where the servos are."""
        before_mm = self.travel_mm
        self._stand(servos)
        self.advance_mm = max(0.0, self.travel_mm - before_mm)
        if abs(self.travel_mm - self._last_mm) > _MOVED_MM:
            self._last_mm, self.moved_s = self.travel_mm, now
        if self.meter is not None:
            is_steered = self.finger.drive.streams
            self.meter.see(self.travel_mm, now, self.line.aside_mm(self.centre_mm) if is_steered else 0.0)
        if self.finger.drive.streams:
            self.track.append(self.centre_mm)

    def _stand(self, servos: Servos) -> None:
        self.servos = servos
        self._centre_mm = self.finger.kinematics.centre_mm(servos)
        self.travel_mm = self.line.travel_mm(self._centre_mm)

    @property
    def cross_track_error_mm(self) -> float:
        """How far the tip is beside its line."""
        return math.dist(self.centre_mm, self.line.point_mm(self.travel_mm))

    def drags(self, light_n: float) -> Floats | None:
        """What a force on each column (cols,) of the array drags the part with as the tip goes back, at most.

        As a share of what presses there, anywhere on the way, if `light_n` is measured at most: then friction
        carries the skin round the tip by little, and what carries the array turns it by little. Infinite at
        the tip's back, by which it hooks the part. None, for all that presses, of a ball, which is touched
        higher or lower, too, and of an array that is not bent round its tip.
        """
        finger, spec = self.finger, self.finger.spec
        if spec.tip.is_ball or finger.array.description.shape is not Shape.CYLINDER:
            return None
        columns = np.array(finger.array.description.columns)
        kinematics = finger.kinematics
        ways = np.linspace(0.0, self.approach.travel_mm, _FACINGS)
        servos = [kinematics.servos_rad(self.line, way) for way in ways.tolist()]
        facing = np.array([kinematics.facing_rad(item) for item in servos if not math.isnan(sum(item))])
        ahead = facing[:, None] + math.radians(spec.array.heading_deg) + columns - self.line.direction_rad
        pressing_n = light_n / (1 - measured_force_share(spec))
        off = float(np.diff(columns).max(initial=0.0)) / 2 + shear_rad(spec.tip, pressing_n)
        off += kinematics.direction_bound_rad + array_bound_rad(spec)
        friction = friction_of(spec.tip)
        off += math.radians(spec.bounds.deflection_deg_per_n) * pressing_n * friction_factor(friction)
        return drag_shares(np.abs(wrap_angle(ahead)).max(axis=0) + off, friction)

    @property
    def loads(self) -> tuple[ContactLoad, ...]:
        """Loads on the part so far, if they are metered."""
        return () if self.meter is None else self.meter.loads()

    def slowed_to(self, speed_mm_s: float) -> float:
        """A speed at which to meet the part, no higher than the approach allows."""
        return min(speed_mm_s, self.approach.touch_mm_s or math.inf)

    @property
    def trace(self) -> LoadTrace | None:
        """Load on the part frame by frame, if it is metered."""
        return None if self.meter is None else self.meter.trace()

    @property
    def unfelt_mm(self) -> float:
        """How far along the line the tip had come before anything was noticed; infinite if nothing was."""
        trace = self.trace
        return math.inf if trace is None else trace.unfelt_mm

    def note_stopped(self, now: float) -> None:
        """Note that the finger has been told to stop, or has arrived."""
        if self.meter is not None:
            self.meter.stopped(now)

    def note_measured(self, now: float) -> None:
        """Note that the grip's contacts have been measured."""
        if self.meter is not None:
            self.meter.measured(now)

    def body(self) -> Body:
        """Room that the finger takes up now; all others ask for it."""
        if self._body is None or self._body[0] is not self.servos:
            radius_mm = self.finger.spec.tip.radius_mm
            self._body = self.servos, self.finger.kinematics.body(self.servos, radius_mm)
        return self._body[1]

    def largest_cross_track_error_mm(self, far_mm: float) -> float:
        """How far the tip was off the straight way from `start_mm` to where it is, up to `far_mm` of it.

        That is what was seen; and between two looks, half the way between them.
        """
        if not self.track:
            return 0.0
        way = Line(self.start_mm, _direction(self.start_mm, self.centre_mm))
        travels = np.array([way.travel_mm(point) for point in self.track])
        counted = (travels >= 0) & (travels <= far_mm)
        if not counted.any():
            return 0.0
        points = np.array(self.track)[counted]
        on_way = np.array([way.point_mm(float(travel)) for travel in travels[counted]])
        off = float(np.hypot(*(points - on_way).T).max())
        gaps = np.diff(np.concatenate([[0.0], np.sort(travels[counted]), [far_mm]]))
        return off + float(gaps.max()) / 2


def _direction(start: tuple[float, float], end: tuple[float, float]) -> float:
    return math.atan2(end[1] - start[1], end[0] - start[0])
