"""From a finger's part of the rig file to its servos on the bus, and what moves it. Called by the hand."""

import math

from palpate.config import Finger, RigFile
from palpate.drivers.dynamixel.bus import Bus
from palpate.drivers.dynamixel.servo import Servo
from palpate.drivers.finger import Servos
from palpate.rig.convert import kinematics_of
from palpate.rig.drives import Drive, SlideDrive
from palpate.rig.waiting import wait_distance_mm

__all__ = ["drive_of", "start_problem"]


def drive_of(spec: Finger, rig: RigFile, bus: Bus) -> Drive:
    """The servos of a finger, limited to its ranges, and what moves them."""
    kinematics = kinematics_of(spec)
    aims = [kinematics.aim_servo_rad(math.radians(value)) for value in spec.aim.range_deg]
    slides = [kinematics.slide_servo_rad(value) for value in spec.slide.range_mm]
    return SlideDrive(
        Servo(bus, spec.aim.dxl_id, spec.aim.model, range_rad=(min(aims), max(aims))),
        Servo(bus, spec.slide.dxl_id, spec.slide.model, range_rad=(min(slides), max(slides))),
        kinematics,
        wait_distance_mm(spec, rig.workspace.radius_mm),
        rig.closing.approach_speed_mm_s,
    )


def start_problem(
    spec: Finger,
    rig: RigFile,  # noqa: ARG001 - the arm's needs it
    servos: tuple[Servo, Servo],
    angles_rad: Servos,
) -> str | None:
    """Why a finger must not start from where it stands; None if it may.

    A slide must be retracted at the start: its servo knows its angle within one turn only.
    """
    distance = kinematics_of(spec).distance_mm(angles_rad[1])
    lo, hi = spec.slide.range_mm
    play = spec.slide.backlash_mm
    if lo - play <= distance <= hi + play:
        return None
    return (
        f"its slide (servo {servos[1].dxl_id}) stands at {distance:.1f} mm, outside its range "
        f"{lo:g} … {hi:g} mm; with torque off, push the finger back by hand until it is retracted within the "
        "servo's first turn, then start again"
    )
