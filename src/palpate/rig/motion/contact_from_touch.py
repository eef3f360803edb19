"""Contact or miss, in W with its bounds, from the state of an approach and the patch on the array."""

import math
from dataclasses import dataclass

from palpate.base.vocabulary.short_repr import ShortRepr
from palpate.config import ClosingConfig, TipConfig
from palpate.drivers.finger import Line, Servos, Turn
from palpate.drivers.tactile.contact import ContactPatch, PatchFlag
from palpate.recognizer import Contact, NormalRange
from palpate.rig.conversion import (
    array_bound_rad,
    deflection_mm,
    deflection_rad,
    finger_of,
    largest_on_skin_n,
    shear_rad,
    softest_n_per_mm,
    stiffest_n_per_mm,
    tip_bound_mm,
    undetected_dent_mm,
    undetected_force_n,
)
from palpate.rig.motion.approach_state import ApproachState
from palpate.rig.motion.contact_load import ContactLoad, LoadTrace
from palpate.rig.motion.pad_touch import PadTouch, face_contact, face_points_of, touched_points

__all__ = ["Touch", "conclude", "dent_range_mm", "may_touch_two_edges"]

_MOST_EDGES = 3  # that a disc of given size meets at once
_TWO_EDGES = frozenset({PatchFlag.WIDE, PatchFlag.SEVERAL_PATCHES})


@dataclass(frozen=True, repr=False)
class Touch(ShortRepr):
    """What came of it: the contact for the recogniser, and the patch that it rests on (None for a miss).

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
    if run.finger.spec.tip.is_pad:
        return _of_pad(run, patch, closing, turn)
    contact = _miss(run, closing, turn) if patch is None else _contact(run, patch, closing, turn)
    return Touch(run.approach.finger_index, contact, patch, run.servos, stage_rad=turn.angle_rad)


def _of_pad(run: ApproachState, patch: ContactPatch | None, closing: ClosingConfig, turn: Turn) -> Touch:
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
    """How hard the tip may be pressed, all its patches together: this one is the strongest."""
    if tip.is_pad and PatchFlag.SEVERAL_PATCHES in patch.flags:
        return closing.max_force_n
    edges = _MOST_EDGES if PatchFlag.SEVERAL_PATCHES in patch.flags else 1
    return min(edges * (patch.force_n + patch.force_bound_n), largest_on_skin_n(tip, closing))


def may_touch_two_edges(patch: ContactPatch) -> bool:
    """Whether a tip may be dented along two normals, as in a notch."""
    return bool(patch.flags & _TWO_EDGES)


def _bound_mm(run: ApproachState, turn: Turn) -> float:
    """How far the tip's surface may be off anywhere on its way, by the mechanics and its radius alone."""
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
    """Where the tip's centre would be if it just touched: the dent is taken back along the normal.

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
