"""Conversion of values in files to values of the layers: between `config` and `drivers` or `recognizer`.

Degrees become radians here, and nowhere else. Likewise, a tip's numbers become bounds: on dents, deflection,
shear, and undetected contact.
"""

import math
from collections.abc import Sequence

import numpy as np

from palpate.base.errors import InputError
from palpate.base.tips import TipShape
from palpate.config import (
    ArrayConfig,
    ClosingConfig,
    ContactsFile,
    FingerConfig,
    MountedArrayConfig,
    RigFile,
    TipConfig,
    WrappedArrayConfig,
)
from palpate.config.rig_servos import AimConfig, JointConfig, SlideConfig
from palpate.drivers.dynamixel import specification
from palpate.drivers.kinematics import Encoder, Line
from palpate.drivers.tactile import Corner, Description, Mounting, Shape
from palpate.recognizer import Approach, Contact, Finger, Goals, NormalRange

SHEAR_SHARE = 2 / 3
"""Of stiffnesses along and across a surface, at least: 2 (1 - v) / (2 - v), v up to 0.5."""

_MAX_FORCE_ERROR_SHARE = 0.9
_CROSSTALK_SHARE = 0.1  # of a force: what crosstalk and the array's edge add to the gains' spread


def grips_of(file: ContactsFile) -> list[list[Contact]]:
    """The contacts of every grip, misses included. Raises InputError where a path has no end."""
    grips = []
    for number, grip in enumerate(file.grips):
        contacts = []
        for entry in grip.contacts:
            end = entry.centre if entry.touched else entry.approach.end
            if end is None:
                raise InputError(f"grip {number}, finger {entry.finger}: no centre and no end")
            contacts.append(
                Contact(
                    name=entry.finger,
                    finger=Finger(entry.tip_radius, entry.height, entry.tip_length / 2, entry.tip_shape),
                    touched=entry.touched,
                    start_mm=entry.approach.start,
                    end_mm=end,
                    position_bound_mm=entry.position_bound,
                    path_bound_mm=entry.path_bound,
                    normal=None if entry.normal is None else NormalRange(*entry.normal),
                    friction=entry.friction,
                )
            )
        grips.append(contacts)
    return grips


def contacts_json(grips: Sequence[Sequence[Contact]]) -> dict[str, object]:
    """Contacts as `palpate/contacts@1`, misses included, grip by grip."""
    return {
        "format": "palpate/contacts@1",
        "units": "mm, rad",
        "grips": [{"contacts": [_contact(contact) for contact in grip]} for grip in grips],
    }


def _contact(contact: Contact) -> dict[str, object]:
    approach: dict[str, object] = {"direction": contact.direction_rad, "start": list(contact.start_mm)}
    entry: dict[str, object] = {
        "finger": contact.name,
        "touched": contact.touched,
        "height": contact.finger.height_mm,
        "tip_radius": contact.finger.tip_radius_mm,
        "position_bound": contact.position_bound_mm,
    }
    if contact.finger.half_length_mm:
        entry["tip_length"] = 2 * contact.finger.half_length_mm
    if contact.finger.shape is not TipShape.CYLINDER:
        entry["tip_shape"] = str(contact.finger.shape)
    if contact.friction is not None:
        entry["friction"] = contact.friction
    if contact.path_bound_mm is not None:
        entry["path_bound"] = contact.path_bound_mm
    if contact.touched:
        entry["centre"] = list(contact.end_mm)
        if contact.normal is not None:
            entry["normal"] = [contact.normal.lo_rad, contact.normal.hi_rad]
    else:
        approach["end"] = list(contact.end_mm)
    return entry | {"approach": approach}


def finger_of(finger: FingerConfig) -> Finger:
    """Finger as far as it decides which grown section it meets."""
    tip = finger.tip
    return Finger(tip.radius_mm, finger.height_mm, tip.half_length_mm, tip.shape)


def line_of(approach: Approach) -> Line:
    """The line of an approach, without its end."""
    return Line(approach.start_mm, approach.direction_rad)


def first_corner(array: ArrayConfig) -> Corner:
    """Corner of the tip at which an array begins to count."""
    return Corner(array.first_texel or "lower-left")


def mounting_of(array: MountedArrayConfig, tip_radius_mm: float) -> Mounting:
    """Mounting of an array that does not describe itself."""
    return Mounting(
        shape=Shape.FLAT if array.shape == "flat" else Shape.CYLINDER,
        tip_radius_mm=tip_radius_mm,
        counts_per_n=array.counts_per_n,
        first=first_corner(array),
        upright=array.first_row == "upright",
    )


def wrapped_description(
    array: WrappedArrayConfig,
    tip_radius_mm: float,
    name: str,
    *,
    counts_per_n: float,
    bit_depth: int,
    emulated: bool,
) -> Description:
    """Description of a sensor that is wrapped round an upright tip; `name` is its firmware's and its id."""
    steps = np.arange(array.columns) - (array.columns - 1) / 2
    angle = steps * math.radians(array.column_step_deg)
    normal = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    normals = np.broadcast_to(normal, (len(array.row_heights_mm), *normal.shape))
    place = tip_radius_mm * normals
    place[..., 2] = np.array(array.row_heights_mm)[:, None]
    return Description(
        unique_id=name.encode()[:16].ljust(16, b"\0"),
        firmware=name,
        emulated=emulated,
        shape=Shape.FREE,
        rows=len(array.row_heights_mm),
        cols=array.columns,
        bit_depth=bit_depth,
        max_rate_hz=array.rate_hz,
        full_scale_n=((1 << bit_depth) - 1) / counts_per_n,
        counts_per_n=counts_per_n,
        tip_radius_mm=0.0,
        columns=(),
        row_heights_mm=(),
        geometry=tuple(np.concatenate([place, normals], axis=2).ravel().tolist()),
    )


def check_cells(array: WrappedArrayConfig, cells: Description) -> None:
    """Refuse an emulated sensor whose cells are not `cells`, on which the bench presses, with InputError."""
    rows = len(array.row_heights_mm)
    if (cells.rows, cells.cols) != (rows, array.columns):
        raise InputError(
            f"emulated arrays have {cells.rows} rows and {cells.cols} columns, and the rig file says "
            f"{rows} and {array.columns}"
        )


def slide_force_n(slide: SlideConfig, current_a: float) -> float:
    """Force (N) along a slide for a current of its servo, by the maker's stall torque over stall current."""
    motor = specification(slide.model).motor
    return 1e3 * motor.stall_torque_nm / motor.stall_current_a * current_a / abs(slide.mm_per_rad)


def calibrated_direction_rad(finger: FingerConfig) -> float | None:
    """Bound on the finger's direction that a calibration found; None without one."""
    found = finger.bounds.direction_deg
    return None if found is None else math.radians(found)


def encoder_of(finger: FingerConfig, servo: AimConfig | SlideConfig | JointConfig) -> Encoder:
    """Encoder of one of a finger's servos."""
    a, b, c, d = (math.radians(value) for value in servo.encoder_harmonics_deg)
    return Encoder((a, b, c, d), math.radians(finger.bounds.encoder_deg))


def tip_bound_mm(finger: FingerConfig) -> float:
    """Distance by which the tip's surface may be further off than its centre: what its radius may be off."""
    # What a calibration finds of the place is of the surface: touches show nothing else.
    tip = finger.tip
    if tip.kind.has_face:
        return 0.0  # its face is where the tip is, however wide it is
    found = 0.0 if finger.bounds.position_mm is None else tip.radius_bound_mm
    if tip.least_share == 1.0:
        return tip.radius_bound_mm - found
    # A smaller circle that touches is off by more than the tip is, and calibration touches at the equator.
    least, off = tip.least_share * tip.radius_mm, tip.radius_bound_mm
    away = math.sqrt(tip.radius_mm**2 - least**2)
    return least - math.sqrt(max((tip.radius_mm - off) ** 2 - away**2, 0.0)) - found


def softest_n_per_mm(tip: TipConfig) -> float:
    """Least force that an array shows for a mm by which a tip is pressed aside.

    Beside a ball's equator its skin is dented by a share of that only.
    """
    return tip.stiffness_n_per_mm * (1 - tip.stiffness_spread) * tip.least_share


def stiffest_n_per_mm(tip: TipConfig) -> float:
    """Greatest force that an array shows for a mm by which a tip is pressed aside."""
    return tip.stiffness_n_per_mm * (1 + tip.stiffness_spread)


def array_bound_rad(finger: FingerConfig) -> float:
    """Angle by which an array, turned on its tip, may be further off than the finger's direction."""
    return math.radians(finger.array.heading_bound_deg) if finger.bounds.direction_deg is None else 0.0


def undetected_force_n(closing: ClosingConfig) -> float:
    """Force with which something may have pressed on a moving tip without being felt.

    Twice the contact threshold: the quick guard leaves out what is below each taxel's noise, and gains vary.
    """
    return 2 * closing.contact_force_n


def largest_on_skin_n(tip: TipConfig, closing: ClosingConfig) -> float:
    """Greatest force that an array may show: a ball's skin may bear more than its finger presses with."""
    return closing.max_force_n / tip.least_share


def undetected_dent_mm(finger: FingerConfig, closing: ClosingConfig) -> float:
    """Depth to which something may have dented a moving tip without being felt.

    Pads are refused whose arrays may miss more than the threshold, spread over the whole face
    (`threshold_problem`); both may be read too low by what gains may be off.
    """
    read_share = 1 - finger.array.gain_spread if finger.tip.kind.has_face else 1.0
    return undetected_force_n(closing) / read_share / softest_n_per_mm(finger.tip)


def shear_rad(tip: TipConfig, pressing_n: float) -> float:
    """Angle round the tip by which friction may have carried the skin at most, under `pressing_n`.

    Skin sticks up to friction times that force, and its stiffness along the surface is `SHEAR_SHARE` of that
    across it or more (Mindlin 1949; Johnson, Contact Mechanics, ch. 7).
    """
    softest = SHEAR_SHARE * softest_n_per_mm(tip)
    return tip.max_friction * pressing_n / softest / (tip.radius_mm - tip.radius_bound_mm)


def deflection_mm(finger: FingerConfig, pressing_n: float) -> float:
    """Deflection of what carries a tip under a force: measured is what presses, friction comes on top."""
    return finger.bounds.deflection_mm_per_n * _force_with_friction_n(finger.tip, pressing_n)


def deflection_rad(finger: FingerConfig, pressing_n: float) -> float:
    """Angle by which that may turn the array."""
    return math.radians(finger.bounds.deflection_deg_per_n) * _force_with_friction_n(finger.tip, pressing_n)


def _force_with_friction_n(tip: TipConfig, pressing_n: float) -> float:
    return pressing_n * math.hypot(1.0, tip.max_friction)


def measured_force_share(finger: FingerConfig) -> float:
    """Share of a force by which it may be mismeasured: gains' spread, crosstalk and the array's edge."""
    return min(finger.array.gain_spread + _CROSSTALK_SHARE, _MAX_FORCE_ERROR_SHARE)


def goals_of(rig: RigFile) -> Goals:
    """Goals that the rig file calls fine enough."""
    return Goals(rig.search.goal_position_mm, math.radians(rig.search.goal_orientation_deg))
