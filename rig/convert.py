"""From files' values to the layers' values: what lies between `config` and `drivers` or `recognizer`.

Degrees become radians here, and nowhere else.
"""

import math

from palpate.config import ContactsFile, ObjectsFile, RigFile
from palpate.config import Finger as FingerFile
from palpate.drivers.finger import FingerKinematics
from palpate.errors import InputError
from palpate.recognizer import (
    Contact,
    Finger,
    Goals,
    NormalRange,
    ObjectModel,
    Polygon,
    Resolution,
    Section,
    State,
)

_NORMAL_HALF_RAD = math.radians(12.5)  # of 291 touches of the emulated bench none was blunter than 11.5°

__all__ = ["finger_of", "goals_of", "grips_of", "kinematics_of", "models_of", "resolution_of"]


def models_of(objects: ObjectsFile) -> list[ObjectModel]:
    """The catalogue's objects as the recogniser wants them."""
    return [
        ObjectModel(
            item.name,
            tuple(
                State(
                    state.name,
                    tuple(
                        Section(*section.z_mm, tuple(Polygon(p.outer, p.holes) for p in section.polygons))
                        for section in state.sections
                    ),
                )
                for state in item.states
            ),
            item.tolerance_mm,
        )
        for item in objects.objects
    ]


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
                    finger=Finger(entry.tip_radius, entry.height),
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


def finger_of(finger: FingerFile) -> Finger:
    """What of a finger decides which grown section it meets."""
    return Finger(finger.tip.radius_mm, finger.height_mm)


def kinematics_of(finger: FingerFile) -> FingerKinematics:
    """Kinematics of a finger. The file counts servo angles from Goal Position 0, the drivers from 2048."""
    mm_per_rad = finger.slide.mm_per_turn / (2 * math.pi)
    return FingerKinematics(
        base_mm=finger.base_mm,
        heading_rad=math.radians(finger.heading_deg),
        gear_ratio=finger.aim.gear_ratio,
        aim_zero_rad=math.radians(finger.aim.zero_deg) - math.pi,
        mm_per_rad=mm_per_rad,
        zero_mm=finger.slide.zero_mm + mm_per_rad * math.pi,
        base_bound_mm=finger.bounds.base_mm,
        heading_bound_rad=math.radians(finger.bounds.heading_deg),
        aim_play_rad=math.radians(finger.aim.backlash_deg),
        slide_play_mm=finger.slide.backlash_mm,
    )


def resolution_of(rig: RigFile) -> Resolution:
    """What the rig can feel, for planning: by how much two measurements of one thing may differ."""
    bounds = []
    for finger in rig.fingers:
        kinematics = kinematics_of(finger)
        middle = math.hypot(*finger.base_mm)
        # A measured contact adds its dent's uncertainty, at the threshold's force, to the kinematics' bound.
        dent = rig.closing.contact_force_n / finger.tip.stiffness_n_per_mm
        bounds.append(kinematics.position_bound_mm(middle) + dent)
    return Resolution(distance_mm=2 * max(bounds), normal_half_rad=_NORMAL_HALF_RAD)


def goals_of(rig: RigFile) -> Goals:
    """What the rig file calls fine enough."""
    return Goals(rig.search.goal_position_mm, math.radians(rig.search.goal_orientation_deg))
