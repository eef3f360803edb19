"""Everything that comes in from files, and what goes out as JSON: formats, checks, shipped rigs and models.

Files are read once at the start of the data's way and become frozen values. A file that is not usable is
an `InputError` with one line that names the file, the place, what is wrong and what is allowed.
"""

from palpate.config.contacts_file import ContactEntry, ContactsFile, GripEntry, Travel, load_contacts
from palpate.config.objects_file import ObjectModel, ObjectsFile, Polygon, Section, State, load_objects
from palpate.config.rig_checks import ARM_MARGIN_MM
from palpate.config.rig_file import (
    AimServo,
    AnyFinger,
    ArmFinger,
    Array,
    Bounds,
    Bus,
    Closing,
    Emulation,
    Finger,
    JointServo,
    Links,
    Obstacle,
    RigFile,
    Search,
    SlideServo,
    Stage,
    Tip,
    Workspace,
    load_rig,
)
from palpate.config.scene_file import Scene, load_scene
from palpate.config.shipped import shipped_objects, shipped_rig

__all__ = [
    "ARM_MARGIN_MM",
    "AimServo",
    "AnyFinger",
    "ArmFinger",
    "Array",
    "Bounds",
    "Bus",
    "Closing",
    "ContactEntry",
    "ContactsFile",
    "Emulation",
    "Finger",
    "GripEntry",
    "JointServo",
    "Links",
    "ObjectModel",
    "ObjectsFile",
    "Obstacle",
    "Polygon",
    "RigFile",
    "Scene",
    "Search",
    "Section",
    "SlideServo",
    "Stage",
    "State",
    "Tip",
    "Travel",
    "Workspace",
    "load_contacts",
    "load_objects",
    "load_rig",
    "load_scene",
    "shipped_objects",
    "shipped_rig",
]
