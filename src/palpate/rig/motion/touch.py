"""Touch: one finger's approach in a grip, and the resulting contact or miss in W, with bounds.

An `ApproachState` is where the tip has been so far; `conclude` makes a `Touch` of it and of the patch on the
array.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from palpate.base.geometry import Floats
from palpate.base.geometry.plane import wrap_angle
from palpate.base.short_repr import ShortRepr
from palpate.config import ARM_MARGIN_MM, ClosingConfig, RigFile, TipConfig
from palpate.drivers.kinematics import FingerBody, Line, Servos, Turn
from palpate.drivers.tactile import ContactPatch, PatchFlag, Shape
from palpate.recognizer import Contact, FingerApproach, NormalRange
from palpate.rig.conversion import (
    array_bound_rad,
    deflection_mm,
    deflection_rad,
    finger_of,
    largest_on_skin_n,
    line_of,
    measured_force_share,
    shear_rad,
    softest_n_per_mm,
    stiffest_n_per_mm,
    tip_bound_mm,
    undetected_dent_mm,
    undetected_force_n,
)
from palpate.rig.fingers import HostFinger
from palpate.rig.motion.current_sensing import CurrentSensor
from palpate.rig.motion.free_force import FreeForce
from palpate.rig.motion.load_meter import (
    ContactLoad,
    LoadMeter,
    LoadTrace,
    drag_shares,
    friction_factor,
    tip_friction,
)
from palpate.rig.pads import PadTouch, face_contact, face_points_of, touched_points

_MOTION_THRESHOLD_MM = 0.05
_FACING_SAMPLES = 9  # places of a way at which is looked where the array faces


@dataclass(eq=False)
class ApproachState:
    """State of one finger's part of a grip; `line` and all places are in the frame that carries the finger.

    `travel_mm` is how far along the line the tip is, `advance_mm` what it has come since the last look, 0 on
    its way back; `track` where it was seen, if it is steered along; `is_steady`: its array came
    to rest with it; `meter`: what loads the part, None where loads are not asked for; `free_force`: what its
    currents have shown on its way so far; `blind_mm`: the beginning of its way, on which nothing is sensed.
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
    is_steady: bool = True
    meter: LoadMeter | None = None
    free_force: FreeForce = field(default_factory=FreeForce)
    blind_mm: float = 0.0
    _centre_mm: tuple[float, float] = (math.nan, math.nan)
    _last_mm: float = 0.0
    _body: tuple[Servos, FingerBody] | None = None

    @classmethod
    def of(cls, finger: HostFinger, approach: FingerApproach, turn: Turn) -> Self:
        """A finger's part of a grip, with the stage at the angle that it asks for."""
        blind_mm = finger.array.blind_mm if isinstance(finger.array, CurrentSensor) else 0.0
        return cls(finger, approach, turn.line_back(line_of(approach)), blind_mm=blind_mm)

    @property
    def name(self) -> str:
        """Name of the finger."""
        return self.finger.name

    @property
    def centre_mm(self) -> tuple[float, float]:
        """Place of the tip's centre when it was seen last."""
        return self._centre_mm

    @property
    def start_mm(self) -> tuple[float, float]:
        """Start of the way that is known to be straight.

        A tip that is steered along may stand a little beside its line until friction is overcome; it does so
        outside of the workspace, where it waits.
        """
        for point in self.track:
            if self.line.travel_mm(point) >= ARM_MARGIN_MM:
                return point
        start = self.finger.kinematics.centre_mm(self.started)
        return Line(start, self.line.direction_rad).point_mm(min(self.blind_mm, max(self.travel_mm, 0.0)))

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
        if abs(self.travel_mm - self._last_mm) > _MOTION_THRESHOLD_MM:
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
        """Distance of the tip from its line."""
        return math.dist(self.centre_mm, self.line.point_mm(self.travel_mm))

    def drags(self, light_n: float) -> Floats | None:
        """Largest drag on the part, as the tip goes back, of a force on each column (cols,) of the array.

        As a share of what presses there, anywhere on the way, if `light_n` is measured at most: then friction
        carries the skin round the tip by little, and what carries the array turns it by little. Infinite at
        the tip's back, by which it hooks the part. None, for all that presses, of a ball, which is touched
        higher or lower, too, and of an array that is not bent round its tip.
        """
        finger, spec = self.finger, self.finger.spec
        if not spec.tip.kind.is_upright or finger.array.description.shape is not Shape.CYLINDER:
            return None
        columns = np.array(finger.array.description.columns)
        kinematics = finger.kinematics
        ways = np.linspace(0.0, self.approach.travel_mm, _FACING_SAMPLES)
        servos = [kinematics.servos_rad(self.line, way) for way in ways.tolist()]
        facing = np.array([kinematics.facing_rad(item) for item in servos if not math.isnan(sum(item))])
        ahead = facing[:, None] + math.radians(spec.array.heading_deg) + columns - self.line.direction_rad
        pressing_n = light_n / (1 - measured_force_share(spec))
        off = float(np.diff(columns).max(initial=0.0)) / 2 + shear_rad(spec.tip, pressing_n)
        off += kinematics.direction_bound_rad + array_bound_rad(spec)
        friction = tip_friction(spec.tip)
        off += math.radians(spec.bounds.deflection_deg_per_n) * pressing_n * friction_factor(friction)
        return drag_shares(np.abs(wrap_angle(ahead)).max(axis=0) + off, friction)

    @property
    def loads(self) -> tuple[ContactLoad, ...]:
        """Loads on the part so far, if they are metered."""
        return () if self.meter is None else self.meter.loads()

    @property
    def trace(self) -> LoadTrace | None:
        """Load on the part frame by frame, if it is metered."""
        return None if self.meter is None else self.meter.trace()

    @property
    def unfelt_mm(self) -> float:
        """Travel along the line before anything was noticed; infinite if nothing was."""
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

    def widen_unsteady(self, patch: ContactPatch | None, rig: RigFile) -> ContactPatch | None:
        """The patch that was measured, with any force that may be if the array did not come to rest."""
        if patch is None or self.is_steady:
            return patch
        return replace(patch, force_bound_n=max(patch.force_bound_n, rig.closing.max_force_n))

    def body(self) -> FingerBody:
        """Room that the finger takes up now; all others ask for it."""
        if self._body is None or self._body[0] is not self.servos:
            half_width_mm = self.finger.spec.tip.half_width_mm
            self._body = self.servos, self.finger.kinematics.body(self.servos, half_width_mm)
        return self._body[1]

    def largest_cross_track_error_mm(self, far_mm: float) -> float:
        """Largest distance of the tip from the straight way from `start_mm` on, up to `far_mm` of it.

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


_MAX_EDGES_TOUCHED = 3  # that a disc of given size meets at once
_TWO_EDGE_FLAGS = frozenset({PatchFlag.WIDE, PatchFlag.SEVERAL_PATCHES, PatchFlag.EDGES_UNKNOWN})


@dataclass(frozen=True, repr=False)
class Touch(ShortRepr):
    """Result of a touch: the contact for the recogniser, and the patch that it rests on (None for a miss).

    `servos`: angles (rad) at which the finger's servos stood then; `stage_rad`: the turning stage's, by its
    servo. `loads`: on the part, in order of time; `trace`: frame by frame, None where it was not metered.
    `points`: what points of a pad's face met, none of other tips; its contact is where the middle of the face
    stopped.
    """

    finger_index: int
    contact: Contact
    patch: ContactPatch | None
    servos: Servos
    loads: tuple[ContactLoad, ...] = ()
    trace: LoadTrace | None = None
    stage_rad: float = 0.0
    points: tuple[Contact, ...] = ()

    @property
    def touched_points(self) -> tuple[Contact, ...]:
        """Points of a pad's face that were touched; none of other tips, or where it missed."""
        return tuple(point for point in self.points if point.touched)

    @property
    def evidence(self) -> tuple[Contact, ...]:
        """The contacts, misses included, that the recogniser is given."""
        return self.points or (self.contact,)


def conclude(run: ApproachState, patch: ContactPatch | None, closing: ClosingConfig, turn: Turn) -> Touch:
    """The contact, or the miss, with the stage where it stands."""
    if run.finger.spec.tip.kind.has_face:
        return _face_touch(run, patch, closing, turn)
    contact = _miss(run, closing, turn) if patch is None else _contact(run, patch, closing, turn)
    return Touch(run.approach.finger_index, contact, patch, run.servos, stage_rad=turn.angle_rad)


def _face_touch(run: ApproachState, patch: ContactPatch | None, closing: ClosingConfig, turn: Turn) -> Touch:
    spec, kinematics = run.finger.spec, run.finger.kinematics
    tilt = kinematics.direction_bound_rad + turn.angle_bound_rad + array_bound_rad(spec)
    facing = kinematics.facing_rad(run.servos) + turn.angle_rad
    if patch is None:
        way, bent = _miss(run, closing, turn), deflection_rad(spec, undetected_force_n(closing))
        points = face_points_of(way, spec.tip, facing, tilt + bent)
        return Touch(
            run.approach.finger_index, way, None, run.servos, stage_rad=turn.angle_rad, points=points
        )
    # Other stretches of skin bear less than the strongest patch, or what is not felt.
    force = max(patch.force_n, closing.contact_force_n)
    _, deepest = dent_range_mm(force, patch.force_bound_n, spec.tip, closing.max_force_n)
    pressing = _pressing_n(patch, spec.tip, closing)
    bent = deflection_mm(spec, pressing)
    touch = PadTouch(
        name=run.finger.name,
        finger=finger_of(spec),
        start_mm=turn.point_mm(run.start_mm),
        stop_mm=turn.point_mm(run.centre_mm),
        facing_rad=facing,
        tilt_rad=tilt + deflection_rad(spec, pressing),
        deepest_mm=deepest,
        bound_mm=_bound_mm(run, turn) + bent,
        path_bound_mm=_bound_mm(run, turn)
        + max(bent, deflection_mm(spec, undetected_force_n(closing)))
        + run.largest_cross_track_error_mm(math.dist(run.start_mm, run.centre_mm))
        + undetected_dent_mm(spec, closing),
    )
    ways = face_points_of(touch.way, spec.tip, facing, touch.tilt_rad)
    points = (*touched_points(touch, patch, spec.tip), *ways)
    return Touch(
        run.approach.finger_index,
        face_contact(touch, points[0].position_bound_mm),
        patch,
        run.servos,
        stage_rad=turn.angle_rad,
        points=points,
    )


def dent_range_mm(
    force_n: float, force_bound_n: float, tip: TipConfig, max_force_n: float
) -> tuple[float, float]:
    """Least and greatest dent (mm) of a tip that bears a force, which is known to within a bound."""
    hardest = min(force_n + force_bound_n, max_force_n / tip.least_share)
    softest = max(force_n - force_bound_n, 0.0)
    return (
        softest / stiffest_n_per_mm(tip),
        hardest / softest_n_per_mm(tip),
    )


def _pressing_n(patch: ContactPatch, tip: TipConfig, closing: ClosingConfig) -> float:
    """Force that may press the tip, all its patches together: this one is the strongest."""
    if tip.kind.has_face and PatchFlag.SEVERAL_PATCHES in patch.flags:
        return closing.max_force_n
    edges = _MAX_EDGES_TOUCHED if PatchFlag.SEVERAL_PATCHES in patch.flags else 1
    return min(edges * (patch.force_n + patch.force_bound_n), largest_on_skin_n(tip, closing))


def may_touch_two_edges(patch: ContactPatch) -> bool:
    """True if a tip may be dented along two normals, as in a notch."""
    return bool(patch.flags & _TWO_EDGE_FLAGS)


def _bound_mm(run: ApproachState, turn: Turn) -> float:
    """Bound on the tip's surface anywhere on its way, by the mechanics and its radius alone."""
    kinematics = run.finger.kinematics
    centre = max(
        kinematics.position_bound_mm(servos) + turn.position_bound_mm(kinematics.centre_mm(servos))
        for servos in (run.started, run.servos)
    )
    return centre + tip_bound_mm(run.finger.spec)


def _miss(run: ApproachState, closing: ClosingConfig, turn: Turn) -> Contact:
    """The way was free as far as the finger went without feeling anything.

    Less a little where a touch could not be measured. From a slight force on it may have pushed the part.
    """
    start, centre = run.start_mm, run.centre_mm
    gone = min(math.dist(start, centre), run.unfelt_mm - run.line.travel_mm(start))
    far = max(gone - (2 * closing.back_off_mm if run.touched else 0.0), 0.0)
    way = Line(start, math.atan2(centre[1] - start[1], centre[0] - start[0]))
    bound = _bound_mm(run, turn) + deflection_mm(run.finger.spec, undetected_force_n(closing))
    return Contact(
        name=run.finger.name,
        finger=finger_of(run.finger.spec),
        touched=False,
        start_mm=turn.point_mm(start),
        end_mm=turn.point_mm(way.point_mm(far)),
        position_bound_mm=bound,
        path_bound_mm=bound
        + run.largest_cross_track_error_mm(far)
        + undetected_dent_mm(run.finger.spec, closing),
    )


def _contact(run: ApproachState, patch: ContactPatch, closing: ClosingConfig, turn: Turn) -> Contact:
    """Contact with the tip's centre as if it just touched: the dent is taken back along the normal.

    Friction may have carried the felt contact round the tip, and the force bent what carries it: to which
    side is not known, so that both widen the bounds either way.
    """
    finger, tip = run.finger, run.finger.spec.tip
    kinematics = finger.kinematics
    facing = kinematics.facing_rad(run.servos) + turn.angle_rad
    normal = facing + math.radians(finger.spec.array.heading_deg) + patch.angle_rad + math.pi
    half = patch.angle_half_range_rad + kinematics.direction_bound_rad + turn.angle_bound_rad
    half += array_bound_rad(finger.spec)
    shallowest, deepest = dent_range_mm(patch.force_n, patch.force_bound_n, tip, closing.max_force_n)
    pressing = _pressing_n(patch, tip, closing)
    half += shear_rad(tip, pressing) + deflection_rad(finger.spec, pressing)
    dent = (deepest + shallowest) / 2
    if half >= math.pi:  # nothing is known of the normal: it may be dented to any side
        dent, shallowest = 0.0, deepest
    # In a notch the dent is along two normals and only one of them is known.
    sideways = deepest if may_touch_two_edges(patch) or half > math.pi / 2 else deepest * math.sin(half)
    x, y = turn.point_mm(run.centre_mm)
    surface = _bound_mm(run, turn) + (deepest - shallowest) / 2 + sideways
    bent = deflection_mm(finger.spec, pressing)
    bent_on_way = max(bent, deflection_mm(finger.spec, undetected_force_n(closing)))
    far = math.dist(run.start_mm, run.centre_mm)
    return Contact(
        name=finger.name,
        finger=finger_of(finger.spec),
        touched=True,
        start_mm=turn.point_mm(run.start_mm),
        end_mm=(x + dent * math.cos(normal), y + dent * math.sin(normal)),
        position_bound_mm=surface + bent,
        path_bound_mm=surface
        + bent_on_way
        + run.largest_cross_track_error_mm(far)
        + undetected_dent_mm(finger.spec, closing),
        normal=NormalRange(normal - half, normal + half) if half < math.pi else None,
    )
